# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""3D key poses of the keyframes: from the solver, from the lifter, or by Taylor's method from a user's choices.

    d_k = normalise( sum_{f in W_k} exp(-(D(k, f) / (beta / 2))^2 / 2) d_f )        for each limb

d_k is the limb direction of keyframe k, d_f that proposed for frame f, and W_k the frames that k represents well.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from mocap_ros.arrays import Array, Indices
from mocap_ros.config import Config
from mocap_ros.errors import InputError
from mocap_ros.geometry.rotations import centre_poses
from mocap_ros.keypoints.joint_map import build_joint_map
from mocap_ros.models import model_file
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.offline.keyframes.image_points import interpolate_gaps, nan_median
from mocap_ros.offline.keyframes.keyframe_set import KeyframeSet
from mocap_ros.offline.keyframes.motion import assemble_poses, compute_limb_directions, symmetrise_lengths
from mocap_ros.offline.keyframes.shots import split_into_sections
from mocap_ros.offline.keyframes.taylor import HALF_NAMES, DepthChoice, reconstruct_limbs
from mocap_ros.offline.whole_sequence import reconstruct_window
from mocap_ros.skeleton import CMU15, estimate_stature
from mocap_ros.solvers.observed_window import ObservedWindow
from mocap_ros.solvers.window import MIN_JOINTS_FOR_CAMERA

MAX_SECTION_S = 20.0  # s; bounds the memory and time of one solve
SOLVER_MARGIN_S = 0.5  # s of frames on both sides of a section, so that its ends are smooth too
LIFTER_MARGIN_S = 1.0  # s of frames on both sides of a section, for the lifter's temporal window
SOLVER_STEP_S = 0.1  # s between the frames solved besides the keyframes; key poses average several frames
MAX_BRIDGED_GAP_S = 0.5  # s; a joint of a keyframe that is not seen for longer is not interpolated
TIME_TOLERANCE_S = 0.002  # s; times in a file are rounded, and frames are further apart than this
EPSILON = 1e-9  # guards the normalisation of a direction of length zero
MIN_BODY_SIZE = 1e-6  # unit of the poses; guards proportions against bodies with all joints in one place


def propose_poses(
    observed: ObservedWindow, keyframes: Indices, models: Mapping[str, PoseModel], config: Config
) -> tuple[str, Array]:
    """Propose 3D poses for many frames, including the keyframes, by the source that `keyframes.poses` names.

    Returns the name of the base poses used, and (F, J, 3) of any size in the virtual camera's axes, NaN in other
    frames.
    """
    if config.keyframes.poses == 'lifter':
        category, poses = next(iter(models)), propose_lifted_poses(observed, config.solver.prior)
    else:
        category, poses = propose_solved_poses(observed, keyframes, models, config)
    if not np.isfinite(poses).all(axis=(1, 2)).any():
        raise InputError('no frame is seen well enough for a 3D pose')
    return category, poses


def propose_lifted_poses(observed: ObservedWindow, prior: str) -> Array:
    """Propose poses (F, J, 3) px by the lifter that `solver.prior` names, or else by the shipped lifter.

    They are NaN where too few joints are seen.
    """
    out = np.empty((*observed.points.shape[:2], 3))
    lifter = model_file.load_prior_lifter(prior, CMU15) or model_file.load_shipped_lifter()
    for padded, section in split_into_sections(observed.times, MAX_SECTION_S, LIFTER_MARGIN_S):
        lifted = lifter.lift_sequence(
            *observed.view_body(padded, observed.virtual_camera.intrinsics.focal),
            observed.times[padded],
            observed.focal,
        ).select_core()
        out[section] = lifted.joints[section.start - padded.start : section.stop - padded.start]
    return out


def propose_solved_poses(
    observed: ObservedWindow, keyframes: Indices, models: Mapping[str, PoseModel], config: Config
) -> tuple[str, Array]:
    """Propose poses (F, J, 3) m by the whole-sequence solver, section by section, and name the base poses.

    The solver gets the keyframes and a frame every `SOLVER_STEP_S`; the others are NaN.
    """
    times, camera = observed.times, observed.virtual_camera
    # derives a neck or a pelvis that was left out as suspect from the joints beside it
    rays, weight = build_joint_map(CMU15.joints).apply(observed.rays, observed.weight)
    rays = np.where(weight[..., None] > 0, rays, 0.0)
    out = np.full((*observed.points.shape[:2], 3), np.nan)
    grid = np.searchsorted(times, np.arange(times[0], times[-1], SOLVER_STEP_S))
    grid = np.minimum(grid, len(times) - 1)  # for the last step may be rounded to after the end
    is_solved = np.zeros(len(times), bool)
    is_solved[grid], is_solved[keyframes] = True, True
    categories = []
    for padded, section in split_into_sections(times, MAX_SECTION_S, SOLVER_MARGIN_S):
        frames = np.flatnonzero(is_solved[padded]) + padded.start
        if not ((observed.weight[frames] > 0).sum(axis=1) >= MIN_JOINTS_FOR_CAMERA).any():
            continue
        part = ObservedWindow.facing_person(
            times[frames], rays[frames], weight[frames], camera.intrinsics, observed.focal
        )
        result = reconstruct_window(part, models, config)
        inner = (frames >= section.start) & (frames < section.stop)
        frames = frames[inner]
        out[frames] = camera.select_frames(frames).to_virtual_camera(centre_poses(result.joints[inner]))
        categories.append(result.category)
    return max(categories, key=categories.count, default=next(iter(models))), out


