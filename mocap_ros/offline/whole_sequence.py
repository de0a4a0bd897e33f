# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Reconstruction of one person over a whole sequence at once, without a sliding window.

With a lifter, either its lifted poses lead or the base poses do, whichever suits the person
(`solvers.leading_prior`), and a sequence is solved two or three times: the lifter gets what the solution knows
before the next one.

The solvers find the core of the body; face, feet, hands and the orientations follow it (`solvers.extremities`).

The lifter learns from the solution of a whole sequence, before it is lifted and solved again, two things.

A detector at times takes something else for a joint, for some frames on end and often at a good score. The
solver's robust loss bears that, but the lifter does not. Points that the solution does not explain are hidden from
it,

    e_tj > UNEXPLAINED_MEDIANS max(median e, MIN_MEDIAN_ERROR_M)

with e_tj the reprojection error in m at the body, and its median over all joints that were seen. In frames with
more than `MAX_UNEXPLAINED_JOINTS` such points all are believed.

The lifter sees 0.8 s of noisy points and knows nothing of constant bones and smooth motion; the solution has used
all frames. So the points are drawn to where the solution has them,

    r_tj <- SEEN_SHARE r_tj + (1 - SEEN_SHARE) r'_tj

with r the rays of the seen joints and r' those of the solution's joints, in perspective even where the solution is
in weak perspective. The solution also knows better how the body is turned. So the new lifted poses P_t are turned
as its poses Q_t are,

    P_tj <- R_t P_tj,    R_t = argmin_R sum_j |R P_tj - Q_tj|^2
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array, Mask
from mocap_ros.config import Config, SolverConfig, TrackerConfig
from mocap_ros.engine import motion as engine
from mocap_ros.geometry.level import (
    LEVEL_UP,
    average_vertical,
)
from mocap_ros.geometry.rotations import centre_poses, fit_rotation
from mocap_ros.keypoints.keypoint_sequence import KeypointSequence
from mocap_ros.keypoints.rays import join_body
from mocap_ros.models.base_poses import ALL_MOTIONS, PoseModel
from mocap_ros.models.joint_std import expect_stature, widen_by_posture
from mocap_ros.models.lifter import LiftedPoses, Lifter
from mocap_ros.models.model_file import load_prior_lifter
from mocap_ros.models.upward_direction import Stances
from mocap_ros.people import PoseSequence
from mocap_ros.skeleton import BODY26, CMU15, CORE_COUNT, HIPS
from mocap_ros.solvers import alternation, joint
from mocap_ros.solvers.classification import choose_category
from mocap_ros.solvers.depth import compare_depths, find_corrections
from mocap_ros.solvers.extremities import (
    SEGMENT_OF,
    ExtremityEvidence,
    attach,
    collect_evidence,
    smooth_extremities,
)
from mocap_ros.solvers.floor import FOCAL_SHARE, POSE_SHARE, SIZE_RANGE
from mocap_ros.solvers.footing import find_contacts, plant_sequence
from mocap_ros.solvers.image_roll import find_camera_roll, find_roll, turn_about_axis
from mocap_ros.solvers.joint.objective import NOISE_REFERENCE
from mocap_ros.solvers.leading_prior import can_base_poses_lead, explains_as_well, let_base_poses_lead
from mocap_ros.solvers.observed_window import (
    ObservedWindow,
    observe_sequence,
    sample_unlifted_histories,
)
from mocap_ros.solvers.vertical import (
    AUTO,
    Vertical,
    find_vertical,
    lift_under_vertical,
    read_given_vertical,
    turn_towards_vertical,
)
from mocap_ros.solvers.window import Reconstruction, Window

Report = Callable[[float], None]  # gets the share, 0 to 1, of the work that is done


class Solved(NamedTuple):
    """One person's poses before the floor is known, without a world and of the assumed size."""

    poses: PoseSequence
    contact: Array  # (F, 4) probabilities of `solvers.footing`; NaN where they are not known
    height_fault: str = ''  # in words why `tracker.camera_height`, if it is given, is not used or may be wrong
    is_size_measured: bool = False  # whether the poses have the size that measured depths show


