# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Reconstruction of one person's whole sequence, and the 3D poses that it gives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mocap_ros.api.arguments import (
    LOGGER,
    Model,
    Parameters,
    check_camera,
    check_sequence,
    load_models,
    make_config,
)
from mocap_ros.arrays import Array
from mocap_ros.config import format_value
from mocap_ros.errors import InputError
from mocap_ros.formats.sequence_file import KeypointSequence, describe_frames, extract_observations
from mocap_ros.offline.keyframes import keyframe_method
from mocap_ros.offline.whole_sequence import SequenceResult, describe_height_faults, reconstruct_sequence
from mocap_ros.recordings.save_results import ReconstructedSequence
from mocap_ros.verdict.summary import Summary, summarise


@dataclass(frozen=True, eq=False, repr=False)
class PoseSequence:
    """One person's 3D poses over time, which `mocap_ros.reconstruct` returns.

    F frames, J = 26 joints of the layout `body26` (15 of `cmu15` with `tracker.skeleton: cmu15`, or by the method
    `keyframes`), K base poses. Coordinates are in metres in the camera's optical frame: x to the right, y down, z
    forward.

    Attributes:
        joints: (F, J, 3) m, positions of the joints; NaN in frames in which the person was out of sight.
        joint_names: (J,) names of the joints.
        parents: (J,) index of each joint's parent, -1 for the root.
        times: (F,) s, times of the frames.
        seen: (F, J) True where the joint was seen in the image, False where the model inferred it.
        orientation: (F, J, 4) quaternions x, y, z, w of the body segment that turns about each joint, to the
            optical frame. If a person stands upright with hanging arms, the axes of all segments are x forward, y
            left and z up. Successive quaternions do not change their sign. NaN where the joints are, or with the
            method `keyframes`.
        turn_inferred: (F, J) True where the image does not show how that segment is turned about its own axis z.
        residual: (F,) px, RMS reprojection error over the seen joints; NaN in frames without any.
        success: True if the solver converged.
        message: why the solver stopped, as a sentence.
        iterations: number of iterations of the solver.
        cost: final value of the objective, m^2.
        base_poses: name of the base poses that were used, such as `walk`, or the path of their file.
        weights: (F, K) m, weights of the base poses.
        scale: (F,) px/m, scale of the weak-perspective camera.
        rotation: (F, 3, 3) rotation from the body frame (x forward, y left, z up) to the camera's optical frame.
        translation: (F, 2) px, image point of the mean of the joints.
        vertical: (F, 3) unit vectors upwards in the camera's optical frame; NaN where nothing is known.
        vertical_std: (F,) rad, standard deviations of the direction of `vertical`; NaN where nothing is known.
        contact: (F, 2) probabilities that the left and the right foot stand; NaN as the joints, where the image
            shows nothing of it, or with the method `keyframes`.
        world_from_camera: (4, 4) transform in m from the optical frame to a world: z up, the floor at z = 0, x
            where the person looks first, the origin below the first pelvis.
        floor_std: m, standard deviation of the height of the camera over that floor; NaN where no standing feet
            showed it, so that the lowest joints are the floor.
        is_scale_known: True if the focal length was given; False if it is nominal, and the distances with it.
        sequence: the keypoints that were reconstructed.
        summary: what the poses rest on, and whether the input is `good`, `doubtful` or `wrong` (`grade`); as text,
            the line that the commands print.
    """

    joints: Array
    joint_names: tuple[str, ...]
    parents: tuple[int, ...]
    times: Array
    seen: NDArray[np.bool_]
    orientation: Array
    turn_inferred: NDArray[np.bool_]
    residual: Array
    success: bool
    message: str
    iterations: int
    cost: float
    base_poses: str
    weights: Array
    scale: Array
    rotation: Array
    translation: Array
    vertical: Array
    vertical_std: Array
    contact: Array
    world_from_camera: Array
    floor_std: float
    is_scale_known: bool
    sequence: KeypointSequence
    summary: Summary
    _reconstruction: ReconstructedSequence

    @staticmethod
    def _create(reconstruction: ReconstructedSequence, summary: Summary) -> PoseSequence:
        sequence, result = reconstruction.sequence, reconstruction.result
        cameras, translation = result.cameras_in_real_image()
        unknown = np.full((*result.seen.shape, 4), np.nan), np.ones(result.seen.shape, bool)
        return PoseSequence(
            joints=result.joints,
            joint_names=result.skeleton.joints,
            parents=result.skeleton.parents,
            times=sequence.timestamps,
            seen=result.seen,
            orientation=unknown[0] if result.orientation is None else result.orientation,
            turn_inferred=unknown[1] if result.turn_inferred is None else result.turn_inferred,
            residual=result.solution.residual,
            success=result.solution.success,
            message=result.solution.message,
            iterations=result.solution.iterations,
            cost=result.solution.cost,
            base_poses=result.category,
            weights=result.solution.theta,
            scale=cameras.scale,
            rotation=cameras.rotation,
            translation=translation,
            vertical=result.vertical,
            vertical_std=result.vertical_std,
            contact=result.foot_contact,
            world_from_camera=result.world_from_camera,
            floor_std=result.floor_std,
            is_scale_known=result.virtual_camera.intrinsics.is_focal_known,
            sequence=sequence,
            summary=summary,
            _reconstruction=reconstruction,
        )

    def __len__(self) -> int:
        """Return the number of frames F."""
        return len(self.times)

    def __repr__(self) -> str:
        return (
            f'PoseSequence: {describe_frames(self.times)}, {len(self.joint_names)} joints '
            f'({1 - self.seen.mean():.0%} inferred), base poses {self.base_poses}, '
            f'residual {self.summary.residual_px:.2f} px, {self.summary.distance_m:.1f} m away'
            + ('' if self.is_scale_known else ' by the nominal focal length')
            + ('' if self.success else f'. {self.message}')
        )


