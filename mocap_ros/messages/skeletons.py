# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""mocap_ros_msgs/Skeleton3DArray, SkeletonDefinition, WeakPerspectiveCameraArray and Predictions: people in 3D.

A point X of the body frame is imaged at x = s (R X)_xy + t = M [X; 1], where s is the scale, R the rotation,
t the translation and M = [s R_xy | t] the 2x4 camera matrix (Wandt et al., TPAMI 2016, section 3.2).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.config import Config, parse_numbers
from mocap_ros.errors import ConfigError, InputError, naming
from mocap_ros.geometry.intrinsics import Intrinsics, recover_intrinsics
from mocap_ros.geometry.rigid_transform import SAME_POSE, RigidTransform
from mocap_ros.geometry.rotations import quaternion_from_rotation
from mocap_ros.messages.camera_placement import CameraPlacement
from mocap_ros.messages.cdr import MOCAP_ROS_MSGS, Header, read_stamp
from mocap_ros.messages.plain import decode_plain, encode_plain
from mocap_ros.people import PEOPLE_COLUMNS, CameraVertical, Motion, MotionKind, People, Posture, PredictedPeople
from mocap_ros.skeleton import CMU15, Skeleton, find_roots, keypoint_layout

SKELETONS = MOCAP_ROS_MSGS + 'Skeleton3DArray'
SKELETON_DEFINITION = MOCAP_ROS_MSGS + 'SkeletonDefinition'
CAMERAS = MOCAP_ROS_MSGS + 'WeakPerspectiveCameraArray'
PREDICTIONS = MOCAP_ROS_MSGS + 'Predictions'
# Columns of people that a Skeleton3D has by their names
FIELDS = tuple(name for name in PEOPLE_COLUMNS if name not in ('rotation', 'scale', 'translation'))
MAX_TIME_S = 1.0  # s; so far the motion predictor was trained
MAX_TIMES = 20  # more than a planner has use for; bounds what a message costs


def encode_skeletons(
    header: Header,
    people: People,
    vertical: CameraVertical | None = None,
    camera: CameraPlacement | None = None,
    cameras: Array | None = None,
) -> bytes:
    """Encode all people in an image as a Skeleton3DArray.

    People and vertical are in the frame of the header; `camera` is None where that is the camera's. `cameras` are
    those of `compute_cameras`, where they are computed already.
    """
    direction, std = (None, math.nan) if vertical is None else (vertical.direction, vertical.std)
    placement = camera or CameraPlacement(header.frame_id)
    pose = placement.pose
    message = {
        'header': header,
        'people': _list_rows(people, compute_cameras(people) if cameras is None else cameras),
        'vertical': direction,
        'vertical_std': std,
        'camera_frame_id': placement.frame_id,
        'camera_pose': SAME_POSE if pose is None else (*pose.translation, *pose.quaternion),
    }
    return encode_plain(message, SKELETONS)


def _list_rows(people: People, cameras: Array) -> list[dict[str, Any]]:
    count = len(people)
    own = {name: getattr(people, name) for name in FIELDS}
    columns: dict[str, Sequence[Any] | NDArray[Any]] = {
        'id': people.ids,
        'skeleton': [people.skeleton.name] * count,
        'camera': cameras,
        'motion': [(m.kind, m.category, m.residual, m.cadence) for m in people.motion],
        'scale_source': [people.is_scale_known] * count,
        'root': people.roots,
        'root_velocity': people.root_velocities,
        **{name: values.tolist() if values.ndim == 1 else values for name, values in own.items()},
        'contact': [feet if np.isfinite(feet).any() else () for feet in people.contact],
    }
    return [{name: values[row] for name, values in columns.items()} for row in range(count)]


def compute_cameras(people: People) -> Array:
    """Return the fields of WeakPerspectiveCameras (N, 15): scale, quaternion, translation and matrix."""
    cameras = np.empty((len(people), 15))
    cameras[:, 0], cameras[:, 5:7] = people.scale, people.translation
    for camera, rotation in zip(cameras, people.rotation, strict=True):
        camera[1:5] = quaternion_from_rotation(rotation)
    matrices = cameras[:, 7:].reshape(-1, 2, 4)
    matrices[..., :3] = people.scale[:, None, None] * people.rotation[:, :2]
    matrices[..., 3] = people.translation
    cameras[:, 7:] = matrices.reshape(-1, 8)
    return cameras


def encode_cameras(header: Header, people: People, cameras: Array | None = None) -> bytes:
    """Encode the cameras of all people in an image as a WeakPerspectiveCameraArray, as `encode_skeletons` does."""
    cameras = compute_cameras(people) if cameras is None else cameras
    return encode_plain({'header': header, 'ids': people.ids, 'cameras': cameras}, CAMERAS)


class ReceivedSkeletons(NamedTuple):
    """What is read of a Skeleton3DArray."""

    header: Header
    people: People  # without rotations and categories of motions
    vertical: Array  # (3,) unit vector upwards; zeros where it is not known
    vertical_std: float  # rad
    camera: CameraPlacement  # in the frame of the header