class SolvedWindow(NamedTuple):
    """The core of a person in the F frames of a window, and what it was solved from."""

    joints: Array  # (F, 15, 3) m, real camera's optical frame
    category: str  # name of the base poses
    # weights, cameras and residuals in the images of the virtual cameras, before the body was scaled to
    # `tracker.body_height`
    solution: Reconstruction
    vertical: Verticals
    observed: ObservedWindow  # with the lifted poses, if there is a lifter


def report_part(report: Report, index: int, count: int) -> Report:
    """Return the function that gets the share of one of several equal parts of the work that is done."""
    return lambda share: report((index + share) / count)


def solve_sequence(
    sequence: KeypointSequence,
    models: Mapping[str, PoseModel],
    config: Config,
    report: Report = lambda _: None,
) -> Solved:
    """Reconstruct a sequence of one person's keypoints, but for the floor (`offline.floor`).

    `models` are base poses by name. Of several, the most probable are chosen (`solvers.classification`); with a
    learned prior, those of all motions are used if present. Parameters of the solver, `min_score`, `undo_swaps`,
    `perspective`, `vertical`, `body_height`, `nominal_focal_length` and `skeleton` of `tracker` apply. `report` is
    called with the share, 0 to 1, that is done.

    Raises:
        SkeletonError: These names give too few of the model's joints.
        InputError: No frame has four seen joints, all seen points lie in one place, or the times span more than
            `observed_window.MAX_SPAN_S`.
        ModelError: The lifter that `solver.prior` names cannot be loaded.
        ConfigError: The vertical that `tracker.vertical` gives is no unit vector.
    """
    report(0.0)
    skeleton = next(iter(models.values())).skeleton
    observed = observe_sequence(sequence, config.tracker, skeleton)
    solved = reconstruct_window(observed, models, config, report)
    poses = describe_poses(sequence, solved, config.tracker)
    poses, ahead = _measure_size(poses, solved.observed)
    poses = _complete(poses, solved, config.tracker, ahead)
    poses = _blank_frames(poses, ~find_frames_in_sight(~poses.inferred, sequence.timestamps))
    observed = solved.observed
    points, weight = join_body(observed.rays, observed.weight, observed.extremities)
    noise = _find_image_noise(solved) or NOISE_REFERENCE
    contact = find_contacts(points, weight, poses.joints, poses.vertical, observed.times, noise)
    contact[np.isnan(poses.joints).all(axis=(1, 2))] = np.nan
    poses = replace(poses, contact=np.fmax(contact[:, ::2], contact[:, 1::2]))
    return Solved(poses, contact, is_size_measured=ahead is not None)


def reconstruct_window(
    observed: ObservedWindow,
    models: Mapping[str, PoseModel],
    config: Config,
    report: Report = lambda _: None,
) -> SolvedWindow:
    """Reconstruct the core of one person from all F frames of a window together, whether or not a joint was seen.

    `observed` the person's joints, not lifted yet; `models` base poses by name, as in `solve_sequence`;
    `config` parameters of the solver, `body_height` and `vertical` of `tracker` apply.
    """
    body_height = config.tracker.body_height
    models = {name: model.rescale(body_height / model.stature) for name, model in models.items()}
    skeleton = next(iter(models.values())).skeleton
    lifter = load_prior_lifter(config.solver.prior, skeleton) if config.solver.method == 'joint' else None
    if lifter is None:
        category, solution = _solve(observed.build_solver_window(), models, config.solver, report)
        vertical = None
    else:
        if ALL_MOTIONS in models:
            models = {ALL_MOTIONS: models[ALL_MOTIONS]}
        lifted, vertical = _lift(observed, lifter, config.tracker)
        observed = _add_lifted(observed, lifted)
        del lifted  # here and below what is as long as the sequence, before it is solved
        report(LIFTED_SHARE)
        category, solution = _solve_with_lifter(observed, vertical, lifter, models, config, report)
    camera = observed.virtual_camera
    root = camera.root_positions(solution.cameras, solution.translation)
    joints = camera.to_real_camera(solution.joints) + root[:, None]
    lengths, depth = skeleton.bone_lengths(solution.joints), camera.measure_depth(root)
    joints *= body_height / expect_stature(lengths, skeleton, observed.lifted, depth)
    if vertical is None:
        vertical = choose_vertical(observed, joints, observed.weight, config.tracker)
    return SolvedWindow(joints, category, solution, vertical, observed)


