# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Whether keypoints are what they are said to be: layout, axes, and left and right.

The lifter estimates how uncertain its poses are. Read as another layout, or mirrored, the same points make poses
that it has not seen, and it is less certain. The uncertainty of a reading of the points in a few frames is

    u = median_t mean_jk log(sigma_tjk / r_t)

with sigma the standard deviations of the core joints and r_t the mean distance of the lifted joints from their
mean. Readings are compared in stretches of `STRETCH_S`, as the mean of u over the stretches.

The limits were set on the recorded detections and on 400 views of motion capture from all sides, with clean points
and with the errors of three detectors: u of sound points is -2.8 to -1.7, of shuffled or shifted joints -1.9 to
-0.5, and another layout than the right one has at least 0.5 more. Sound points that are read as lying or upside
down have at most 0.07 less than upright. On 66 other views, of people who are in no model, residuals of sound
points are at most 0.062 of the body height, half of those of wrong layouts and orders above 0.13 and 0.18.

Points whose left and right are exchanged show a person who is mirrored in depth: one who faces the camera faces
away from it. In an image of a level camera this is as likely. The lifter knows that cameras mostly look down, and
where a vertical is given, it is measured with it: sound points have at most 0.12 less mirrored, on 434 views. And
people mostly walk forwards (`Walk`). A camera that drives moves them as well, but not their ankles against each
other: those of people who stood moved by less than 0.2 m along the way, of 16 who walked mostly by over 0.25 m.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.findings import SIZE_ADVICE, SOUND, Fault, Finding, Grade
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.virtual_camera import VirtualCamera
from mocap_ros.keypoints.rays import convert_to_rays, join_body
from mocap_ros.keypoints.validation import PointPlaces
from mocap_ros.models.lifter_input import sample_histories
from mocap_ros.models.model_file import load_shipped_lifter
from mocap_ros.skeleton import (
    CMU15,
    CORE_COUNT,
    KEYPOINT_LAYOUTS,
    canonical_joint_names,
    keypoint_layout,
    skeleton_from_joints,
)
from mocap_ros.solvers.vertical import GIVEN_STD_DEG
from mocap_ros.units import NS_PER_S

STRETCH_S = 1.5  # s; the lifter sees 0.8 s
MAX_STRETCHES = 3  # of a recording: its beginning, its middle and its end
LIFTED_FRAMES = 8  # frames of a stretch that are lifted, in its second half
MIN_SEEN_JOINTS = 6  # joints that must be seen in a frame that counts
MIN_FRAMES = 5  # frames with as many, or a stretch says nothing
VIEW_SMOOTHING_S = 3.0  # s; as of the reconstruction
_HIPS, _SHOULDERS, _ANKLES = ([CMU15.index(s + name) for s in 'lr'] for name in ('hip', 'shoulder', 'ankle'))
UNIT_CAMERA = Intrinsics(1.0, (0.0, 0.0), is_focal_known=True)  # whose px are rays

MAX_UNCERTAINTY = -1.65  # u; above it, points hardly look like a person in that layout
# 1; residuals over the body height. Sound recordings have at most 0.06, and 0.04 where u is above the limit.
NEAR_SHARE, FAR_SHARE, WRONG_SHARE = 0.045, 0.075, 0.1
LAYOUT_MARGIN = 0.35  # u by which another layout must be more certain
MIN_LAYOUT_UNCERTAINTY = -1.85  # u above which other layouts are considered
TURN_MARGIN = 0.12  # u by which a turned image must be more certain
AXES_MARGIN = 0.025  # u by which a mirrored and turned image must be more certain than a turned one
# Joints and the share of them, 1, without which nothing shows whether a person is mirrored: of whole bodies 0.8
# and more are seen; of 206 sound views without hips and legs 6 are by more than `MIRROR_MARGIN` likelier mirrored
SIDED_JOINTS, MIN_SIDED_SHARE = {s + n for s in 'lr' for n in ('shoulder', 'hip', 'knee')}, 0.7
MIRROR_MARGIN = 0.15  # u by which a mirrored image must be more certain
BACKWARDS_MARGIN = 0.05  # u, likewise where people walk backwards
# m, s; people walk where they move by at least so far within a time
WALK_M, WALK_S = 0.9, 1.5
# m, 1; after so far, of those who walk forwards the share ahead of all movement is 0.9 and more, of those with
# exchanged sides 0.4 and less
MIN_WALKED_M, MAX_BACKWARDS_SHARE = 0.7, 0.4
LOOK_S = 0.1  # s, from look to look at where people walk
MAX_GAP_SHARE = 0.25  # 1; longest step from image to image, of `WALK_S`
MIN_STRIDE_M = 0.2  # m; by which the ankles of people who walk move against each other, along their way
NOT_JUDGED = Fault.UNKNOWN.found(Grade.GOOD, stretch_s=STRETCH_S, images=MIN_FRAMES, joints=MIN_SEEN_JOINTS)


