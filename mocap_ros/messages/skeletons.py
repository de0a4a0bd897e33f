# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""mocap_ros_msgs/Skeleton3DArray, SkeletonDefinition, WeakPerspectiveCameraArray and Predictions: people in 3D.

A point X of the body frame is imaged at x = s (R X)_xy + t = M [X; 1], where s is the scale, R the rotation,
t the translation and M = [s R_xy | t] the 2x4 camera matrix (Wandt et al., TPAMI 2016, section 3.2).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.config import Config, parse_numbers
from mocap_ros.errors import ConfigError, InputError, naming
from mocap_ros.geometry.rigid_transform import SAME_POSE, RigidTransform
from mocap_ros.geometry.rotations import quaternion_from_rotation
from mocap_ros.messages.camera_placement import CameraPlacement
from mocap_ros.messages.cdr import MOCAP_ROS_MSGS, Header, read_stamp
from mocap_ros.messages.plain import decode_plain, encode_plain
from mocap_ros.people import CameraVertical, Person3D, PredictedPerson
from mocap_ros.skeleton import CMU15, Skeleton, keypoint_layout

SKELETONS = MOCAP_ROS_MSGS + 'Skeleton3DArray'
SKELETON_DEFINITION = MOCAP_ROS_MSGS + 'SkeletonDefinition'
CAMERAS = MOCAP_ROS_MSGS + 'WeakPerspectiveCameraArray'
PREDICTIONS = MOCAP_ROS_MSGS + 'Predictions'
MAX_TIME_S = 1.0  # s; so far the motion predictor was trained
FEET = 2  # left and right
MAX_TIMES = 20  # more than a planner has use for; bounds what a message costs


def encode_skeletons(
    header: Header,
    people: Sequence[Person3D],
    vertical: CameraVertical | None = None,
    camera: CameraPlacement | None = None,
) -> bytes:
    """Encode all people in an image as a Skeleton3DArray.

    People and vertical are in the frame of the header; `camera` is None where that is the camera's.
    """
    direction, std = (None, math.nan) if vertical is None else (vertical.direction, vertical.std)
    placement = camera or CameraPlacement(header.frame_id)
    pose = placement.pose
    message = {
        'header': header,
        'people': [_list_fields(person) for person in people],
        'vertical': direction,
        'vertical_std': std,
        'camera_frame_id': placement.frame_id,
        'camera_pose': SAME_POSE if pose is None else (*pose.translation, *pose.quaternion),
    }
    return encode_plain(message, SKELETONS)


def _list_fields(person: Person3D) -> dict[str, Any]:
    motion = person.motion
    return {
        'id': person.id,
        'skeleton': person.skeleton.name,
        'joints': person.joints,
        'joint_std': person.std,
        'inferred': person.inferred,
        'camera': _compute_camera(person),
        'motion': (motion.kind, motion.category, motion.residual, motion.cadence),
        'reprojection_residual': person.residual,
        'scale_source': person.scale_known,
        'predicted': person.predicted,
        'tentative': person.tentative,
        'joint_velocity': person.velocity,
        'joint_velocity_std': person.velocity_std,
        'root': person.root,
        'root_covariance': person.root_covariance,
        'root_velocity': person.root_velocity,
        'root_velocity_covariance': person.root_velocity_covariance,
        'age': person.age,
        'unseen_for': person.unseen_for,
        'joint_orientation': person.orientation,
        'turn_inferred': person.turn_inferred,
        'contact': person.contact if np.isfinite(person.contact).any() else (),
    }


def _compute_camera(person: Person3D) -> Array:
    """Return the fields of a WeakPerspectiveCamera (15,): scale, quaternion x, y, z, w, translation and matrix."""
    matrix = np.column_stack([person.scale * person.rotation[:2], person.translation])
    quaternion = quaternion_from_rotation(person.rotation)
    return np.array([person.scale, *quaternion, *person.translation, *matrix.ravel()])


def encode_cameras(header: Header, people: Sequence[Person3D]) -> bytes:
    """Encode the cameras of all people in an image as a WeakPerspectiveCameraArray."""
    cameras = [_compute_camera(person) for person in people]
    return encode_plain({'header': header, 'ids': [p.id for p in people], 'cameras': cameras}, CAMERAS)


