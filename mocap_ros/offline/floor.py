# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The people of one recording on one floor, under one vertical, and in one world.

Live, each person is put on a known floor by a recursion over frames (`tracking.body_size`). Whole sequences do not
have it: forwards and backwards over 12 views of people in no training, with points as of detectors, it puts them
114 mm from their places (146 mm where the vertical is found, too), and the least squares of `solvers.floor` 94 mm
(131 mm). Those weigh heels and toes of all frames at once, and also find where several people stand.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.config import TrackerConfig
from mocap_ros.geometry.level import (
    CALIBRATED_TILT_STD,
    MAX_CERTAIN_STD,
    Floor,
    average_vertical,
    build_world,
)
from mocap_ros.offline.whole_sequence import Solved, assume_size_share
from mocap_ros.people import PoseSequence
from mocap_ros.skeleton import CORE_COUNT
from mocap_ros.solvers.floor import SIZE_RANGE, Stander, fit_floor
from mocap_ros.solvers.posture import find_postures, measure_likelihood
from mocap_ros.solvers.vertical import read_given_vertical

MEASURED_SHARE = 0.015  # 1; standard deviation of sizes that depths show, by surfaces and the depth camera
MIN_TILT_STD = 1e-3  # rad; a smaller deviation of a vertical is not believed
USUAL_SIZES = 0.75, 1.2  # 1; three standard deviations of the size of adults
UNUSUAL = 'makes a person {:.2f} times as tall as tracker.body_height: one of both is wrong, or it is a child'
# why `tracker.camera_height` is not used where feet show another one
WRONG_HEIGHT = (
    f'is not used: by it people are not {SIZE_RANGE[0]:g} to {SIZE_RANGE[1]:g} times as tall as '
    'tracker.body_height; check both'
)


def share_floor(found: Sequence[Solved], config: TrackerConfig) -> tuple[list[PoseSequence], list[str]]:
    """Return people of one recording on one floor, under one vertical, and in one world, that of the first.

    `tracker.camera_height` shows their true sizes; what is wrong with it for some people is returned in words.
    Where it is not known, the sizes of several become those with which all stand on the floor.
    """
    people = [person.poses for person in found]
    known = [(p, average_vertical(p.vertical, p.vertical_std)) for p in people]
    known = [(p, upward) for p, upward in known if np.isfinite(upward).all()]
    trust = np.array([max(float(np.nanmean(p.vertical_std)), MIN_TILT_STD) ** -2 for p, _ in known])
    total = np.sum([t * upward for t, (_, upward) in zip(trust, known, strict=True)], axis=0)
    length = float(np.linalg.norm(total))
    agree = length > trust.sum() / 2  # opposite verticals show none
    vertical = total / length if agree else np.full(3, np.nan)
    std = float(trust.sum()) ** -0.5 if agree else math.nan
    tilt_std = std if std <= MAX_CERTAIN_STD else math.nan
    if read_given_vertical(config) is not None:
        std = tilt_std = CALIBRATED_TILT_STD
    standing: list[_Standing] = []
    fault = ''
    if config.camera_height > 0:
        is_focal_known = all(p.is_scale_known for p in people)
        fault = find_height_fault(is_focal_known=is_focal_known, tilt_std=std)
        if not fault:
            standing = _stand_on(found, Floor(vertical, config.camera_height, tilt_std), config)
            fault = next((s.height_fault for s in standing if s.floor is None), '')
    if not any(s.floor for s in standing):
        standing = [
            s._replace(height_fault=s.height_fault or fault)
            for s in _stand_on(found, Floor(vertical, None, tilt_std), config)
        ]
    first = next((s for s in standing if s.floor is not None), standing[0])
    world = first.build_world()
    people = [
        replace(
            _name_postures(s.poses),
            world_from_camera=world if len(standing) > 1 else s.build_world(),
            floor_std=math.nan if s.floor is None else s.floor.height_std,
            predicted=np.asarray(s.poses.inferred[:, :CORE_COUNT].all(axis=1)),
        )
        for s in standing
    ]
    return people, [words for words in dict.fromkeys(s.height_fault for s in standing) if words]


def _name_postures(poses: PoseSequence) -> PoseSequence:
    likelihood = measure_likelihood(poses.joints, poses.inferred, poses.vertical, poses.vertical_std)
    posture, probability = find_postures(poses.times, likelihood)
    return replace(poses, posture=posture, posture_probability=probability)


class _Standing(NamedTuple):
    """One person's poses of the size that the floor shows, and the floor; None if nothing shows it."""

    poses: PoseSequence
    floor: Floor | None = None
    height_fault: str = ''

    def build_world(self) -> Array:
        poses = self.poses
        if self.floor is not None:
            return build_world(poses.joints, self.floor.upward, self.floor.camera_height)
        return build_world(poses.joints, average_vertical(poses.vertical, poses.vertical_std), None)


def _stand_on(found: Sequence[Solved], before: Floor, config: TrackerConfig) -> list[_Standing]:
    """Return people on a floor, of the sizes that it shows; who cannot be of such a size has a fault instead."""
    share = assume_size_share(config)
    standers = [
        Stander(s.poses.joints, s.contact, s.poses.times, MEASURED_SHARE if s.is_size_measured else share)
        for s in found
    ]
    fit = fit_floor(standers, before)
    if fit is None:
        floor = before if before.camera_height else None
        return [_Standing(s.poses, floor, s.height_fault) for s in found]
    people = []
    sizes = fit.sizes[~np.isnan(fit.sizes)]
    is_scale_shown = before.camera_height is not None or len(sizes) > 1
    if before.camera_height is None and (np.abs(sizes - 1) > 3 * share).any():
        return [_Standing(s.poses, None, s.height_fault) for s in found]  # they rather stand at different heights
    for p, (person, size) in enumerate(zip(found, fit.sizes.tolist(), strict=True)):
        poses, fault = person.poses, person.height_fault
        if not SIZE_RANGE[0] < (1.0 if math.isnan(size) else size) < SIZE_RANGE[1]:
            people.append(_Standing(poses, None, WRONG_HEIGHT if before.camera_height else ''))
            continue
        if is_scale_shown:
            vertical = np.tile(fit.floor.upward, (len(poses), 1))
            poses = replace(poses, vertical=vertical, vertical_std=np.full(len(poses), fit.floor.tilt_std))
        if is_scale_shown and not math.isnan(size) and not person.is_size_measured:
            poses = replace(
                poses,
                joints=fit.place(p, poses.joints),
                joint_std=size * poses.joint_std,
                root_covariance=size * size * poses.root_covariance,
                body_height=size * poses.body_height,
            )
            if before.camera_height and not USUAL_SIZES[0] < size < USUAL_SIZES[1]:
                fault = UNUSUAL.format(size)
        people.append(_Standing(poses, fit.floor, fault))
    return people


def find_height_fault(*, is_focal_known: bool, tilt_std: float) -> str:
    """Return why a known height of the camera is of no use, in words; `tilt_std` of the vertical in rad."""
    if not is_focal_known:
        return 'is not used: the focal length is not known, and distances with it'
    return '' if tilt_std <= MAX_CERTAIN_STD else 'is not used: the vertical is not known: give tracker.vertical'