def reconstruct(
    keypoints: KeypointSequence | ArrayLike,
    joint_names: Sequence[str] | str | None = None,
    times: ArrayLike | None = None,
    *,
    image_size: tuple[int, int] | None = None,
    camera_matrix: ArrayLike | None = None,
    distortion: ArrayLike | None = None,
    model: Model = 'auto',
    parameters: Parameters = None,
    method: Literal['whole', 'keyframes'] = 'whole',
) -> PoseSequence:
    """Reconstruct one person in 3D over a whole sequence, so that every frame supports the others.

    Args:
        keypoints: (F, J, 3) x to the right and y down in px, and confidence score in [0, 1]; NaN, x = y = 0 or
            score 0 where a keypoint was not seen; where scores exceed 1, those of the frame are divided by the
            largest. Or a `KeypointSequence`, as `mocap_ros.read` returns it; then only `model`, `parameters` and
            `method` may be given as well.
        joint_names: (J,) names of the keypoints in any common spelling (`left_shoulder`, `LShoulder`), or the name
            of a keypoint layout, such as `coco17`.
        times: (F,) s, increasing.
        image_size: (width, height) in px.
        camera_matrix: (3, 3) px, intrinsic matrix K of the camera; without it a nominal focal length is used, and
            the distance of the person is as uncertain as that.
        distortion: distortion coefficients in OpenCV's order, 4, 5 or 8 of them; None for a lens without.
        model: base poses: the name of shipped ones, the path of a model file, `BasePoses`, or `auto` for the
            choice by the parameter `tracker.model`.
        parameters: values by parameter name, such as `{'solver.prior': 'pca'}`, or a `Config`; the names are
            those of `mocap-ros config --all`, but for those of the node, `node.*` and `recorder.*`.
        method: `whole` solves all frames together; `keyframes` fits key poses to the image, for minutes of mixed
            action with outliers.

    Returns:
        The poses, with joints (F, J, 3) in m in the camera's optical frame, those of `tracker.skeleton`, but for
        the method `keyframes` always the 15 of `cmu15`.

    Raises:
        InputError: an argument is not valid, or the keypoints do not suffice; the error names the argument.
        SkeletonError: no keypoint layout has the name given as `joint_names`.
        ModelError: the base poses, or the lifter that `solver.prior` names, cannot be loaded.
        ConfigError: a parameter is unknown or the node's, or its value has the wrong type or is out of range.
    """
    if method not in ('whole', 'keyframes'):
        raise InputError(f'method: {format_value(method)}, expected whole or keyframes')
    config = make_config(parameters)
    models = load_models(model, config)
    needed = {'joint_names': joint_names, 'times': times, 'image_size': image_size}
    camera = {'camera_matrix': camera_matrix, 'distortion': distortion}
    if isinstance(keypoints, KeypointSequence):
        for argument, value in {**needed, **camera}.items():
            if value is not None:
                raise InputError(f'{argument}: the KeypointSequence has its own')
        sequence = check_sequence(keypoints)
    else:
        for argument, value in needed.items():
            if value is None:
                raise InputError(f'{argument}: missing')
        check_camera(image_size, camera_matrix, distortion)  # type: ignore[arg-type] # is no None here
        given = KeypointSequence(keypoints, joint_names, times, image_size, camera_matrix, distortion)  # type: ignore[arg-type]
        sequence = check_sequence(given, 'times')
    observations = extract_observations(sequence, config.tracker.nominal_focal_length)
    try:
        if method == 'keyframes':
            result = keyframe_method.reconstruct(*observations, models, config).result
        else:
            result = reconstruct_sequence(*observations, models, config)
    except (InputError, np.linalg.LinAlgError) as error:
        raise InputError(f'keypoints: {error}') from None
    summary = summarise([sequence], [result], config)
    _warn(summary, result)
    return PoseSequence._create(ReconstructedSequence(sequence, result, summary), summary)


def _warn(summary: Summary, result: SequenceResult) -> None:
    for fault in describe_height_faults([result]):
        LOGGER.warning('tracker.camera_height %s', fault)
    if summary.reason:
        LOGGER.warning('keypoints: %s: %s', summary.grade, summary.reason)
