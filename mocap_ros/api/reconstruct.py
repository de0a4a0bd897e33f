# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Reconstruction of one person's whole sequence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

from numpy.typing import ArrayLike

from mocap_ros.api.arguments import (
    LOGGER,
    Model,
    Parameters,
    check_camera,
    check_sequence,
    load_models,
    make_config,
)
from mocap_ros.config import Config, format_value
from mocap_ros.errors import InputError
from mocap_ros.keypoints.keypoint_sequence import KeypointSequence
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.offline.keyframes import keyframe_method
from mocap_ros.offline.whole_sequence import Report, Solved, solve_sequence
from mocap_ros.people import PoseSequence
from mocap_ros.recordings import reconstruct as recordings
from mocap_ros.recordings.reconstruct import ReconstructionOptions


def reconstruct(
    keypoints: KeypointSequence | ArrayLike,
    joint_names: Sequence[str] | str | None = None,
    times: ArrayLike | None = None,
    *,
    image_size: tuple[int, int] | None = None,
    camera_matrix: ArrayLike | None = None,
    distortion: ArrayLike | None = None,
    depth: ArrayLike | None = None,
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
        depth: (F, J) m along the optical axis of the surfaces that are seen at the keypoints, as a depth camera
            measures them; NaN or 0 where unknown. It is used with a `camera_matrix`, and by the method
            `whole`.
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
    options = ReconstructionOptions(
        config, load_models(model, config), method=_solve_by_keyframes if method == 'keyframes' else solve_sequence
    )
    needed = {'joint_names': joint_names, 'times': times, 'image_size': image_size}
    camera = {'camera_matrix': camera_matrix, 'distortion': distortion, 'depth': depth}
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
        given = KeypointSequence(keypoints, joint_names, times, image_size, camera_matrix, distortion, depth=depth)  # type: ignore[arg-type]
        sequence = check_sequence(given, 'times')

    try:
        recording = recordings.reconstruct([sequence], options)
    except InputError as error:
        raise InputError(f'keypoints: {error}') from None
    for note in recording.notes:
        LOGGER.warning('%s', note)
    (poses,) = recording.people
    if poses.summary is not None and poses.summary.reason:
        LOGGER.warning('keypoints: %s: %s', poses.summary.grade, poses.summary.reason)
    return poses


def _solve_by_keyframes(
    sequence: KeypointSequence, models: Mapping[str, PoseModel], config: Config, _: Report
) -> Solved:
    return keyframe_method.reconstruct(sequence, models, config).solved
