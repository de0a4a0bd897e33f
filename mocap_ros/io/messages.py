"""ROS messages as CDR bytes: what comes in is decoded and checked here, what goes out is encoded here.

The same bytes are published and recorded. No ROS installation is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from mocap_ros.camera import quaternion
from mocap_ros.config import NodeConfig
from mocap_ros.errors import InputError, SkeletonError
from mocap_ros.io.foreign_types import DEFINITIONS, OPENPOSE, YOLO, ZED
from mocap_ros.io.keypoints import first_fault, looks_normalised, tidied
from mocap_ros.lens import Distortion
from mocap_ros.people import Intrinsics, Person2D, Person3D
from mocap_ros.skeleton import CMU15, LAYOUT_NAMES, Skeleton, joint_map, layout

Array = NDArray[np.float64]

ROS_DISTRO = 'kilted'
NS = 1_000_000_000
WORD = 4

OWN = 'mocap_ros_msgs/msg/'
KEYPOINTS = OWN + 'Keypoints2DArray'
SKELETONS = OWN + 'Skeleton3DArray'
CAMERAS = OWN + 'WeakPerspectiveCameraArray'
SKELETON_DEFINITION = OWN + 'SkeletonDefinition'
MARKERS = 'visualization_msgs/msg/MarkerArray'
CAMERA_INFO = 'sensor_msgs/msg/CameraInfo'

POINTS = 'sensor_msgs/msg/PointCloud2'

KEYPOINT_TYPES = (KEYPOINTS, YOLO, ZED, OPENPOSE)


class Header(NamedTuple):
    """Time of an image in ns and the camera's optical frame."""

    stamp_ns: int
    frame_id: str


@dataclass(frozen=True)
class OutputMessage:
    """A message to publish and to record.

    Attributes:
        topic: relative name.
        type: such as `visualization_msgs/msg/MarkerArray`.
        stamp_ns: header.stamp.
        data: CDR.
    """

    topic: str
    type: str
    stamp_ns: int
    data: bytes


@dataclass(frozen=True, eq=False)
class KeypointsFrame:
    """Everyone detected in one image.

    Attributes:
        header: of the image.
        image_width: px, 0 where unknown.
        image_height: px, 0 where unknown.
        people: in the order of the message.
    """

    header: Header
    image_width: int
    image_height: int
    people: tuple[Person2D, ...]


@dataclass(frozen=True)
class CameraInfo:
    """The part of a sensor_msgs/CameraInfo that is used: image size (px, 0 unknown) and intrinsics."""

    width: int
    height: int
    intrinsics: Intrinsics


def image_size(camera: CameraInfo | None, node: NodeConfig) -> tuple[int, int]:
    """Of images whose messages do not say it: (width, height) px by CameraInfo, else by the parameters, else 0."""
    if camera is not None and camera.width and camera.height:
        return camera.width, camera.height
    return (node.image_width, node.image_height) if node.image_width and node.image_height else (0, 0)


def check_size(frame: KeypointsFrame, camera: CameraInfo) -> None:
    """Refuse an image that is not of this camera.

    Raises:
        InputError: both say a size, and not the same.
    """
    said, calibrated = (frame.image_width, frame.image_height), (camera.width, camera.height)
    if all(said) and all(calibrated) and said != calibrated:
        raise InputError(
            'image_width, image_height: {} x {} px, but CameraInfo is for {} x {} px'.format(*said, *calibrated)
        )


@lru_cache(maxsize=1)
def typestore() -> Typestore:
    """The standard messages of ROS 2, those of mocap_ros_msgs, and the foreign ones that are taken as input."""
    store = get_typestore(Stores.ROS2_KILTED)
    own: dict[str, Any] = {}
    for name, text in DEFINITIONS.items():
        own.update(get_types_from_msg(text, name))
    for definition in (files('mocap_ros') / 'msg').iterdir():
        if definition.name.endswith('.msg'):
            text = definition.read_text(encoding='utf-8')
            own.update(get_types_from_msg(text, OWN + definition.name.removesuffix('.msg')))
    store.register(own)
    return store


def new(msgtype: str, **values: Any) -> Any:
    """A message object of that type."""
    return typestore().types[msgtype](**values)


def encode(message: Any, msgtype: str) -> bytes:
    """A message object as CDR, padded to whole words as DDS does it: what is recorded is what is received."""
    raw = bytes(typestore().serialize_cdr(message, msgtype))
    return raw + bytes(-len(raw) % WORD)


def decode(raw: bytes, msgtype: str) -> Any:
    """CDR as a message object.

    Raises:
        InputError: not a message of that type.
    """
    try:
        return typestore().deserialize_cdr(raw, msgtype)
    except Exception as error:  # bytes of a stranger: any reader error ends up here
        reason = str(error).removeprefix(f"Could not deserialize '{msgtype}': ").rstrip('.')
        raise InputError(f'not a {msgtype} ({reason}; {len(raw)} bytes)') from None


