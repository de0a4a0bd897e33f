"""Reconstruction of one person over a whole sequence in one solve, without a sliding window."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import Config, SolverConfig
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.virtual_camera import VirtualCamera, solver_focal
from mocap_ros.keypoints.joint_map import map_to_model_joints
from mocap_ros.keypoints.left_right import find_swapped_frames
from mocap_ros.models.base_poses import ALL_MOTIONS, BasePoses
from mocap_ros.models.model_file import load_prior_lifter
from mocap_ros.skeleton import Skeleton, estimate_stature
from mocap_ros.solvers import alternation, joint
from mocap_ros.solvers.classification import choose_category
from mocap_ros.solvers.window import Reconstruction, Window

Array = NDArray[np.float64]

# s; the virtual cameras' directions are averaged over it, so that they follow a walk, but not the joints that come
# and go in single frames
VIEW_SMOOTHING_S = 3.0


@dataclass(frozen=True, eq=False)
class SequenceResult:
    """A reconstructed sequence.

    Attributes:
        joints: (F, J, 3) m, real camera's optical frame, joints of `skeleton`.
        seen: (F, J) True where the joint was seen in the image, False where it was inferred.
        skeleton: skeleton of the joints.
        category: name of the base poses used.
        solution: weights, cameras and residuals in the images of the virtual cameras, before the body was scaled
            to `tracker.body_height`.
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
        keypoints: (F, J, 3) x and y in px, and confidence score; NaN or score 0 where not seen.
        joint_names: (J,) any names that `keypoints.joint_map` knows.
        times: (F,) s, increasing.
        intrinsics: intrinsics of the camera.
        model: base poses, or several by name. Of several, the most probable are chosen (`solvers.classification`);
            with a learned prior, those of all motions are used if present.
        config: parameters of the solver; `min_score`, `undo_swaps`, `perspective` and `body_height` of `tracker`
            apply.

    Raises:
        SkeletonError: These names give too few of the model's joints.
        InputError: No frame has four seen joints.
        ModelError: The lifter that `solver.prior` names cannot be loaded.
    """
    tracker = config.tracker
    models = {model.name: model} if isinstance(model, BasePoses) else model
    scaled_models = {name: m.rescale(tracker.body_height / m.stature) for name, m in models.items()}
    skeleton = next(iter(scaled_models.values())).skeleton
    points, weight = map_to_model_joints(
        keypoints[..., :2], keypoints[..., 2], joint_names, tracker.min_score, skeleton
    )
    if tracker.undo_swaps:
        mirror = np.array(skeleton.mirror)
        swapped = find_swapped_frames(times, points, weight, mirror)
        points = np.where(swapped[:, None, None], points[:, mirror], points)
        weight = np.where(swapped[:, None], weight[:, mirror], weight)
    rays = intrinsics.pixels_to_rays(points)
    camera = VirtualCamera.look_at_person(rays, weight, times, VIEW_SMOOTHING_S, intrinsics)
    focal = solver_focal(intrinsics, tracker.perspective)
    window = Window(np.where(weight[..., None] > 0, camera.project_rays(rays), 0.0), weight, times, focal=focal)
    lifter = load_prior_lifter(config.solver.prior, skeleton) if config.solver.method == 'joint' else None
    if lifter is not None:
        lifted = lifter.lift_sequence(window.points, weight, times, intrinsics.focal)
        window = replace(window, lifted=lifted)
        if ALL_MOTIONS in scaled_models:
            scaled_models = {ALL_MOTIONS: scaled_models[ALL_MOTIONS]}
    category, solution = _solve(window, scaled_models, config.solver)
    root = camera.root_positions(solution.cameras, solution.translation)
    joints = camera.to_real_camera(solution.joints) + root[:, None]
    joints *= tracker.body_height / estimate_stature(solution.joints, skeleton)
    return SequenceResult(joints, weight > 0, skeleton, category, solution)


def _solve(window: Window, models: Mapping[str, BasePoses], config: SolverConfig) -> tuple[str, Reconstruction]:
    """Reconstruct by the method that `solver.method` names, with the most probable of several base poses.

    Returns:
        The name of the base poses used, and the reconstruction.
    """
    if len(models) > 1:
        choice = choose_category(window, models, config)
        return choice.category, choice.reconstruction
    ((name, model),) = models.items()
    if config.method == 'alternation':
        return name, alternation.reconstruct(window, model, config)
    (solution,) = joint.solve_hypotheses([window], model, config)
    return name, solution
