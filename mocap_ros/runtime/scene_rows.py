"""The skeletons and keypoints of messages, collected as numbers, and the scene that they make.

Numbers instead of message objects keep an hour of people in some tens of MB. A bag is collected as a whole, a live
view frame by frame.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap_ros.errors import InputError
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.image_size import UNKNOWN_SIZE, ImageSize, resolve_image_size
from mocap_ros.messages.camera_info import CameraInfo
from mocap_ros.messages.cdr import read_stamp
from mocap_ros.messages.keypoints import KeypointsFrame
from mocap_ros.runtime.frame_assembly import is_stamp_missing
from mocap_ros.skeleton import CMU15, keypoint_layout, skeleton_from_joints
from mocap_ros.units import NS_PER_S
from mocap_ros.viewing.scene import Mark, MarkKind, Scene, SceneKeypoints, ScenePerson

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

UNKNOWN_STD = np.full(len(CMU15.joints), np.nan, np.float32)  # m, of a message without standard deviations
MAX_POINT_PX = 1e6  # px; image points farther away are garbage and not drawn
FALLBACK_SIZE = (640, 480)  # px, of a live view before anybody is seen
MIN_DEPTH_M = 0.1  # m; nearer joints have no image point that could be drawn


def project_joints(joints: NDArray[np.floating[Any]], intrinsics: Intrinsics) -> Array32:
    """Return the image points (..., 2) of joints (..., 3), NaN behind or at the camera."""
    points = np.where(joints[..., 2:] > MIN_DEPTH_M, joints, np.nan).astype(np.float64)
    return intrinsics.project(points).astype(np.float32)


def recover_intrinsics(roots: Array, scale: Array, translation: Array) -> tuple[Intrinsics, tuple[int, int]]:
    """Return the camera whose weak-perspective cameras these are, without lens distortion.

    f = median s z,  c = median (t - f (x, y) / z)

    Args:
        roots: (N, 3) m, means (x, y, z) of the joints.
        scale: (N,) px/m, s.
        translation: (N, 2) px, t.

    Returns:
        The intrinsics, and the image size in px if the principal point is in its middle.
    """
    focal = float(np.median(scale * roots[:, 2]))
    centre = np.median(translation - focal * roots[:, :2] / roots[:, 2:], axis=0)
    if not (np.isfinite(focal) and np.isfinite(centre).all() and focal >= 1):
        raise InputError('scale, translation: not those of a camera')
    size = max(round(2 * float(centre[0])), 1), max(round(2 * float(centre[1])), 1)
    return Intrinsics(focal, (float(centre[0]), float(centre[1])), is_focal_known=False), size


class _PersonRows:
    """The skeletons of one person, as numbers in the order of the messages."""

    def __init__(self) -> None:
        self.stamps = array('q')
        self.joints, self.std, self.cameras, self.numbers = (array('f') for _ in range(4))
        self.inferred, self.states = bytearray(), bytearray()

    def add(self, stamp_ns: int, skeleton: Any) -> None:
        """Add a Skeleton3D message."""
        if len(skeleton.joints) != len(CMU15.joints) or len(skeleton.inferred) != len(CMU15.joints):
            raise InputError(f'skeleton of {len(skeleton.joints)} joints, expected {len(CMU15.joints)}')
        self.stamps.append(stamp_ns)
        self.joints.extend([value for joint in skeleton.joints for value in (joint.x, joint.y, joint.z)])
        std = np.asarray(skeleton.joint_std, np.float32)
        self.std.frombytes((std if len(std) == len(CMU15.joints) else UNKNOWN_STD).tobytes())
        self.inferred += bytes(skeleton.inferred)
        self.cameras.extend((skeleton.camera.scale, *skeleton.camera.translation))
        self.numbers.extend((skeleton.reprojection_residual, skeleton.motion.cadence))
        self.states += bytes((skeleton.motion.state, skeleton.predicted, skeleton.tentative))

    def recover_intrinsics(self) -> tuple[Intrinsics, ImageSize]:
        """Return what the cameras of the skeletons imply; see the function of that name."""
        cameras = np.array(self.cameras, np.float64).reshape(-1, 3)
        roots = np.array(self.joints, np.float64).reshape(len(cameras), -1, 3).mean(axis=1)
        return recover_intrinsics(roots, cameras[:, 0], cameras[:, 1:])


class _KeypointRows:
    """All detections of one keypoint layout, as numbers in the order of the messages."""

    def __init__(self) -> None:
        self.stamps = array('q')
        self.numbers = array('f')

    def add(self, stamp_ns: int, x: NDArray[Any], y: NDArray[Any], score: NDArray[Any]) -> None:
        """Add a detection: (J,) px, px and confidence scores."""
        self.stamps.append(stamp_ns)
        keypoints = np.empty((len(score), 3), np.float32)
        keypoints[:, 0], keypoints[:, 1], keypoints[:, 2] = x, y, score
        self.numbers.frombytes(keypoints.tobytes())


class SceneRows:
    """Collects the messages of a recording, or of one frame.

    Args:
        person: id of the only person to show; None for all.

    Attributes:
        newest_ns: stamp of the last skeletons in ns.
    """

    def __init__(self, person: str | None = None) -> None:
        self.newest_ns = 0
        self._person = person
        self._people: dict[str, _PersonRows] = {}
        self._keypoints: dict[tuple[str, ...], _KeypointRows] = {}
        self._stamps: set[int] = set()
        self._drops: list[tuple[int, str]] = []
        self._image_size = UNKNOWN_SIZE

    @property
    def has_people(self) -> bool:
        """Whether there is a skeleton."""
        return bool(self._people)

    def add_skeletons(self, message: Any) -> None:
        """Add a Skeleton3DArray.

        Raises:
            InputError: a skeleton has another number of joints than `CMU15`.
        """
        self.newest_ns = read_stamp(message.header.stamp)
        self._stamps.add(self.newest_ns)
        for skeleton in message.people:
            if self._person in (None, skeleton.id):
                self._people.setdefault(skeleton.id, _PersonRows()).add(self.newest_ns, skeleton)

    def add_keypoints(self, frame: KeypointsFrame) -> None:
        """Add the people whom a detector saw in an image."""
        self._image_size = (frame.image_width, frame.image_height) if frame.image_width else self._image_size
        self._stamps.add(frame.header.stamp_ns)
        for person in frame.people:
            rows = self._keypoints.setdefault(person.joints, _KeypointRows())
            rows.add(frame.header.stamp_ns, person.points[:, 0], person.points[:, 1], person.score)

    def add_own_keypoints(self, message: Any) -> None:
        """Add a Keypoints2DArray without the checks of the tracker, which take most of the time of a long bag.

        Raises:
            InputError: the arrays of a person are not of the layout's length.
            SkeletonError: a layout is unknown.
        """
        stamp_ns = read_stamp(message.header.stamp)
        if message.image_width and message.image_height:
            self._image_size = message.image_width, message.image_height
        self._stamps.add(stamp_ns)
        for person in message.people:
            joints = tuple(person.joint_names) or keypoint_layout(person.skeleton).joints
            if not len(person.x) == len(person.y) == len(person.score) == len(joints):
                raise InputError(f'people: {len(person.x)} keypoints, expected {len(joints)}')
            self._keypoints.setdefault(joints, _KeypointRows()).add(stamp_ns, person.x, person.y, person.score)

    def add_drop(self, reason: str) -> None:
        """Add an input that was dropped after the last skeletons."""
        self._drops.append((self.newest_ns, reason))

    def build_frame(self) -> Scene:
        """Return the scene of one frame, which may show nobody, as a live view draws it."""
        if self._people:
            return self.build('live')
        size = self._image_size if all(self._image_size) else FALLBACK_SIZE
        stamps = np.array(sorted(self._stamps), np.int64)
        keypoints = tuple(_finish_keypoints(names, rows, stamps) for names, rows in self._keypoints.items())
        return Scene('live', stamps.tolist(), (), keypoints, size, Intrinsics.from_image_size(*size, 1.0))

    def build(self, title: str, camera: CameraInfo | None = None) -> Scene:
        """Return the scene of what was collected, which has a skeleton; the rows are given up, to save memory.

        Args:
            title: title of the scene.
            camera: the CameraInfo, where it is known.

        Raises:
            InputError: the skeletons' cameras are not valid.
        """
        stamps = np.array(sorted(self._stamps), np.int64)
        if len(stamps) > 1 and is_stamp_missing(int(stamps[0]), int(stamps[-1])):
            stamps = stamps[1:]
        intrinsics, implied_size = next(iter(self._people.values())).recover_intrinsics()
        size = resolve_image_size(
            stated=self._image_size, camera=camera.size if camera else None, configured=implied_size
        )
        intrinsics = camera.intrinsics if camera else intrinsics
        people = [_finish_person(i, self._people.pop(i), stamps, intrinsics) for i in list(self._people)]
        keypoints = [
            _finish_keypoints(names, self._keypoints.pop(names), stamps) for names in list(self._keypoints)
        ]
        return Scene(
            title=title,
            stamps_ns=stamps.tolist(),
            people=tuple(sorted((p for p in people if len(p.frames)), key=lambda p: int(p.frames[0]))),
            keypoints=tuple(keypoints),
            image_size=size,
            intrinsics=intrinsics,
            marks=tuple(_make_drops(self._drops, stamps)),
        )


def _make_drops(drops: Sequence[tuple[int, str]], stamps: NDArray[np.int64]) -> list[Mark]:
    """Return the marks of dropped inputs, by the stamps in ns of the skeletons before them and reasons."""
    frames = np.searchsorted(stamps, [stamp for stamp, _ in drops]).clip(max=len(stamps) - 1)
    times = (stamps[frames] - stamps[0]) / NS_PER_S
    return [Mark(float(time), MarkKind.DROP, reason) for time, (_, reason) in zip(times, drops, strict=True)]


def _finish_person(
    person_id: str, rows: _PersonRows, stamps: NDArray[np.int64], intrinsics: Intrinsics
) -> ScenePerson:
    """Return the person of the collected rows; of several rows with one stamp the last is kept."""
    own = np.array(rows.stamps, np.int64)
    order = np.argsort(own, kind='stable')
    is_last = np.append(np.diff(own[order]) > 0, True)
    kept = order[is_last & (own[order] >= stamps[0])]
    shape = (len(own), len(CMU15.joints))
    joints = np.frombuffer(rows.joints, np.float32).reshape(*shape, 3)[kept]
    numbers = np.frombuffer(rows.numbers, np.float32).reshape(-1, 2)[kept]
    states = np.frombuffer(rows.states, np.uint8).reshape(-1, 3)[kept]
    return ScenePerson(
        id=person_id,
        frames=np.searchsorted(stamps, own[kept]),
        joints=joints,
        std=np.frombuffer(rows.std, np.float32).reshape(shape)[kept],
        inferred=np.frombuffer(rows.inferred, np.uint8).reshape(shape)[kept] > 0,
        image=project_joints(joints, intrinsics),
        residual=numbers[:, 0],
        cadence=numbers[:, 1],
        motion=states[:, 0],
        predicted=states[:, 1] > 0,
        tentative=states[:, 2] > 0,
    )


def _finish_keypoints(names: tuple[str, ...], rows: _KeypointRows, stamps: NDArray[np.int64]) -> SceneKeypoints:
    """Return the detections of the collected rows in the order of their stamps."""
    own = np.array(rows.stamps, np.int64)
    order = np.argsort(own, kind='stable')
    order = order[own[order] >= stamps[0]]
    numbers = np.frombuffer(rows.numbers, np.float32).reshape(len(own), len(names), 3)[order]
    is_seen = (numbers[..., 2:] > 0) & (np.abs(numbers[..., :2]) < MAX_POINT_PX)
    points = np.where(is_seen, numbers[..., :2], np.float32(np.nan))
    score = np.where(np.isfinite(points).all(axis=2), numbers[..., 2], np.float32(0))
    return SceneKeypoints(skeleton_from_joints(names), np.searchsorted(stamps, own[order]), points, score)