class RecordedPerson(NamedTuple):
    """What is read of a Skeleton3D with J joints: units and shapes are those of the message."""

    id: str
    skeleton: Skeleton
    joints: Array  # (J, 3) m, in the camera's optical frame
    std: NDArray[np.float32]  # (J,) m, standard deviations of the joints; NaN if unknown
    inferred: NDArray[np.bool_]  # (J,) whether a joint was not seen; version 0.1 did not record it
    residual: float  # px, RMS over the seen joints
    cadence: float  # Hz; NaN for motions that are not periodic
    motion: int  # number of the `MotionKind`
    predicted: bool
    tentative: bool
    scale: float  # px/m, of the weak-perspective camera
    translation: Array  # (2,) px, of the weak-perspective camera
    root_covariance: Array  # (3, 3) m^2, in the camera's optical frame; zeros if unknown
    contact: Array  # (2,) probabilities that left and right foot stand; NaN if unknown


class RecordedSkeletons(NamedTuple):
    """What is read of a Skeleton3DArray: stamp in ns; people and vertical (3,) in the camera's optical frame."""

    stamp_ns: int
    people: tuple[RecordedPerson, ...]
    vertical: Array
    vertical_std: float


def decode_skeletons(raw: bytes) -> RecordedSkeletons:
    """Decode a Skeleton3DArray, with joints, root covariances and vertical in the camera's optical frame."""
    message = decode_plain(raw, SKELETONS)
    pose = None
    with naming('camera_pose'):
        if tuple(message.camera_pose) != SAME_POSE:
            pose = RigidTransform.from_numbers(message.camera_pose.tolist()).inverse()
    people = []
    for index, person in enumerate(message.people):
        with naming(f'people[{index}]'):
            people.append(_read_person(person, pose))
    vertical = message.vertical if pose is None else pose.rotate(message.vertical)
    return RecordedSkeletons(read_stamp(message.header.stamp), tuple(people), vertical, message.vertical_std)


def _read_person(person: SimpleNamespace, pose: RigidTransform | None) -> RecordedPerson:
    """Read a Skeleton3D; `pose` places its frame in the optical frame."""
    skeleton, joints = keypoint_layout(person.skeleton), person.joints
    count, covariance = len(skeleton.joints), person.root_covariance.reshape(3, 3)
    if len(joints) != count or len(person.inferred) not in (0, count):
        flags = len(person.inferred)
        raise InputError(f'{len(joints)} joints and {flags} flags, {skeleton.name} has {count}')
    return RecordedPerson(
        person.id,
        skeleton,
        joints if pose is None else pose.apply(joints),
        person.joint_std if len(person.joint_std) == count else np.full(count, np.nan, np.float32),
        person.inferred if len(person.inferred) else np.zeros(count, bool),
        person.reprojection_residual,
        person.motion.cadence,
        person.motion.state,
        person.predicted,
        person.tentative,
        scale=person.camera[0],
        translation=person.camera[5:7],
        root_covariance=covariance if pose is None else pose.rotate_covariance(covariance),
        contact=np.asarray(person.contact if len(person.contact) == FEET else [np.nan] * FEET, float),
    )


def encode_skeleton_definition(skeleton: Skeleton) -> bytes:
    """Encode the names and the tree of a skeleton's joints as a SkeletonDefinition."""
    message = {
        'name': skeleton.name,
        'joint_names': skeleton.joints,
        'parents': skeleton.parents,
        'bones': np.ravel(skeleton.bones),
    }
    return encode_plain(message, SKELETON_DEFINITION)


class PredictedFrame(NamedTuple):
    """The people at a time, in s after an image, in the camera's optical frame."""

    ahead: float
    people: Sequence[PredictedPerson]


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


def encode_predictions(header: Header, frames: Sequence[PredictedFrame], camera: CameraPlacement) -> bytes:
    """Encode people at each time after an image as Predictions, in the frame in which `camera` places them."""
    times = []
    for ahead, people in frames:
        placed = camera.place_predicted(people, ahead)
        times.append((ahead, [(p.id, p.joints, p.std, p.root, p.root_covariance) for p in placed]))
    return encode_plain((header, CMU15.name, times), PREDICTIONS)
