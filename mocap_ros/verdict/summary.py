# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What a reconstruction rests on, in numbers and one line: who was seen, the fit, the focal length, the vertical.

`summarise` makes it of whole recordings and `RunSummary` of images that follow one another; `plausibility`
judges both.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.bags.journal import Acceptance
from mocap_ros.config import Config
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.level import MAX_CERTAIN_STD
from mocap_ros.keypoints.joint_map import build_joint_map
from mocap_ros.keypoints.person import Person2D
from mocap_ros.keypoints.validation import MAX_SHARE_OUTSIDE, PointPlaces
from mocap_ros.messages.skeletons import RecordedPerson
from mocap_ros.models.model_file import load_shipped_lifter
from mocap_ros.people import CameraVertical, Person3D, PoseSequence
from mocap_ros.skeleton import CMU15, CORE_COUNT, skeleton_from_joints
from mocap_ros.solvers.vertical import read_given_vertical
from mocap_ros.summary import Summary
from mocap_ros.units import NS_PER_S
from mocap_ros.verdict.plausibility import (
    LOOK_S,
    MAX_STRETCHES,
    MIN_FRAMES,
    MIN_SEEN_JOINTS,
    STRETCH_S,
    Fault,
    Grade,
    Judgement,
    Reading,
    Stretch,
    Walk,
    average,
    cut_stretches,
    judge,
    list_readings,
    make_stretch,
    measure_uncertainty,
)

NOT_JUDGED = Judgement(Grade.GOOD, Fault.UNKNOWN)
MAX_JUDGED_PEOPLE = 3  # of a recording; those who come first in the input
MAX_STEP = 0.5  # of the person's size in the image; of a person from one image to the next
MAX_IDS = 10_000  # people; live, one who comes back after so many others counts anew
PLACES_MEMORY_S = 20.0  # s; live, about so long the places of people count, unless none is seen for `MEMORY_S`
MEMORY_S = 5.0  # s; live, the residual is averaged over about this time, and after it points are judged anew
MAX_REFUSED = 0.1  # 1, share of the messages of people; of more, the input is doubtful
MAX_REFUSED_IN_TURN = 30  # messages, a second at 30 Hz; as many that no accepted one has followed yet, likewise

AnyPerson3D = Person3D | RecordedPerson

# What to say of a fault; `{given}` is the layout of the points.
WORDS = {
    Fault.LAYOUT: 'these look like {layout}, not {given}: give layout {layout}, or its joint names',
    Fault.MISFIT: 'the points do not fit people with {given}: the joints may be in another order than their '
    'names, or the detector sees something else',
    Fault.UNKNOWN: f'no {STRETCH_S:g} s have {MIN_FRAMES} images that show {MIN_SEEN_JOINTS} joints',
    Fault.AXES: 'x and y look exchanged',
    Fault.Y_UP: 'y looks as if it pointed upwards: expected is y = 0 at the top of the image',
    Fault.MIRRORED: 'left and right look exchanged in the names of the joints',
    Fault.TURNED: 'people lie or are upside down in the image: x and y may be exchanged, or y points upwards; '
    'if the camera is turned, give tracker.vertical',
}  # fmt: skip


def describe_grade(judgement: Judgement) -> str:
    """Return the grade in words."""
    return 'not judged' if judgement.fault is Fault.UNKNOWN else judgement.grade.name.lower()


def judge_size(places: PointPlaces) -> tuple[Grade, str]:
    """Return whether points lie where they do in an image of that size, and why not, in words."""
    fault = places.describe_fault()
    if not fault:
        return Grade.GOOD, ''
    advice = 'check that the detector sees images of that size, and gives points in px from the upper left corner'
    grade = Grade.WRONG if places.share_outside > MAX_SHARE_OUTSIDE else Grade.DOUBTFUL
    return grade, f'{fault}; {advice}'


def describe_fault(judgement: Judgement, names: Sequence[str], size_fault: str) -> str:
    """Return why points of these joints are not sound, in words; `size_fault` is that of `judge_size`."""
    if judgement.fault is Fault.SIZE:
        return size_fault
    given = skeleton_from_joints(tuple(names)).name or 'the given joints'
    return WORDS.get(judgement.fault, '').format(layout=judgement.layout, given=given)


