# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Reconstruction of a long sequence by keyframes, from 2D keypoints to 3D motion (Loy et al. 2004, figure 1)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mocap_ros.arrays import Array, Indices, Mask
from mocap_ros.config import Config, KeyframesConfig, TrackerConfig
from mocap_ros.errors import InputError
from mocap_ros.geometry.rotations import fit_rotation
from mocap_ros.geometry.weak_perspective import WeakPerspectiveCameras
from mocap_ros.keypoints.keypoint_sequence import KeypointSequence
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.offline.keyframes.alignment import (
    AlignedMotion,
    align_motion,
    estimate_joint_offsets,
    subtract_offsets,
)
from mocap_ros.offline.keyframes.half_poses import estimate_torso_lengths, extract_half_poses, split_into_halves
from mocap_ros.offline.keyframes.image_points import find_jumping_points, find_outliers, interpolate_gaps
from mocap_ros.offline.keyframes.key_poses import (
    apply_depth_choice,
    average_key_directions,
    blend_directions,
    estimate_limb_lengths,
    propose_poses,
)
from mocap_ros.offline.keyframes.keyframe_set import KeyframeSet, find_keyframe_set
from mocap_ros.offline.keyframes.motion import (
    FitResult,
    assemble_poses,
    compute_limb_directions,
    compute_reprojection_distances,
    fit_motion,
    select_control_points,
    slerp,
)
from mocap_ros.offline.keyframes.shots import find_shots, split_into_sections
from mocap_ros.offline.keyframes.taylor import DepthChoice
from mocap_ros.offline.whole_sequence import (
    Solved,
    SolvedWindow,
    choose_vertical,
    describe_poses,
    find_frames_in_sight,
)
from mocap_ros.people import PoseSequence
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.observed_window import ObservedWindow, observe_sequence
from mocap_ros.solvers.window import Reconstruction

MAX_SECTION_S = 60.0  # s; bounds the memory of the running medians
SECTION_MARGIN_S = 1.0  # s on both sides of a section; longer than the links between inliers
MAX_FILLED_GAP_S = 1.0  # s; a missing point's displacement from the motion is interpolated over at most this long
FILLED_WEIGHT = 0.5  # weight of a filled point in the fit, less than that of a point seen with certainty
MAX_BRIDGED_GAP_S = 0.5  # s; a joint missing for longer is not interpolated before poses are compared
TORSO_M = 0.5  # m, torso length of an adult; turns torso lengths into metres before the 3D motion is known


@dataclass(frozen=True, eq=False)
class KeyframeResult:
    """A sequence reconstructed by keyframes."""

    # Joints that were not seen or are outliers are `inferred`. The poses say how the gradient fit ended; its
    # objective is the mean squared reprojection error, which may rise, since limb lengths are reset at each step
    solved: Solved
    keyframes: tuple[KeyframeSet, KeyframeSet]  # keyframes of the upper and the lower half of the body
    motion: Array  # (F, J, 3) m, virtual camera's axes: the initial motion X^0 between key poses, before the fit
    outliers: Mask  # (F, J) True for the image points that were seen and found to be outliers


def observe_shots(sequence: KeypointSequence, config: TrackerConfig) -> ObservedWindow:
    """Observe a sequence that may have cuts; arguments and errors are those of `observe_sequence`."""
    return observe_sequence(sequence, config, CMU15, find_shots)


def observe_plausible_points(sequence: KeypointSequence, config: TrackerConfig) -> ObservedWindow:
    """Observe a long sequence without its suspect points; arguments and errors are those of `observe_sequence`."""
    observed = observe_shots(sequence, config)
    return observed.exclude_points(find_suspect_points(observed))


def find_keyframes(
    observed: ObservedWindow, config: KeyframesConfig, progress: Callable[[str], None] = lambda _: None
) -> tuple[KeyframeSet, KeyframeSet]:
    """Find the keyframes of both halves of the body in a sequence (section 4).

    `progress` called with the name of each stage before it begins.
    """
    out = []
    for half in split_into_halves(CMU15):
        progress(f'keyframes, {half.name} body')
        poses = extract_half_poses(observed.points, observed.weight, observed.times, half, MAX_BRIDGED_GAP_S)
        out.append(find_keyframe_set(poses, half, len(observed.times), config))
    return out[0], out[1]


