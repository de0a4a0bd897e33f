# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The scene: all that the page (`viewing/page.py`) draws of a recording, with the colours in which it draws it.

Joints are in m in the camera's optical frame (x right, y down, z forward), image points in px.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from mocap_ros.arrays import Array, Array32, Indices, Mask
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.level import LOWEST_PERCENTILE, rotation_to_level
from mocap_ros.people import PoseSequence
from mocap_ros.skeleton import CMU15, Skeleton, canonical_joint_names
from mocap_ros.units import NS_PER_S
from mocap_ros.viewing.plots import MIDDLE_COLOUR, TRUTH_COLOUR, PlotData, choose_side_colour

PALE_COLOUR = '#a8a8a8'  # grey; people who are predicted or tentative
# Colours of several people, which people with defective colour vision distinguish as well (Okabe and Ito 2008),
# without the orange of inferred joints
PERSON_COLOURS = ('#0072b2', '#009e73', '#cc79a7', '#a6761d', '#56b4e9', '#7a5195', '#66a61e', '#b2182b')
RIGHT_SHADE = 0.62  # factor of a person's colour on the right side of the body, dark enough to differ
TRAIL_JOINT = 'pelvis'  # the joint whose way is drawn, because it is nearest to the centre of the body
EXTENT_PERCENTILES = (2, 98)  # %; of the joints' coordinates, for the first view of the scene
# A part of the body counts as exchanged by the detector if its keypoints fit the result with left and right
# exchanged at less than this share of the error that they have as they are,
MAX_EXCHANGED_ERROR = 0.5  # 1
# and if that error is more than this share of the extent of the person's image, about a third of the hips' width
MIN_SWAP_ERROR = 0.03  # 1
# The parts of the body whose sides detectors exchange, by their joints without the side.
SIDED_PARTS = (('shoulder', 'elbow', 'wrist'), ('hip', 'knee', 'ankle'))
SIDED_JOINTS = tuple(side + joint for side in 'lr' for part in SIDED_PARTS for joint in part)
MAX_CENTRE_DISTANCE = 1.0  # extents of a person's image; a detection whose centre is farther is another person's
MIN_DEPTH_M = 0.1  # m; nearer joints have no image point that could be drawn
MIN_PART_JOINTS = 2  # pairs of joints of a part that must be seen on both sides; one alone may be an outlier

STANDING_COLOUR = '#222222'  # of the disc under a foot that stands
STANDS = 0.5  # 1; probability from which a foot is drawn as one that stands
DROP_NAME, DROP_COLOUR = 'input dropped', '#d62728'  # of marks on the time line; red


class Mark(NamedTuple):
    """An input that was dropped: s from the beginning of the scene, and why."""

    time_s: float
    text: str


def project_joints(person: PoseSequence) -> Array32:
    """Return the joints of a person in the image, (F, J, 2) px; NaN behind or at the camera."""
    points = np.where(person.joints[..., 2:] > MIN_DEPTH_M, person.joints, np.nan)
    return person.intrinsics.project(points).astype(np.float32)


@dataclass(frozen=True, eq=False)
class SceneKeypoints:
    """All detections of one keypoint layout; several rows may be of one frame."""

    skeleton: Skeleton  # the layout
    frames: Indices  # (N,) index of the frame of each detection, not decreasing
    points: Array32  # (N, Jk, 2) px; NaN where a keypoint was not seen

    @staticmethod
    def merge(parts: Sequence[SceneKeypoints]) -> SceneKeypoints:
        """Return the detections of parts of one layout together."""
        frames = np.concatenate([part.frames for part in parts])
        order = np.argsort(frames, kind='stable')
        points = np.concatenate([part.points for part in parts])
        return SceneKeypoints(parts[0].skeleton, frames[order], points[order])


class SceneImages(NamedTuple):
    """Reduced images of the camera."""

    frames: Indices  # (N,) frames of the scene to which they belong, increasing
    jpegs: tuple[bytes, ...]  # (N,) their bytes as JPEG
    step: int  # how many images of the recording there are for each of them


