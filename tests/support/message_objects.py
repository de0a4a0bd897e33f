# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The outputs as message objects, which say by their names what the encoders write field by field."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mocap_ros.geometry.rigid_transform import RigidTransform
from mocap_ros.geometry.rotations import quaternion_from_rotation
from mocap_ros.messages.camera_placement import CameraPlacement
from mocap_ros.messages.cdr import MOCAP_ROS_MSGS, Header, create_header, create_message, encode
from mocap_ros.messages.markers import (
    ADD,
    BONE_SCALE_M,
    BRIGHTNESS,
    DELETE,
    FIRST_HUE,
    GOLDEN_RATIO,
    INFERRED_STYLE,
    JOINT_SCALE_M,
    MARKERS,
    SEEN_STYLE,
    UNCERTAIN_STYLE,
    MarkerStyle,
)
from mocap_ros.messages.point_cloud import DATATYPES, POINT_DTYPE, POINTS
from mocap_ros.messages.skeletons import CAMERAS, SKELETONS
from mocap_ros.messages.transforms import TRANSFORMS
from mocap_ros.people import CameraVertical, Person3D
from mocap_ros.units import NS_PER_S

Array = NDArray[np.float64]


def create_points(positions: Array) -> list[Any]:
    return [create_message('geometry_msgs/msg/Point', x=x, y=y, z=z) for x, y, z in positions.tolist()]


def create_quaternion(x: float, y: float, z: float, w: float) -> Any:
    return create_message('geometry_msgs/msg/Quaternion', x=x, y=y, z=z, w=w)


NO_ROTATION = (0.0, 0.0, 0.0, 1.0)


def create_vector(x: float, y: float, z: float) -> Any:
    return create_message('geometry_msgs/msg/Vector3', x=x, y=y, z=z)


def create_pose(transform: RigidTransform | None) -> Any:
    transform = transform or RigidTransform.identity()
    return create_message(
        'geometry_msgs/msg/Pose',
        position=create_points(transform.translation[None])[0],
        orientation=create_quaternion(*transform.quaternion),
    )


def create_camera(person: Person3D) -> Any:
    return create_message(
        MOCAP_ROS_MSGS + 'WeakPerspectiveCamera',
        scale=person.scale,
        rotation=create_quaternion(*quaternion_from_rotation(person.rotation)),
        translation=person.translation,
        matrix=np.column_stack([person.scale * person.rotation[:2], person.translation]).ravel(),
    )


def encode_cameras_slowly(header: Header, people: Sequence[Person3D]) -> bytes:
    ids, cameras = [p.id for p in people], [create_camera(p) for p in people]
    return encode(create_message(CAMERAS, header=create_header(header), ids=ids, cameras=cameras), CAMERAS)


def encode_skeletons_slowly(
    header: Header,
    people: Sequence[Person3D],
    vertical: CameraVertical | None = None,
    camera: CameraPlacement | None = None,
) -> bytes:
    skeletons = [
        create_message(
            MOCAP_ROS_MSGS + 'Skeleton3D',
            id=person.id,
            skeleton=person.skeleton.name,
            joints=create_points(person.joints),
            joint_std=person.std.astype(np.float32),
            inferred=person.inferred,
            camera=create_camera(person),
            motion=create_message(
                MOCAP_ROS_MSGS + 'MotionState',
                state=int(person.motion.kind),
                category=person.motion.category,
                residual=person.motion.residual,
                cadence=person.motion.cadence,
            ),
            reprojection_residual=person.residual,
            scale_source=int(person.scale_known),
            predicted=person.predicted,
            tentative=person.tentative,
            joint_velocity=[create_vector(*velocity) for velocity in person.velocity.tolist()],
            joint_velocity_std=person.velocity_std.astype(np.float32),
            root=create_points(person.root[None])[0],
            root_covariance=person.root_covariance.ravel(),
            root_velocity=create_vector(*person.root_velocity.tolist()),
            root_velocity_covariance=person.root_velocity_covariance.ravel(),
            age=person.age,
            unseen_for=person.unseen_for,
            joint_orientation=[create_quaternion(*q) for q in person.orientation.tolist()],
            turn_inferred=person.turn_inferred,
        )
        for person in people
    ]
    direction, std = (np.zeros(3), float('nan')) if vertical is None else vertical
    message = create_message(
        SKELETONS,
        header=create_header(header),
        people=skeletons,
        vertical=create_vector(*direction),
        vertical_std=std,
        camera_frame_id=header.frame_id if camera is None else camera.frame_id,
        camera_pose=create_pose(camera.pose if camera else None),
    )
    return encode(message, SKELETONS)


def encode_points_slowly(header: Header, people: Sequence[Person3D]) -> bytes:
    points = [
        (*person.joints[joint], person.std[joint], index, joint, person.inferred[joint])
        for index, person in enumerate(people)
        for joint in range(len(person.joints))
    ]
    cloud = np.array(points, POINT_DTYPE)
    fields = [
        create_message(
            'sensor_msgs/msg/PointField', name=name, offset=offset, datatype=DATATYPES[dtype.str], count=1
        )
        for name, (dtype, offset, *_) in (POINT_DTYPE.fields or {}).items()
    ]
    message = create_message(
        POINTS,
        header=create_header(header),
        height=1,
        width=cloud.size,
        fields=fields,
        is_bigendian=False,
        point_step=POINT_DTYPE.itemsize,
        row_step=POINT_DTYPE.itemsize * cloud.size,
        data=np.frombuffer(cloud.tobytes(), np.uint8),
        is_dense=True,
    )
    return encode(message, POINTS)


