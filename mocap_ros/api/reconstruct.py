# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Reconstruction of one person's whole sequence."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, overload

import numpy as np
from numpy.typing import ArrayLike

from mocap_ros.api.arguments import Model, Parameters, check_sequence, load_models, make_config, make_sequence
from mocap_ros.api.poses import PoseSequence
from mocap_ros.config import format_value
from mocap_ros.errors import InputError
from mocap_ros.formats.sequence_file import KeypointSequence, extract_observations
from mocap_ros.offline.keyframes import reconstruct as keyframes
from mocap_ros.offline.whole_sequence import reconstruct_sequence
from mocap_ros.runtime.save_results import ReconstructedSequence

Method = Literal['whole', 'keyframes']


@overload
def reconstruct(
    keypoints: KeypointSequence,
    *,
    model: Model = ...,
    parameters: Parameters = ...,
    method: Method = ...,
) -> PoseSequence: ...


@overload
def reconstruct(
    keypoints: ArrayLike,
    joint_names: Sequence[str] | str,
    times: ArrayLike,
    *,
    image_size: tuple[int, int],
    camera_matrix: ArrayLike | None = ...,
    distortion: ArrayLike | None = ...,
    model: Model = ...,
    parameters: Parameters = ...,
    method: Method = ...,
) -> PoseSequence: ...


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
    method: Method = 'whole',
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
            those of `mocap-ros config`.
        method: `whole` solves all frames together; `keyframes` fits key poses to the image, for minutes of mixed
            action with outliers.

    Returns:
        The poses, with joints (F, J, 3) in m in the camera's optical frame, those of `tracker.skeleton`, but for
        the method `keyframes` always the 15 of `cmu15`.

    Raises:
        InputError: an argument is not valid, or the keypoints do not suffice; the error names the argument.
        SkeletonError: no keypoint layout has the name given as `joint_names`.
        ModelError: the base poses, or the lifter that `solver.prior` names, cannot be loaded.
        ConfigError: a parameter is unknown, or its value has the wrong type or is out of range.
    """
    if method not in ('whole', 'keyframes'):
        raise InputError(f'method: {format_value(method)}, expected whole or keyframes')
    config = make_config(parameters)
    models = load_models(model, config)
    if isinstance(keypoints, KeypointSequence):
        others = {
            'joint_names': joint_names,
            'times': times,
            'image_size': image_size,
            'camera_matrix': camera_matrix,
            'distortion': distortion,
        }
        for argument, value in others.items():
            if value is not None:
                raise InputError(f'{argument}: the KeypointSequence has its own')
        sequence = check_sequence(keypoints)
    else:
        if joint_names is None or times is None or image_size is None:
            missing = 'joint_names' if joint_names is None else 'times' if times is None else 'image_size'
            raise InputError(f'{missing}: missing')
        sequence = make_sequence(keypoints, joint_names, times, image_size, camera_matrix, distortion)
    observations = extract_observations(sequence, config.tracker.nominal_focal_length)
    try:
        if method == 'keyframes':
            result = keyframes.reconstruct(*observations, models, config).result
        else:
            result = reconstruct_sequence(*observations, models, config)
    except InputError as error:
        raise InputError(f'keypoints: {error}') from None
    except np.linalg.LinAlgError as error:
        raise InputError(f'keypoints: the reconstruction failed ({error})') from None
    return PoseSequence(ReconstructedSequence(sequence, result))
