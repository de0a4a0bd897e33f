# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Scenes of people who swing their limbs before a camera, and pages that tests look at with Playwright."""

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.people import MotionKind, PoseSequence
from mocap_ros.skeleton import CMU15
from mocap_ros.units import NS_PER_S
from mocap_ros.viewing.scene import Mark, Scene, SceneKeypoints, project_joints
from tests.support.bodies import make_swinging_body

INTRINSICS = Intrinsics(600.0, (320.0, 240.0), is_focal_known=True)
STEP_NS = 33_333_333  # ns between two frames; about 30 Hz


def make_scene_person(person_id: str, frames: Sequence[int], place: Sequence[float]) -> PoseSequence:
    """Return a person who stands at a place (3,) in m in the given frames."""
    joints = make_swinging_body(len(frames))[0] + np.asarray(place)
    count = len(frames)
    return PoseSequence(
        id=person_id,
        times=np.asarray(frames) * STEP_NS / NS_PER_S,
        skeleton=CMU15,
        joints=joints,
        joint_std=np.full((count, 15), 0.05),
        inferred=np.zeros((count, 15), bool),
        intrinsics=INTRINSICS,
        reprojection_residual=np.linspace(2, 3, count),
        cadence=np.full(count, 0.9),
        motion=np.full(count, MotionKind.PERIODIC, np.uint8),
        predicted=np.zeros(count, bool),
        tentative=np.zeros(count, bool),
        contact=np.tile([1.0, 0.0], (count, 1)),
        recorded_ns=tuple(frame * STEP_NS for frame in frames),
    )


def make_keypoints(people: Sequence[PoseSequence]) -> SceneKeypoints:
    frames = np.concatenate([np.array(person.stamps_ns) // STEP_NS for person in people])
    order = np.argsort(frames, kind='stable')
    points = np.concatenate([project_joints(person) for person in people])[order]
    return SceneKeypoints(CMU15, frames[order], points)


def make_scene(frames: int = 40) -> Scene:
    """Return two people, of whom the second comes later and is predicted at the end, and a drop."""
    anna = make_scene_person('anna', range(frames), (-0.7, 0.1, 4.0))
    ben = make_scene_person('<b>en', range(frames // 2, frames), (0.8, 0.0, 5.0))
    anna.inferred[:, 4] = True
    ben.predicted[-3:] = True
    return Scene(
        title='two </script> people',
        stamps_ns=[frame * STEP_NS for frame in range(frames)],
        people=(anna, ben),
        keypoints=(make_keypoints([anna, ben]),),
        image_size=(640, 480),
        intrinsics=INTRINSICS,
        marks=(Mark(0.5, 'too late'),),
    )


def count_colours(png: bytes) -> int:
    """Return the number of different colours in a picture, which is 1 where nothing was drawn."""
    return len(np.unique(np.asarray(Image.open(BytesIO(png)).convert('RGB')).reshape(-1, 3), axis=0))


def write_and_open(page: Any, path: Path, text: str) -> None:
    """Write a page to a file and open it as a user would, without a server."""
    path.write_text(text, encoding='utf-8')
    page.goto(path.as_uri())