@dataclass(frozen=True, eq=False)
class Scene:
    """All that is drawn of a recording."""

    title: str  # name of the recording
    stamps_ns: Sequence[int]  # (F,) ns, increasing times of the frames
    people: tuple[PoseSequence, ...]  # in the frames in which each has a skeleton
    keypoints: tuple[SceneKeypoints, ...]  # the 2D input, one entry a keypoint layout; empty where it is unknown
    image_size: tuple[int, int]  # (width, height) in px
    intrinsics: Intrinsics  # of the camera
    marks: tuple[Mark, ...] = ()  # in the order of their times
    truth: Array32 | None = None  # (F, J, 3) m, true joints of one person, NaN where unknown
    skeleton: Skeleton = CMU15
    # (3,) unit vector upwards in the camera's optical frame; NaN where it is not known
    vertical: Array = field(default_factory=lambda: np.full(3, np.nan))
    camera_height: float | None = None  # m, over the floor; None where it is not known
    images: SceneImages | None = None  # behind the points
    summary: str = ''  # what the people rest on, in words; empty where that is not known
    is_wrong: bool = False  # whether the input is wrong, as the summary says

    @cached_property
    def times(self) -> Array:
        """(F,) s from the first frame."""
        return (np.asarray(self.stamps_ns, np.int64) - self.stamps_ns[0]) / NS_PER_S

    def find_frames(self, person: PoseSequence) -> Indices:
        """Return the indices (N,) of the frames of a person."""
        return np.searchsorted(self.stamps_ns, person.stamps_ns)

    @cached_property
    def _coordinates(self) -> Array:
        # (K, 3) m, joints of all people in all frames, or one point before the camera where there are none
        joints = [person.joints.reshape(-1, 3) for person in self.people]
        known = [own[np.isfinite(own).all(axis=1)] for own in joints]
        return np.concatenate([*known, np.empty((0, 3))]) if any(map(len, known)) else np.array([[0.0, 0.0, 4.0]])

    @cached_property
    def centre(self) -> Array:
        """(3,) m, the middle of the space in which the people move."""
        return np.asarray(np.percentile(self._coordinates, EXTENT_PERCENTILES, axis=0).mean(axis=0))

    @cached_property
    def extent(self) -> float:
        """Largest side of the space in which the people move, m."""
        return float(np.ptp(np.percentile(self._coordinates, EXTENT_PERCENTILES, axis=0), axis=0).max())

    @cached_property
    def to_level(self) -> Array:
        """(3, 3) rotation from the camera's optical frame to that of a level camera at its position."""
        return rotation_to_level(self.vertical)

    @cached_property
    def floor_y(self) -> float:
        """Y in m, in the frame of the level camera, of the floor; where it is not known, of the lowest joints."""
        if self.camera_height is not None:
            return self.camera_height
        down = self.to_level[1].astype(np.float32)
        lowest = [np.fmax.reduce(person.joints @ down, axis=1) for person in self.people if len(person)]
        known = [own[np.isfinite(own)] for own in lowest]
        return (
            float(np.percentile(np.concatenate(known), 100 - LOWEST_PERCENTILE)) if any(map(len, known)) else 1.0
        )

    @cached_property
    def swapped(self) -> tuple[Mask, ...]:
        """(N,) for each person, True in the frames in which an exchange of left and right was undone."""
        detected = SidedPoints.find(self.keypoints)
        return tuple(
            find_undone_swaps(person, self.find_frames(person), detected, self.skeleton) for person in self.people
        )

    def to_plot_data(self) -> PlotData:
        """Return the person who is seen in most frames, with the own detections, for a picture."""
        person = max(self.people, key=len)
        frames, image = self.find_frames(person), project_joints(person)
        shape = len(self.stamps_ns), len(self.skeleton.joints)
        joints, seen, keypoints = np.full((*shape, 3), np.nan), np.zeros(shape, bool), None
        joints[frames], seen[frames] = person.joints, ~person.inferred
        projected = np.full((*shape, 2), np.nan)
        projected[frames] = image
        detected = max(self.keypoints, key=lambda k: len(k.frames), default=None)
        if detected is not None:
            near, _, distance, _ = find_near(person, frames, SidedPoints.find([detected]), self.skeleton)
            order = near[np.argsort(-distance, kind='stable')]  # the nearest comes last
            keypoints = np.full((len(self.stamps_ns), len(detected.skeleton.joints), 3), np.nan)
            keypoints[detected.frames[order], :, :2] = detected.points[order]
            keypoints[..., 2] = np.isfinite(keypoints[..., 0])
        truth = None if self.truth is None else self.truth.astype(np.float64)
        layout = CMU15 if detected is None else detected.skeleton
        shown = keypoints, layout, projected
        return PlotData(self.times, joints, seen, self.skeleton, truth, *shown, to_level=self.to_level)