def estimate_limb_lengths(poses: Array, body_height: float) -> Array:
    """Estimate limb lengths (B,) in m from proposed poses: their median proportions, at the stature given.

    `poses` (F, J, 3) any size, NaN in frames without a pose; `body_height` m, stature.
    """
    lengths = CMU15.bone_lengths(poses)
    has_size = np.nan_to_num(lengths).sum(axis=1) > MIN_BODY_SIZE
    usable = np.isfinite(poses).all(axis=(1, 2)) & has_size
    if not usable.any():
        raise InputError('no frame shows a body: all joints are in one place')
    poses, lengths = poses[usable], lengths[usable]
    proportions = nan_median(lengths / lengths.sum(axis=1, keepdims=True), axis=0)
    lengths = symmetrise_lengths(proportions, CMU15)
    body = assemble_poses(compute_limb_directions(poses[:1], CMU15.bones), lengths, CMU15)
    return np.asarray(lengths * body_height / estimate_stature(body, CMU15))


def average_key_directions(keyframes: KeyframeSet, poses: Array, beta: float) -> Array:
    """Return the limb directions (K, B, 3) of the key poses of one half; NaN without proposed poses."""
    directions = compute_limb_directions(poses, keyframes.body_half.bones)
    has_pose = np.isfinite(directions).all(axis=(1, 2))
    nearness = np.exp(-0.5 * (keyframes.distance / (beta / 2)) ** 2)
    weight = np.where(keyframes.well_represented & has_pose, nearness, 0.0)
    total = np.zeros((len(keyframes.frames), *directions.shape[1:]))
    used = np.flatnonzero(weight > 0)
    np.add.at(total, keyframes.nearest[used], weight[used, None, None] * directions[used])
    return _normalise(total, directions[keyframes.frames])


def blend_directions(key_directions: Array, frame_directions: Array, frame_share: float) -> Array:
    """Blend limb directions (C, B, 3) of control points' key poses with those proposed for their own frames.

    The share of the latter is 0 in the paper's method.
    """
    mixed = (1 - frame_share) * key_directions + frame_share * frame_directions
    return _normalise(mixed, key_directions)


def _normalise(vectors: Array, otherwise: Array) -> Array:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > EPSILON, vectors / np.maximum(length, EPSILON), otherwise)


def apply_depth_choice(
    choice: DepthChoice,
    keyframes: Sequence[KeyframeSet],
    key_directions: Sequence[Array],
    observed: ObservedWindow,
    lengths: Array,
) -> None:
    """Replace the key pose of one keyframe by the pose that Taylor's method gives for a user's choice.

    `choice` keyframe, and the limbs that point towards the camera; `key_directions` (K, B, 3) limb directions of
    each half's key poses, those of the keyframe are overwritten; `lengths` (B,) m, limb lengths of the whole
    skeleton.
    """
    half_index = HALF_NAMES.index(choice.half)
    half_keyframes, half_directions = keyframes[half_index], key_directions[half_index]
    times = observed.times[half_keyframes.frames] - observed.times[0]
    if not len(times):
        raise InputError(f'{choice.location}: the {choice.half} body has no keyframes')
    keyframe = int(np.abs(times - choice.time_s).argmin())
    if abs(times[keyframe] - choice.time_s) > TIME_TOLERANCE_S:
        raise InputError(
            f'{choice.location}: no keyframe of the {choice.half} body at {choice.time_s:g} s; the nearest is at '
            f'{times[keyframe]:.3f} s'
        )
    points, known = interpolate_gaps(observed.points, observed.weight > 0, observed.times, MAX_BRIDGED_GAP_S)
    frame = half_keyframes.frames[keyframe]
    frame_points = np.where(known[frame][:, None], points[frame], np.nan)
    bones = half_keyframes.body_half.bones
    half_lengths = np.array([lengths[CMU15.bones.index(bone)] for bone in bones])
    try:
        limbs, _ = reconstruct_limbs(frame_points, half_lengths, bones, choice.forward, choice.scale)
    except InputError as error:
        raise InputError(f'{choice.location}: {error}') from None
    half_directions[keyframe] = limbs / half_lengths[:, None]