class Reading(NamedTuple):
    """A way to read keypoints: the layout, empty as it is given; quarter turns clockwise; mirrored before them."""

    layout: str = ''
    turns: int = 0
    is_mirrored: bool = False


GIVEN, MIRROR_IMAGE = Reading(), Reading(is_mirrored=True)
TURNED = tuple(Reading(turns=turns) for turns in (1, 2, 3))  # quarter turns clockwise
UPSIDE_DOWN = 2  # quarter turns
MIRRORED = {Reading(turns=turns, is_mirrored=True): fault for turns, fault in enumerate(
    (Fault.MIRRORED, Fault.TURNED, Fault.Y_UP, Fault.AXES))}  # fmt: skip


class Stretch(NamedTuple):
    """Keypoints of one person in some frames."""

    keypoints: Array  # (F, J, 3) rays and scores; 0 where not seen
    names: tuple[str, ...]  # (J,) names of the joints
    times: Array  # (F,) s
    # (3,) unit vector upwards in the camera's optical frame, or None where none is given
    vertical: Array | None = None


def list_readings(stretch: Stretch) -> list[Reading]:
    """Return the ways to read keypoints: as given, turned, mirrored if they show enough, or as another layout."""
    names = stretch.names
    layouts = [s.name for s in KEYPOINT_LAYOUTS.values() if len(s.joints) == len(names) and s.joints != names]
    sided = [i for i, name in enumerate(canonical_joint_names(names)) if name in SIDED_JOINTS]
    is_seen = stretch.keypoints[..., 2] > 0
    shown = is_seen[is_showing(is_seen)][:, sided].mean(axis=0).sum() / len(SIDED_JOINTS)
    return [GIVEN, *TURNED, *(MIRRORED if shown >= MIN_SIDED_SHARE else ()), *map(Reading, layouts)]


