# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The 3D person of a track in one solved frame: joints, velocities, their deviations, extremities, orientations.

With a motion filter, joints and velocities are of its state; with a lag, the velocity is the central difference of
the smooth solution. In the newest frame, lifted poses give a learned correction (`models/velocity_correction.py`)
of the velocity.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.engine import motion as engine
from mocap_ros.geometry.interpolation import central_velocity
from mocap_ros.geometry.level import LEVEL_UP
from mocap_ros.models.joint_std import widen_by_posture
from mocap_ros.models.model_file import load_velocity_correction
from mocap_ros.models.velocity_correction import SPANS_S, VelocityPast
from mocap_ros.people import CameraVertical, Motion, People
from mocap_ros.skeleton import HIPS, Skeleton
from mocap_ros.solvers.depth import compare_depths
from mocap_ros.solvers.extremities import BODY, ExtremityEvidence, collect_evidence
from mocap_ros.solvers.footing import plant_newest
from mocap_ros.solvers.observed_window import ObservedWindow
from mocap_ros.solvers.posture import follow_postures, measure_likelihood, name_postures
from mocap_ros.tracking.body_size import BodySize, SizeEvidence
from mocap_ros.tracking.motion_filter import (
    OF_EXTREMITIES,
    OF_FOOTING,
    OF_MOTION,
    OF_POSTURE,
    OFFSETS,
    SHIFT,
    STANDING,
    STANDING_CORE,
    STANDING_TIME,
)
from mocap_ros.tracking.solution import TrackSolution
from mocap_ros.tracking.track import Track

AGO = np.array([0.0, *SPANS_S])  # s; now, and the starts of the spans
_HIPS = np.array(HIPS)
FindSize = Callable[[Track], BodySize]


class Shown(NamedTuple):
    """P >= 1 solved people, each in one frame of the window."""

    tracks: Sequence[Track]
    frames: Sequence[int]
    windows: Sequence[ObservedWindow]
    solutions: Sequence[TrackSolution]
    times: Array  # (P,) s, of these frames since each person's first
    noise: Array  # (P,) m, image noise at people of the assumed size
    filters: Array  # (P, R) `FILTERS`, copies that the stages advance

    @staticmethod
    def of(tracks: Sequence[Track], frames: Sequence[int] | None = None) -> Shown:
        """Return people in a frame of each, by default the newest."""
        if frames is None:
            frames = [t.newest for t in tracks]
        windows, solutions = [t.observed for t in tracks], [t.solved for t in tracks]
        times = np.array([w.times[f] for w, f in zip(windows, frames, strict=True)])
        noise = np.array([s.noise / s.stature_ratio for s in solutions])
        return Shown(tracks, frames, windows, solutions, times, noise, np.array([t.filters for t in tracks]))


class CoreMotion(NamedTuple):
    """The cores of P people of the assumed size and their velocities, in the camera's optical frame."""

    joints: Array  # (P, J, 3) m
    velocity: Array  # (P, J, 3) m/s; NaN if unknown
    velocity_std: Array  # (P, J) m/s, standard deviation of each joint's velocity; NaN if unknown
    # (P, 3, 3) m^2/s^2, covariance of the velocity of the point between the hips; NaN if unknown
    root_velocity_covariance: Array


def follow_motion(
    shown: Shown, vertical: CameraVertical | None, find_size: FindSize, stamp_ns: int, *, is_steady: bool
) -> tuple[CoreMotion, ExtremityEvidence]:
    """Filter the motion of people, if `is_steady`, plant their feet, and follow their extremities and postures.

    Where depths are measured, sizes of people follow, and their distances, stamp of the frame in ns.
    """
    filters, times = shown.filters, shown.times
    now, earlier = locate_past(shown)
    motion = find_published_motion(shown, now, earlier, is_steady=is_steady)
    core = motion.joints
    plant_newest(
        filters[:, OF_FOOTING],
        times,
        shown.windows,
        shown.frames,
        core,
        filters[:, OFFSETS].reshape(len(times), -1, 3),
        None if vertical is None else vertical.direction,
        shown.noise,
        measure_depths(shown, core, find_size, stamp_ns),
    )
    evidence = collect_evidence(core, shown.windows, shown.noise, shown.frames)
    follow_extremities(shown, evidence, times, is_steady=is_steady)
    if vertical is not None:
        likelihood = measure_likelihood(
            core, evidence.weight == 0, vertical.direction[None], np.array([vertical.std])
        )
        follow_postures(filters[:, OF_POSTURE], times, likelihood)
    for track, own in zip(shown.tracks, filters, strict=True):
        track.filters = own
    return motion, evidence


