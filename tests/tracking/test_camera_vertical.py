# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The vertical of the camera: found, given, contradicted, forgotten, and of use."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mocap_ros.config import Config, with_values
from mocap_ros.demo.scene import make_recording
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.models.model_file import load_base_pose_models
from mocap_ros.offline.whole_sequence import SequenceResult, reconstruct_sequence
from mocap_ros.people import CameraVertical, Person3D
from mocap_ros.tracking.tracker import Tracker
from mocap_ros.tracking.vertical_check import LEAST_S, VerticalCheck
from tests.support.bodies import UPRIGHT, angles_deg, make_person_3d

SEQUENCE = make_recording().sequence()
CAMERA = SEQUENCE.intrinsics(1.0)
MODELS = load_base_pose_models('all')
FRAMES = 60


def make_tracker(**values: object) -> Tracker:
    return Tracker(MODELS, with_values(Config(), {f'tracker.{k}': v for k, v in values.items()}))


def feed(tracker: Tracker, first: int, last: int, camera: Intrinsics = CAMERA) -> list[np.ndarray]:
    """Return the joints of one person in some frames of the demo."""
    given = [(SEQUENCE.stamps_ns[frame], [SEQUENCE.person(frame, 'ann')], camera) for frame in range(first, last)]
    return [tracker.update(*frame)[-1].joints for frame in given]


def reconstruct(vertical: str, frames: int = FRAMES) -> SequenceResult:
    keypoints = SEQUENCE.keypoints[:frames].astype(float)
    config = with_values(Config(), {'tracker.vertical': vertical})
    times = SEQUENCE.timestamps[:frames]
    return reconstruct_sequence(keypoints, SEQUENCE.joint_names, times, CAMERA, MODELS, config)


def find(tracker: Tracker) -> CameraVertical:
    assert tracker.vertical is not None
    return tracker.vertical


def test_it_is_found_from_certain_people_and_is_that_of_the_whole_sequence() -> None:
    tracker = make_tracker()
    feed(tracker, 0, 2)
    assert tracker.vertical is None, 'a tentative person may be none'
    feed(tracker, 2, 4)
    early = find(tracker)
    feed(tracker, 4, FRAMES)
    late, whole = find(tracker), reconstruct('auto')
    assert late.std < early.std
    assert np.linalg.norm(late.direction) == pytest.approx(1)
    assert late.direction[1] < -0.9, 'y is down in the camera, which is nearly level'
    assert angles_deg(late.direction, whole.vertical[-1]) < 3
    assert late.std == pytest.approx(whole.vertical_std[-1], rel=0.2)


def test_another_camera_or_a_restart_forgets_what_was_found_and_a_little_drift_does_not() -> None:
    steady, drifting = make_tracker(), make_tracker()
    x, y = CAMERA.center
    for frame in range(FRAMES):
        focal = CAMERA.focal * (1 + 5e-4 * (-1) ** frame)
        near = replace(CAMERA, focal=focal, center=(x + 0.1, y)) if frame else CAMERA
        np.testing.assert_array_equal(feed(drifting, frame, frame + 1, near), feed(steady, frame, frame + 1))
    known = find(steady).std
    assert find(drifting).std == known
    feed(steady, FRAMES, FRAMES + 1, replace(CAMERA, focal=1.002 * CAMERA.focal))
    feed(drifting, FRAMES, FRAMES + 1, replace(CAMERA, center=(x + 0.002 * CAMERA.focal, y)))
    assert min(find(steady).std, find(drifting).std) > known
    drifting.reset()
    assert drifting.vertical is None


def test_a_given_vertical_stays_and_turns_people() -> None:
    tilted = make_tracker(vertical='0 -0.9397 -0.3420')  # the camera looks down by 20 degrees, which is not true
    plain = make_tracker(vertical='none')
    joints = feed(tilted, 0, 30)[-1], feed(plain, 0, 30)[-1]
    assert find(tilted).direction == pytest.approx([0, -0.9397, -0.3420], abs=1e-3)
    assert plain.vertical is None
    trunks = [(j[1] - j[8]) / np.linalg.norm(j[1] - j[8]) for j in joints]  # neck less pelvis
    assert trunks[0][2] < trunks[1][2] - 0.02, 'the upper body is nearer to the camera'
    tilted.reset()
    assert tilted.vertical is not None
    given, none = reconstruct('0 -1 0', 10), reconstruct('none', 10)
    assert np.array_equal(given.vertical, np.tile([0.0, -1.0, 0.0], (10, 1)))
    assert given.vertical_std == pytest.approx(np.full(10, math.radians(1)))
    assert np.isnan(none.vertical).all()


UP = np.array([0.0, 0.0, 1.0])
STEP_NS = 100_000_000


def make_leaning(angle_deg: float) -> Person3D:
    turn = Rotation.from_rotvec([np.radians(angle_deg), 0, 0])
    return replace(make_person_3d('anna'), joints=turn.apply(UPRIGHT))


def advance(check: VerticalCheck, people: list[Person3D], seconds: float, first: int = 0) -> float | None:
    found = None
    for frame in range(first, first + round(seconds * 10)):
        found = check.advance(frame * STEP_NS, people, UP)
    return found


@given(st.floats(0, 180))
@settings(max_examples=30)
def test_the_angle_between_people_and_the_vertical_decides(angle_deg: float) -> None:
    found = advance(VerticalCheck(), [make_leaning(angle_deg)], LEAST_S + 3)
    if angle_deg < 33:
        assert found is None
    if angle_deg > 47:
        assert found == pytest.approx(angle_deg, abs=6)  # as the body stands a little behind its feet


def test_it_takes_a_while_and_who_stands_among_people_who_lie_confirms_it() -> None:
    assert advance(VerticalCheck(), [make_leaning(180)], LEAST_S - 0.5) is None
    assert advance(VerticalCheck(), [make_leaning(90), make_leaning(0)], 20) is None
    unsure = replace(make_leaning(180), tentative=True), replace(make_leaning(180), predicted=True)
    assert advance(VerticalCheck(), [*unsure], 20) is None
    check = VerticalCheck()
    assert advance(check, [make_leaning(0)], 10) is None
    assert advance(check, [make_leaning(90)], 5, 100) is None, 'a person who lies down'
    assert advance(check, [make_leaning(90)], 60, 150) is not None


def test_it_holds_at_any_rate_and_begins_anew_with_the_stamps() -> None:
    lying = [make_leaning(180)]
    for hz in (1, 2, 5, 200):
        check = VerticalCheck()
        assert [check.advance(i * 10**9 // hz, lying, UP) for i in range(10 * hz)][-1] is not None
    assert check.advance(0, lying, UP) is None, 'the stamps began anew'
    assert not any(VerticalCheck().advance(t, lying, UP) for t in range(0, 10**12, 60 * 10**9))