def summarise(people: Sequence[PoseSequence], config: Config) -> Summary:
    """Summarise the reconstruction of all people of a recording, with their keypoints."""
    sequences = [person.sequence for person in people if person.sequence is not None]
    tracker, lifter = config.tracker, load_shipped_lifter()
    given, walk, places = read_given_vertical(tracker), Walk(), PointPlaces()
    vertical = None if given is None else given.direction
    measured: list[dict[Reading, float]] = []
    rows, seen = [], []
    for sequence, person in zip(sequences, people, strict=True):
        intrinsics = person.intrinsics
        depth = float(np.nanmedian(person.joints[..., 2]))
        residual = float(np.nanmean(person.reprojection_residual))
        share = residual * depth / intrinsics.focal / person.body_height
        std = person.vertical_std[np.isfinite(person.vertical_std)]
        rows.append((residual, share, depth, float(np.median(std)) if len(std) else math.nan))
        score = np.where(sequence.keypoints[..., 2] >= tracker.min_score, sequence.keypoints[..., 2], 0.0)
        keypoints = np.concatenate([sequence.keypoints[..., :2], score[..., None]], axis=-1)
        seen.append(float((score > 0)[(score > 0).any(axis=1)].mean()))
        places.add(keypoints[..., :2], score, sequence.image_size)
        for stamp_ns, joints in zip(sequence.stamps_ns, person.joints, strict=True):
            walk.add(str(len(rows)), stamp_ns, joints)
        if len(measured) < MAX_JUDGED_PEOPLE * MAX_STRETCHES:
            points = keypoints, sequence.joint_names, sequence.timestamps
            for stretch in cut_stretches(*points, intrinsics, vertical):
                readings = list_readings(stretch)
                measured.append({r: measure_uncertainty(stretch, r, lifter, tracker.min_score) for r in readings})
    counts = [len(sequence) for sequence in sequences]
    residual, share, depth, std = np.average(rows, axis=0, weights=counts).tolist()
    size, size_fault = judge_size(places)
    sequence, intrinsics = sequences[0], people[0].intrinsics
    is_known, (width, height) = intrinsics.is_focal_known, sequence.image_size
    if sequence.is_size_assumed and not is_known and size is Grade.GOOD:
        size, size_fault = Grade.DOUBTFUL, f'the image size of {width}x{height} px is assumed'
    judgement = judge(average(measured), share, size, is_backwards=walk.is_backwards)
    return Summary(
        people=len(sequences),
        frames=len(set().union(*(s.stamps_ns for s in sequences))),
        seen=float(np.mean(seen)),
        residual_px=residual,
        residual_share=share,
        distance_m=depth,
        focal_px=intrinsics.focal,
        focal_source=sequence.focal_source or ('known' if is_known else 'nominal'),
        vertical=describe_vertical(std, is_given=given is not None),
        vertical_std_deg=math.degrees(std),
        grade=describe_grade(judgement),
        reason=describe_fault(judgement, sequence.joint_names, size_fault),
    )


def describe_vertical(std: float, *, is_given: bool) -> str:
    """Return how the vertical is known, by its standard deviation in rad, which is NaN where nothing is known."""
    if is_given:
        return 'given'
    if not math.isfinite(std):
        return 'none'
    return 'found' if std <= MAX_CERTAIN_STD else 'uncertain'


def name_alike(person: Person2D, last: Person2D | None) -> Person2D:
    """Return a person with canonical names, in the order of those of the last where they mean the same joints.

    Where wrong names were put right, the points in the given order still have the shape of the last.
    """
    joints = build_joint_map(person.joints).source
    own = Person2D(person.id, joints, person.points, person.score)
    if last is None or joints == last.joints or set(joints) != set(last.joints):
        return own
    order = [joints.index(name) for name in last.joints]
    ordered = Person2D(person.id, last.joints, person.points[order], person.score[order])
    return min(ordered, own, key=lambda p: _measure_change(last, p))


def _measure_change(last: Person2D, person: Person2D) -> float:
    """Return the median distance in px of the points of two people, column by column, about their middles."""
    moved = (person.points - last.points)[(last.score > 0) & (person.score > 0)]
    return float(np.median(np.linalg.norm(moved - moved.mean(axis=0), axis=1))) if len(moved) else math.inf


def find_same_person(last: Person2D, detections: Sequence[Person2D]) -> Person2D | None:
    """Return the detection whose points are nearest to those of a person in the image before; None if far."""
    size = float(np.ptp(last.points[last.score > 0], axis=0).max())
    nearest: tuple[Person2D | None, float] = None, MAX_STEP * size
    for person in detections:
        shared = (last.score > 0) & (person.score > 0) if person.joints == last.joints else np.zeros(0, bool)
        if shared.any():
            distance = float(np.median(np.linalg.norm((person.points - last.points)[shared], axis=1)))
            nearest = min(nearest, (person, distance), key=lambda found: found[1])
    return nearest[0]