def decode_keypoints(raw: bytes, limits: NodeConfig) -> KeypointsFrame:
    """A checked Keypoints2DArray.

    Args:
        raw: CDR.
        limits: most people, joints and text that a message may hold.

    Raises:
        InputError: names the field, and the person where there is one.
    """
    _check_size(raw, limits)
    message = decode(raw, KEYPOINTS)
    header = checked_header(message.header, limits)
    check_count('people', len(message.people), limits)
    people = tuple(_person(p, i, message.image_width, limits) for i, p in enumerate(message.people))
    check_ids('people', people)
    return KeypointsFrame(header, message.image_width, message.image_height, people)


def check_count(field: str, count: int, limits: NodeConfig) -> None:
    """Refuse too many people.

    Raises:
        InputError: names the field.
    """
    if count > limits.max_people:
        raise InputError(f'{field}: {count}, more than {limits.max_people}')


def check_ids(field: str, people: Sequence[Person2D]) -> None:
    """Refuse an id that two people have.

    Raises:
        InputError: names the field and the id.
    """
    named = [p.id for p in people if p.id]
    if len(set(named)) != len(named):
        raise InputError(f'{field}: id {max(named, key=named.count)!r} twice')


def _check_size(raw: bytes, limits: NodeConfig) -> None:
    """Refuse, before anything is decoded, what no message within the limits can hold."""
    text = 4 * limits.max_text + 8
    person = 2 * text + limits.max_joints * (text + 12) + 64
    largest = 64 + text + limits.max_people * person
    if len(raw) > largest:
        raise InputError(f'{len(raw)} bytes, more than the limits allow ({largest})')


def checked_header(header: Any, limits: NodeConfig) -> Header:
    """A std_msgs/Header, checked.

    Raises:
        InputError: a stamp that is no time, or a frame_id that is too long.
    """
    seconds, nanoseconds = header.stamp.sec, header.stamp.nanosec
    if seconds < 0 or nanoseconds >= NS:
        raise InputError(f'header.stamp: {seconds} s {nanoseconds} ns is no time')
    return Header(seconds * NS + nanoseconds, checked_text(header.frame_id, 'header.frame_id', limits))


def checked_text(text: str, field: str, limits: NodeConfig) -> str:
    """The text, where it is not too long.

    Raises:
        InputError: it is; names the field.
    """
    if len(text) > limits.max_text:
        raise InputError(f'{field}: {len(text)} characters, more than {limits.max_text}')
    return text


def _person(person: Any, index: int, image_width: int, limits: NodeConfig) -> Person2D:
    try:
        return _checked_person(person, image_width, limits)
    except InputError as error:
        raise InputError(f'people[{index}].{error}') from None


def _checked_person(person: Any, image_width: int, limits: NodeConfig) -> Person2D:
    lengths = {f: len(getattr(person, f)) for f in ('x', 'y', 'score')}
    if len(set(lengths.values())) > 1:
        raise InputError(f'x, y, score: unequal lengths {", ".join(map(str, lengths.values()))}')
    count = lengths['x']
    if count > limits.max_joints:
        raise InputError(f'x: {count} joints, more than {limits.max_joints}')
    joints = _joints(person, count, limits)
    points = np.stack([person.x, person.y], axis=-1).astype(np.float64)
    score = np.asarray(person.score, np.float64)
    return checked_person(checked_text(person.id, 'id', limits), joints, points, score, image_width)


def checked_person(name: str, joints: tuple[str, ...], points: Array, score: Array, image_width: int) -> Person2D:
    """A person whose keypoints have been looked at, wherever they come from.

    Args:
        name: the detector's, or empty.
        joints: (J,) names.
        points: (J, 2) px.
        score: (J,).
        image_width: px, 0 where unknown.

    Raises:
        InputError: names the field and the joint.
    """
    fault = first_fault(points, score)
    if fault:
        raise InputError(f'{fault.field}[{fault.index[0]}]: {fault.what}')
    points, score = tidied(points, score)
    if looks_normalised(points, score, image_width):
        raise InputError('x, y: looks normalised; px expected')
    return Person2D(name, joints, points, score)


def _joints(person: Any, count: int, limits: NodeConfig) -> tuple[str, ...]:
    """Names of the joints of a message's person."""
    name = checked_text(person.skeleton, 'skeleton', limits)
    if not name and not person.joint_names:
        raise InputError(f'skeleton: empty, and no joint_names; known: {", ".join(LAYOUT_NAMES)}')
    given = tuple(checked_text(n, 'joint_names', limits) for n in person.joint_names)
    field, named = ('joint_names', 'there are') if given else ('skeleton', f'{name!r} has')
    try:
        joints = given or layout(name).joints
        if len(joints) != count:
            raise InputError(f'{field}: {named} {len(joints)} joints, x has {count}')
        joint_map(joints)
    except SkeletonError as error:
        raise InputError(f'{field}: {error}') from None
    return joints


