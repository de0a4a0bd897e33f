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
from typing import NamedTuple

import numpy as np

from mocap_ros.arrays import Array, Mask
from mocap_ros.bags.journal import Acceptance
from mocap_ros.config import Config
from mocap_ros.findings import SOUND, Fault, Finding, Grade, find_worst
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.level import MAX_CERTAIN_STD
from mocap_ros.keypoints.joint_map import build_joint_map
from mocap_ros.keypoints.person import Person2D
from mocap_ros.keypoints.validation import PointPlaces
from mocap_ros.people import People, PoseSequence, TrackedFrame
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.vertical import read_given_vertical
from mocap_ros.summary import Summary
from mocap_ros.units import NS_PER_S
from mocap_ros.verdict.input_faults import DepthCheck
from mocap_ros.verdict.plausibility import (
    LOOK_S,
    MAX_STRETCHES,
    MIN_SEEN_JOINTS,
    NOT_JUDGED,
    STRETCH_S,
    Reading,
    Stretch,
    Walk,
    average,
    cut_stretches,
    hide_unsure,
    judge,
    judge_size,
    list_readings,
    make_stretch,
    measure_all,
    measure_uncertainty,
)
from mocap_ros.verdict.seen_joints import SeenJoints

MAX_JUDGED_PEOPLE = 3  # of a recording; those who come first in the input
MAX_STEP = 0.5  # of the person's size in the image; of a person from one image to the next
MAX_IDS = 10_000  # people; live, one who comes back after so many others counts anew
PLACES_MEMORY_S = 20.0  # s; live, about so long the places of people count, unless none is seen for `MEMORY_S`
MEMORY_S = 5.0  # s; live, the residual is averaged over about this time, and after it points are judged anew
MAX_REFUSED = 0.1  # 1, share of the messages of people; of more, the input is doubtful
MAX_REFUSED_IN_TURN = 30  # messages, a second at 30 Hz; as many that no accepted one has followed yet, likewise


class Fit(NamedTuple):
    """How well people fit their points, as a mean or of one of them."""

    residual_px: float  # px, RMS reprojection error
    residual_share: float  # 1, the same over the height of the body in the image
    distance_m: float  # m, along the optical axis


class CameraBasis(NamedTuple):
    """What is known of the camera."""

    focal_px: float
    focal_source: str  # as in `Summary`
    vertical_std: float  # rad; NaN where no vertical is known
    is_vertical_given: bool

    def describe_vertical(self) -> str:
        """Return how the vertical is known, as in `Summary`."""
        if self.is_vertical_given:
            return 'given'
        if not math.isfinite(self.vertical_std):
            return 'none'
        return 'found' if self.vertical_std <= MAX_CERTAIN_STD else 'uncertain'


NO_CAMERA = CameraBasis(math.nan, '', math.nan, is_vertical_given=False)


class Basis:
    """What people rest on, over the images or the whole sequences that were added so far."""

    def __init__(self) -> None:
        self.people = self.frames = 0
        self.seen_joints = SeenJoints()
        self.camera = NO_CAMERA
        self._fits, self._weight = np.zeros(3), 0.0

    def add_fit(self, fit: Fit, weight: float = 1.0) -> None:
        """Add how well people fit in images, as many as the weight."""
        self._fits += weight * np.array(fit)
        self._weight += weight

    @property
    def fit(self) -> Fit:
        """The mean over all images; NaN without any."""
        return Fit(*(self._fits / (self._weight or math.nan)).tolist())

    def summarise(self, *findings: Finding) -> Summary:
        """Return the summary, with what was found in the input."""
        faults, fit = [finding for finding in findings if finding.words], self.fit
        worst = find_worst(*faults) if faults else SOUND
        return Summary(
            people=self.people,
            frames=self.frames,
            seen=self.seen_joints.share,
            residual_px=fit.residual_px,
            residual_share=fit.residual_share,
            distance_m=fit.distance_m,
            focal_px=self.camera.focal_px,
            focal_source=self.camera.focal_source,
            vertical=self.camera.describe_vertical(),
            vertical_std_deg=math.degrees(self.camera.vertical_std),
            grade='not judged' if worst.fault is Fault.UNKNOWN else worst.grade.word,
            reason='; '.join(finding.words for finding in faults),
            unseen=self.seen_joints.name_unseen(),
        )