def reconstruct(
    sequence: KeypointSequence,
    models: Mapping[str, PoseModel],
    config: Config,
    choices: Sequence[DepthChoice] = (),
    progress: Callable[[str], None] = lambda _: None,
) -> KeyframeResult:
    """Reconstruct a long sequence of one person's keypoints by keyframes.

    Arguments and errors are those of `whole_sequence.solve_sequence`, but the result always has the
    joints of `skeleton.CMU15`; the models are for the solver that proposes poses. `choices` are forward/backward
    choices for the keyframes whose key poses Taylor's method is to make. `progress` is called with the name of
    each stage before it begins. InputError also where no frame gives a 3D pose or a choice does not fit the
    keyframes.
    """
    parameters, times = config.keyframes, sequence.timestamps
    observed = observe_shots(sequence, config.tracker)
    plausible = observed.exclude_points(find_suspect_points(observed))
    keyframes = find_keyframes(plausible, parameters, progress)
    progress('key poses')
    frames = np.concatenate([half.frames for half in keyframes])
    category, poses = propose_poses(plausible, frames, models, config)
    lengths = estimate_limb_lengths(poses, config.tracker.body_height)
    progress('interpolation')
    key_directions = tuple(average_key_directions(half, poses, parameters.beta) for half in keyframes)
    for choice in choices:
        apply_depth_choice(choice, keyframes, key_directions, plausible, lengths)
    if not any(np.isfinite(k).all(axis=(1, 2)).any() for k in key_directions):
        raise InputError(
            'no key poses: too few joints are seen, too few poses are alike (keyframes.beta), or too small a '
            'share of the frames is to be represented (keyframes.alpha)'
        )
    motion = interpolate_key_poses(plausible, keyframes, key_directions, poses, lengths, parameters)
    start = align_motion(motion, plausible.points, plausible.weight, times, observed.focal)
    displacement = start.displacement(observed.points, observed.focal)
    outliers = find_outliers(displacement, observed.weight > 0, times)
    inliers = observed.exclude_points(outliers)
    start = align_motion(motion, inliers.points, inliers.weight, times, observed.focal)
    model = models[category].rescale(config.tracker.body_height / models[category].stature)
    with_pose = np.flatnonzero(np.isfinite(poses).all(axis=(1, 2)))
    proposed = assemble_poses(compute_limb_directions(poses[with_pose], CMU15.bones), lengths, CMU15)
    shown = inliers.points[with_pose], inliers.weight[with_pose]
    aligned = align_motion(proposed, *shown, times[with_pose], observed.focal)
    offsets = estimate_joint_offsets(aligned, *shown, observed.focal, model.mean)
    seen_points = subtract_offsets(offsets, start, inliers.points, observed.focal, model.mean)
    start = align_motion(motion, seen_points, inliers.weight, times, observed.focal)
    progress('fit')
    points, weight = fill_missing_points(start, seen_points, inliers.weight, times, observed.focal)
    fit = fit_motion(
        start,
        points,
        weight,
        times,
        lengths,
        CMU15,
        focal=observed.focal,
        step=parameters.step,
        smoothing=parameters.smoothing,
        iterations=parameters.iterations,
    )
    in_sight = find_frames_in_sight(observed.weight > 0, observed.times)
    found = _describe_poses(sequence, fit, inliers, seen_points, in_sight, category, model, config.tracker)
    contact = np.full((len(times), 4), np.nan)
    fault = 'is not used: the method keyframes has no feet on a floor' if config.tracker.camera_height else ''
    return KeyframeResult(Solved(found, contact, fault), keyframes, motion, outliers)


def find_suspect_points(observed: ObservedWindow) -> Mask:
    """Find the points (F, J) that jump in the image.

    They are left out of distances and key poses, and are judged again once a 3D motion is known.
    """
    out = np.zeros(observed.weight.shape, bool)
    torso = estimate_torso_lengths(observed.points, observed.weight, observed.times)
    points_m = observed.points / torso[:, None, None] * TORSO_M
    for padded, section in split_into_sections(observed.times, MAX_SECTION_S, SECTION_MARGIN_S):
        found = find_jumping_points(points_m[padded], observed.weight[padded] > 0, observed.times[padded])
        out[section] = found[section.start - padded.start : section.stop - padded.start]
    return out