def encode_keypoints(header: Header, image_size: tuple[int, int], people: Sequence[Person2D]) -> bytes:
    """A Keypoints2DArray.

    Args:
        header: of the image.
        image_size: (width, height) px.
        people: their joints go by the name of a layout where they are one, else by their own names.
    """
    message = new(
        KEYPOINTS,
        header=new_header(header),
        image_width=image_size[0],
        image_height=image_size[1],
        people=[_new_person(p) for p in people],
    )
    return encode(message, KEYPOINTS)


def _new_person(person: Person2D) -> Any:
    name = next((n for n in LAYOUT_NAMES if layout(n).joints == person.joints), '')
    return new(
        OWN + 'Keypoints2D',
        id=person.id,
        skeleton=name,
        joint_names=[] if name else list(person.joints),
        x=person.points[:, 0].astype(np.float32),
        y=person.points[:, 1].astype(np.float32),
        score=person.score.astype(np.float32),
    )


def decode_camera_info(raw: bytes, *, rectified: bool = False) -> CameraInfo:
    """Image size and intrinsics of a sensor_msgs/CameraInfo.

    Args:
        raw: CDR.
        rectified: whether keypoints are those of the rectified image: P holds then (K where P is not set), and the
            lens has no distortion.

    Raises:
        InputError: not a CameraInfo, its matrix is not set, or its distortion model is not known.
    """
    message = decode(raw, CAMERA_INFO)
    field, matrix = 'k', np.asarray(message.k, np.float64).reshape(3, 3)
    if rectified and message.p[0]:
        field, matrix = 'p', np.asarray(message.p, np.float64).reshape(3, 4)[:, :3]
    lens = Distortion()
    if not rectified:
        lens = Distortion.named(message.distortion_model, tuple(map(float, message.d)))
    try:
        intrinsics = Intrinsics.from_matrix(matrix, lens)
    except InputError as error:
        raise InputError(f'{field}: {error}; the camera is not calibrated') from None
    return CameraInfo(message.width, message.height, intrinsics)


def encode_skeletons(header: Header, people: Sequence[Person3D]) -> bytes:
    """A Skeleton3DArray."""
    message = new(SKELETONS, header=new_header(header), people=[_new_skeleton(p) for p in people])
    return encode(message, SKELETONS)


def encode_cameras(header: Header, people: Sequence[Person3D]) -> bytes:
    """A WeakPerspectiveCameraArray."""
    message = new(
        CAMERAS,
        header=new_header(header),
        ids=[p.id for p in people],
        cameras=[_new_camera(p) for p in people],
    )
    return encode(message, CAMERAS)


def encode_skeleton_definition(skeleton: Skeleton) -> bytes:
    """A SkeletonDefinition."""
    message = new(
        SKELETON_DEFINITION,
        name=skeleton.name,
        joint_names=list(skeleton.joints),
        parents=np.array(skeleton.parents, np.int32),
        bones=np.array(skeleton.bones, np.uint32).ravel(),
    )
    return encode(message, SKELETON_DEFINITION)


def new_header(header: Header) -> Any:
    """As std_msgs/Header."""
    seconds, nanoseconds = divmod(header.stamp_ns, NS)
    stamp = new('builtin_interfaces/msg/Time', sec=seconds, nanosec=nanoseconds)
    return new('std_msgs/msg/Header', stamp=stamp, frame_id=header.frame_id)


def new_points(positions: Array) -> list[Any]:
    """(N, 3) m as geometry_msgs/Point."""
    point = typestore().types['geometry_msgs/msg/Point']
    return [point(*p) for p in positions.tolist()]


def _new_camera(person: Person3D) -> Any:
    x, y, z, w = quaternion(person.rotation)
    left = person.scale * person.rotation[:2]
    return new(
        OWN + 'WeakPerspectiveCamera',
        scale=person.scale,
        rotation=new('geometry_msgs/msg/Quaternion', x=x, y=y, z=z, w=w),
        translation=np.asarray(person.translation, np.float64),
        matrix=np.column_stack([left, person.translation]).ravel(),
    )


def _new_skeleton(person: Person3D) -> Any:
    motion = new(
        OWN + 'MotionState',
        state=int(person.motion.kind),
        category=person.motion.category,
        residual=person.motion.residual,
        cadence=person.motion.cadence,
    )
    return new(
        OWN + 'Skeleton3D',
        id=person.id,
        skeleton=CMU15.name,
        joints=new_points(person.joints),
        joint_std=person.std.astype(np.float32),
        filled=np.asarray(person.filled, np.bool_),
        camera=_new_camera(person),
        motion=motion,
        reprojection_residual=person.residual,
        scale_source=int(person.scale_known),
        predicted=person.predicted,
    )