def decode_skeletons(raw: bytes, *, is_in_camera: bool = True) -> ReceivedSkeletons:
    """Decode a Skeleton3DArray, with people and vertical in the camera's optical frame or in that of the header.

    InputError, which names the field, where it does not fit together.
    """
    message = decode_plain(raw, SKELETONS)
    header, pose = Header(read_stamp(message.header.stamp), message.header.frame_id), None
    with naming('camera_pose'):
        if tuple(message.camera_pose) != SAME_POSE:
            pose = RigidTransform.from_numbers(message.camera_pose.tolist())
    camera = CameraPlacement(message.camera_frame_id or header.frame_id, pose)
    people, vertical = _read_people(message.people), message.vertical
    if is_in_camera and pose is not None:
        people, vertical = camera.invert().place(people), pose.inverse().rotate(vertical)
    return ReceivedSkeletons(header, people, vertical, message.vertical_std, camera)


def _read_people(rows: Sequence[SimpleNamespace]) -> People:
    if not rows:
        return People.none()
    if len(names := sorted({row.skeleton for row in rows})) > 1:
        raise InputError(f'people: skeletons of several layouts: {", ".join(names)}')
    with naming('people[0].skeleton'):
        skeleton = keypoint_layout(names[0])
    count = len(skeleton.joints)
    for index, row in enumerate(rows):
        joints, flags, deviations = len(row.joints), len(row.inferred), len(row.joint_std)
        if joints != count or {flags, deviations} - {0, count}:
            lengths = f'{joints} joints, {flags} inferred and {deviations} joint_std'
            raise InputError(f'people[{index}]: {lengths}; {skeleton.name} has {count}')
    cameras = np.array([row.camera for row in rows])
    columns = {name: _read_column([getattr(row, name) for row in rows], name, count) for name in FIELDS}
    columns['inferred'] = np.array([row.inferred if len(row.inferred) else np.zeros(count, bool) for row in rows])
    columns['posture'] = Posture.read(columns['posture'])
    return People(
        ids=tuple(row.id for row in rows),
        skeleton=skeleton,
        motion=tuple(Motion(_read_kind(row.motion.state), '', math.nan, row.motion.cadence) for row in rows),
        scale=cameras[:, 0],
        translation=cameras[:, 5:7],
        is_scale_known=all(row.scale_source for row in rows),
        **columns,
    )


def _read_column(values: Sequence[Any], name: str, joints: int) -> NDArray[Any]:
    """Return a column; unknown are those of recordings of older versions, in which the field is empty."""
    column = PEOPLE_COLUMNS[name]
    with suppress(ValueError):  # of rows of other lengths
        return np.array(values, type(column.unknown)).reshape(column.find_shape(len(values), joints))
    filled = column.fill(len(values), joints)
    for row, value in enumerate(values):
        if np.size(value) == filled[row].size:
            filled[row] = np.reshape(value, filled.shape[1:])
    return filled


def _read_kind(state: int) -> MotionKind:
    return MotionKind(state) if state in [*MotionKind] else MotionKind.UNKNOWN


def find_intrinsics(people: People) -> Intrinsics:
    """Return the camera that shows recorded people, one or more, as their own cameras do."""
    found = recover_intrinsics(people.core.mean(axis=1), people.scale, people.translation)
    return replace(found, is_focal_known=people.is_scale_known)


def encode_skeleton_definition(skeleton: Skeleton) -> bytes:
    """Encode the names and the tree of a skeleton's joints as a SkeletonDefinition."""
    message = {
        'name': skeleton.name,
        'joint_names': skeleton.joints,
        'parents': skeleton.parents,
        'bones': np.ravel(skeleton.bones),
    }
    return encode_plain(message, SKELETON_DEFINITION)


def read_prediction_times(config: Config) -> tuple[float, ...]:
    """Return the times in s for which the parameters ask for predictions; none if these are not published."""
    if not config.node.publish_predictions:
        return ()
    if config.tracker.lag > 0:
        raise ConfigError(
            'node.publish_predictions: needs tracker.lag = 0, as an output with a lag is of the past'
        )
    text = config.node.prediction_times
    times = parse_numbers(text)
    if not 0 < len(times) <= MAX_TIMES or not all(0 < t <= MAX_TIME_S for t in times):
        raise ConfigError(
            f'node.prediction_times = {text!r}: expected one to {MAX_TIMES} times in s, above 0 and up to '
            f'{MAX_TIME_S:g}, separated by blanks or commas, such as 0.2 0.4'
        )
    return times


def encode_predictions(header: Header, times: Sequence[PredictedPeople], camera: CameraPlacement) -> bytes:
    """Encode people at each time after an image as Predictions, in the frame in which `camera` places them."""
    message = []
    for placed in map(camera.place_predicted, times):
        columns = placed.ids, placed.joints, placed.joint_std, find_roots(placed.joints), placed.root_covariance
        message.append((placed.ahead, list(zip(*columns, strict=True))))
    return encode_plain((header, CMU15.name, message), PREDICTIONS)
