# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""mocap_ros_msgs/Skeleton3DArray and SkeletonDefinition: the people in 3D, and the names of their joints."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mocap_ros.errors import InputError
from mocap_ros.geometry.rigid_transform import SAME_POSE, RigidTransform
from mocap_ros.messages.camera_placement import CameraPlacement
from mocap_ros.messages.cameras import CAMERA_NUMBERS, compute_camera_numbers
from mocap_ros.messages.cdr import MOCAP_ROS_MSGS, Header, create_message, decode, encode
from mocap_ros.messages.stacked_people import StackedPeople, stack_people
from mocap_ros.messages.template import (
    BYTE,
    DOUBLE,
    KEPT_TEMPLATES,
    SINGLE,
    MessageTemplate,
    TemplateWriter,
)
from mocap_ros.people import HIPS, CameraVertical, Person3D
from mocap_ros.skeleton import Skeleton

SKELETONS = MOCAP_ROS_MSGS + 'Skeleton3DArray'
SKELETON_DEFINITION = MOCAP_ROS_MSGS + 'SkeletonDefinition'

_ROOT_NUMBERS = 3 + 9 + 3 + 9  # numbers of root, root_covariance, root_velocity and root_velocity_covariance


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
    stacked, placement = stack_people(people), camera or CameraPlacement(header.frame_id)
    direction, std = (np.zeros(3), math.nan) if vertical is None else vertical
    pose = placement.pose
    numbers: dict[str, ArrayLike] = {
        'vertical': direction,
        'vertical_std': std,
        'camera_pose': SAME_POSE if pose is None else (*pose.translation.tolist(), *pose.quaternion),
    }
    if stacked:
        numbers |= _collect_numbers(stacked)
    texts = tuple([(p.id, p.motion.category) for p in stacked])
    return _lay_out(header.frame_id, texts, stacked.skeleton, placement.frame_id).fill(header.stamp_ns, **numbers)


def _collect_numbers(people: StackedPeople) -> dict[str, ArrayLike]:
    """Return the numbers of the Skeleton3D of people, by the fields of `_lay_out`."""
    motions = [p.motion for p in people]
    velocity = np.array([p.velocity for p in people])
    covariances, velocity_covariances = (
        np.array([getattr(p, name) for p in people]).reshape(-1, 9)
        for name in ('root_covariance', 'root_velocity_covariance')
    )
    root_velocity = (velocity[:, HIPS[0]] + velocity[:, HIPS[1]]) / 2
    return {
        'joints': people.joints,
        'std': people.std,
        'inferred': np.array([p.inferred for p in people]),
        'camera': people.share(compute_camera_numbers),
        'kind': [motion.kind for motion in motions],
        'fit': [(m.residual, m.cadence, p.residual) for p, m in zip(people, motions, strict=True)],
        'flags': [(p.scale_known, p.predicted, p.tentative) for p in people],
        'velocity': velocity,
        'velocity_std': np.array([p.velocity_std for p in people]),
        'root': np.concatenate([people.roots, covariances, root_velocity, velocity_covariances], axis=1),
        'times': [(p.age, p.unseen_for) for p in people],
        'orientation': np.array([p.orientation for p in people]),
        'turn_inferred': np.array([p.turn_inferred for p in people]),
    }


@lru_cache(maxsize=KEPT_TEMPLATES)
def _lay_out(
    frame_id: str, people: tuple[tuple[str, str], ...], skeleton: Skeleton, camera_frame_id: str
) -> MessageTemplate:
    """Return the template for people of whom the id and the category of the motion are given.

    Args:
        frame_id: frame of the people.
        people: their texts.
        skeleton: names and order of their joints.
        camera_frame_id: the camera's optical frame.
    """
    writer, joints = TemplateWriter(), len(skeleton.joints)
    writer.add_stamped(frame_id)
    writer.add_count(len(people))
    for person_id, category in people:
        writer.add_text(person_id)
        writer.add_text(skeleton.name)
        writer.add_number_sequence('joints', DOUBLE, joints, 3)
        writer.add_number_sequence('std', SINGLE, joints)
        writer.add_number_sequence('inferred', BYTE, joints)
        writer.add_numbers('camera', DOUBLE, CAMERA_NUMBERS)
        writer.add_numbers('kind', BYTE, 1)
        writer.add_text(category)
        writer.add_numbers('fit', SINGLE, 3)  # motion.residual, motion.cadence and reprojection_residual
        writer.add_numbers('flags', BYTE, 3)  # scale_source, predicted and tentative
        writer.add_number_sequence('velocity', DOUBLE, joints, 3)
        writer.add_number_sequence('velocity_std', SINGLE, joints)
        writer.add_numbers('root', DOUBLE, _ROOT_NUMBERS)
        writer.add_numbers('times', SINGLE, 2)  # age and unseen_for
        writer.add_number_sequence('orientation', DOUBLE, joints, 4)
        writer.add_number_sequence('turn_inferred', BYTE, joints)
    writer.add_numbers('vertical', DOUBLE, 3)
    writer.add_numbers('vertical_std', SINGLE, 1)
    writer.add_text(camera_frame_id)
    writer.add_numbers('camera_pose', DOUBLE, len(SAME_POSE))
    return writer.finish_template()


def decode_skeletons(raw: bytes) -> Any:
    """Decode a Skeleton3DArray, with joints and root covariances in the camera's optical frame whatever its own.

    Other fields, such as velocities and orientations, stay as they are.

    Args:
        raw: CDR bytes.

    Raises:
        InputError: the bytes are no Skeleton3DArray, or its camera pose is not valid.
    """
    array = decode(raw, SKELETONS)
    position, orientation = array.camera_pose.position, array.camera_pose.orientation
    numbers = (position.x, position.y, position.z, orientation.x, orientation.y, orientation.z, orientation.w)
    if numbers == SAME_POSE or not any(numbers[3:]):  # version 0.1 recorded no pose, which is converted to zeros
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
    return array


def encode_skeleton_definition(skeleton: Skeleton) -> bytes:
    """Encode the names and the tree of a skeleton's joints as a SkeletonDefinition."""
    message = create_message(
        SKELETON_DEFINITION,
        name=skeleton.name,
        joint_names=list(skeleton.joints),
        parents=np.array(skeleton.parents, np.int32),
        bones=np.array(skeleton.bones, np.uint32).ravel(),
    )
    return encode(message, SKELETON_DEFINITION)
