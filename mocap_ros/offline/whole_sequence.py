"""Whole-sequence reconstruction of one person: no window, every frame sees all the others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import Config, SolverConfig
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.virtual_camera import View, solver_focal
from mocap_ros.keypoints.left_right import swapped_frames
from mocap_ros.models.base_poses import ALL_MOTIONS, BasePoses
from mocap_ros.models.model_file import lifter_for_prior
from mocap_ros.skeleton import Skeleton, model_joints, stature
from mocap_ros.solvers import alternation, joint
from mocap_ros.solvers.classification import choose_category
from mocap_ros.solvers.window import Reconstruction, Window

Array = NDArray[np.float64]

FACING = 3.0


@dataclass(frozen=True, eq=False)
class SequenceResult:
    """A reconstructed sequence.

    Attributes:
        joints: (F, J, 3) m, camera optical frame, joints of `skeleton`.
        seen: (F, J) True where the joint was seen in the image.
        skeleton: of the joints.
        category: name of the base poses used.
        solution: weights, cameras and residuals in the image of virtual cameras (`perspective.View`), before the
            body was made `tracker.body_height` tall.
    """

    joints: Array
    seen: NDArray[np.bool_]
    skeleton: Skeleton
    category: str
    solution: Reconstruction


def reconstruct_sequence(
    keypoints: Array,
    joint_names: tuple[str, ...],
    times: Array,
    intrinsics: Intrinsics,
    model: BasePoses | Mapping[str, BasePoses],
    config: Config,
) -> SequenceResult:
    """Reconstruct a sequence of one person's keypoints.

    Args:
        keypoints: (F, J, 3) x, y in px and score; NaN or score 0 where not seen.
        joint_names: (J,) any names that `skeleton.joint_map` knows.
        times: (F,) s, increasing.
        intrinsics: of the camera.
        model: base poses, or several by name: the likeliest are used (`classification`), or with a learned prior
            those of all motions, if they are among them.
        config: of the solver; `tracker.min_score` and `tracker.body_height` apply too.

    Raises:
        SkeletonError: too few of the model's joints can be had from these names.
        InputError: no frame has four seen joints.
        ModelError: the lifter that `solver.prior` names cannot be had.
    """
    settings = config.tracker
    models = {model.name: model} if isinstance(model, BasePoses) else model
    sized = {name: m.rescaled(settings.body_height / m.stature) for name, m in models.items()}
    skeleton = next(iter(sized.values())).skeleton
    points, weight = model_joints(keypoints[..., :2], keypoints[..., 2], joint_names, settings.min_score, skeleton)
    if settings.undo_swaps:
        mirror = np.array(skeleton.mirror)
        swapped = swapped_frames(times, points, weight, mirror)
        points = np.where(swapped[:, None, None], points[:, mirror], points)
        weight = np.where(swapped[:, None], weight[:, mirror], weight)
    rays = intrinsics.rays(points)
    view = View.of(rays, weight, times, FACING, intrinsics)
    focal = solver_focal(intrinsics, settings.perspective)
    window = Window(np.where(weight[..., None] > 0, view.image(rays), 0.0), weight, times, focal=focal)
    lifter = lifter_for_prior(config.solver.prior, skeleton) if config.solver.method == 'joint' else None
    if lifter is not None:
        lifted = lifter.lift_sequence(window.points, weight, times, intrinsics.focal)
        window = replace(window, lifted=lifted)
        if ALL_MOTIONS in sized:
            sized = {ALL_MOTIONS: sized[ALL_MOTIONS]}
    category, solution = _solve(window, sized, config.solver)
    joints = view.to_camera(solution.joints) + view.roots(solution.cameras, solution.translation)[:, None]
    joints *= settings.body_height / stature(solution.joints, skeleton)
    return SequenceResult(joints, weight > 0, skeleton, category, solution)


def _solve(window: Window, models: Mapping[str, BasePoses], config: SolverConfig) -> tuple[str, Reconstruction]:
    if len(models) > 1:
        choice = choose_category(window, models, config)
        return choice.category, choice.reconstruction
    ((name, model),) = models.items()
    if config.method == 'alternation':
        return name, alternation.reconstruct(window, model, config)
    (solution,) = joint.solve_hypotheses([window], model, config)
    return name, solution
