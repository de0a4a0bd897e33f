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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.config import Config, SolverConfig, TrackerConfig
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.level import CALIBRATED_TILT_STD, MAX_CERTAIN_STD, Floor, average_vertical, build_world
from mocap_ros.geometry.rotations import centre_poses, fit_rotation
from mocap_ros.geometry.virtual_camera import VirtualCamera
from mocap_ros.geometry.weak_perspective import WeakPerspectiveCameras
from mocap_ros.keypoints.rays import join_body
from mocap_ros.models.base_poses import ALL_MOTIONS, BasePoses
from mocap_ros.models.joint_std import expect_stature
from mocap_ros.models.lifter import LiftedPoses, Lifter
from mocap_ros.models.model_file import load_prior_lifter
from mocap_ros.models.upward_direction import Stances
from mocap_ros.skeleton import BODY26, CMU15, CORE_COUNT, Skeleton
from mocap_ros.solvers import alternation, joint
from mocap_ros.solvers.classification import choose_category
from mocap_ros.solvers.extremities import SEGMENT_OF, attach, collect_evidence, smooth_extremities
from mocap_ros.solvers.floor import POSE_SHARE, SIZE_RANGE, Stander, fit_floor
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


@dataclass(frozen=True, eq=False)
class SequenceResult:
    """A reconstructed sequence."""

    # (F, J, 3) m, real camera's optical frame, joints of `skeleton`; NaN before the first and after the last frame
    # in which a joint was seen, and in gaps of more than `MAX_GAP_S`, where it is not known whether the person is
    # there
    joints: Array
    # (F, J) True where the joint was seen in the image, False where it was inferred or is NaN
    seen: NDArray[np.bool_]
    skeleton: Skeleton
    category: str
    # weights, cameras and residuals in the images of the virtual cameras, before the body was scaled to
    # `tracker.body_height`
    solution: Reconstruction
    # the virtual cameras of `solution`, one a frame, with the real camera's intrinsics
    virtual_camera: VirtualCamera
    vertical: Array  # (F, 3) unit vectors upwards in the real camera's optical frame; NaN where it is not known
    vertical_std: Array  # (F,) rad, standard deviations of these directions; NaN likewise
    # (F, J, 4) quaternions x, y, z, w, as in `people.Person3D`; NaN where the joints are; None if they were not
    # computed
    orientation: Array | None = None
    # (F, J) True where nothing shows how a segment is turned about its own axis; None likewise
    turn_inferred: NDArray[np.bool_] | None = None
    contact: Array | None = None  # (F, 4) probabilities of `solvers.footing`; None likewise
    floor: Floor | None = None  # the floor on which the person stands; None if nothing shows it
    size: float = 1.0  # of the body, as a share of `tracker.body_height`
    height_note: str = ''  # in words why `tracker.camera_height`, if it is given, is not used or may be wrong
    shared_world: Array | None = None  # the `world_from_camera` of another person on the same floor

    @property
    def core(self) -> Array:
        """(F, 15, 3) m, the joints of `skeleton.CMU15`, without face, feet and hands."""
        return self.joints[:, :CORE_COUNT]

    @property
    def world_from_camera(self) -> Array:
        """(4, 4) m, from the optical frame to the person's world (`geometry.level`); NaN without joints."""
        if self.shared_world is not None:
            return self.shared_world
        if self.floor is not None:
            return build_world(self.joints, self.floor.upward, self.floor.camera_height)
        return build_world(self.joints, average_vertical(self.vertical, self.vertical_std), None)

    @property
    def foot_contact(self) -> Array:
        """(F, 2) probabilities that the left and the right foot stand; NaN where they were not computed."""
        if self.contact is None:
            return np.full((len(self.joints), 2), np.nan)
        return np.fmax(self.contact[:, ::2], self.contact[:, 1::2])

    @property
    def floor_std(self) -> float:
        """Standard deviation of the height of the floor in m; NaN where nothing shows the floor."""
        return math.nan if self.floor is None else self.floor.height_std

    def cameras_in_real_image(self) -> tuple[WeakPerspectiveCameras, Array]:
        """Return the weak-perspective cameras that show the body as the real camera does; NaN as the joints.

        Returns scale (F,) in px/m and rotation (F, 3, 3) from the body frame to the real camera's optical frame;
        and (F, 2) px, image of the body's origin in the real camera.
        """
        intrinsics, roots = self.virtual_camera.intrinsics, self.core.mean(axis=1)
        rotation = self.virtual_camera.body_rotations(self.solution.cameras)
        rotation = np.where(np.isfinite(roots[:, :1, None]), rotation, np.nan)
        cameras = WeakPerspectiveCameras(intrinsics.focal / roots[:, 2], rotation)
        return cameras, intrinsics.project(roots)


