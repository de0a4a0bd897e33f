# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Which tracked person each detection of a frame is, and which detections are but parts of a person.

The steps, each for the people and detections that are left by those before:

1. A detection with a person's id that is near where the person is expected is this person: a detector that gives
   good ids decides who is who, also where people cross.
2. So is one that is farther away, unless it is part of a person who was found in the first step, or lies where
   another person is and both had their ids in their newest frames: no two people exchange their places from one
   frame to the next, but ids do, above all those that count the people of an image.
3. The others are matched by position, size and pose (Hungarian method). A detection without an id, or with an id
   that is new, goes on with the track of a known person; with a new id it must be nearer.
4. A detection that fits a person who has been found is part of it or the same once more, and one that fits a new
   detection with more joints is part of that, or the same once more where all joints coincide. It is joined to it,
   and never a person of its own.

Whoever is left is new.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.association import (
    MIN_DETECTION_SIZE,
    MIN_SHARED_JOINTS,
    KnownPerson,
    SeenPeople,
    choose_pairs,
    expect_people,
    measure_distances,
    measure_sizes,
)
from mocap_ros.keypoints.person import Person2D, choose_depth
from mocap_ros.keypoints.rays import Extremities, convert_to_rays, select_core_depth
from mocap_ros.skeleton import CORE_COUNT
from mocap_ros.units import NS_PER_S

GATE = 0.6  # person sizes (RMS radius, about 0.5 m of an adult); acrobats move less from frame to frame
GATE_GROWTH_PER_S = 3.0  # person sizes/s; an unseen person may walk away and the predicted position gets worse
SIZE_GATE = (
    0.4  # natural logarithm of 1.5; no person shrinks by more from one frame to the next, but parts are smaller
)
SIZE_GATE_GROWTH_PER_S = 1.0  # the same per s; an unseen person may crouch or walk away
NEW_ID_GATE = 0.5  # person sizes; a detector that gives a new id may mean another person, who is farther away
NEW_ID_GATE_GROWTH_PER_S = 1.0  # person sizes/s; likewise
SAME_ID_GATE = 5.0  # person sizes; a detection with a known id that is farther away belongs to another person
SAME_ID_GATE_GROWTH_PER_S = 10.0  # person sizes/s; likewise
PART_GATE = 0.3  # person sizes, about 0.15 m; the joints of a part are those of the person, but for image noise
# Person sizes, about 0.1 and 0.2 m; distances of the joints of a person detected twice: their median, and each. Of
# people one behind the other, seen along that line, they are so small in one of a hundred images.
DOUBLE_GATE, DOUBLE_JOINT_GATE = 0.2, 0.4
UNTRACKED_ID = '-1'  # the id by which some detectors say that they know none
TENTATIVE_COST = 0.5  # person sizes; a known person gets a detection sooner than one who may be none


@dataclass(eq=False)
class DetectedBody:
    """One detected person of whom enough was seen to be tracked."""

    given_id: str  # name that the detector gives the person; empty if it gives none
    rays: Array  # (J, 2) x / z and y / z of the model's joints in the camera; 0 for a joint that was not seen
    weight: Array  # (J,) confidence scores in [0, 1]; 0 for a joint that was not seen
    is_evidence: NDArray[np.bool_]  # (J,) as of `rays.convert_to_rays`
    size: float  # RMS distance of the seen joints from their mean, in the units of rays
    extremities: Extremities
    # (J,) m along the optical axis of the surfaces that are seen at joints; NaN where unknown, None if all are
    depth: Array | None = None

    @staticmethod
    def from_people(
        people: Sequence[Person2D], intrinsics: Intrinsics, min_score: float, min_joints: int
    ) -> list[DetectedBody | None]:
        """Convert the keypoints of people to rays of the model's joints.

        `people` are as a detector gave them; `min_score` confidence score below which a keypoint counts as not
        seen; `min_joints` smallest number of seen joints, at least 1, that makes a detection usable. Returns a
        detection for each person; None if fewer joints were seen, or all of them in one place.

        Raises:
            SkeletonError: A person's joints do not cover enough of the model's.
        """
        found: list[DetectedBody | None] = [None] * len(people)
        for joints in dict.fromkeys(p.joints for p in people):
            own = [i for i, p in enumerate(people) if p.joints == joints]
            points, score = np.array([people[i].points for i in own]), np.array([people[i].score for i in own])
            rays, weight, is_evidence, others = convert_to_rays(points, score, joints, intrinsics, min_score)
            for n, size in enumerate(measure_sizes(rays, weight).tolist()):
                if np.count_nonzero(weight[n]) >= min_joints and size > MIN_DETECTION_SIZE:
                    person = people[own[n]]
                    measured = person.depth if intrinsics.is_focal_known else None
                    found[own[n]] = DetectedBody(
                        '' if person.id == UNTRACKED_ID else person.id,
                        rays[n],
                        weight[n],
                        is_evidence[n],
                        size,
                        others.select_frames(n),
                        select_core_depth(measured, joints, weight[n]),
                    )
        return found

    def join(self, part: DetectedBody) -> DetectedBody:
        """Return the detection with the joints of another detection of the same person that this one lacks."""
        rays, weight = _fill_gaps(self.rays, self.weight, part.rays, part.weight)
        extremities = Extremities(*_fill_gaps(*self.extremities, *part.extremities))
        (size,) = measure_sizes(rays[None], weight[None]).tolist()
        is_evidence = np.where(self.weight > 0, self.is_evidence, part.is_evidence)
        depth = choose_depth(self.weight > 0, self.depth, part.depth)
        return DetectedBody(self.given_id or part.given_id, rays, weight, is_evidence, size, extremities, depth)


