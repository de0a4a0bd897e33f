# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The skeletons and keypoints of messages, collected as numbers, and the scene that they make.

Messages are decoded many at a time (`messages/columns.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from mocap_ros.errors import InputError
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.level import average_vertical
from mocap_ros.keypoints.image_size import UNKNOWN_SIZE, resolve_image_size
from mocap_ros.keypoints.validation import find_seen
from mocap_ros.messages.camera_info import CameraInfo
from mocap_ros.messages.keypoint_columns import KeypointMessages, read_keypoints
from mocap_ros.messages.keypoints import KeypointsFrame
from mocap_ros.messages.skeleton_columns import SkeletonColumns, SkeletonMessages, read_skeletons
from mocap_ros.runtime.frame_assembly import is_stamp_missing
from mocap_ros.skeleton import CMU15, Skeleton, skeleton_from_joints
from mocap_ros.units import NS_PER_S
from mocap_ros.viewing.scene import Mark, MarkKind, Scene, SceneKeypoints, ScenePerson

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Indices = NDArray[np.intp]
Stamps = NDArray[np.int64]
T = TypeVar('T', SkeletonMessages, KeypointMessages)

BATCH_MESSAGES = 512  # messages that are decoded at a time; more are not faster, and take memory
BATCH_BYTES = 4 << 20  # bytes of messages that are decoded at a time
MAX_POINT_PX = 1e6  # px; image points farther away are garbage and not drawn
CAMERA_ROWS = 10_000  # skeletons whose cameras tell the intrinsics; more would tell the same


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
    is_known = np.isfinite(roots).all(axis=1) & np.isfinite(scale) & np.isfinite(translation).all(axis=1)
    if not is_known.any():
        raise InputError('scale, translation: not finite in any frame')
    roots, scale, translation = roots[is_known], scale[is_known], translation[is_known]
    focal = float(np.median(scale * roots[:, 2]))
    centre = np.median(translation - focal * roots[:, :2] / roots[:, 2:], axis=0)
    if not (np.isfinite(focal) and np.isfinite(centre).all() and focal >= 1):
        raise InputError('scale, translation: not those of a camera')
    size = max(round(2 * float(centre[0])), 1), max(round(2 * float(centre[1])), 1)
    return Intrinsics(focal, (float(centre[0]), float(centre[1])), is_focal_known=False), size


class _Rows:
    """Columns of rows that are added in pieces: stamps in ns, places among all messages, and any others."""

    def __init__(self) -> None:
        self._pieces: list[tuple[NDArray[Any], ...]] = []

    def add(self, *columns: NDArray[Any]) -> None:
        """Add rows."""
        self._pieces.append(columns)

    def finish(self) -> list[NDArray[Any]]:
        """Return the columns but that of the places, by stamp and then by place."""
        stamps, places, *others = (np.concatenate(column) for column in zip(*self._pieces, strict=True))
        order = np.lexsort((places, stamps))
        return [column[order] for column in (stamps, *others)]


class _Buffer(NamedTuple):
    """Messages that wait for being decoded, and reasons of drops with the number of messages before them."""

    raws: list[bytes]
    drops: list[tuple[int, str]]


class SceneRows:
    """Collects the messages of a recording.

    Args:
        person: id of the only person to show; None for all.

    Attributes:
        faults: descriptions of the messages that could not be read.
    """

    def __init__(self, person: str | None = None) -> None:
        self.faults: list[str] = []
        self._person = person
        self._skeletons, self._keypoints = _Buffer([], []), _Buffer([], [])
        self._people: dict[str, _Rows] = {}
        self._detections: dict[tuple[str, ...], _Rows] = {}
        self._stamps: list[Stamps] = []
        self._vertical: list[Array] = []
        self._cameras: list[Array] = []
        self._drops: list[tuple[int, str]] = []
        self._image_size = UNKNOWN_SIZE
        self._skeleton: Skeleton | None = None
        self._newest_ns = 0
        self._order = 0  # number of messages so far

    @property
    def has_people(self) -> bool:
        """Whether there is a skeleton in any message."""
        self._decode_skeletons()
        return bool(self._people)

    def add_skeletons(self, raw: bytes) -> None:
        """Add a Skeleton3DArray."""
        self._skeletons.raws.append(raw)
        if len(self._skeletons.raws) >= BATCH_MESSAGES or len(raw) * len(self._skeletons.raws) > BATCH_BYTES:
            self._decode_skeletons()

    def add_keypoints(self, raw: bytes) -> None:
        """Add a Keypoints2DArray, without the checks of the tracker."""
        self._keypoints.raws.append(raw)
        if len(self._keypoints.raws) >= BATCH_MESSAGES or len(raw) * len(self._keypoints.raws) > BATCH_BYTES:
            self._decode_keypoints()

    def add_keypoints_frame(self, frame: KeypointsFrame) -> None:
        """Add the people whom a detector saw in an image, from a message of any type."""
        self._image_size = (frame.image_width, frame.image_height) if frame.image_width else self._image_size
        stamps = np.array([frame.header.stamp_ns], np.int64)
        self._stamps.append(stamps)
        for person in frame.people:
            numbers = np.column_stack([person.points, person.score])[None]
            self._add_detections(person.joints, stamps, np.array([self._order]), numbers)
        self._order += 1

    def add_drop(self, reason: str) -> None:
        """Add an input that was dropped after the last skeletons."""
        self._skeletons.drops.append((len(self._skeletons.raws), reason))

    def build(self, title: str, camera: CameraInfo | None = None) -> Scene:
        """Return the scene of what was collected, which has a skeleton.

        Args:
            title: title of the scene.
            camera: the CameraInfo, where it is known.

        Raises:
            InputError: the skeletons' cameras are not valid.
        """
        self._decode_skeletons()
        self._decode_keypoints()
        stamps = np.unique(np.concatenate(self._stamps))
        if len(stamps) > 1 and is_stamp_missing(int(stamps[0]), int(stamps[-1])):
            stamps = stamps[1:]
        roots, scale, translation = np.split(np.concatenate(self._cameras), [3, 4], axis=1)
        intrinsics, implied_size = recover_intrinsics(roots, scale[:, 0], translation)
        size = resolve_image_size(
            stated=self._image_size, camera=camera.size if camera else None, configured=implied_size
        )
        intrinsics = camera.intrinsics if camera else intrinsics
        people = [_finish_person(i, rows, stamps, intrinsics) for i, rows in self._people.items()]
        keypoints = [_finish_keypoints(names, rows, stamps) for names, rows in self._detections.items()]
        return Scene(
            title=title,
            stamps_ns=stamps.tolist(),
            people=tuple(sorted((p for p in people if len(p.frames)), key=lambda p: int(p.frames[0]))),
            keypoints=tuple(keypoints),
            image_size=size,
            intrinsics=intrinsics,
            marks=tuple(_make_drops(self._drops, stamps)),
            skeleton=self._skeleton or CMU15,
            vertical=average_vertical(np.array(self._vertical)),
        )

    def _decode_skeletons(self) -> None:
        """Decode the skeletons that wait, and place the drops beside them."""
        raws, drops = self._skeletons
        stamps = np.full(len(raws) + 1, -1, np.int64)
        stamps[0] = self._newest_ns

        def add(messages: SkeletonMessages, places: Stamps) -> None:
            stamps[places - self._order + 1] = messages.stamps_ns
            self._add_skeleton_messages(messages, places)

        self._decode('skeletons', raws, self._order, read_skeletons, add)
        newest = np.maximum.accumulate(np.where(stamps >= 0, np.arange(len(stamps)), 0))
        self._drops += [(int(stamps[newest[count]]), reason) for count, reason in drops]
        self._newest_ns = int(stamps[newest[-1]])
        self._order += len(raws)
        raws.clear()
        drops.clear()

    def _decode_keypoints(self) -> None:
        """Decode the keypoints that wait."""
        raws = self._keypoints.raws
        self._decode('keypoints', raws, self._order, read_keypoints, self._add_keypoint_messages)
        self._order += len(raws)
        raws.clear()

    def _decode(
        self,
        name: str,
        raws: Sequence[bytes],
        first: int,
        read: Callable[[Sequence[bytes]], Iterable[T]],
        add: Callable[[T, Stamps], None],
    ) -> None:
        """Decode messages together; those that are damaged are found by halving, and left out.

        Args:
            name: what they hold, for the description of a fault.
            raws: the messages.
            first: place of the first one among all messages.
            read: function that decodes messages, and yields them in groups with their `rows`.
            add: function that takes a group and the places (N,) of its messages.
        """
        try:
            groups = list(read(raws))
        except InputError as error:
            if len(raws) == 1:
                self.faults.append(f'{name}: {error}')
                return
            half = len(raws) // 2
            self._decode(name, raws[:half], first, read, add)
            self._decode(name, raws[half:], first + half, read, add)
            return
        for group in groups:
            add(group, first + group.rows)

    def _add_skeleton_messages(self, messages: SkeletonMessages, places: Stamps) -> None:
        self._stamps.append(messages.stamps_ns)
        direction = average_vertical(messages.vertical)
        if np.isfinite(direction).all():
            self._vertical.append(direction)
        for person in messages.people:
            if self._person in (None, person.id):
                self._add_person(person, messages.stamps_ns[person.rows], places[person.rows])

    def _add_person(self, person: SkeletonColumns, stamps: Stamps, places: Stamps) -> None:
        self._skeleton = self._skeleton or person.skeleton
        if person.skeleton != self._skeleton:
            self.faults += [f'{person.id}: joints of {person.skeleton.name}, others of {self._skeleton.name}']
            return
        core = [person.skeleton.index(joint) for joint in CMU15.joints]
        if sum(map(len, self._cameras)) < CAMERA_ROWS:
            joints = person.joints[:, core]
            count = np.isfinite(joints).sum(axis=1)
            roots = np.nan_to_num(joints, posinf=0, neginf=0).sum(axis=1) / np.where(count, count, np.nan)
            self._cameras.append(np.column_stack([roots, person.cameras]))
        columns = (
            person.joints.astype(np.float32),
            person.std,
            person.inferred,
            person.residual,
            person.cadence,
            person.motion,
            person.predicted,
            person.tentative,
        )
        self._people.setdefault(person.id, _Rows()).add(stamps, places, *columns)

    def _add_keypoint_messages(self, messages: KeypointMessages, places: Stamps) -> None:
        stated = messages.image_size[messages.image_size.all(axis=1)]
        if len(stated):
            self._image_size = int(stated[-1, 0]), int(stated[-1, 1])
        self._stamps.append(messages.stamps_ns)
        for people in messages.people:
            stamps = messages.stamps_ns[people.rows]
            self._add_detections(people.joints, stamps, places[people.rows], people.numbers)

    def _add_detections(
        self, joints: tuple[str, ...], stamps: Stamps, places: Stamps, numbers: NDArray[np.floating[Any]]
    ) -> None:
        """Add detections (N, J, 3), whose points are NaN from here on where a keypoint was not seen."""
        is_drawn = (np.abs(numbers[..., :2]) < MAX_POINT_PX).all(axis=2)
        is_drawn &= find_seen(numbers[..., :2], numbers[..., 2])
        points = np.where(is_drawn[..., None], numbers[..., :2], np.float32(np.nan)).astype(np.float32)
        self._detections.setdefault(joints, _Rows()).add(stamps, places, points)


def _make_drops(drops: Sequence[tuple[int, str]], stamps: Stamps) -> list[Mark]:
    """Return the marks of dropped inputs, by the stamps in ns of the skeletons before them and reasons."""
    frames = np.searchsorted(stamps, [stamp for stamp, _ in drops]).clip(max=len(stamps) - 1)
    times = (stamps[frames] - stamps[0]) / NS_PER_S
    return [Mark(float(time), MarkKind.DROP, reason) for time, (_, reason) in zip(times, drops, strict=True)]


def _finish_person(person_id: str, rows: _Rows, stamps: Stamps, intrinsics: Intrinsics) -> ScenePerson:
    """Return the person of the collected rows; of several rows with one stamp the last is kept."""
    own, joints, std, inferred, residual, cadence, motion, predicted, tentative = rows.finish()
    kept = (np.diff(own, append=np.iinfo(np.int64).max) > 0) & (own >= stamps[0])
    if not kept.all():
        joints, std, inferred, residual, cadence, motion, predicted, tentative = (
            column[kept] for column in (joints, std, inferred, residual, cadence, motion, predicted, tentative)
        )
    return ScenePerson(
        id=person_id,
        frames=np.searchsorted(stamps, own[kept]),
        joints=joints,
        std=std,
        inferred=inferred,
        intrinsics=intrinsics,
        residual=residual,
        cadence=cadence,
        motion=motion,
        predicted=predicted,
        tentative=tentative,
    )


def _finish_keypoints(names: tuple[str, ...], rows: _Rows, stamps: Stamps) -> SceneKeypoints:
    """Return the detections of the collected rows in the order of their stamps."""
    own, points = rows.finish()
    kept = own >= stamps[0]
    return SceneKeypoints(skeleton_from_joints(names), np.searchsorted(stamps, own[kept]), points[kept])