def measure_depths(shown: Shown, core: Array, find_size: FindSize, stamp_ns: int) -> Array | None:
    """Return displacements of people for `plant_newest`, by measured depths; None without. Sizes of people follow.

    Who was measured before, but not in this frame, has no information, others have NaN.

    `core` (P, 15, 3) m are solved bodies of the assumed size.
    """
    known = [p for p, window in enumerate(shown.windows) if window.depth is not None]
    if not known:
        return None
    depths = [(shown.windows[p].depth, shown.frames[p]) for p in known]
    surface = np.array([depth[frame] for depth, frame in depths if depth is not None])
    size = np.array([find_size(shown.tracks[p]).ratio for p in known])
    found, distance = compare_depths(surface, core[known], size), core[:, :, 2].mean(axis=1)
    for p, log_size in zip(known, found.log_size.tolist(), strict=True):
        track = shown.tracks[p]
        if not track.is_tentative:
            before = track.size_by_depth
            track.size_by_depth = SizeEvidence.add_depth(before, stamp_ns, log_size, float(distance[p]))
    size = np.array([find_size(shown.tracks[p]).ratio for p in known])
    ahead = np.full((len(core), 2), np.nan)
    ahead[known] = found.find_displacement(core[known], size)
    ahead[[track.size_by_depth is None for track in shown.tracks]] = np.nan
    return ahead


def follow_extremities(shown: Shown, evidence: ExtremityEvidence, times: Array, *, is_steady: bool) -> None:
    """Advance the extremities of people to times (P,) s, with filtered orientations if `is_steady`."""
    statures = np.array([s.model.stature for s in shown.solutions])
    BODY.follow(shown.filters[:, OF_EXTREMITIES], evidence, statures, times, is_steady)


def locate_past(shown: Shown) -> tuple[Array, Array]:
    """Return solved joints (P, J, 3) m in the frame, and (P, T, J, 3) of before it where it is the newest."""
    ago = AGO if shown.windows[0].lifted is not None else AGO[:1]
    located = engine.sample_joints(ago, shown.frames, shown.windows, shown.solutions)
    for own, track, frame in zip(located, shown.tracks, shown.frames, strict=True):
        if frame != track.newest:
            own[1:] = np.nan
    return np.ascontiguousarray(located[:, 0]), np.ascontiguousarray(located[:, 1:])


def find_motion(shown: Shown, located: Array, *, is_steady: bool = False) -> CoreMotion:
    """Return the motion of people in the frame, filtered where that is known; `located` (P, J, 3) m is solved.

    If `is_steady`, the filters take in the frame first.
    """
    filters = shown.filters[:, OF_MOTION]
    motion = CoreMotion(*engine.filter_motion(filters, shown.times, located, shown.noise, _HIPS, is_steady))
    for p, (track, frame) in enumerate(zip(shown.tracks, shown.frames, strict=True)):
        if 0 < frame < track.newest and np.isnan(motion.velocity[p, 0, 0]):
            times = shown.windows[p].times[frame - 1 : frame + 2]
            window, solution = shown.windows[p], shown.solutions[p]
            (around,) = engine.sample_joints(times[2] - times, [frame + 1], [window], [solution])
            motion.velocity[p] = central_velocity(times, around)[1]
    return motion


def find_published_motion(shown: Shown, now: Array, earlier: Array, *, is_steady: bool = False) -> CoreMotion:
    """Return what `find_motion` does, with the velocity corrected where that is learned.

    The joints are those of `locate_past`.
    """
    motion = find_motion(shown, now, is_steady=is_steady)
    if earlier.shape[1]:
        past = describe_past(shown, motion, now, earlier)
        load_velocity_correction().correct(past, motion.root_velocity_covariance)
    return motion


def describe_past(shown: Shown, filtered: CoreMotion, now: Array, earlier: Array) -> VelocityPast:
    """Return what the correction of the newest velocities rests on; the joints are those of `locate_past`."""
    axes = np.array([s.rotation[-1] for s in shown.solutions])
    return VelocityPast(filtered.velocity, filtered.velocity_std, now, earlier, axes)