def _fill_gaps(rays: Array, weight: Array, other_rays: Array, other_weight: Array) -> tuple[Array, Array]:
    is_own = weight > 0
    return np.where(is_own[:, None], rays, other_rays), np.where(is_own, weight, other_weight)


P = TypeVar('P', bound=KnownPerson)


class Matches(NamedTuple, Generic[P]):
    """The matches of a frame."""

    detections: list[DetectedBody]  # the detections of people, in their order, with their parts joined to them
    tracks: list[P | None]  # the person who each of these detections is; None for a detection of a new one
    replaced: list[P]  # people whose id the detector has given to another person
    members: list[list[int]]  # for each of these detections its index, and those of its parts
    are_ids_exchanged: bool  # whether ids have gone from people to others who are where they were
    # pairs of these detections in which one person is seen twice; twice the same where they have been joined
    doubles: list[tuple[int, int]]


def match_detections(stamp_ns: int, tracks: Sequence[P], detections: Sequence[DetectedBody]) -> Matches[P]:
    """Match the detections of a frame, stamp in ns, with the people who are known."""
    matcher = _Matcher(stamp_ns, tracks, detections)
    matcher.match_near_ids()
    matcher.find_exchanged_ids()
    matcher.match_far_ids()
    matcher.match_positions()
    matcher.join_parts()
    return matcher.finish()


def find_doubles(seen: SeenPeople) -> list[tuple[int, int]]:
    """Return the pairs of detections, by their indices, whose joints coincide as those of one person seen twice.

    At least half of the joints of one are seen in both, and all of these are near each other. Those of people who
    hug are not: the left side of one is at the right side of the other.
    """
    if len(seen.points) < 2:
        return []
    found, sizes, is_seen = [], measure_sizes(*seen), seen.weight > 0
    centres = seen.points.sum(axis=1) / is_seen.sum(axis=1, keepdims=True)  # points that were not seen are 0
    is_near = np.linalg.norm(centres[:, None] - centres, axis=-1) < np.maximum(sizes[:, None], sizes)
    for d, e in np.argwhere(np.triu(is_near, 1)).tolist():
        shared = is_seen[d] & is_seen[e]
        offsets = np.linalg.norm((seen.points[d] - seen.points[e])[shared], axis=1) / max(sizes[d], sizes[e])
        has_most = len(offsets) >= max(MIN_SHARED_JOINTS, min(is_seen[d].sum(), is_seen[e].sum()) / 2)
        if has_most and np.median(offsets) <= DOUBLE_GATE and offsets.max() <= DOUBLE_JOINT_GATE:
            found.append((d, e))
    return found