def summarise(people: Sequence[PoseSequence], config: Config) -> Summary:
    """Summarise the reconstruction of all people of a recording, with their keypoints."""
    sequences = [person.sequence for person in people if person.sequence is not None]
    given, walk, places, basis = read_given_vertical(config.tracker), Walk(), PointPlaces(), Basis()
    measured: list[dict[Reading, float]] = []
    depths, is_depth_unused = DepthCheck(), False
    vertical_stds: list[float] = []
    for number, (sequence, person) in enumerate(zip(sequences, people, strict=True)):
        distance_m = float(np.nanmedian(person.joints[..., 2]))
        residual_px = float(np.nanmean(person.reprojection_residual))
        share = residual_px * distance_m / person.intrinsics.focal / person.body_height
        basis.add_fit(Fit(residual_px, share, distance_m), len(sequence))
        std = person.vertical_std[np.isfinite(person.vertical_std)]
        vertical_stds.append(float(np.median(std)) if len(std) else math.nan)
        keypoints = hide_unsure(sequence.keypoints, config.tracker.min_score)
        basis.seen_joints.add(sequence.joint_names, keypoints[..., 2] > 0)
        places.add(keypoints[..., :2], keypoints[..., 2], sequence.image_size)
        for stamp_ns, joints in zip(sequence.stamps_ns, person.joints, strict=True):
            walk.add(str(number), stamp_ns, joints)
        if sequence.depth is not None:
            for depth, distance in zip(sequence.depth, person.joints[..., 2].mean(axis=1).tolist(), strict=True):
                depths.add(depth, distance)
            is_depth_unused |= not person.intrinsics.is_focal_known
        if len(measured) < MAX_JUDGED_PEOPLE * MAX_STRETCHES:
            stretches = cut_stretches(
                keypoints,
                sequence.joint_names,
                sequence.timestamps,
                person.intrinsics,
                given.direction if given else None,
            )
            measured += map(measure_all, stretches)
    sequence, intrinsics = sequences[0], people[0].intrinsics
    is_known, (width, height) = intrinsics.is_focal_known, sequence.image_size
    basis.people, basis.frames = len(sequences), len(set().union(*(s.stamps_ns for s in sequences)))
    source = sequence.focal_source or ('known' if is_known else 'nominal')
    vertical_std = float(np.average(vertical_stds, weights=[len(s) for s in sequences]))
    basis.camera = CameraBasis(intrinsics.focal, source, vertical_std, given is not None)
    size = judge_size(places)
    if sequence.is_size_assumed and not is_known and size.grade is Grade.GOOD:
        size = Fault.SIZE_ASSUMED.found(width=width, height=height)
    share = basis.fit.residual_share
    return basis.summarise(
        judge(average(measured), share, sequence.joint_names, size, is_backwards=walk.is_backwards),
        Fault.DEPTH_UNUSED.found(Grade.GOOD) if is_depth_unused else depths.judge(),
    )


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

    def measure_change(person: Person2D) -> float:
        steps = _find_steps(last, person)
        return _measure_length(steps - steps.mean(axis=0)) if len(steps) else math.inf

    return min(ordered, own, key=measure_change)


def _find_steps(last: Person2D, person: Person2D) -> Array:
    """Return the steps (K, 2) px from the points of a person to those of another that both have, by column."""
    return (person.points - last.points)[(last.score > 0) & (person.score > 0)]


def _measure_length(steps: Array) -> float:
    """Return the median length of steps (K, 2); infinite if there are none."""
    return float(np.median(np.linalg.norm(steps, axis=1))) if len(steps) else math.inf


def find_same_person(last: Person2D, detections: Sequence[Person2D]) -> Person2D | None:
    """Return the detection whose points are nearest to those of a person in the image before; None if far."""
    alike = [person for person in detections if person.joints == last.joints]
    nearest = min(alike, key=lambda person: _measure_length(_find_steps(last, person)), default=None)
    farthest = MAX_STEP * float(np.ptp(last.points[last.score > 0], axis=0).max())
    return nearest if nearest and _measure_length(_find_steps(last, nearest)) < farthest else None