def report_part(report: Report, index: int, count: int) -> Report:
    """Return the function that gets the share of one of several equal parts of the work that is done."""
    return lambda share: report((index + share) / count)


def reconstruct_sequence(
    keypoints: Array,
    joint_names: tuple[str, ...],
    times: Array,
    intrinsics: Intrinsics,
    model: BasePoses | Mapping[str, BasePoses],
    config: Config,
    report: Report = lambda _: None,
) -> SequenceResult:
    """Reconstruct a sequence of one person's keypoints.

    The arguments are those of `reconstruct_without_floor`, and so are the errors.
    """
    result = reconstruct_without_floor(keypoints, joint_names, times, intrinsics, model, config, report)
    return share_floor([result], [times], config.tracker)[0]


def reconstruct_without_floor(
    keypoints: Array,
    joint_names: tuple[str, ...],
    times: Array,
    intrinsics: Intrinsics,
    model: BasePoses | Mapping[str, BasePoses],
    config: Config,
    report: Report = lambda _: None,
) -> SequenceResult:
    """Reconstruct a sequence of one person's keypoints, for whom `share_floor` has still to find the floor.

    `keypoints` (F, J, 3) x and y in px, and confidence score, NaN or score 0 where not seen; `joint_names` (J,)
    any names that `keypoints.joint_map` knows; `times` (F,) s, increasing; `model` base poses, or several by name.
    Of several, the most probable are chosen (`solvers.classification`), with a learned prior, those of all motions
    are used if present; `config` parameters of the solver, `min_score`, `undo_swaps`, `perspective`, `vertical`,
    `body_height`, `camera_height` and `skeleton` of `tracker` apply; `report` is called with the
    share, 0 to 1, that is done.

    Raises:
        SkeletonError: These names give too few of the model's joints.
        InputError: No frame has four seen joints, all seen points lie in one place, or the times span more than
            `observed_window.MAX_SPAN_S`.
        ModelError: The lifter that `solver.prior` names cannot be loaded.
        ConfigError: The vertical that `tracker.vertical` gives is no unit vector.
    """
    report(0.0)
    models = {model.name: model} if isinstance(model, BasePoses) else model
    skeleton = next(iter(models.values())).skeleton
    observed = observe_sequence(keypoints, joint_names, times, intrinsics, config.tracker, skeleton)
    result, lifted = _reconstruct(observed, models, config, report)
    in_sight = find_frames_in_sight(result.seen, times)
    complete = _blank_frames(_complete(result, lifted, config.tracker), ~in_sight)
    return _find_contacts(complete, lifted)


def reconstruct_window(
    observed: ObservedWindow, models: Mapping[str, BasePoses], config: Config
) -> SequenceResult:
    """Reconstruct the core of one person from all F frames of a window together, whether or not a joint was seen.

    `observed` the person's joints, not lifted yet; `models` base poses by name, as in `reconstruct_sequence`;
    `config` parameters of the solver, `body_height` and `vertical` of `tracker` apply.
    """
    return _reconstruct(observed, models, config)[0]


def _reconstruct(
    observed: ObservedWindow, models: Mapping[str, BasePoses], config: Config, report: Report = lambda _: None
) -> tuple[SequenceResult, ObservedWindow]:
    """Return the result of `reconstruct_window`, and the window with the lifted poses, if there is a lifter."""
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
    result = SequenceResult(joints, observed.weight > 0, skeleton, category, solution, camera, *vertical)
    return result, observed


