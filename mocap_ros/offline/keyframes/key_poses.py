"""3D poses of keyframes: from the solver or the lifter, or by Taylor's method from somebody's choices."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import Config
from mocap_ros.errors import InputError
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.rotations import centred
from mocap_ros.models import model_file
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.offline.keyframes.filters import bridged, median
from mocap_ros.offline.keyframes.gradient_fit import symmetric
from mocap_ros.offline.keyframes.interpolation import limb_directions, pose_of
from mocap_ros.offline.keyframes.keyframe_set import Keyframes
from mocap_ros.offline.keyframes.observations import ENOUGH_FOR_A_POSE, Observed, sections
from mocap_ros.offline.keyframes.taylor import HALVES, Choice, taylor_pose
from mocap_ros.offline.whole_sequence import reconstruct_sequence
from mocap_ros.skeleton import CMU15, stature

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

SECTION, MARGIN, STEP = 20.0, 0.5, 0.1
HISTORY = 1.0
BRIDGE = 0.5
SAME_FRAME = 0.002
SMALLEST = 1e-9
SMALLEST_BODY = 1e-6


def proposals(
    observed: Observed, keyframes: Indices, intrinsics: Intrinsics, models: Mapping[str, BasePoses], config: Config
) -> tuple[str, Array]:
    """3D poses of many frames, the keyframes among them, by what `keyframes.poses` says.

    Returns:
        Name of the base poses used, and (F, J, 3), any size, virtual camera's axes; NaN in other frames.

    Raises:
        InputError: no frame has one.
    """
    if config.keyframes.poses == 'lifter':
        category, poses = next(iter(models)), lifted_poses(observed, config.solver.prior)
    else:
        category, poses = solved_poses(observed, keyframes, intrinsics, models, config)
    if not np.isfinite(poses).all(axis=(1, 2)).any():
        raise InputError('no frame is seen well enough for a 3D pose')
    return category, poses


def lifted_poses(observed: Observed, prior: str) -> Array:
    """(F, J, 3) px, virtual camera's axes, by the lifter that `prior` names; NaN where too little is seen."""
    out = np.empty((*observed.points.shape[:2], 3))
    net = model_file.lifter_for_prior(prior, CMU15) or model_file.shipped_lifter()
    for wide, own in sections(observed.times, SECTION, HISTORY):
        part = net.lift_sequence(
            observed.points[wide], observed.weight[wide], observed.times[wide], observed.focal
        )
        out[own] = part.joints[own.start - wide.start : own.stop - wide.start]
    return out


def solved_poses(
    observed: Observed, keyframes: Indices, intrinsics: Intrinsics, models: Mapping[str, BasePoses], config: Config
) -> tuple[str, Array]:
    """Poses of the keyframes and of frames `STEP` s apart by the whole-sequence solver, in sections.

    Returns:
        The base poses used, and (F, J, 3) m, virtual camera's axes; NaN in other frames.
    """
    as_they_are = replace(config.tracker, min_score=0.0, undo_swaps=False)
    config = replace(config, tracker=as_they_are)
    keypoints = np.concatenate([observed.pixels, observed.weight[..., None]], axis=-1)
    times = observed.times
    out = np.full((*observed.points.shape[:2], 3), np.nan)
    grid = np.searchsorted(times, np.arange(times[0], times[-1], STEP))
    wanted = np.zeros(len(times), bool)
    wanted[grid], wanted[keyframes] = True, True
    categories = []
    for wide, own in sections(times, SECTION, MARGIN):
        at = np.flatnonzero(wanted[wide]) + wide.start
        if not ((observed.weight[at] > 0).sum(axis=1) >= ENOUGH_FOR_A_POSE).any():
            continue
        solved = reconstruct_sequence(keypoints[at], CMU15.joints, times[at], intrinsics, models, config)
        inner = (at >= own.start) & (at < own.stop)
        at = at[inner]
        out[at] = centred(solved.joints[inner]) @ np.swapaxes(observed.view.turn[at], -1, -2)
        categories.append(solved.category)
    return max(categories, key=categories.count, default=next(iter(models))), out