class RunSummary:
    """Summary of the images of one camera so far; `finding` is what is wrong with the points of its last part.

    Every few seconds the points of one person are collected for a stretch of `plausibility`. One of its
    readings is measured at each call of `advance_judgement`, so that no image waits for all of them.
    """

    def __init__(self) -> None:
        self.rate = SOUND  # whether the stamps of some images can be those of no camera
        self.finding = self._worst = NOT_JUDGED  # of the points, as of the last image; of the parts before
        self._basis = Basis()
        self._ids: dict[str, None] = {}  # of the last `MAX_IDS` people
        self._last_ns = 0
        self._last: Person2D | None = None  # who was followed last
        self._messages = self._refused = self._refused_in_turn = 0
        self.restart()

    def restart(self) -> None:
        """Begin a part of the run, which is judged anew; of all parts the worst counts."""
        self._worst, self.finding = find_worst(self.finding, self._worst), NOT_JUDGED
        self._residual_share = math.nan  # averaged over `MEMORY_S`
        self._places, self._walk, self._size = PointPlaces(), Walk(), SOUND
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
        tracked: TrackedFrame,
        intrinsics: Intrinsics,
        focal_source: str,
        config: Config,
    ) -> None:
        """Add an image: what the detector saw, and the people who were reconstructed up to it."""
        basis, min_score, vertical = self._basis, config.tracker.min_score, tracked.vertical
        basis.frames += 1
        std, is_given = (vertical.std, vertical.is_given) if vertical else (math.nan, False)
        basis.camera = CameraBasis(intrinsics.focal, focal_source, std, is_given)
        if stamp_ns < self._last_ns:  # a clock that was set, or a bag that begins again
            self.restart()
        certain = tracked.people.certain
        for name in (person_id for person_id in certain.ids if person_id not in self._ids):
            basis.people += 1
            self._ids[name] = None
            if len(self._ids) > MAX_IDS:
                del self._ids[next(iter(self._ids))]
        is_due = not 0 <= stamp_ns - self._looked_ns < LOOK_S * NS_PER_S
        if is_due and detections and (size := intrinsics.image_size) is not None:
            points, score = (np.concatenate([getattr(d, k) for d in detections]) for k in ('points', 'score'))
            self._look(stamp_ns, points, score, size, certain)
        is_fitted = ~certain.predicted & np.isfinite(certain.reprojection_residual)
        if is_fitted.any():
            for detection in detections:
                basis.seen_joints.add(detection.joints, detection.score[None] >= min_score)
            fit = _measure_fit(certain, is_fitted)
            basis.add_fit(fit)
            before = self._residual_share if math.isfinite(self._residual_share) else fit.residual_share
            fresh = 1 - math.exp(-min(max(stamp_ns - self._last_ns, 0) / NS_PER_S, 1.0) / MEMORY_S)
            self._residual_share = before + fresh * (fit.residual_share - before)
        self._last_ns = stamp_ns
        # One that was found rests on these points: for it, a y axis upwards is a camera that is upside down.
        given = vertical.direction if vertical and vertical.is_given else None
        self._follow(stamp_ns, detections, intrinsics, given, min_score)

    def count(self, acceptance: Acceptance) -> None:
        """Count a message of people; those skipped for a backlog say nothing about the input."""
        if acceptance is not Acceptance.BACKLOG:
            is_refused = acceptance is not Acceptance.ACCEPTED
            self._messages += 1
            self._refused += is_refused
            self._refused_in_turn = self._refused_in_turn + 1 if is_refused else 0

    def _look(self, stamp_ns: int, points: Array, score: Array, size: tuple[int, int], people: People) -> None:
        """Look at where the points (N, 2) px of all people are, and where one of the people walks."""
        step_s = (stamp_ns - self._looked_ns) / NS_PER_S
        kept = math.exp(-step_s / PLACES_MEMORY_S) if 0 <= step_s < MEMORY_S else 0.0
        self._places.add(points, score, size, kept)
        self._size = judge_size(self._places)
        self._looked_ns = stamp_ns
        if len(people):
            row = people.ids.index(self._walk.person) if self._walk.person in people.ids else 0
            self._walk.add(people.ids[row], stamp_ns, people.joints[row])

    def _follow(
        self,
        stamp_ns: int,
        detections: Sequence[Person2D],
        intrinsics: Intrinsics,
        vertical: Array | None,
        min_score: float,
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
        keypoints = np.array([np.column_stack([p.points, p.score]) for _, p in self._followed])
        times = np.array([(ns - start_ns) / NS_PER_S for ns, _ in self._followed])
        stretch = make_stretch(hide_unsure(keypoints, min_score), person.joints, times, intrinsics, vertical)
        self._followed, self._rest_ns = [], stamp_ns + round(MEMORY_S * NS_PER_S)
        self._is_sparse = stretch is None
        if stretch is not None:
            self._measured = {}
            self._readings = [(stretch, reading) for reading in list_readings(stretch)]

    def advance_judgement(self) -> None:
        """Measure a reading of the points that were collected, if there are any, and judge after the last."""
        if self._readings:
            stretch, reading = self._readings.pop()
            self._measured[reading] = measure_uncertainty(stretch, reading)
            if not self._readings:
                self._parts.append(self._measured)
                self._uncertainty = average(self._parts)
        is_known = self._is_sparse or bool(self._uncertainty)  # a new fit of moving people is still bad
        self.finding = judge(
            self._uncertainty,
            self._residual_share if is_known else math.nan,
            self._last.joints if self._last else (),
            self._size if is_known else SOUND,
            is_backwards=self._walk.is_backwards,
        )

    def summarise(self) -> Summary:
        """Return the summary of all images and messages so far."""
        return self._basis.summarise(self.rate, self._judge_refusals(), find_worst(self.finding, self._worst))

    def _judge_refusals(self) -> Finding:
        """Return whether the input is doubtful for the messages that were refused."""
        if MAX_REFUSED_IN_TURN < self._refused_in_turn < self._messages:
            return Fault.REFUSED_LAST.found(refused=self._refused_in_turn)
        if self._refused <= MAX_REFUSED * self._messages:
            return SOUND
        grade = Grade.WRONG if self._refused == self._messages else Grade.DOUBTFUL
        return Fault.REFUSED.found(grade, refused=self._refused, messages=self._messages)


def _measure_fit(people: People, is_fitted: Mask) -> Fit:
    """Return the mean fit of some people in an image; where they are is where their first joint is."""
    heights = CMU15.bone_lengths(people.core[is_fitted]) @ CMU15.stature_per_bone
    residuals, depths = people.reprojection_residual[is_fitted], people.joints[is_fitted, 0, 2]
    shares = residuals / people.scale[is_fitted] / heights
    return Fit(float(residuals.mean()), float(shares.mean()), float(depths.mean()))
