"""Whole-sequence reconstruction of one person: no window, every frame sees all the others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros import alternation, nonperiodic
from mocap_ros.base_poses import BasePoses
from mocap_ros.config import Config
from mocap_ros.people import Intrinsics
from mocap_ros.reconstruction import Reconstruction, Window
from mocap_ros.skeleton import Skeleton, joint_map
from mocap_ros.tracker import root_position

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SequenceResult:
    """A reconstructed sequence.

    Attributes:
        joints: (F, J, 3) m, camera optical frame, joints of `skeleton`.
        seen: (F, J) True where the joint was seen in the image.
        skeleton: of the joints.
        solution: cameras, weights and residuals.
    """

    joints: Array
    seen: NDArray[np.bool_]
    skeleton: Skeleton
    solution: Reconstruction


def reconstruct_sequence(
    keypoints: Array,
    joint_names: tuple[str, ...],
    times: Array,
    intrinsics: Intrinsics,
    model: BasePoses,
    config: Config,
) -> SequenceResult:
    """Reconstruct a sequence of one person's keypoints.

    Args:
        keypoints: (F, J, 3) x, y in px and score; NaN or score 0 where not seen.
        joint_names: (J,) any names that `skeleton.joint_map` knows.
        times: (F,) s, increasing.
        intrinsics: of the camera.
        model: base poses.
        config: of the solver; `tracker.min_score` and `tracker.body_height` apply too.

    Raises:
        SkeletonError: too few of the model's joints can be had from these names.
        InputError: no frame has four seen joints.
    """
    settings = config.tracker
    sized = model.rescaled(settings.body_height / model.stature)
    score = np.where(keypoints[..., 2] >= settings.min_score, keypoints[..., 2], 0.0)
    points, weight = joint_map(joint_names, model.skeleton).apply(keypoints[..., :2], score)
    points = np.where(weight[..., None] > 0, points, 0.0)
    window = Window(points, weight, times)
    if config.solver.method == 'alternation':
        solution = alternation.reconstruct(window, sized, config.solver)
    else:
        (solution,) = nonperiodic.solve_hypotheses([window], sized, config.solver)
    root = root_position(solution.translation, solution.cameras.scale, intrinsics)
    return SequenceResult(solution.joints + root[:, None], weight > 0, model.skeleton, solution)
