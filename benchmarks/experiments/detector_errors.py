# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Errors of whole sequences and of the live result, by frame and by the pose that the person truly is in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import common
import numpy as np
from numpy.typing import NDArray

from experiments.detector_views import DetectedView, load_motion
from mocap_ros.skeleton import CMU15

Array = NDArray[np.float64]

# Kinds of poses, of which a pose is the first that holds; the others are upright.
KNEELING = 'kneeling, on all fours, lying'
BENT_OVER = 'bent over'
LEG_RAISED = 'leg raised'
CROUCHING = 'crouching, lunging, sitting'
UPRIGHT = 'upright'
POSES = (UPRIGHT, CROUCHING, LEG_RAISED, BENT_OVER, KNEELING)
KNEE_ON_FLOOR_M = 0.15  # m of a knee above the lowest joint; the joint is a hand's breadth above a floor it is on
BENT_OVER_DEG = 50.0  # degrees between trunk and vertical, as in the record of real detectors
LEG_RAISED_M = 0.1  # m of an ankle above the other knee; more than in a step or in running
# The limbs' ends and middles, of which the delay is measured.
LIMBS = [CMU15.index(side + n) for side in 'lr' for n in ('elbow', 'wrist', 'knee', 'ankle')]
LAGS = range(-2, 8)  # frames, by which the result may be behind the truth
CROUCHING_SHARE = 0.75  # of the length of the legs, height of the hips; 0.5 on a chair, 0.95 to 1 in walking


def compute_errors(seen: DetectedView, joints: Array) -> dict[str, Any]:
    """Return the protocol's errors, the RMS accelerations in m/s^2, and the errors by pose.

    `poses` holds for each kind of pose the number of frames and the sums of their MPJPE and PA-MPJPE in mm;
    `found_acceleration` and `true_acceleration` are of the joints about the body's centre, and `velocity_products`
    the products of found and true velocities of the limbs at each of `LAGS`, over their RMS.
    """
    found, truth = common.align_scale(joints, seen.truth)
    known = np.isfinite(found).all(axis=(1, 2))
    squares = [((np.diff(p, 2, axis=0) * common.FPS**2) ** 2).sum(axis=-1).mean(axis=1) for p in (found, truth)]
    usable = np.isfinite(squares[0])
    both = [common.compute_pose_errors(found[known], truth[known], similarity=s) for s in (False, True)]
    kinds = classify_poses(seen.body, load_motion()[1])[known]
    return common.compute_errors(seen.view, joints, CMU15.joints, 'body15') | {
        'found_acceleration': float(np.sqrt(squares[0][usable].mean())),
        'true_acceleration': float(np.sqrt(squares[1][usable].mean())),
        'velocity_products': correlate_velocities(found, truth),
        'poses': {
            k: [int((kinds == k).sum()), *(float(e[kinds == k].sum()) for e in both)] for k in set(kinds.tolist())
        },
    }


def correlate_velocities(found: Array, truth: Array) -> list[float]:
    """Return the correlations of the limbs' velocities, of poses (F, 15, 3) m, for each of `LAGS`."""
    velocities = [np.nan_to_num(np.diff(p[:, LIMBS], axis=0)) for p in (found, truth)]
    size = float(np.sqrt(np.prod([(v**2).sum() for v in velocities]))) or 1.0
    first, last = LAGS[-1], len(velocities[0]) + LAGS[0]
    late, true = velocities
    return [float((late[first:last] * true[first - lag : last - lag]).sum()) / size for lag in LAGS]


def find_delay(records: Sequence[Mapping[str, Any]]) -> float:
    """Return the delay in frames: the lag that maximises the correlation over all records, by a parabola."""
    total = np.sum([r['velocity_products'] for r in records], axis=0)
    best = int(np.clip(np.argmax(total), 1, len(LAGS) - 2))
    before, at, after = total[best - 1 : best + 2]
    bend = before - 2 * at + after
    return float(LAGS[best] + (0.5 * (before - after) / bend if bend < 0 else 0.0))


def classify_poses(body: Array, joints: Sequence[str]) -> NDArray[np.str_]:
    """Return the kinds of true poses (F, J, 3) m with y up and J named joints, (F,) names of `POSES`."""

    def at(name: str) -> Array:
        return body[:, joints.index(name)]

    knees, ankles, hips = (np.stack([at(side + n) for side in 'lr'], axis=1) for n in ('knee', 'ankle', 'hip'))
    floor = body[..., 1].min(axis=1)
    legs = np.linalg.norm(hips - knees, axis=-1).mean(axis=1) + np.linalg.norm(knees - ankles, axis=-1).mean(
        axis=1
    )
    trunk = at('neck') - at('pelvis')
    lean_deg = np.degrees(np.arccos(trunk[:, 1] / np.linalg.norm(trunk, axis=-1)))
    is_raised = (ankles[..., 1] - knees[:, ::-1, 1]).max(axis=1) > LEG_RAISED_M
    hip_height = hips[..., 1].mean(axis=1) - ankles[..., 1].min(axis=1)
    conditions = {
        KNEELING: knees[..., 1].min(axis=1) - floor < KNEE_ON_FLOOR_M,
        BENT_OVER: lean_deg > BENT_OVER_DEG,
        LEG_RAISED: is_raised,
        CROUCHING: hip_height < CROUCHING_SHARE * legs,
    }
    return np.select(list(conditions.values()), list(conditions), UPRIGHT)


def summarise(records: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Return the means over the records; over all of them the ratio of RMS accelerations and the limbs' delay."""
    squares = [np.mean([r[k] ** 2 for r in records]) for k in ('found_acceleration', 'true_acceleration')]
    return {
        'mpjpe': float(np.mean([r['mpjpe_mm'] for r in records])),
        'pa': float(np.mean([r['pa_mpjpe_mm'] for r in records])),
        'acceleration': float(np.mean([r['accel_mm_s2'] for r in records])) / 1e3,
        'ratio': float(np.sqrt(squares[0] / squares[1])),
        'delay': find_delay(records),
        'failed': sum(r['failed_frames'] for r in records),
    }