class _Matcher(Generic[P]):
    """The matching of the D detections of a frame with the P tracked people, step by step.

    Attributes:
        expected: where the P people are expected.
        seen: where the D detections are.
        age_s: (P,) s, time since each person was last seen.
        distances: (D, P) distances of all detections from all people.
        has_size: (D, P) whether the detection is large enough to be that of the person.
        track_of: index of the track of each matched detection, by the detection's index.
        exchanged: detections that have the id of a person who is far, where another person is.
        whole_of: detection of which a detection is part, by indices.
        doubles: pairs of `find_doubles`.
    """

    def __init__(self, stamp_ns: int, tracks: Sequence[P], detections: Sequence[DetectedBody]) -> None:
        self.tracks, self.detections = tracks, detections
        self.expected = expect_people(tracks, stamp_ns)
        self.age_s = np.array([(stamp_ns - t.stamps_ns[-1]) / NS_PER_S for t in tracks])
        rays, weight = np.array([d.rays for d in detections]), np.array([d.weight for d in detections])
        self.seen = SeenPeople(rays.reshape(-1, CORE_COUNT, 2), weight.reshape(-1, CORE_COUNT))
        self.distances, growths = measure_distances(self.expected, self.seen)
        self.has_size = growths >= -(SIZE_GATE + SIZE_GATE_GROWTH_PER_S * self.age_s)
        self.gates = GATE + GATE_GROWTH_PER_S * self.age_s
        self.track_of: dict[int, int] = {}
        self.exchanged: set[int] = set()
        self.whole_of: dict[int, int] = {}
        self.doubles = find_doubles(self.seen)
        # tracks by the id that the detector gave the person last, and by the person's in the output
        self.called: dict[str, list[int]] = {}
        for p, track in enumerate(tracks):
            for name in {track.given_id, track.id}:
                self.called.setdefault(name, []).append(p)

    @property
    def same_id_gates(self) -> Array:
        """(P,) distances within which detections with a person's id may be this person."""
        return SAME_ID_GATE + SAME_ID_GATE_GROWTH_PER_S * self.age_s

    def match_near_ids(self) -> None:
        """Match detections with people of their id who are near."""
        for d in range(len(self.detections)):
            p = self._find_same_id(d, self.gates)
            if p is not None:
                self.track_of[d] = p

    def find_exchanged_ids(self) -> None:
        """Find the detections whose ids people cannot have taken with them since their newest frames."""
        if len(self.tracks) < 2:
            return
        for d, detection in enumerate(self.detections):
            called = self.called.get(detection.given_id, ()) if detection.given_id else ()
            if d in self.track_of or not called or not all(self.tracks[p].has_newest_id for p in called):
                continue
            is_there = self.has_size[d] & (self.distances[d] <= PART_GATE)
            others = [p for p in np.flatnonzero(is_there).tolist() if p not in called]
            if (self.distances[d, called] > self.gates[[*called]]).all() and any(
                self.tracks[p].has_newest_id and not self.tracks[p].is_tentative for p in others
            ):
                self.exchanged.add(d)

    def match_far_ids(self) -> None:
        """Match detections with people of their id who are far, but for parts of people who have been found."""
        found = list(self.track_of)
        for d in range(len(self.detections)):
            is_settled = d in self.track_of or d in self.exchanged
            p = None if is_settled else self._find_same_id(d, self.same_id_gates)
            if p is not None and self._find_whole(d, found) is None:
                self.track_of[d] = p

    def _find_same_id(self, d: int, gates: Array) -> int | None:
        """Return the likeliest person with a detection's id within gates (P,); None if there is none."""
        name, taken = self.detections[d].given_id, self.track_of.values()
        if not name:
            return None
        called = [p for p in self.called.get(name, ()) if p not in taken]
        near = [p for p in called if self.has_size[d, p] and self.distances[d, p] <= gates[p]]

        def rank(p: int) -> tuple[bool, bool, float]:
            return self.tracks[p].given_id != name, self.tracks[p].is_tentative, self.distances[d, p]

        return min(near, key=rank, default=None)

    def match_positions(self) -> None:
        """Match detections with people by their distances."""
        free_d = [d for d in range(len(self.detections)) if d not in self.track_of]
        free_p = [p for p in range(len(self.tracks)) if p not in self.track_of.values()]
        if not free_d or not free_p:
            return
        tentative_costs = [TENTATIVE_COST * self.tracks[p].is_tentative for p in free_p]
        extra = GATE_GROWTH_PER_S * self.age_s[free_p] + tentative_costs
        # No match costs the same for all: otherwise a detection of a new person would let the one who was
        # lost for longest, for whom no match costs most, have the detection of another one.
        cost = np.full((len(free_d), len(free_p)), (self.gates[free_p] + extra).max())
        is_permitted = np.zeros(cost.shape, bool)
        is_near = (self.has_size & (self.distances < self.gates))[free_d][:, free_p]
        for row, column in zip(*(indices.tolist() for indices in is_near.nonzero()), strict=True):
            d, p = free_d[row], free_p[column]
            track, is_named = self.tracks[p], self.detections[d].given_id != ''
            is_other_id = is_named and track.given_id == track.id and not track.is_tentative
            if not is_other_id or self.distances[d, p] < NEW_ID_GATE + NEW_ID_GATE_GROWTH_PER_S * self.age_s[p]:
                cost[row, column], is_permitted[row, column] = self.distances[d, p] + extra[column], True
        for d, index in zip(free_d, choose_pairs(cost, is_permitted), strict=True):
            if index is not None:
                self.track_of[d] = free_p[index]

    def join_parts(self) -> None:
        """Find the detections that are parts of others."""
        free = [d for d in range(len(self.detections)) if d not in self.track_of]
        if not free:
            return
        joints = [np.count_nonzero(d.weight) for d in self.detections]
        wholes = list(self.track_of)
        for d in sorted(free, key=lambda d: -joints[d]):
            same = {e for pair in self.doubles if d in pair for e in pair}
            larger = [w for w in wholes if w in self.track_of or w in same or joints[w] > joints[d]]
            whole = self._find_whole(d, larger)
            if whole is None:
                wholes.append(d)
            else:
                self.whole_of[d] = whole

    def _find_whole(self, d: int, wholes: Sequence[int]) -> int | None:
        """Return the nearest of some detections of which another may be a part; None if there is none."""
        if not wholes:
            return None
        seen = SeenPeople(self.seen.points[d : d + 1], self.seen.weight[d : d + 1])
        distances = measure_distances(self._complete(wholes), seen, MIN_SHARED_JOINTS)[0][0]
        ages_s = [self.age_s[self.track_of[w]] if w in self.track_of else 0.0 for w in wholes]
        distances /= PART_GATE + NEW_ID_GATE_GROWTH_PER_S * np.array(ages_s)
        nearest = int(np.argmin(distances))
        return wholes[nearest] if distances[nearest] < 1 else None

    def _complete(self, wholes: Sequence[int]) -> SeenPeople:
        """Return the joints of detections, and where the others are expected if the person is known."""
        points, weight = self.seen.points[[*wholes]], self.seen.weight[[*wholes]]
        for n, whole in enumerate(wholes):
            if whole in self.track_of:
                unseen, expected = weight[n] == 0, [e[self.track_of[whole]] for e in self.expected]
                points[n, unseen], weight[n, unseen] = (e[unseen] for e in expected)
        return SeenPeople(points, weight)

    def finish(self) -> Matches[P]:
        """Return the matches."""
        people = {d: [d] for d in range(len(self.detections)) if d not in self.whole_of}
        detections = [*self.detections]
        for part, whole in self.whole_of.items():
            people[whole].append(part)
            detections[whole] = detections[whole].join(self.detections[part])
        tracks = [self.tracks[self.track_of[d]] if d in self.track_of else None for d in people]
        new = [d for d in people if d not in self.track_of]
        unmatched = {*range(len(self.tracks))}.difference(self.track_of.values()) if new else ()
        replaced = [self.tracks[p] for p in sorted(unmatched) if any(self._is_replaced(p, d) for d in new)]
        members = [*people.values()]
        place = {member: n for n, own in enumerate(members) for member in own}
        doubles = [(place[d], place[e]) for d, e in self.doubles]
        return Matches([detections[d] for d in people], tracks, replaced, members, bool(self.exchanged), doubles)

    def _is_replaced(self, p: int, d: int) -> bool:
        """Return whether the detector has given a person's id to a new detection that is another person's."""
        name = self.detections[d].given_id
        is_far = self.distances[d, p] > self.same_id_gates[p]
        return bool(is_far) and name != '' and p in self.called.get(name, ())