def create_color(number: int, style: MarkerStyle) -> Any:
    r, g, b = colorsys.hsv_to_rgb((FIRST_HUE + number * GOLDEN_RATIO) % 1, style.saturation, BRIGHTNESS)
    return create_message('std_msgs/msg/ColorRGBA', r=r, g=g, b=b, a=style.opacity)


def create_marker(header: Header, namespace: str, number: int, action: int) -> Any:
    """Return a marker in which all other fields are zero or empty."""
    nothing = np.zeros(0, np.uint8)
    return create_message(
        'visualization_msgs/msg/Marker',
        header=create_header(header),
        ns=namespace,
        id=number,
        type=0,
        action=action,
        pose=create_message(
            'geometry_msgs/msg/Pose',
            position=create_message('geometry_msgs/msg/Point', x=0.0, y=0.0, z=0.0),
            orientation=create_quaternion(0.0, 0.0, 0.0, 1.0),
        ),
        scale=create_vector(0.0, 0.0, 0.0),
        color=create_message('std_msgs/msg/ColorRGBA', r=0.0, g=0.0, b=0.0, a=0.0),
        lifetime=create_message('builtin_interfaces/msg/Duration', sec=0, nanosec=0),
        frame_locked=False,
        points=[],
        colors=[],
        texture_resource='',
        texture=create_message(
            'sensor_msgs/msg/CompressedImage', header=create_header(Header(0, '')), format='', data=nothing
        ),
        uv_coordinates=[],
        text='',
        mesh_resource='',
        mesh_file=create_message('visualization_msgs/msg/MeshFile', filename='', data=nothing),
        mesh_use_embedded_materials=False,
    )


def create_person_markers(header: Header, person: Person3D, number: int, lifetime_s: float) -> list[Any]:
    bones = np.array(person.skeleton.bones)
    inferred_bones = person.inferred[bones].any(axis=1)
    seen_color = create_color(number, UNCERTAIN_STYLE if person.tentative else SEEN_STYLE)
    is_uncertain = person.predicted or person.tentative
    inferred_color = create_color(number, UNCERTAIN_STYLE if is_uncertain else INFERRED_STYLE)
    markers = []
    for namespace, type_, scale, points, is_inferred in (
        ('joints', 7, JOINT_SCALE_M, person.joints, person.inferred),
        ('bones', 5, BONE_SCALE_M, person.joints[bones.ravel()], np.repeat(inferred_bones, 2)),
    ):
        marker = create_marker(header, namespace, number, ADD)
        marker.type = type_
        marker.scale = create_vector(*scale)
        marker.points = create_points(points)
        marker.colors = [inferred_color if i else seen_color for i in is_inferred]
        marker.color = seen_color
        seconds, nanoseconds = divmod(round(lifetime_s * NS_PER_S), NS_PER_S)
        marker.lifetime = create_message('builtin_interfaces/msg/Duration', sec=seconds, nanosec=nanoseconds)
        markers.append(marker)
    return markers


def encode_markers_slowly(
    header: Header, people: Sequence[Person3D], deleted_numbers: Sequence[int], lifetime_s: float
) -> bytes:
    """Encode the markers of people numbered from 0, after the deletion of those of other numbers."""
    markers = [create_marker(header, s, n, DELETE) for s in ('bones', 'joints') for n in deleted_numbers]
    for number, person in enumerate(people):
        markers += create_person_markers(header, person, number, lifetime_s)
    return encode(create_message(MARKERS, markers=markers), MARKERS)


def create_transform(header: Header, child: str, position: Array, rotation: Sequence[float]) -> Any:
    return create_message(
        'geometry_msgs/msg/TransformStamped',
        header=create_header(header),
        child_frame_id=child,
        transform=create_message(
            'geometry_msgs/msg/Transform',
            translation=create_vector(*position),
            rotation=create_quaternion(*rotation),
        ),
    )


def encode_transforms_slowly(header: Header, people: Sequence[Person3D], prefix: str) -> bytes:
    """Encode the transforms of people whose ids are valid in the names of frames."""
    transforms = []
    for person in people:
        position = dict(zip(person.joint_names, person.joints, strict=True))
        turns = dict(zip(person.joint_names, person.orientation.tolist(), strict=True))
        torso = (position['lshoulder'] + position['rshoulder']) / 2
        root = (position['lhip'] + position['rhip']) / 2
        up = (torso - root) / np.linalg.norm(torso - root)
        forward = np.cross(position['lhip'] - position['rhip'], up)
        forward /= np.linalg.norm(forward)
        axes = np.stack([forward, np.cross(up, forward), up], axis=-1)
        body = f'{prefix}body_{person.id}'
        transforms.append(create_transform(header, body, root, quaternion_from_rotation(axes)))
        middle = [joint for joint in ('head', 'nose') if joint in position]
        limbs = [joint for joint in position if joint[0] in 'lr']
        links = {'torso': (torso, turns['neck'])} | {j: (position[j], turns[j]) for j in middle}
        links |= {f'{j[0]}_{j[1:]}': (position[j], turns[j]) for j in limbs}
        for link, (origin, turn) in links.items():
            rotation = (0.0, 0.0, 0.0, 1.0)
            if np.isfinite(turn).all():
                rotation = (Rotation.from_matrix(axes).inv() * Rotation.from_quat(turn)).as_quat()
            child = f'{prefix}{link}_{person.id}'
            own_header = Header(header.stamp_ns, body)
            transforms.append(create_transform(own_header, child, (origin - root) @ axes, rotation))
    return encode(create_message(TRANSFORMS, transforms=transforms), TRANSFORMS)