def interpolate_key_poses(
    observed: ObservedWindow,
    keyframes: tuple[KeyframeSet, KeyframeSet],
    key_directions: Sequence[Array],
    poses: Array,
    lengths: Array,
    config: KeyframesConfig,
) -> Array:
    """Interpolate between key poses to the initial motion X^0 (F, J, 3) m (section 6.1).

    A half without any key pose follows the proposed poses (F, J, 3). Directions of key poses are (K, B, 3),
    lengths (B,).
    """
    times = observed.times
    directions = np.zeros((len(times), len(CMU15.bones), 3))
    has_pose = np.flatnonzero(np.isfinite(poses).all(axis=(1, 2)))
    proposed = slerp(compute_limb_directions(poses[has_pose], CMU15.bones), times[has_pose], times)
    for half_keyframes, half_directions in zip(keyframes, key_directions, strict=True):
        has_key_pose = np.asarray(np.isfinite(half_directions).all(axis=(1, 2)))
        bones = [CMU15.bones.index(bone) for bone in half_keyframes.body_half.bones]
        if not has_key_pose.any():
            directions[:, bones] = proposed[:, bones]
            continue
        assignment: Indices = np.where(has_key_pose[half_keyframes.nearest], half_keyframes.assignment, -1)
        distance = _rank_fits(observed, half_keyframes, half_directions, assignment, lengths)
        control = select_control_points(assignment, distance, times, config.gap)
        blended = blend_directions(
            half_directions[assignment[control]], proposed[control][:, bones], config.frame_pose_share
        )
        directions[:, bones] = slerp(blended, times[control], times)
    return assemble_poses(directions, lengths, CMU15)


def _rank_fits(
    observed: ObservedWindow, keyframes: KeyframeSet, key_directions: Array, assignment: Indices, lengths: Array
) -> Array:
    torso_px = estimate_torso_lengths(observed.points, observed.weight, observed.times)
    points = observed.points / torso_px[:, None, None]
    torso_m = lengths[CMU15.bones.index((CMU15.index('pelvis'), CMU15.index('neck')))]
    bones = [CMU15.bones.index(bone) for bone in keyframes.body_half.bones]
    all_directions = np.zeros((len(key_directions), len(CMU15.bones), 3))
    all_directions[:, bones] = key_directions
    key_poses = assemble_poses(all_directions, lengths / torso_m, CMU15)[..., :2]
    joints = list(keyframes.body_half.joints)
    out = np.full(len(assignment), np.inf)
    frames = np.flatnonzero(assignment >= 0)
    out[frames] = compute_reprojection_distances(
        key_poses[assignment[frames]][:, joints], points[frames][:, joints], observed.weight[frames][:, joints] > 0
    )
    return np.nan_to_num(out, nan=np.inf)


def fill_missing_points(
    motion: AlignedMotion, points: Array, weight: Array, times: Array, focal: float
) -> tuple[Array, Array]:
    """Fill the points that are not seen, as displacements from the motion interpolated over time.

    Returns all points (F, J, 2) px and weights (F, J), `FILLED_WEIGHT` for filled points.
    """
    seen = weight > 0
    displacement, known = interpolate_gaps(motion.displacement(points, focal), seen, times, MAX_FILLED_GAP_S)
    joints = motion.joints.copy()
    joints[..., :2] += np.where(known[..., None], displacement, 0.0)
    filled = AlignedMotion(joints, motion.scale, motion.translation).project(focal)
    return np.where(seen[..., None], points, filled), np.where(seen, weight, FILLED_WEIGHT)


def _describe_poses(
    sequence: KeypointSequence,
    fit: FitResult,
    observed: ObservedWindow,
    points: Array,
    in_sight: Mask,
    category: str,
    model: PoseModel,
    config: TrackerConfig,
) -> PoseSequence:
    """Return the fitted motion over time; outliers count as not seen in it.

    Only frames in sight (F,), from the first to the last in which a joint was seen, outliers included, get joints.
    Rotations and weights are those that bring the base poses nearest to the joints.
    """
    motion = fit.motion
    joints, translation = motion.joints, motion.translation
    seen = observed.weight > 0
    rotation = fit_rotation(np.broadcast_to(model.mean, joints.shape), joints)
    cameras = WeakPerspectiveCameras(motion.scale, rotation)
    squared_error = ((motion.project(observed.focal) - points) ** 2).sum(axis=-1)
    with np.errstate(invalid='ignore'):
        residual = np.sqrt((squared_error * seen).sum(axis=1) / seen.sum(axis=1))
    solution = Reconstruction(
        joints=joints,
        theta=model.weights(joints @ rotation),
        cameras=cameras,
        translation=translation,
        residual=residual,
        status=fit.status,
        history=fit.mean_squared_errors,
        iterations=len(fit.mean_squared_errors) - 1,
    )
    camera = observed.virtual_camera
    in_camera = camera.to_real_camera(joints) + camera.root_positions(cameras, translation)[:, None]
    in_camera[~in_sight] = np.nan
    vertical = choose_vertical(observed, in_camera, observed.weight, config)
    return describe_poses(sequence, SolvedWindow(in_camera, category, solution, vertical, observed), config)