class RunSummary:
    """Summary of the images of one camera so far; `judgement` is that of its last part, as of the last image.

    Every few seconds the points of one person are collected for a stretch of `plausibility`. One of its
    readings is measured at each call of `advance_judgement`, so that no image waits for all of them.
    """

    def __init__(self) -> None:
        self.judgement, self._worst = NOT_JUDGED, (NOT_JUDGED, '')  # as of the last image; of the parts before
        self._ids: dict[str, None] = {}  # of the last `MAX_IDS` people
        self._people = self._frames = self._counted = 0
        self._sums = np.zeros(4)  # over people seen: share of points, residual in px, its share, distance
        self._size_fault = ''
        self._last_ns = 0
        self._focal, self._focal_source = math.nan, ''
        self._vertical: CameraVertical | None = None
        self._last: Person2D | None = None  # who was followed last
        self._messages = self._refused = self._refused_in_turn = 0
        self.rate_fault = ''  # why the stamps of some images can be those of no camera
        self.restart()

    def restart(self) -> None:
        """Begin a part of the run, which is judged anew; of all parts the worst counts."""
        self._worst, self.judgement = self._find_worst(), NOT_JUDGED
        self._residual_share = math.nan  # averaged over `MEMORY_S`
        self._places, self._walk = PointPlaces(), Walk()
        self._size_grade, self._size_fault = Grade.GOOD, ''
        self._looked_ns = 0  # stamp of the image in which places and the walk were last looked at
        self._followed: list[tuple[int, Person2D]] = []  # one person's points, by stamp in ns
        self._rest_ns = 0  # stamp from which on the next stretch begins
        self._measured: dict[Reading, float] = {}
        self._uncertainty: dict[Reading, float] = {}  # means over `_parts`
        self._readings: list[tuple[Stretch, Reading]] = []  # still to be measured
        self._is_sparse = False  # whether the last stretch had too few images to be measured
        self._parts: deque[dict[Reading, float]] = deque(maxlen=MAX_STRETCHES)

    def add(
        self,
        stamp_ns: int,
        detections: Sequence[Person2D],
        people: Sequence[AnyPerson3D],
        intrinsics: Intrinsics,
        focal_source: str,
        vertical: CameraVertical | None,
        config: Config,
    ) -> None:
        """Add an image: what the detector saw, and the people who were reconstructed up to it."""
        self._frames += 1
        self._focal, self._focal_source, self._vertical = intrinsics.focal, focal_source, vertical
        if stamp_ns < self._last_ns:  # a clock that was set, or a bag that begins again
            self.restart()
        seen = [p for p in people if not p.tentative]
        for name in (p.id for p in seen if p.id not in self._ids):
            self._people += 1
            self._ids[name] = None
            if len(self._ids) > MAX_IDS:
                del self._ids[next(iter(self._ids))]
        fitted = [p for p in seen if not p.predicted and math.isfinite(p.residual)]
        fresh = 1 - math.exp(-min(max(stamp_ns - self._last_ns, 0) / NS_PER_S, 1.0) / MEMORY_S)
        is_due = not 0 <= stamp_ns - self._looked_ns < LOOK_S * NS_PER_S
        if is_due and detections and (size := intrinsics.image_size) is not None:
            points, score = (np.concatenate([getattr(d, k) for d in detections]) for k in ('points', 'score'))
            self._look(stamp_ns, points, score, size, seen)
        if fitted:
            cores = np.array([p.joints[:CORE_COUNT] for p in fitted])
            heights = CMU15.bone_lengths(cores) @ CMU15.stature_per_bone
            sizes = zip(fitted, heights.tolist(), strict=True)
            fits = [(p.residual, p.residual / p.scale / height, p.joints[0, 2]) for p, height in sizes]
            share = sum((d.score >= config.tracker.min_score).mean() for d in detections) / max(len(detections), 1)
            mean = np.array([share, *np.mean(fits, axis=0)])
            self._sums += mean
            self._counted += 1
            before = self._residual_share if math.isfinite(self._residual_share) else mean[2]
            self._residual_share = before + fresh * (mean[2] - before)
        self._last_ns = stamp_ns
        self._follow(stamp_ns, detections, intrinsics, config)

    def count(self, acceptance: Acceptance) -> None:
        """Count a message of people; those skipped for a backlog say nothing about the input."""
        if acceptance is not Acceptance.BACKLOG:
            is_refused = acceptance is not Acceptance.ACCEPTED
            self._messages += 1
            self._refused += is_refused
            self._refused_in_turn = self._refused_in_turn + 1 if is_refused else 0

    def _look(
        self, stamp_ns: int, points: Array, score: Array, size: tuple[int, int], people: Sequence[AnyPerson3D]
    ) -> None:
        """Look at where the points (N, 2) px of all people are, and where one of the people walks."""
        step_s = (stamp_ns - self._looked_ns) / NS_PER_S
        kept = math.exp(-step_s / PLACES_MEMORY_S) if 0 <= step_s < MEMORY_S else 0.0
        self._places.add(points, score, size, kept)
        self._size_grade, self._size_fault = judge_size(self._places)
        self._looked_ns = stamp_ns
        if people:
            walker = next((p for p in people if p.id == self._walk.person), people[0])
            self._walk.add(walker.id, stamp_ns, walker.joints)

    def _follow(
        self, stamp_ns: int, detections: Sequence[Person2D], intrinsics: Intrinsics, config: Config
    ) -> None:
        """Collect the points of one person, and begin to measure them when there are enough."""
        if self._readings or stamp_ns < self._rest_ns:
            return
        detections = [name_alike(d, self._last) for d in detections if (d.score > 0).sum() >= MIN_SEEN_JOINTS]
        if self._followed:
            last_ns, last = self._followed[-1]
            if not 0 < stamp_ns - last_ns < STRETCH_S * NS_PER_S:
                self._followed = []
                return
            person = find_same_person(last, detections)
        else:
            person = max(detections, key=lambda d: int((d.score > 0).sum()), default=None)
        if person is None:
            return
        self._followed.append((stamp_ns, person))
        if self._last is None or person.joints != self._last.joints:
            self.restart()
            self._followed = [(stamp_ns, person)]
        self._last = person
        start_ns = self._followed[0][0]
        if stamp_ns - start_ns < STRETCH_S * NS_PER_S:
            return
        score = np.array([p.score for _, p in self._followed])
        score[score < config.tracker.min_score] = 0.0
        keypoints = np.concatenate([[p.points for _, p in self._followed], score[..., None]], axis=-1)
        times = np.array([(ns - start_ns) / NS_PER_S for ns, _ in self._followed])
        # One that was found rests on these points: for it, a y axis upwards is a camera that is upside down.
        given = self._vertical.direction if self._vertical and self._vertical.is_given else None
        stretch = make_stretch(keypoints, person.joints, times, intrinsics, given)
        self._followed, self._rest_ns = [], stamp_ns + round(MEMORY_S * NS_PER_S)
        self._is_sparse = stretch is None
        if stretch is not None:
            self._measured = {}
            self._readings = [(stretch, reading) for reading in list_readings(stretch)]

    def advance_judgement(self, config: Config) -> None:
        """Measure a reading of the points that were collected, if there are any, and judge after the last."""
        if self._readings:
            stretch, reading = self._readings.pop()
            u = measure_uncertainty(stretch, reading, load_shipped_lifter(), config.tracker.min_score)
            self._measured[reading] = u
            if not self._readings:
                self._parts.append(self._measured)
                self._uncertainty = average(self._parts)
        is_known = self._is_sparse or bool(self._uncertainty)  # a new fit of moving people is still bad
        residual_share = self._residual_share if is_known else math.nan
        size, is_backwards = self._size_grade if is_known else Grade.GOOD, self._walk.is_backwards
        self.judgement = judge(self._uncertainty, residual_share, size, is_backwards=is_backwards)

    @property
    def reason(self) -> str:
        """Why the input is not sound, in words; empty if it is, or was not judged yet."""
        is_sound = self.judgement.grade is Grade.GOOD
        return '' if is_sound else self._describe_fault()

    def _describe_fault(self) -> str:
        names = self._last.joints if self._last else ()
        return describe_fault(self.judgement, names, self._size_fault)

    def _find_worst(self) -> tuple[Judgement, str]:
        """Return the worst judgement of all parts, and why it is not good, in words."""
        newest = self.judgement, self._describe_fault()
        return max(newest, self._worst, key=lambda found: (found[0].grade, found[0].fault is not Fault.UNKNOWN))

    def summarise(self) -> Summary:
        """Return the summary of all images and messages so far."""
        judgement, *faults = self._find_worst()
        grade = describe_grade(judgement)
        if reasons := [*filter(None, (self.rate_fault, self._describe_refusals()))]:
            least = Grade.WRONG if self._refused == self._messages else Grade.DOUBTFUL
            grade, faults = max(judgement.grade, least).name.lower(), [*reasons, *faults]
        seen, residual, share, depth = (self._sums / (self._counted or math.nan)).tolist()
        vertical, std = self._vertical, self._vertical.std if self._vertical else math.nan
        return Summary(
            people=self._people,
            frames=self._frames,
            seen=seen,
            residual_px=residual,
            residual_share=share,
            distance_m=depth,
            focal_px=self._focal,
            focal_source=self._focal_source,
            vertical=describe_vertical(std, is_given=vertical is not None and vertical.is_given),
            vertical_std_deg=math.degrees(std),
            grade=grade,
            reason='; '.join(filter(None, faults)),
        )

    def _describe_refusals(self) -> str:
        """Return how many messages were refused, if the input is doubtful for it; else an empty text."""
        if MAX_REFUSED_IN_TURN < self._refused_in_turn < self._messages:
            return f'the last {self._refused_in_turn} messages were refused'
        is_much = self._refused > MAX_REFUSED * self._messages
        return f'{self._refused} of {self._messages} messages were refused' if is_much else ''
