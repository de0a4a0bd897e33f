# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""mocap_ros_msgs/Skeleton3DArray, SkeletonDefinition and WeakPerspectiveCameraArray: the people in 3D.

A point X of the body frame is imaged at x = s (R X)_xy + t = M [X; 1], where s is the scale, R the rotation,
t the translation and M = [s R_xy | t] the 2x4 camera matrix (Wandt et al., TPAMI 2016, section 3.2).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from mocap_ros.errors import InputError
from mocap_ros.geometry.rigid_transform import SAME_POSE, RigidTransform
from mocap_ros.geometry.rotations import quaternion_from_rotation
from mocap_ros.messages.camera_placement import CameraPlacement
from mocap_ros.messages.cdr import MOCAP_ROS_MSGS, Array, Header, decode
from mocap_ros.messages.plain import encode_plain
from mocap_ros.people import CameraVertical, Person3D
from mocap_ros.skeleton import Skeleton

SKELETONS = MOCAP_ROS_MSGS + 'Skeleton3DArray'
SKELETON_DEFINITION = MOCAP_ROS_MSGS + 'SkeletonDefinition'
CAMERAS = MOCAP_ROS_MSGS + 'WeakPerspectiveCameraArray'


def encode_skeletons(
    header: Header,
    people: Sequence[Person3D],
    vertical: CameraVertical | None = None,
    camera: CameraPlacement | None = None,
) -> bytes:
    """Encode all people in an image as a Skeleton3DArray.

    Args:
        header: time of the image, and the frame in which the people and the vertical are.
        people: all people in the image.
        vertical: what is known of the camera's vertical; None if nothing is.
        camera: the camera in that frame; None where the frame is the camera's.
    """
    direction, std = (None, math.nan) if vertical is None else vertical
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
    """Return the fields of a Skeleton3D."""
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


def decode_skeletons(raw: bytes) -> Any:
    """Decode a Skeleton3DArray, with joints, root covariances and vertical in the camera's optical frame.

    Other fields, such as velocities and orientations, stay as they are.

    Args:
        raw: CDR bytes.

    Raises:
        InputError: the bytes are no Skeleton3DArray, or its camera pose is not valid.
    """
    array = decode(raw, SKELETONS)
    position, orientation = array.camera_pose.position, array.camera_pose.orientation
    numbers = (position.x, position.y, position.z, orientation.x, orientation.y, orientation.z, orientation.w)
    if numbers == SAME_POSE:
        return array
    try:
        to_optical_frame = RigidTransform.from_numbers(numbers).inverse()
    except InputError as error:
        raise InputError(f'camera_pose: {error}') from None
    for skeleton in array.people:
        joints = to_optical_frame.apply(np.array([(p.x, p.y, p.z) for p in skeleton.joints]).reshape(-1, 3))
        for point, (x, y, z) in zip(skeleton.joints, joints.tolist(), strict=True):
            point.x, point.y, point.z = x, y, z
        covariance = to_optical_frame.rotate_covariance(skeleton.root_covariance.reshape(3, 3))
        skeleton.root_covariance = covariance.ravel()
    up = array.vertical
    up.x, up.y, up.z = to_optical_frame.rotate(np.array([up.x, up.y, up.z])).tolist()
    return array


def encode_skeleton_definition(skeleton: Skeleton) -> bytes:
    """Encode the names and the tree of a skeleton's joints as a SkeletonDefinition."""
    message = {
        'name': skeleton.name,
        'joint_names': skeleton.joints,
        'parents': skeleton.parents,
        'bones': np.ravel(skeleton.bones),
    }
    return encode_plain(message, SKELETON_DEFINITION)