def set_standing_joints(shown: Shown, motion: CoreMotion) -> None:
    """Set the joints of people in the frame of which it is known how their feet stand."""
    is_known = shown.filters[:, STANDING_TIME.start] == shown.times
    motion.joints[is_known] = shown.filters[is_known, STANDING_CORE].reshape(-1, *motion.joints.shape[1:])


def describe_cores(
    shown: Shown, joints: Array, seen: ExtremityEvidence, sizes: Sequence[BodySize]
) -> tuple[Array, Array]:
    """Return the deviations (P, J) m of joints and the covariances (P, 3, 3) m^2 of roots, of the assumed size."""
    posterior = np.array([s.joint_std / s.stature_ratio for s in shown.solutions])
    shifts = shown.filters[:, SHIFT].copy()
    shifts[[t.size_by_depth is not None for t in shown.tracks]] = np.nan
    return engine.describe_cores(posterior, seen, joints, np.array(sizes), shifts, _HIPS)


def widen_deviations(
    std: Array, joints: Array, seen: ExtremityEvidence, sizes: Sequence[BodySize], upward: Array | None
) -> Array:
    """Return the deviations (..., P, 15) m that are published; `upward` (3,), None if level."""
    is_seen = seen.weight[:, : joints.shape[1]] > 0
    up, shares = LEVEL_UP if upward is None else upward, np.array([size.share for size in sizes])
    return widen_by_posture(std, joints, is_seen, up, shares)


def make_people(
    shown: Shown,
    cores: CoreMotion,
    std: Array,
    root_covariance: Array,
    weight: Array,
    sizes: Sequence[BodySize],
    skeleton: Skeleton,
    unseen_for: Sequence[float] | None = None,
) -> People:
    """Return the people in the frame.

    `cores`, with the deviations (P, 15) m and the covariances (P, 3, 3) m^2 of roots, are of the assumed size;
    `weight` (P, 26) are the scores of the joints; `unseen_for` (P,) s of people who are predicted.
    """
    intrinsics, is_seen = shown.tracks[0].intrinsics, unseen_for is None
    ratios = np.array([size.ratio for size in sizes])
    *whole, roots = BODY.complete(shown.filters[:, OF_EXTREMITIES], ratios, cores, std, root_covariance)
    joints, std, velocity, velocity_std, turns, turn_inferred, inferred = (
        values[:, : len(skeleton.joints)] for values in (*whole, weight == 0)
    )
    ages, count = shown.times, len(shown.tracks)
    away = np.zeros(count) if unseen_for is None else np.array(unseen_for)
    at = list(zip(shown.frames, shown.solutions, strict=True))
    posture, posture_probability = name_postures(shown.filters[:, OF_POSTURE], ages + away)
    return People(
        ids=tuple(track.id for track in shown.tracks),
        skeleton=skeleton,
        joints=joints,
        joint_std=std,
        inferred=inferred,
        scale=intrinsics.focal / roots[:, 2],
        rotation=np.array([solution.rotation[frame] for frame, solution in at]),
        translation=intrinsics.project(roots),
        motion=tuple(
            _describe_motion(track, solution)
            for track, solution in zip(shown.tracks, shown.solutions, strict=True)
        ),
        reprojection_residual=np.array(
            [solution.frame_residuals[frame] if is_seen else math.nan for frame, solution in at]
        ),
        is_scale_known=intrinsics.is_focal_known,
        predicted=np.full(count, not is_seen),
        tentative=np.array([track.is_tentative for track in shown.tracks]),
        joint_velocity=velocity,
        joint_velocity_std=velocity_std,
        root_covariance=root_covariance,
        root_velocity_covariance=cores.root_velocity_covariance,
        age=ages + away,
        unseen_for=away,
        joint_orientation=turns,
        turn_inferred=turn_inferred,
        contact=shown.filters[:, STANDING].copy() if is_seen else np.full((count, 2), np.nan),
        posture=posture,
        posture_probability=posture_probability,
    )


def _describe_motion(track: Track, solution: TrackSolution) -> Motion:
    motion = track.schedule.motion
    category = motion.category if track.schedule.is_periodic else solution.model_name
    return Motion(motion.kind, category, solution.residual, motion.cadence)