def describe_poses(sequence: KeypointSequence, solved: SolvedWindow, config: TrackerConfig) -> PoseSequence:
    """Return the core of a person over time, as solved from a sequence of keypoints."""
    solution, camera = solved.solution, solved.observed.virtual_camera
    rotation = camera.body_rotations(solution.cameras)
    return PoseSequence(
        id=sequence.person_id,
        times=sequence.timestamps,
        skeleton=CMU15,
        joints=solved.joints,
        inferred=~(solved.observed.weight > 0),
        reprojection_residual=solution.residual,
        intrinsics=camera.intrinsics,
        rotation=np.where(np.isfinite(solved.joints).all(axis=(1, 2), keepdims=True), rotation, np.nan),
        vertical=solved.vertical.direction,
        vertical_std=solved.vertical.std,
        body_height=config.body_height,
        base_poses=solved.category,
        weights=solution.theta,
        success=solution.success,
        message=solution.message,
        iterations=solution.iterations,
        cost=solution.cost,
        sequence=sequence,
        recorded_ns=sequence.recorded_ns,
    )


def _measure_size(poses: PoseSequence, observed: ObservedWindow) -> tuple[PoseSequence, Array | None]:
    """Return poses of the size that measured depths show, and displacements for `plant_sequence`."""
    if observed.depth is None:
        return poses, None
    same = np.ones(len(poses))
    found = compare_depths(observed.depth, poses.joints, same)
    known = found.log_size[np.isfinite(found.log_size)]
    if len(known) < MIN_MEASURED_FRAMES:
        return poses, None
    size = math.exp(float(np.median(known)))
    if not SIZE_RANGE[0] < size < SIZE_RANGE[1]:
        return poses, None
    poses = replace(poses, joints=poses.joints * size, body_height=poses.body_height * size)
    found = compare_depths(observed.depth, poses.joints, same)
    return poses, found.find_displacement(poses.joints, same)


def _find_image_noise(solved: SolvedWindow) -> float:
    return solved.solution.noise if isinstance(solved.solution, joint.JointReconstruction) else 0.0


def _complete(
    poses: PoseSequence, solved: SolvedWindow, config: TrackerConfig, ahead: Array | None
) -> PoseSequence:
    """Return poses with the orientations and, if `tracker.skeleton` says so, with face, feet and hands."""
    core, observed, count = poses.joints, solved.observed, len(poses)
    image_noise = _find_image_noise(solved)
    windows, noise = [observed] * count, np.full(count, image_noise)
    found = smooth_extremities(
        observed.times, collect_evidence(core, windows, noise, range(count)), config.body_height
    )
    core = plant_sequence(observed, core, found.offsets, poses.vertical, image_noise or NOISE_REFERENCE, ahead)
    evidence = collect_evidence(core, windows, noise, range(count))
    found = smooth_extremities(observed.times, evidence, config.body_height)
    upward = average_vertical(poses.vertical, poses.vertical_std)
    std, root_covariance = _find_deviations(
        evidence, solved.solution, upward, config, is_focal_known=poses.is_scale_known
    )
    poses = replace(poses, root_covariance=root_covariance)
    if config.skeleton == CMU15.name:
        return replace(
            poses,
            joints=core,
            joint_std=std,
            joint_orientation=found.quaternions,
            turn_inferred=~found.is_turn_seen,
        )
    offset_std = np.pad(found.offset_std, ((0, 0), (CORE_COUNT, 0)))
    return replace(
        poses,
        skeleton=BODY26,
        joints=attach(core, found.offsets),
        joint_std=np.hypot(std[:, SEGMENT_OF], offset_std),
        inferred=~(evidence.weight > 0),
        joint_orientation=found.quaternions[:, SEGMENT_OF],
        turn_inferred=~found.is_turn_seen[:, SEGMENT_OF],
    )


