# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Prediction of a person after the last detection: through a gap, and ahead of the newest image.

Both come from what the window holds of the last 0.8 s, by the learned motion predictor
(`models/motion_predictor.py`). A body that would come behind the camera stops before it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.engine import motion as engine
from mocap_ros.geometry.level import LEVEL_UP
from mocap_ros.models.model_file import load_motion_predictor
from mocap_ros.models.motion_predictor import PAST_S, Displacements, Past
from mocap_ros.people import People, PredictedPeople
from mocap_ros.skeleton import CORE_COUNT, Skeleton
from mocap_ros.solvers.extremities import ExtremityEvidence, collect_evidence
from mocap_ros.tracking.body_size import BodySize
from mocap_ros.tracking.motion_filter import SHIFT
from mocap_ros.tracking.output import (
    CoreMotion,
    Shown,
    describe_cores,
    find_motion,
    find_published_motion,
    follow_extremities,
    locate_past,
    make_people,
    set_standing_joints,
    widen_deviations,
)
from mocap_ros.tracking.track import Track
from mocap_ros.units import NS_PER_S

VELOCITY_SPAN_S = 0.05  # s; over which the velocity in a gap is a difference: short, and far above rounding
VELOCITY_STD_M_S = 0.5  # m/s; what the velocity may have changed by in a gap
MIN_CLEARANCE_M = 0.1  # m; a predicted body must stay this far in front of the camera, or its image is meaningless
OPTICAL_AXIS = np.array([0.0, 0.0, 1.0])  # direction away from the camera, in its optical frame
_AGO = np.array([0.0, *PAST_S])


def predict_people(
    tracks: Sequence[Track], stamp_ns: int, upward: Array | None, sizes: Sequence[BodySize], skeleton: Skeleton
) -> People:
    """Return the people of P solved tracks at a time after their last detections; `upward` (3,), None if level."""
    if not tracks:
        return People.none(skeleton)
    ages = [(stamp_ns - t.stamps_ns[-1]) / NS_PER_S for t in tracks]
    times = np.array(ages)[:, None] + [0.0, VELOCITY_SPAN_S]
    _, ahead = _predict(tracks, times, upward, sizes)
    shown = Shown.of(tracks)
    last = find_published_motion(shown, *locate_past(shown))
    set_standing_joints(shown, last)
    seen = collect_evidence(last.joints, shown.windows, shown.noise, shown.frames)
    _, root_covariance = describe_cores(shown, last.joints, seen, sizes)
    velocity_std = VELOCITY_STD_M_S / np.array([[size.ratio] for size in sizes])
    cores = CoreMotion(
        last.joints + ahead.joints[:, 0],
        (ahead.joints[:, 1] - ahead.joints[:, 0]) / VELOCITY_SPAN_S,
        np.hypot(last.velocity_std, velocity_std),
        last.root_velocity_covariance + velocity_std[..., None] ** 2 / 3 * np.eye(3),
    )
    std = widen_deviations(ahead.std[:, 0], last.joints, seen, sizes, upward)
    unseen = ExtremityEvidence.without_image(cores.joints)
    now = np.array([stamp_ns - t.first_ns for t in tracks]) / NS_PER_S
    follow_extremities(shown, unseen, now, is_steady=False)
    root_covariance += ahead.root_covariance[:, 0]
    return make_people(shown, cores, std, root_covariance, unseen.weight, sizes, skeleton, ages)


def predict_ahead(
    tracks: Sequence[Track],
    stamp_ns: int,
    times_s: Sequence[float],
    upward: Array | None,
    sizes: Sequence[BodySize],
) -> list[PredictedPeople]:
    """Return the people of P tracks at each of T times in s after a frame; else as `predict_people`."""
    if not tracks:
        nobody = np.zeros((0, CORE_COUNT, 3)), np.zeros((0, CORE_COUNT)), np.zeros((0, 3, 3))
        return [PredictedPeople(ahead_s, (), *nobody) for ahead_s in times_s]
    ages = [(stamp_ns - track.stamps_ns[-1]) / NS_PER_S for track in tracks]
    times = np.array(ages)[:, None] + np.array(times_s)
    past, ahead = _predict(tracks, times, upward, sizes)
    shown = Shown.of(tracks)
    seen = collect_evidence(past.joints, shown.windows, shown.noise, shown.frames)
    _, covariances = describe_cores(shown, past.joints, seen, sizes)
    ratio = np.array([size.ratio for size in sizes])[:, None, None, None]
    joints, covariances = past.joints[:, None] + ahead.joints, covariances[:, None] + ahead.root_covariance
    std = widen_deviations(ahead.std.swapaxes(0, 1), past.joints, seen, sizes, upward).swapaxes(0, 1)
    predicted = ratio * joints, ratio[..., 0] * std, ratio**2 * covariances
    ids = tuple(track.id for track in tracks)
    return [
        PredictedPeople(ahead_s, ids, *(values[:, i] for values in predicted)) for i, ahead_s in enumerate(times_s)
    ]


def sample_past(tracks: Sequence[Track], upward: Array | None = None) -> Past:
    """Return the motions of the cores of people of the assumed size up to their newest frames."""
    shown = Shown.of(tracks)
    located = engine.sample_joints(_AGO, shown.frames, shown.windows, shown.solutions)
    motion = find_motion(shown, np.ascontiguousarray(located[:, 0]))
    set_standing_joints(shown, motion)
    joints, velocity, *_ = motion
    located += np.nan_to_num(shown.filters[:, None, None, SHIFT])
    is_known = ~np.isnan(located[..., :1, :1])
    # without a filter, or in the first frame
    simple = np.where(is_known[:, 1], (joints - located[:, 1]) / _AGO[1], 0.0)
    velocity = np.where(np.isfinite(velocity).all(axis=(1, 2), keepdims=True), velocity, simple)
    earlier = np.where(is_known, located, joints[:, None] - _AGO[:, None, None] * velocity[:, None])[:, 1:]
    seen = collect_evidence(joints, shown.windows, shown.noise, shown.frames)
    std, _ = describe_cores(shown, joints, seen, [BodySize(1.0, 0.0)] * len(tracks))
    heading = np.array([t.solved.rotation[t.newest, :, 0] for t in tracks])
    up = np.broadcast_to(LEVEL_UP if upward is None else upward, heading.shape)
    return Past(joints, velocity, std, earlier, heading, up)


def _predict(
    tracks: Sequence[Track], times: Array, upward: Array | None, sizes: Sequence[BodySize]
) -> tuple[Past, Displacements]:
    """Return what is known of N >= 1 people, and predictions at times (N, T) in s after that.

    Both are of the assumed size. Who is not nearer already stays `MIN_CLEARANCE_M` before the camera.
    """
    past = sample_past(tracks, upward)
    ahead = load_motion_predictor().predict(past, times)
    depths = past.joints[:, None, :, 2]
    clearance = MIN_CLEARANCE_M / np.array([[size.ratio] for size in sizes])
    least = np.minimum(_measure_clearance(depths), clearance)
    too_near = np.maximum(least - _measure_clearance(depths + ahead.joints[..., 2]), 0.0)
    moved = ahead.joints + too_near[..., None, None] * OPTICAL_AXIS
    return past, ahead._replace(joints=moved)


def _measure_clearance(depths: Array) -> Array:
    """Return mean - (max - mean) of the depths (..., J) of bodies in m, as if they reached as far forwards."""
    mean = depths.mean(axis=-1)
    return np.asarray(2 * mean - depths.max(axis=-1))