def is_showing(is_seen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return (F,) whether enough of the joints (F, J) are seen for a frame to count."""
    return np.asarray(is_seen.sum(axis=1) >= MIN_SEEN_JOINTS)


def hide_unsure(keypoints: Array, min_score: float) -> Array:
    """Return keypoints (F, J, 3) whose scores are 0 where they are below `min_score`."""
    x, y, score = np.moveaxis(keypoints, -1, 0)
    return np.stack([x, y, np.where(score >= min_score, score, 0.0)], axis=-1)


def make_stretch(
    keypoints: Array, names: tuple[str, ...], times: Array, intrinsics: Intrinsics, vertical: Array | None = None
) -> Stretch | None:
    """Return keypoints (F, J, 3), x and y in px and the score, as a stretch; None if too little was seen."""
    if is_showing(keypoints[..., 2] > 0).sum() < MIN_FRAMES:
        return None
    rays = intrinsics.pixels_to_rays(np.nan_to_num(keypoints[..., :2]))
    return Stretch(np.concatenate([rays, keypoints[..., 2:]], axis=-1), names, times, vertical)


def cut_stretches(
    keypoints: Array, names: tuple[str, ...], times: Array, intrinsics: Intrinsics, vertical: Array | None = None
) -> list[Stretch]:
    """Return stretches of a recording of one person; arguments as of `make_stretch`."""
    shown_s = times[is_showing(keypoints[..., 2] > 0)]
    if not len(shown_s):
        return []
    starts = np.linspace(shown_s[0], max(shown_s[-1] - STRETCH_S, shown_s[0]), MAX_STRETCHES)
    cuts = {tuple(np.searchsorted(times, [s, s + STRETCH_S]).tolist()) for s in starts}
    found = [make_stretch(keypoints[a:b], names, times[a:b], intrinsics, vertical) for a, b in sorted(cuts)]
    return [stretch for stretch in found if stretch is not None]


def measure_all(stretch: Stretch) -> dict[Reading, float]:
    """Return u of every reading."""
    return {reading: measure_uncertainty(stretch, reading) for reading in list_readings(stretch)}


def measure_uncertainty(stretch: Stretch, reading: Reading) -> float:
    """Return u of a reading (formula of the module); infinite where the lifter has no pose.

    Mirrored points are compared with those as given under the vertical, if one is given.
    """
    if reading != MIRROR_IMAGE or stretch.vertical is None:
        return _measure(stretch, reading)
    given, mirrored = (_measure(stretch, r, stretch.vertical) for r in (GIVEN, reading))
    return _measure(stretch, GIVEN) + mirrored - given


def _measure(stretch: Stretch, reading: Reading, vertical: Array | None = None) -> float:
    upright_turns = 0 if stretch.vertical is None else count_upright_turns(stretch.vertical)
    side = [-1.0 if reading.is_mirrored else 1.0, 1.0]
    points = _turn(_turn(stretch.keypoints[..., :2], upright_turns) * side, reading.turns)
    names = keypoint_layout(reading.layout).joints if reading.layout else stretch.names
    core, weight, _, extremities = convert_to_rays(points, stretch.keypoints[..., 2], names, UNIT_CAMERA, 0.0)
    camera = VirtualCamera.look_at_person(core, weight, stretch.times, VIEW_SMOOTHING_S, UNIT_CAMERA)
    body, body_weight = join_body(core, weight, extremities)
    frames = np.flatnonzero(is_showing(weight > 0))
    if not len(frames):
        return math.inf
    frames = frames[np.unique(np.linspace(len(frames) // 2, len(frames) - 1, LIFTED_FRAMES).astype(int))]
    view = camera.view_rays(body, body_weight, 1.0)
    upward, std = None, np.full(len(frames), math.radians(GIVEN_STD_DEG))
    if vertical is not None:
        turned = np.append(_turn(vertical[:2], upright_turns) * side, vertical[2])
        seen = camera.select_frames(frames).to_virtual_camera(np.tile(turned, (len(frames), 1, 1)))[:, 0]
        upward = np.ascontiguousarray(seen)
    sampled, sampled_weight = sample_histories(view, body_weight, stretch.times, frames)
    poses = load_shipped_lifter().lift(sampled, sampled_weight, 1.0, upward, std)
    radius = np.linalg.norm(poses.joints[:, :CORE_COUNT], axis=-1).mean(axis=1)
    known = np.isfinite(radius)
    if not known.any():
        return math.inf
    share = poses.std[known, :CORE_COUNT] / radius[known, None, None]
    return float(np.median(np.log(share).mean(axis=(1, 2))))


def _turn(points: Array, quarters: int) -> Array:
    for _ in range(quarters):
        points = points[..., ::-1] * [-1.0, 1.0]
    return points


def count_upright_turns(upward: Array) -> int:
    """Return the quarter turns clockwise after which a direction (3,) upwards is up in the image of its camera."""
    x, y = upward[:2].tolist()
    return int(np.argmin([y, x, -y, -x]))


class Walk:
    """How far in m people have walked, and how much of it ahead, in the direction in which the body faces."""

    def __init__(self) -> None:
        self.walked = self.ahead = 0.0
        self.person = ''
        # stamp in ns, position of the hips, from the right ankle to the left, direction ahead
        self._past: deque[tuple[int, Array, Array, Array]] = deque()

    @property
    def is_backwards(self) -> bool:
        """Whether people seem to walk backwards or sideways."""
        return self.walked >= MIN_WALKED_M and self.ahead < MAX_BACKWARDS_SHARE * self.walked

    def add(self, person: str, stamp_ns: int, joints: Array) -> None:
        """Add joints (J, 3) m of a person in the next image, stamp in ns; NaN where they are not known."""
        if person != self.person:
            self.person = person
            self._past.clear()
        last_ns = self._past[-1][0] if self._past else stamp_ns
        if 0 < stamp_ns - last_ns < LOOK_S * NS_PER_S:
            return
        if not np.isfinite(joints[:CORE_COUNT]).all() or stamp_ns < last_ns:
            self._past.clear()
            return
        hips, shoulders = joints[_HIPS], joints[_SHOULDERS]
        position, across = hips.mean(axis=0), hips[0] - hips[1] + shoulders[0] - shoulders[1]
        facing = np.cross(across, shoulders.mean(axis=0) - position)
        ahead = facing / max(float(np.linalg.norm(facing)), 1e-9)
        left, right = joints[_ANKLES]
        self._past.append((stamp_ns, position, left - right, ahead))
        if stamp_ns - self._past[0][0] >= WALK_S * NS_PER_S:
            step = position - self._past[0][1]
            length, share = float(np.linalg.norm(step)), (stamp_ns - last_ns) / NS_PER_S / WALK_S
            has_strides = np.ptp([apart @ step for *_, apart, _ in self._past]) >= MIN_STRIDE_M * length
            if length >= WALK_M and share < MAX_GAP_SHARE and has_strides:
                self.walked += share * length
                self.ahead += share * float(step @ np.mean([ahead for *_, ahead in self._past], axis=0))
        while stamp_ns - self._past[0][0] >= WALK_S * NS_PER_S:
            self._past.popleft()


def judge(
    uncertainty: Mapping[Reading, float],
    residual_share: float,
    names: Sequence[str],
    size: Finding = SOUND,
    *,
    is_backwards: bool = False,
) -> Finding:
    """Judge the input of a reconstruction by u of every reading of `list_readings`; empty if too little was seen.

    `residual_share` is the reprojection error over the body height in the image, NaN if unknown; the points have
    these joint names, `size` says whether they lie where they do in an image of that size, and `is_backwards`
    whether people seem to walk backwards.
    """
    if size.grade is Grade.WRONG:
        return size
    if not uncertainty:
        return _judge_fit(residual_share, names, is_uncertain=False) or NOT_JUDGED
    given, upright = min(uncertainty[reading] for reading in (GIVEN, *TURNED)), uncertainty[GIVEN]
    layouts = [reading for reading in uncertainty if reading.layout]
    if layouts and given > MIN_LAYOUT_UNCERTAINTY:
        best = min(layouts, key=uncertainty.__getitem__)
        if uncertainty[best] < min(given - LAYOUT_MARGIN, MAX_UNCERTAINTY):
            return Fault.LAYOUT.found(Grade.WRONG, layout=best.layout, given=_name_layout(names))
    mirrors = [reading for reading in MIRRORED if reading in uncertainty]
    mirrored = min(mirrors, key=uncertainty.__getitem__, default=GIVEN)
    mirrored_u = uncertainty[mirrored]
    if misfit := _judge_fit(residual_share, names, is_uncertain=min(given, mirrored_u) > MAX_UNCERTAINTY):
        return misfit
    is_turned = min(given, mirrored_u) < upright - TURN_MARGIN and (given < upright or mirrored.turns > 0)
    if is_turned and MIRRORED.get(mirrored) in (Fault.Y_UP, Fault.AXES) and mirrored_u < given - AXES_MARGIN:
        return MIRRORED[mirrored].found(Grade.WRONG)
    excess = given - uncertainty.get(MIRROR_IMAGE, math.inf)
    if excess > (BACKWARDS_MARGIN if is_backwards else MIRROR_MARGIN):
        return Fault.MIRRORED.found(Grade.WRONG if excess > MIRROR_MARGIN else Grade.DOUBTFUL)
    if is_turned:  # people may lie, but are seldom upside down
        best = min((GIVEN, *TURNED, *mirrors), key=uncertainty.__getitem__)
        return Fault.TURNED.found(Grade.WRONG if best.turns == UPSIDE_DOWN else Grade.DOUBTFUL)
    return size


def judge_size(places: PointPlaces) -> Finding:
    """Return whether points lie where they do in an image of that size."""
    finding = places.judge()
    return finding._replace(words=f'{finding.words}; {SIZE_ADVICE}') if finding.words else finding


def _judge_fit(residual_share: float, names: Sequence[str], *, is_uncertain: bool) -> Finding | None:
    doubtful, wrong = (NEAR_SHARE, FAR_SHARE) if is_uncertain else (FAR_SHARE, WRONG_SHARE)
    grade = Grade(int(residual_share > doubtful) + int(residual_share > wrong))
    return Fault.MISFIT.found(grade, given=_name_layout(names)) if grade else None


def _name_layout(names: Sequence[str]) -> str:
    return skeleton_from_joints(tuple(names)).name or 'the given joints'


def average(parts: Sequence[Mapping[Reading, float]]) -> dict[Reading, float]:
    """Return the means of u over stretches, of the readings that all of them have."""
    common = set.intersection(*(set(part) for part in parts)) if parts else set()
    return {reading: float(np.mean([part[reading] for part in parts])) for reading in common}
