"""Errors of whole sequences and of the live result, by frame and by the pose that the person truly is in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import common
import numpy as np
from common import View
from numpy.typing import NDArray

from experiments.detector_views import DetectedView, load_motion
from mocap_ros.config import Config
from mocap_ros.geometry.rotations import centre_poses
from mocap_ros.keypoints.person import Person2D
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.offline.whole_sequence import reconstruct_sequence
from mocap_ros.skeleton import CMU15
from mocap_ros.tracking.seen_frames import SeenFrames
from mocap_ros.tracking.tracker import Tracker
from mocap_ros.units import NS_PER_S

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
CROUCHING_SHARE = 0.75  # of the length of the legs, height of the hips; 0.5 on a chair, 0.95 to 1 in walking


@dataclass(frozen=True, eq=False)
class LiveResult:
    """What the tracker knew of one person when each frame was the newest; NaN and None without a result.

    Attributes:
        joints: (F, 15, 3) m, joints of the newest frame.
        newest: (F,) the tracker's window that ends with this frame.
    """

    joints: Array
    newest: list[SeenFrames | None]


def reconstruct_whole(view: View, models: Mapping[str, BasePoses], config: Config) -> Array:
    """Return the poses (F, 15, 3) m of the whole sequence."""
    keypoints, times = view.sequence['keypoints'].astype(float), view.sequence['timestamps']
    return reconstruct_sequence(keypoints, view.joint_names, times, view.intrinsics, models, config).joints


def track(view: View, models: Mapping[str, BasePoses], config: Config) -> LiveResult:
    """Reconstruct a sequence frame by frame."""
    tracker, newest = Tracker(models, config), []
    joints = np.full((view.frames, len(CMU15.joints), 3), np.nan)
    keypoints, times = view.sequence['keypoints'].astype(float), view.sequence['timestamps']
    for frame, (k, time_s) in enumerate(zip(keypoints, times, strict=True)):
        person = Person2D('p', view.joint_names, k[:, :2], k[:, 2])
        people = tracker.update(round(time_s * NS_PER_S) + 1, [person], view.intrinsics)
        if people:
            joints[frame] = people[0].joints
        is_seen = bool(people) and not people[0].predicted
        newest.append(tracker.snapshot().tracks[0].seen if is_seen else None)
        tracker.run_deferred_work()
    return LiveResult(joints, newest)


def reconstruct(way: str, view: View, models: Mapping[str, BasePoses], config: Config) -> Array:
    """Return the poses (F, 15, 3) m of the way `whole` or `live`."""
    if way == 'whole':
        return reconstruct_whole(view, models, config)
    return track(view, models, config).joints


def compute_errors(seen: DetectedView, joints: Array) -> dict[str, Any]:
    """Return the protocol's errors, the RMS accelerations in m/s^2, and the errors by pose.

    `poses` holds for each kind of pose the number of frames and the sums of their MPJPE and PA-MPJPE in mm;
    `found_acceleration` and `true_acceleration` are of the joints about the body's centre.
    """
    truth, found = centre_poses(seen.truth), centre_poses(joints)
    known = np.isfinite(found).all(axis=(1, 2))
    found *= (found * truth)[known].sum() / (found * found)[known].sum()
    squares = [((np.diff(p, 2, axis=0) * common.FPS**2) ** 2).sum(axis=-1).mean(axis=1) for p in (found, truth)]
    usable = np.isfinite(squares[0])
    both = [common.compute_pose_errors(found[known], truth[known], similarity=s) for s in (False, True)]
    kinds = classify_poses(seen.body, load_motion()[1])[known]
    return common.compute_errors(seen.view, joints, CMU15.joints, 'body15') | {
        'found_acceleration': float(np.sqrt(squares[0][usable].mean())),
        'true_acceleration': float(np.sqrt(squares[1][usable].mean())),
        'poses': {
            k: [int((kinds == k).sum()), *(float(e[kinds == k].sum()) for e in both)] for k in set(kinds.tolist())
        },
    }


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
    """Return the means over the records, and the ratio of output to true RMS acceleration over all of them."""
    squares = [np.mean([r[k] ** 2 for r in records]) for k in ('found_acceleration', 'true_acceleration')]
    return {
        'mpjpe': float(np.mean([r['mpjpe_mm'] for r in records])),
        'pa': float(np.mean([r['pa_mpjpe_mm'] for r in records])),
        'acceleration': float(np.mean([r['accel_mm_s2'] for r in records])) / 1e3,
        'ratio': float(np.sqrt(squares[0] / squares[1])),
        'failed': sum(r['failed_frames'] for r in records),
    }