def _find_deviations(
    evidence: ExtremityEvidence,
    solution: Reconstruction,
    upward: Array,
    config: TrackerConfig,
    *,
    is_focal_known: bool,
) -> tuple[Array, Array]:
    """Return the deviations (F, 15) m of joints and the covariances (F, 3, 3) m^2 of roots, as of live people."""
    count, share = len(evidence.core), assume_size_share(config)
    posterior = solution.joint_std if isinstance(solution, joint.JointReconstruction) else None
    std, root_covariance = engine.describe_cores(
        np.full((count, CORE_COUNT), np.nan if posterior is None else posterior),
        evidence,
        evidence.core,
        np.tile((1.0, share, 0.0 if is_focal_known else FOCAL_SHARE), (count, 1)),
        np.full((count, 3), np.nan),
        np.array(HIPS),
    )
    is_seen = evidence.weight[:, :CORE_COUNT] > 0
    up = upward if np.isfinite(upward).all() else LEVEL_UP
    return widen_by_posture(std, evidence.core, is_seen, up, np.full(count, share)), root_covariance


def assume_size_share(config: TrackerConfig) -> float:
    """Return the standard deviation of a person's size, as a share of it, before anything shows it."""
    return math.hypot(config.body_height_std / config.body_height, POSE_SHARE)


def _blank_frames(poses: PoseSequence, is_blank: Mask) -> PoseSequence:
    of_joints = is_blank[:, None]
    return replace(
        poses,
        joints=np.where(of_joints[..., None], np.nan, poses.joints),
        inferred=poses.inferred | of_joints,
        rotation=np.where(of_joints[..., None], np.nan, poses.rotation),
        joint_orientation=np.where(of_joints[..., None], np.nan, poses.joint_orientation),
        turn_inferred=poses.turn_inferred | of_joints,
    )


def find_frames_in_sight(seen: NDArray[np.bool_], times: Array) -> NDArray[np.bool_]:
    """Return the frames (F,), at times (F,) in s, in which a core joint was seen (F, J), and those in short gaps.

    In gaps of more than `MAX_GAP_S`, before the first sight and after the last it is not known whether the person
    is there.
    """
    in_sight = np.asarray(seen[:, :CORE_COUNT].any(axis=1))
    frames = np.flatnonzero(in_sight)
    for before, after in pairwise(frames):
        if times[after] - times[before] <= MAX_GAP_S:
            in_sight[before:after] = True
    return in_sight


class Verticals(NamedTuple):
    """The vertical in each frame, as `PoseSequence` has it: (F, 3) and (F,) rad."""

    direction: Array
    std: Array


def choose_vertical(observed: ObservedWindow, joints: Array, weight: Array, config: TrackerConfig) -> Verticals:
    """Return the vertical in each frame as `tracker.vertical` says: given, found, or NaN.

    The poses (F, J, 3), of joints with scores (F, J), are in any unit, in the axes of the real camera.
    """
    if config.vertical == AUTO:
        roll = _find_camera_roll(observed)
        stances = Stances.of(turn_about_axis(joints, roll), weight=weight)
        direction, std = find_vertical(observed.times, stances, is_turned=roll != 0)
        return Verticals(turn_about_axis(direction, -roll), std)
    given, frames = read_given_vertical(config), len(observed.times)
    if given is None:
        return Verticals(np.full((frames, 3), np.nan), np.full(frames, np.nan))
    return _repeat_vertical(given, frames)


def _find_camera_roll(observed: ObservedWindow) -> float:
    return find_camera_roll(observed.rays, observed.weight, observed.times)


def _repeat_vertical(given: Vertical, frames: int) -> Verticals:
    return Verticals(np.tile(given.direction, (frames, 1)), np.full(frames, given.std))