def limb_lengths(poses: Array, body_height: float) -> Array:
    """(B,) m, left and right the same: the median proportions of poses (F, J, 3) at that stature, m."""
    lengths = CMU15.bone_lengths(poses)
    good = np.isfinite(poses).all(axis=(1, 2)) & (np.nan_to_num(lengths).sum(axis=1) > SMALLEST_BODY)
    if not good.any():
        raise InputError('no frame shows a body: all joints are in one place')
    poses, lengths = poses[good], lengths[good]
    proportions = median(lengths / lengths.sum(axis=1, keepdims=True), axis=0)
    lengths = symmetric(proportions, CMU15)
    body = pose_of(limb_directions(poses[:1], CMU15.bones), lengths, CMU15)
    return np.asarray(lengths * body_height / stature(body, CMU15))


def key_directions(keyframes: Keyframes, poses: Array, beta: float) -> Array:
    """(K, B, 3) limb directions of the key poses of one half.

    Each is the mean over the frames that the keyframe represents, most of all the nearest ones; NaN where none of
    them has a pose.

    Args:
        keyframes: of the half.
        poses: (F, J, 3) proposals, any size, NaN where unknown.
        beta: torso lengths.
    """
    directions = limb_directions(poses, keyframes.half.bones)
    known = np.isfinite(directions).all(axis=(1, 2))
    weight = np.where(keyframes.well & known, np.exp(-0.5 * (keyframes.distance / (beta / 2)) ** 2), 0.0)
    total = np.zeros((len(keyframes.frames), *directions.shape[1:]))
    used = np.flatnonzero(weight > 0)
    np.add.at(total, keyframes.nearest[used], weight[used, None, None] * directions[used])
    length = np.linalg.norm(total, axis=-1, keepdims=True)
    own = directions[keyframes.frames]
    return np.where(length > SMALLEST, total / np.maximum(length, SMALLEST), own)


def adapted(keys: Array, own: Array, share: float) -> Array:
    """(C, B, 3) limb directions of control points, between those of key poses and those proposed for the frames.

    Args:
        keys: (C, B, 3) of the key pose of each.
        own: (C, B, 3) proposed for the frame itself.
        share: of the latter; 0 is as in the paper.
    """
    mixed = (1 - share) * keys + share * own
    length = np.linalg.norm(mixed, axis=-1, keepdims=True)
    return np.where(length > SMALLEST, mixed / np.maximum(length, SMALLEST), keys)


def choose(
    choice: Choice, keyframes: Sequence[Keyframes], keys: Sequence[Array], observed: Observed, lengths: Array
) -> None:
    """Put the limbs that somebody chose in the place of a keyframe's (Taylor's method).

    Args:
        choice: which keyframe, and which limbs point towards the camera.
        keyframes: of both halves.
        keys: (K, B, 3) limb directions of each half's key poses; those of the keyframe are overwritten.
        observed: believable image points.
        lengths: (B,) m, of all limbs.

    Raises:
        InputError: there is no such keyframe, or Taylor's method cannot be had of it; names the choice.
    """
    which = HALVES.index(choice.half)
    half, out = keyframes[which], keys[which]
    times = observed.times[half.frames] - observed.times[0]
    if not len(times):
        raise InputError(f'{choice.place}: the {choice.half} body has no keyframes')
    key = int(np.abs(times - choice.time).argmin())
    if abs(times[key] - choice.time) > SAME_FRAME:
        raise InputError(
            f'{choice.place}: no keyframe of the {choice.half} body at {choice.time:g} s; the nearest is at '
            f'{times[key]:.3f} s'
        )
    points, known = bridged(observed.points, observed.weight > 0, observed.times, BRIDGE)
    frame = half.frames[key]
    points = np.where(known[frame][:, None], points[frame], np.nan)
    bones = half.half.bones
    own = np.array([lengths[CMU15.bones.index(bone)] for bone in bones])
    try:
        limbs, _ = taylor_pose(points, own, bones, choice.forward, choice.scale)
    except InputError as error:
        raise InputError(f'{choice.place}: {error}') from None
    out[key] = limbs / own[:, None]