def image_corners(image_size: tuple[int, int], intrinsics: Intrinsics) -> Array:
    """Return the corners (4, 3) of the image in the plane z = 1 of the optical frame, lens distortion ignored."""
    width, height = image_size
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]])
    return np.column_stack([(corners - intrinsics.center_array) / intrinsics.focal_lengths, np.ones(4)])


def choose_person_colour(scene: Scene, index: int) -> str:
    """Return the colour of a person in curves and names; a person alone is dark grey."""
    return MIDDLE_COLOUR if len(scene.people) == 1 else PERSON_COLOURS[index % len(PERSON_COLOURS)]


def choose_joint_colours(scene: Scene, index: int) -> list[str]:
    """Return the colour of each joint of a person: by side if the person is alone, else the person's own.

    The right side of the body is darker where the colours are those of people.
    """
    if len(scene.people) == 1:
        return [choose_side_colour(joint) for joint in scene.skeleton.joints]
    own = choose_person_colour(scene, index)
    dark = '#' + ''.join(f'{round(int(own[i : i + 2], 16) * RIGHT_SHADE):02x}' for i in (1, 3, 5))
    return [dark if joint.startswith('r') else own for joint in scene.skeleton.joints]


def list_colour_key(scene: Scene) -> list[tuple[str, str]]:
    """Return names and colours that the viewers explain besides those of inferred joints."""
    sides = [('left', choose_side_colour('l')), ('right', choose_side_colour('r'))]
    key = sides if len(scene.people) == 1 else [('darker: right side', MIDDLE_COLOUR)]
    if any((person.contact > STANDS).any() for person in scene.people):
        key = [*key, ('foot that stands', STANDING_COLOUR)]
    if any(person.predicted.any() or person.tentative.any() for person in scene.people):
        key = [*key, ('predicted or tentative', PALE_COLOUR)]
    return key if scene.truth is None else [*key, ('truth', TRUTH_COLOUR)]


class SidedPoints(NamedTuple):
    """The keypoints of N detections whose sides detectors exchange."""

    frames: Indices  # (N,) index of the frame of each detection
    points: Array32  # (N, 12, 2) px, those that are `SIDED_JOINTS`; NaN where not seen or not in the layout
    centre: Array32  # (N, 2) px, their mean; NaN where none was seen

    @staticmethod
    def find(keypoints: Sequence[SceneKeypoints]) -> SidedPoints:
        """Return these keypoints of all detections of some layouts."""
        parts = [np.empty((0, len(SIDED_JOINTS), 2), np.float32)]
        for detected in keypoints:
            names = canonical_joint_names(detected.skeleton.joints)
            parts.append(np.full((len(detected.points), len(SIDED_JOINTS), 2), np.nan, np.float32))
            for column, joint in enumerate(SIDED_JOINTS):
                if joint in names:
                    parts[-1][:, column] = detected.points[:, names.index(joint)]
        points = np.concatenate(parts)
        count = np.isfinite(points).sum(axis=1)
        centre = np.nansum(points, axis=1) / np.where(count > 0, count, np.nan)
        frames = np.concatenate([np.empty(0, np.intp), *(detected.frames for detected in keypoints)])
        return SidedPoints(frames, points, centre.astype(np.float32))