def _lift(
    observed: ObservedWindow, lifter: Lifter, config: TrackerConfig, known: Verticals | None = None
) -> tuple[LiftedPoses, Verticals]:
    """Return lifted poses that are turned towards the vertical, in the virtual cameras' axes, and the vertical.

    The lifter gets a vertical that is given, for those with a straight leg; `known` is one that was found before.
    """
    given = read_given_vertical(config)
    if given is not None:
        known, roll = _repeat_vertical(given, len(observed.times)), find_roll(given.direction)
    else:
        roll = _find_camera_roll(observed)
    parts = []
    for first in range(0, len(observed.times), LIFTED_FRAMES):
        frames = slice(first, first + LIFTED_FRAMES)
        points, weight, cameras = sample_unlifted_histories([observed], roll, frames)
        in_lifter = None
        if given is not None:
            in_lifter = cameras @ given.direction, np.full(len(cameras), given.std)
        poses = lift_under_vertical(lifter, points, weight, in_lifter)
        parts.append((poses.joints, poses.std, weight.max(axis=1), cameras))
    joints, std, seen, cameras = map(np.concatenate, zip(*parts, strict=True))
    lifted = LiftedPoses(joints, std)
    if observed.depth is not None:
        found = find_corrections(observed.depth, observed.rays, cameras, lifted, config.body_height)
        lifted = found.apply(lifted)
    if known is None:
        known = choose_vertical(observed, lifted.joints @ cameras, seen, config)
    lifted = turn_towards_vertical(
        lifted, Stances.of(lifted.joints, cameras, seen), cameras, known.direction, known.std
    )
    return LiftedPoses(turn_about_axis(lifted.joints, -roll), lifted.std), known


def _add_lifted(observed: ObservedWindow, lifted: LiftedPoses) -> ObservedWindow:
    in_real_camera = observed.virtual_camera.to_real_camera(lifted.joints)
    return replace(observed, lifted=LiftedPoses(in_real_camera, lifted.std))


def _solve_with_lifter(
    observed: ObservedWindow,
    vertical: Verticals,
    lifter: Lifter,
    models: Mapping[str, PoseModel],
    config: Config,
    report: Report,
) -> tuple[str, Reconstruction]:
    """Reconstruct with lifted poses, and again with those of points that the first solution corrects.

    If there are points that the first solution does not explain, they are hidden from the lifter for a second one.
    The last one has poses of points that are drawn to the solution before.
    """
    window = observed.build_solver_window()
    _, solution = _solve(window, models, config.solver, _share(report, LIFTED_SHARE, SOLVED_SHARE))
    believed = hide_unexplained_points(observed, window, solution)
    del window
    if believed is not observed:
        lifted, _ = _lift(replace(believed, lifted=None), lifter, config.tracker, vertical)
        observed = _add_lifted(observed, lifted)
        del lifted
        rest = _share(report, SOLVED_SHARE, SOLVED_AGAIN_SHARE)
        _, solution = _solve(observed.build_solver_window(), models, config.solver, rest)
    report(SOLVED_AGAIN_SHARE)
    again, _ = _lift(draw_points(believed, solution), lifter, config.tracker, vertical)
    observed = _add_lifted(observed, turn_like(again, solution.joints))
    del again, believed, solution
    return _solve(observed.build_solver_window(), models, config.solver, _share(report, SOLVED_AGAIN_SHARE, 1.0))


def _share(report: Report, first: float, last: float) -> Report:
    return lambda share: report(first + share * (last - first))


def _solve(
    window: Window, models: Mapping[str, PoseModel], config: SolverConfig, report: Report
) -> tuple[str, Reconstruction]:
    if len(models) > 1:
        name, reconstruction = choose_category(window, models, config)
        if config.method == 'alternation':  # the choice compares joint solutions
            return name, alternation.reconstruct(window, models[name], config)
        return name, reconstruction
    ((name, model),) = models.items()
    if config.method == 'alternation':
        return name, alternation.reconstruct(window, model, config)
    if window.lifted is None or not can_base_poses_lead(name):
        return name, joint.solve_in_sections(window, model, config, report)
    solution = joint.solve_in_sections(window, model, config, _share(report, 0.0, 0.5))
    led = joint.solve_in_sections(window, model, let_base_poses_lead(config), _share(report, 0.5, 1.0))
    return name, led if explains_as_well(led.misfit, solution.misfit) else solution


