# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Whether keypoints are what they are said to be: layout, axes, left and right, and the size of the image.

The lifter estimates how uncertain its poses are. Read as another layout, or mirrored, the same points make poses
that it has not seen, and it is less certain. The uncertainty of a reading of the points in a few frames is

    u = median_t mean_jk log(sigma_tjk / r_t)

with sigma the standard deviations of the core joints and r_t the mean distance of the lifted joints from their
mean. Readings are compared in stretches of `STRETCH_S`, as the mean of u over the stretches.

The limits were set on the recorded detections and on 400 views of motion capture from all sides, with clean points
and with the errors of three detectors: u of sound points is -2.8 to -1.7, of shuffled or shifted joints -1.9 to
-0.5, and another layout than the right one has at least 0.5 more. Sound points that are read as lying or upside
down have at most 0.07 less than upright, mirrored ones 0.2 less.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from enum import Enum, IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.virtual_camera import VirtualCamera
from mocap_ros.keypoints.extremities import convert_body_to_rays, join_body
from mocap_ros.keypoints.validation import MAX_SHARE_OUTSIDE
from mocap_ros.models.lifter import Lifter
from mocap_ros.models.lifter_input import sample_histories
from mocap_ros.skeleton import CORE_COUNT, KEYPOINT_LAYOUTS, keypoint_layout

Array = NDArray[np.float64]

STRETCH_S = 1.5  # s; the lifter sees 0.8 s
MAX_STRETCHES = 3  # of a recording: its beginning, its middle and its end
LIFTED_FRAMES = 8  # frames of a stretch that are lifted, in its second half
MIN_SEEN_JOINTS = 6  # joints that must be seen in a frame that counts
MIN_FRAMES = 5  # frames with as many, or a stretch says nothing
VIEW_SMOOTHING_S = 3.0  # s; as of the reconstruction
UNIT_CAMERA = Intrinsics(1.0, (0.0, 0.0), is_focal_known=True)  # whose px are rays

MAX_UNCERTAINTY = -1.65  # u; above it, points hardly look like a person in that layout
# 1; residuals over the body height. Sound recordings have at most 0.06, and 0.04 where u is above the limit.
NEAR_SHARE, FAR_SHARE, WRONG_SHARE = 0.045, 0.075, 0.1
LAYOUT_MARGIN = 0.35  # u by which another layout must be more certain
MIN_LAYOUT_UNCERTAINTY = -1.85  # u above which other layouts are considered
TURN_MARGIN = 0.12  # u by which a turned image must be more certain
AXES_MARGIN = 0.05  # u by which a mirrored and turned image must be more certain than a turned one
MIRROR_MARGIN = 0.25  # u by which a mirrored image must be more certain


class Grade(IntEnum):
    """How sound the input of a reconstruction is."""

    GOOD = 0
    DOUBTFUL = 1
    WRONG = 2


class Fault(Enum):
    """What is wrong with keypoints."""

    NONE = ''
    UNKNOWN = 'unknown'  # too little was seen to be judged
    OUTSIDE = 'outside'  # most points lie outside the image
    LAYOUT = 'layout'  # another known layout fits
    MISFIT = 'misfit'  # no known layout fits, or the fit is bad
    AXES = 'axes'  # x and y are exchanged
    Y_UP = 'y up'  # y points upwards
    MIRRORED = 'mirrored'  # left and right are exchanged
    TURNED = 'turned'  # people lie on their side, or are upside down


class Judgement(NamedTuple):
    """A grade, why it is not good, and the layout that fits instead of the given one, if there is any."""

    grade: Grade
    fault: Fault = Fault.NONE
    layout: str = ''


class Reading(NamedTuple):
    """A way to read keypoints: the layout, empty as it is given; quarter turns clockwise; mirrored before them."""

    layout: str = ''
    turns: int = 0
    is_mirrored: bool = False


GIVEN = Reading()
TURNED = tuple(Reading(turns=turns) for turns in (1, 2, 3))  # quarter turns clockwise
MIRRORED = {Reading(turns=turns, is_mirrored=True): fault for turns, fault in enumerate(
    (Fault.MIRRORED, Fault.TURNED, Fault.Y_UP, Fault.AXES))}  # fmt: skip


class Stretch(NamedTuple):
    """Keypoints of one person in some frames: rays and scores (F, J, 3), names (J,), and times (F,) in s."""

    keypoints: Array
    names: tuple[str, ...]
    times: Array


def list_readings(names: tuple[str, ...]) -> list[Reading]:
    """Return all ways to read keypoints of these names: as given, turned, mirrored, or as another layout."""
    layouts = [s.name for s in KEYPOINT_LAYOUTS.values() if len(s.joints) == len(names) and s.joints != names]
    return [GIVEN, *TURNED, *MIRRORED, *map(Reading, layouts)]


def make_stretch(keypoints: Array, names: tuple[str, ...], times: Array, intrinsics: Intrinsics) -> Stretch | None:
    """Return keypoints (F, J, 3), x and y in px and the score, as a stretch; None if too little was seen."""
    seen = (keypoints[..., 2] > 0).sum(axis=1) >= MIN_SEEN_JOINTS
    if seen.sum() < MIN_FRAMES:
        return None
    rays = intrinsics.pixels_to_rays(np.nan_to_num(keypoints[..., :2]))
    return Stretch(np.concatenate([rays, keypoints[..., 2:]], axis=-1), names, times)