def find_undone_swaps(
    person: PoseSequence, frames: Indices, detected: SidedPoints, skeleton: Skeleton = CMU15
) -> Mask:
    """Find the frames in which the result has left and right of a part of the body otherwise than the detector.

    e = mean |x_j - y_j| and e' = mean |x_m(j) - y_j| over the joints j of a part that are seen on both sides, with
    x the detector's keypoints, y the result in the image and m(j) the same joint of the other side. A swap was
    undone if e' < `MAX_EXCHANGED_ERROR` e and e > `MIN_SWAP_ERROR` times the extent of the person's image. Of
    several detections in a frame, the one that fits the person best counts; those elsewhere are passed over.
    Returns (N,) True in these of the person's N frames.
    """
    swapped = np.zeros(len(person), bool)
    if not len(person):
        return swapped
    near, rows, _, image = find_near(person, frames, detected, skeleton)
    cost, is_undone = _compare_sides(detected.points[near], image[rows])
    order = np.lexsort((cost, rows))
    found, best = np.unique(rows[order], return_index=True)
    swapped[found] = is_undone[order[best]]
    return swapped


def find_near(
    person: PoseSequence, frames: Indices, detected: SidedPoints, skeleton: Skeleton
) -> tuple[Indices, Indices, Array32, Array32]:
    """Find the detections where a person of N > 0 `frames` of the scene is, where the person was detected.

    Returns their indices (K,), the rows (K,) of the person's frames in which they are, the distances (K,) px of
    the centres, and the person's `SIDED_JOINTS` in the image (N, 12, 2) px.
    """
    image = project_joints(person)[:, [skeleton.index(joint) for joint in SIDED_JOINTS]]
    rows = np.searchsorted(frames, detected.frames).clip(max=len(frames) - 1)
    is_detected = (frames[rows] == detected.frames) & ~person.predicted[rows]
    distance = np.linalg.norm(detected.centre - image.mean(axis=1)[rows], axis=1)
    near = np.flatnonzero(is_detected & (distance < MAX_CENTRE_DISTANCE * _measure_extent(image)[rows]))
    return near, rows[near], distance[near], image


def _measure_extent(image: Array32) -> Array32:
    return np.maximum(np.ptp(image, axis=1).max(axis=1), 1.0)


def _compare_sides(points: Array32, image: Array32) -> tuple[Array32, Mask]:
    """Compare detected `SIDED_JOINTS` (N, 12, 2) with a person's, as they are and with left and right exchanged.

    Returns sums (N,) of the smaller errors of the parts in extents (N,) of the image, and where a swap was undone.
    """
    extent, mirror = _measure_extent(image), np.roll(np.arange(len(SIDED_JOINTS)), len(SIDED_JOINTS) // 2)
    both = np.isfinite(points[..., 0])
    both &= both[:, mirror]
    error, exchanged = (
        np.where(both, np.hypot(*np.moveaxis(own - image, 2, 0)), 0) for own in (points, points[:, mirror])
    )
    cost, verdict = np.zeros(len(points), np.float32), np.zeros(len(points), bool)
    for part in SIDED_PARTS:
        columns = [column for column, joint in enumerate(SIDED_JOINTS) if joint[1:] in part]
        count = both[:, columns].sum(axis=1)
        as_is, other = (e[:, columns].sum(axis=1) / np.maximum(count, 1) for e in (error, exchanged))
        is_exchanged = (other < MAX_EXCHANGED_ERROR * as_is) & (as_is > MIN_SWAP_ERROR * extent)
        verdict |= is_exchanged & (count >= 2 * MIN_PART_JOINTS)
        cost += np.minimum(as_is, other) / extent
    return cost, verdict