def _complete(result: SequenceResult, observed: ObservedWindow, config: TrackerConfig) -> SequenceResult:
    """Return a result with the orientations and, if `tracker.skeleton` says so, with face, feet and hands."""
    core, count = result.joints, len(result.joints)
    image_noise = result.solution.noise if isinstance(result.solution, joint.JointReconstruction) else 0.0
    seen = [observed] * count, np.full(count, image_noise), range(count)
    found = smooth_extremities(observed.times, collect_evidence(core, *seen), config.body_height)
    core = plant_sequence(observed, core, found.offsets, result.vertical, image_noise or NOISE_REFERENCE)
    evidence = collect_evidence(core, *seen)
    found = smooth_extremities(observed.times, evidence, config.body_height)
    result = replace(result, joints=core)
    if config.skeleton == CMU15.name:
        return replace(result, orientation=found.quaternions, turn_inferred=~found.is_turn_seen)
    return replace(
        result,
        joints=attach(core, found.offsets),
        seen=evidence.weight > 0,
        skeleton=BODY26,
        orientation=found.quaternions[:, SEGMENT_OF],
        turn_inferred=~found.is_turn_seen[:, SEGMENT_OF],
    )


def _find_contacts(result: SequenceResult, observed: ObservedWindow) -> SequenceResult:
    points = join_body(observed.rays, observed.weight, observed.extremities)
    contact = find_contacts(*points, result.joints, result.vertical, observed.times)
    contact[np.isnan(result.joints).all(axis=(1, 2))] = np.nan
    return replace(result, contact=contact)


def find_height_fault(*, is_focal_known: bool, tilt_std: float) -> str:
    """Return why a known height of the camera is of no use, in words; `tilt_std` of the vertical in rad."""
    if not is_focal_known:
        return 'is not used: the focal length is not known, and distances with it'
    return '' if tilt_std <= MAX_CERTAIN_STD else 'is not used: the vertical is not known: give tracker.vertical'


def share_floor(
    results: Sequence[SequenceResult], times: Sequence[Array], config: TrackerConfig
) -> tuple[SequenceResult, ...]:
    """Return people of one recording on one floor, under one vertical, and in one world, that of the first.

    The results are those of `reconstruct_without_floor`, with times (F,) s of each.
    `tracker.camera_height` shows their true sizes. Where it is not known, the sizes of several become those with
    which all stand on the floor.
    """
    if not results:
        return ()
    known = [(r, average_vertical(r.vertical, r.vertical_std)) for r in results]
    known = [(r, upward) for r, upward in known if np.isfinite(upward).all()]
    trust = np.array([max(float(np.nanmean(r.vertical_std)), MIN_TILT_STD) ** -2 for r, _ in known])
    total = np.sum([t * upward for t, (_, upward) in zip(trust, known, strict=True)], axis=0)
    length = float(np.linalg.norm(total))
    agree = length > trust.sum() / 2  # opposite verticals show none
    vertical = total / length if agree else np.full(3, np.nan)
    std = float(trust.sum()) ** -0.5 if agree else math.nan
    tilt_std = min(FOUND_TILT_FACTOR * std, MAX_CERTAIN_STD) if std <= MAX_CERTAIN_STD else math.nan
    if read_given_vertical(config) is not None:
        std = tilt_std = CALIBRATED_TILT_STD
    people, fault = list(results), ''
    if config.camera_height > 0:
        is_focal_known = all(r.virtual_camera.intrinsics.is_focal_known for r in results)
        fault = find_height_fault(is_focal_known=is_focal_known, tilt_std=std)
        if not fault:
            people = _stand_on(results, times, Floor(vertical, config.camera_height, tilt_std), config)
            fault = next((r.height_note for r in people if r.floor is None), '')
    if not config.camera_height or (fault and not any(r.floor for r in people)):
        people = [
            replace(r, height_note=r.height_note or fault)
            for r in _stand_on(results, times, Floor(vertical, None, tilt_std), config)
        ]
    first = next((r for r in people if r.floor is not None), people[0])
    return tuple(replace(r, shared_world=first.world_from_camera if len(people) > 1 else None) for r in people)