def cut_stretches(keypoints: Array, names: tuple[str, ...], times: Array, intrinsics: Intrinsics) -> list[Stretch]:
    """Return stretches of a recording of one person; arguments as of `make_stretch`."""
    seen = np.flatnonzero((keypoints[..., 2] > 0).sum(axis=1) >= MIN_SEEN_JOINTS)
    if not len(seen):
        return []
    starts = np.linspace(times[seen[0]], max(times[seen[-1]] - STRETCH_S, times[seen[0]]), MAX_STRETCHES)
    cuts = {tuple(np.searchsorted(times, [s, s + STRETCH_S]).tolist()) for s in starts}
    found = [make_stretch(keypoints[a:b], names, times[a:b], intrinsics) for a, b in sorted(cuts)]
    return [stretch for stretch in found if stretch is not None]


def measure_uncertainty(
    stretch: Stretch, reading: Reading, upright_turns: int, lifter: Lifter, score: float
) -> float:
    """Return u of a reading (formula of the module); infinite where the lifter has no pose.

    Args:
        stretch: the keypoints.
        reading: how to read them.
        upright_turns: quarter turns clockwise after which the camera is upright, as far as it is known.
        lifter: the lifter.
        score: least score of a point that counts as seen.
    """
    points, names = stretch.keypoints[..., :2], stretch.names
    points = _turn(points, upright_turns)
    points = points * [-1.0, 1.0] if reading.is_mirrored else points
    points = _turn(points, reading.turns)
    names = keypoint_layout(reading.layout).joints if reading.layout else names
    core, weight, extremities = convert_body_to_rays(points, stretch.keypoints[..., 2], names, UNIT_CAMERA, score)
    camera = VirtualCamera.look_at_person(core, weight, stretch.times, VIEW_SMOOTHING_S, UNIT_CAMERA)
    body, body_weight = join_body(core, weight, extremities)
    frames = np.flatnonzero((weight > 0).sum(axis=1) >= MIN_SEEN_JOINTS)
    if not len(frames):
        return math.inf
    frames = frames[np.unique(np.linspace(len(frames) // 2, len(frames) - 1, LIFTED_FRAMES).astype(int))]
    view = camera.view_rays(body, body_weight, 1.0)
    poses = lifter.lift(*sample_histories(view, body_weight, stretch.times, frames), 1.0)
    radius = np.linalg.norm(poses.joints[:, :CORE_COUNT], axis=-1).mean(axis=1)
    known = np.isfinite(radius)
    if not known.any():
        return math.inf
    share = poses.std[known, :CORE_COUNT] / radius[known, None, None]
    return float(np.median(np.log(share).mean(axis=(1, 2))))


def _turn(points: Array, quarters: int) -> Array:
    """Return points (..., 2) turned clockwise by quarters of a turn."""
    for _ in range(quarters):
        points = points[..., ::-1] * [-1.0, 1.0]
    return points


def judge(uncertainty: Mapping[Reading, float], residual_share: float, share_outside: float = 0.0) -> Judgement:
    """Judge the input of a reconstruction.

    Args:
        uncertainty: u of every reading of `list_readings`; empty if too little was seen.
        residual_share: reprojection error over the body height in the image; NaN if it is unknown.
        share_outside: share of the points that lie outside the image.
    """
    if share_outside > MAX_SHARE_OUTSIDE:
        return Judgement(Grade.WRONG, Fault.OUTSIDE)
    if not uncertainty:
        if residual_share > FAR_SHARE:
            return Judgement(Grade.WRONG if residual_share > WRONG_SHARE else Grade.DOUBTFUL, Fault.MISFIT)
        return Judgement(Grade.GOOD, Fault.UNKNOWN)
    given, upright = min(uncertainty[reading] for reading in (GIVEN, *TURNED)), uncertainty[GIVEN]
    layouts = [reading for reading in uncertainty if reading.layout]
    if layouts and given > MIN_LAYOUT_UNCERTAINTY:
        best = min(layouts, key=uncertainty.__getitem__)
        if uncertainty[best] < min(given - LAYOUT_MARGIN, MAX_UNCERTAINTY):
            return Judgement(Grade.WRONG, Fault.LAYOUT, best.layout)
    mirrored = min(MIRRORED, key=uncertainty.__getitem__)
    mirrored_u = uncertainty[mirrored]
    is_uncertain = min(given, mirrored_u) > MAX_UNCERTAINTY
    if residual_share > (FAR_SHARE if is_uncertain else WRONG_SHARE):
        return Judgement(Grade.WRONG, Fault.MISFIT)
    if residual_share > (NEAR_SHARE if is_uncertain else FAR_SHARE):
        return Judgement(Grade.DOUBTFUL, Fault.MISFIT)
    is_turned = min(given, mirrored_u) < upright - TURN_MARGIN and (given < upright or mirrored.turns > 0)
    margin = MIRROR_MARGIN if not mirrored.turns else AXES_MARGIN if is_turned else math.inf
    if mirrored_u < given - margin and MIRRORED[mirrored] is not Fault.TURNED:
        return Judgement(Grade.WRONG, MIRRORED[mirrored])
    if is_turned:
        return Judgement(Grade.DOUBTFUL, Fault.TURNED)
    return Judgement(Grade.GOOD)


def average(parts: Sequence[Mapping[Reading, float]]) -> dict[Reading, float]:
    """Return the means of u over stretches, of the readings that all of them have."""
    common = set.intersection(*(set(part) for part in parts)) if parts else set()
    return {reading: float(np.mean([part[reading] for part in parts])) for reading in common}
