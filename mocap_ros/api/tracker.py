# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Reconstruction of people frame by frame."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from mocap_ros.api.arguments import (
    LOGGER,
    Model,
    Parameters,
    check_camera,
    load_models,
    make_config,
    read_array,
    read_joint_names,
    read_names,
    read_number,
    read_numbers,
    rename_errors,
)
from mocap_ros.arrays import Array
from mocap_ros.errors import InputError, name_errors
from mocap_ros.formats.sequence_file import MAX_TIMESTAMP_S, check_timestamps
from mocap_ros.keypoints.joint_map import build_joint_map
from mocap_ros.keypoints.keypoint_sequence import create_intrinsics
from mocap_ros.keypoints.person import Person2D
from mocap_ros.keypoints.validation import (
    MAX_METRES,
    MIN_JUDGED_FRAMES,
    check_places,
    describe_other_unit,
    describe_step,
    mark_unknown_depth,
    mark_unseen,
)
from mocap_ros.messages.keypoints import check_ids
from mocap_ros.people import TrackedFrame
from mocap_ros.tracking import tracker as tracking
from mocap_ros.units import NS_PER_S


class Tracker:
    """Reconstructs people in 3D frame by frame, as the live node does: keypoints of a frame in, people out.

    Args:
        joint_names: (J,) names of the keypoints in any common spelling, or the name of a keypoint layout, such as
            `coco17`.
        image_size: (width, height) in px.
        camera_matrix: (3, 3) px, intrinsic matrix K of the camera; without it a nominal focal length is used.
        distortion: distortion coefficients in OpenCV's order; None for a lens without.
        model: base poses: the name of shipped ones, the path of a model file, `BasePoses`, or `auto` for the
            choice by the parameter `tracker.model`.
        parameters: values by parameter name, such as `{'tracker.lag': 0.2}`, or a `Config`; none of the
            node's, `node.*` and `recorder.*`.

    Raises:
        InputError: an argument is not valid; the error names it.
        SkeletonError: the joint names give too few joints, or no keypoint layout has that name.
        ModelError: the base poses, or the lifter that `solver.prior` names, cannot be loaded.
        ConfigError: a parameter is unknown or the node's, or its value has the wrong type or is out of range.
    """

    def __init__(
        self,
        joint_names: Sequence[str] | str,
        *,
        image_size: tuple[int, int],
        camera_matrix: ArrayLike | None = None,
        distortion: ArrayLike | None = None,
        model: Model = 'auto',
        parameters: Parameters = None,
    ) -> None:
        config = make_config(parameters)
        self._joint_names = read_joint_names('joint_names', joint_names)
        with name_errors('joint_names'):
            build_joint_map(self._joint_names)
        self._image_size, matrix, coefficients = check_camera(image_size, camera_matrix, distortion)
        focal_in_sides = config.tracker.nominal_focal_length
        self._intrinsics = create_intrinsics(self._image_size, matrix, coefficients, focal_in_sides)
        self._tracker = tracking.PeopleTracker(load_models(model, config), config)
        self._frame_count = 0
        self._first_frames: list[tuple[float, Array]] = []

    def __repr__(self) -> str:
        width, height = self._image_size
        frames = f'{self._frame_count} frames'
        return f'Tracker: {len(self._joint_names)} keypoints in {width} x {height} px, {frames}'

    def update(
        self,
        time_s: float,
        people: ArrayLike,
        *,
        ids: Sequence[str] | None = (),
        depth: ArrayLike | None = None,
    ) -> TrackedFrame:
        """Track the people of the next frame.

        Args:
            time_s: s, time of the image, later than that of the frame before. A time that is earlier by more than
                1 s restarts the tracking.
            people: (P, J, 3) keypoints of the P people in the image, possibly none: x to the right and y down in
                px, and confidence score in [0, 1]; NaN, x = y = 0 or score 0 where a keypoint was not seen.
            ids: (P,) names that the detector gives the people, empty where it gives none; by default, or with
                None, people are distinguished by their positions.
            depth: (P, J) m along the optical axis of the surfaces that are seen at the keypoints, as depth cameras
                measure them; NaN or 0 where unknown. It is used with a `camera_matrix`.

        Returns:
            The frame, with its time `time_s` and its `people`, in the order of those given, without those who
            show too few joints; then those who were not detected and are predicted. With `tracker.lag` it is an
            earlier one. Its `vertical` is what is known of the direction upwards in the camera's optical frame:
            `direction` (3,) with `std` in rad; None if nothing is.

        Raises:
            InputError: an argument is not valid; the error names it and the person. The tracker has not changed.
            FrameDropped: the time repeats that of the frame before, or is a little earlier. The tracker has not
                changed.
        """
        time_s = read_number('time_s', time_s, (0, MAX_TIMESTAMP_S), 's')
        detected = self._read_people(people, ids, depth)
        first_frames = self._judge_first_frames(time_s, detected)
        with name_errors('time_s'):
            found = self._tracker.update(round(time_s * NS_PER_S), detected, self._intrinsics)
        self._first_frames = first_frames
        self._frame_count += 1
        return found

    def reset(self) -> None:
        """Forget all people and all times."""
        self._tracker.reset()
        self._frame_count = 0
        self._first_frames = []

    def _judge_first_frames(self, time_s: float, detected: Sequence[Person2D]) -> list[tuple[float, Array]]:
        """Return the first `MIN_JUDGED_FRAMES` frames; by all of them, judge units and the size of the image.

        Raises:
            InputError: the times seem to have another unit, or width and height of the image to be transposed.
        """
        newest_s = self._first_frames[-1][0] if self._first_frames else -1.0
        if 0 < time_s - newest_s < 1 / NS_PER_S:
            raise InputError(f'time_s: {describe_step(time_s - newest_s)}')
        if len(self._first_frames) == MIN_JUDGED_FRAMES or time_s <= newest_s:
            return self._first_frames
        points = np.concatenate([np.empty((0, 3)), *(np.column_stack([p.points, p.score]) for p in detected)])
        frames = [*self._first_frames, (time_s, points)]
        if len(frames) == MIN_JUDGED_FRAMES:
            with rename_errors({'timestamps': 'time_s'}):
                check_timestamps(np.array([t for t, _ in frames]))
            seen = np.concatenate([k for _, k in frames])
            with name_errors('image_size'):
                outside = check_places(seen[:, :2], seen[:, 2], self._image_size)
            if outside:
                LOGGER.warning('people: %s', outside)
        return frames

    def _read_people(
        self, people: ArrayLike, ids: Sequence[str] | None, depth: ArrayLike | None
    ) -> list[Person2D]:
        given = read_array('people', people)
        shape = (len(given) if given.ndim else None, len(self._joint_names), 3)
        if given.dtype != np.float64 or given.shape != shape:
            given = read_numbers('people', given, shape) if given.size else np.empty((0, *shape[1:]))
        names = read_names('ids', () if ids is None else ids, 'a list of names') or ('',) * len(given)
        if len(names) != len(given):
            raise InputError(f'ids: {len(names)} names for {len(given)} people')
        keypoints = np.asarray(given, np.float64)
        points, score = keypoints[..., :2], keypoints[..., 2]
        points, score, fault = mark_unseen(points, score)
        if fault:
            person, joint = fault.index
            raise InputError(f'people[{person}]: {fault.field}[{joint}]: {fault.what}')
        for i, largest in enumerate(np.fmax.reduce(points, axis=(1, 2)).tolist()):
            if largest <= MAX_METRES and (
                other_unit := describe_other_unit(points[i], score[i], self._image_size[0])
            ):
                raise InputError(f'people[{i}]: x, y: {other_unit}')
        depths: Sequence[Array | None] = [None] * len(given)
        if depth is not None:
            depths = [*mark_unknown_depth(read_numbers('depth', depth, score.shape))]
        detected = [
            Person2D(name, self._joint_names, p, s, z)
            for name, p, s, z in zip(names, points, score, depths, strict=True)
        ]
        check_ids('ids', detected)
        return [person.hide_border(self._image_size) for person in detected]