def _stand_on(
    results: Sequence[SequenceResult], times: Sequence[Array], before: Floor, config: TrackerConfig
) -> list[SequenceResult]:
    """Return people on a floor, of the sizes that it shows; who cannot be of such a size has a fault instead."""
    share = math.hypot(config.body_height_std / config.body_height, POSE_SHARE)
    unknown = [np.full((len(r.joints), 4), np.nan) if r.contact is None else r.contact for r in results]
    standers = [Stander(r.joints, c, t) for r, c, t in zip(results, unknown, times, strict=True)]
    fit = fit_floor(standers, before, share)
    if fit is None:
        return [replace(r, floor=before if before.camera_height else None) for r in results]
    people = []
    sizes = fit.sizes[~np.isnan(fit.sizes)]
    is_scale_shown = before.camera_height is not None or len(sizes) > 1
    if before.camera_height is None and (np.abs(sizes - 1) > 3 * share).any():
        return list(results)  # they rather stand at different heights
    for p, (result, size) in enumerate(zip(results, fit.sizes.tolist(), strict=True)):
        if not SIZE_RANGE[0] < (1.0 if math.isnan(size) else size) < SIZE_RANGE[1]:
            people.append(replace(result, height_note=WRONG_HEIGHT if before.camera_height else ''))
            continue
        person = replace(result, floor=fit.floor)
        if is_scale_shown:
            frames = len(result.joints)
            vertical = np.tile(fit.floor.upward, (frames, 1))
            std = np.full(frames, fit.floor.tilt_std)
            person = replace(person, vertical=vertical, vertical_std=std)
        if is_scale_shown and not math.isnan(size):
            person = replace(person, joints=fit.place(p, result.joints), size=size)
            if before.camera_height and not USUAL_SIZES[0] < size < USUAL_SIZES[1]:
                person = replace(person, height_note=UNUSUAL.format(size))
        people.append(person)
    return people


def _blank_frames(result: SequenceResult, is_blank: NDArray[np.bool_]) -> SequenceResult:
    of_joints = is_blank[:, None]
    blanked = replace(
        result, joints=np.where(of_joints[..., None], np.nan, result.joints), seen=result.seen & ~of_joints
    )
    if result.orientation is None or result.turn_inferred is None:
        return blanked
    return replace(
        blanked,
        orientation=np.where(of_joints[..., None], np.nan, result.orientation),
        turn_inferred=result.turn_inferred | of_joints,
    )


def describe_height_faults(results: Sequence[SequenceResult]) -> list[str]:
    """Return in words what is wrong with `tracker.camera_height` for some people."""
    return [fault for fault in dict.fromkeys(r.height_note for r in results) if fault]


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
    """The vertical in each frame, as `SequenceResult` has it: (F, 3) and (F,) rad."""

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
    if known is None:
        known = choose_vertical(observed, lifted.joints @ cameras, seen, config)
    lifted = turn_towards_vertical(lifted, Stances.of(lifted.joints, cameras, seen), cameras, *known)
    return LiftedPoses(turn_about_axis(lifted.joints, -roll), lifted.std), known


def _add_lifted(observed: ObservedWindow, lifted: LiftedPoses) -> ObservedWindow:
    in_real_camera = observed.virtual_camera.to_real_camera(lifted.joints)
    return replace(observed, lifted=LiftedPoses(in_real_camera, lifted.std))


def _solve_with_lifter(
    observed: ObservedWindow,
    vertical: Verticals,
    lifter: Lifter,
    models: Mapping[str, BasePoses],
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
    window: Window, models: Mapping[str, BasePoses], config: SolverConfig, report: Report
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
MIN_TILT_STD = 1e-3  # rad; a smaller deviation of a vertical is not believed
FOUND_TILT_FACTOR = 1.5  # 1; by which a vertical counts less that people show, who share its errors
USUAL_SIZES = 0.75, 1.2  # 1; three standard deviations of the size of adults
UNUSUAL = 'makes a person {:.2f} times as tall as tracker.body_height: one of both is wrong, or it is a child'
# why `tracker.camera_height` is not used where feet show another one
WRONG_HEIGHT = (
    f'is not used: by it people are not {SIZE_RANGE[0]:g} to {SIZE_RANGE[1]:g} times as tall as '
    'tracker.body_height; check both'
)
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