# 1; shares of the time after which the stages of a reconstruction end, measured with 3,120 frames; almost all
# sequences are solved three times
LIFTED_SHARE, SOLVED_SHARE, SOLVED_AGAIN_SHARE = 0.07, 0.4, 0.68
LIFTED_FRAMES = 3600  # that are lifted at once; their histories take 20 MB
MIN_MEASURED_FRAMES = 10  # with depths; fewer show no size
MAX_GAP_S = 3.0  # s; a person who is not seen for longer may be anywhere
SEEN_SHARE = 0.3  # 1; with less, unusual poses are drawn to usual ones; with more, the noise of detectors stays
MIN_DEPTH_M = 0.1  # m; guards divisions, no person is nearer to a camera
UNEXPLAINED_MEDIANS = 4.0  # median errors; 4.7 standard deviations of a coordinate, if errors are Gaussian
# m at the body; a smaller median error counts as this much, so that precise points are believed even where the
# model cannot follow them
MIN_MEDIAN_ERROR_M = 0.03
# joints of a frame; where more are unexplained, the solution is wrong rather than the detector
MAX_UNEXPLAINED_JOINTS = 2


def hide_unexplained_points(observed: ObservedWindow, window: Window, solution: Reconstruction) -> ObservedWindow:
    """Return a person's joints in F frames, seen as `window`, without those that a solution does not explain."""
    unexplained = find_unexplained_points(measure_errors(window, solution), window.weight > 0)
    return observed.exclude_points(unexplained) if unexplained.any() else observed


def draw_points(observed: ObservedWindow, solution: Reconstruction) -> ObservedWindow:
    """Return a person's joints in F frames, not lifted yet, drawn to where a solution has them."""
    camera = observed.virtual_camera
    roots = camera.root_positions(solution.cameras, solution.translation)
    positions = camera.to_real_camera(solution.joints) + roots[:, None]
    rays = positions[..., :2] / np.maximum(positions[..., 2:], MIN_DEPTH_M)
    drawn = SEEN_SHARE * observed.rays + (1 - SEEN_SHARE) * rays
    return replace(observed, rays=np.where(observed.weight[..., None] > 0, drawn, observed.rays), lifted=None)


def turn_like(lifted: LiftedPoses, joints: Array) -> LiftedPoses:
    """Return lifted poses that are turned as the poses (F, J_c, 3) of a solution, in the same axes."""
    core = lifted.joints[:, :CORE_COUNT]
    known = np.isfinite(core).all(axis=(1, 2))
    turned = lifted.joints.copy()
    rotation = fit_rotation(centre_poses(core[known]), centre_poses(joints[known]))
    turned[known] = turned[known] @ np.swapaxes(rotation, -1, -2)
    return LiftedPoses(turned, lifted.std)


def measure_errors(window: Window, solution: Reconstruction) -> Array:
    """Return the reprojection errors (F, J) of a solution in m at the body; 0 where a joint was not seen."""
    scale = solution.cameras.scale[:, None]
    depth = 1 + scale * solution.joints[..., 2] / window.focal
    image = (scale[..., None] * solution.joints[..., :2] + solution.translation[:, None]) / depth[..., None]
    return np.where(window.weight > 0, np.linalg.norm(image - window.points, axis=-1) / scale, 0.0)


def find_unexplained_points(error: Array, seen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Find the seen points (F, J) whose errors (F, J) in m are not explained (formula of the module)."""
    median = max(float(np.median(error[seen])), MIN_MEDIAN_ERROR_M)
    unexplained = seen & (error > UNEXPLAINED_MEDIANS * median)
    return np.asarray(unexplained & (unexplained.sum(axis=1, keepdims=True) <= MAX_UNEXPLAINED_JOINTS))
