# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Who is who from frame to frame: the tracker and the readers of whole recordings name the same people alike.

Each frame is matched with the people who are known (`keypoints.matching`). Whoever is not seen for a while is
forgotten, and whoever is new gets a name: the detector's id or, without one, a number. Where a person was lost
less than `RETURN_S` ago, a new one without an id, or with an id that no person had, is that person again and has
the name of before.

Ids that the detector does not keep for a person but counts anew in each image go from one person to another, far
away, again and again (`Matches.are_ids_exchanged`). Once they did so in `MAX_EXCHANGES` frames of
`EXCHANGE_MEMORY_S`, ids are ignored.

Two people whose joints coincide (`matching.find_doubles`) in most frames are one whom the detector sees twice: the
newer one is forgotten, at once if still tentative. Where the people of an image are those of the image before the
last, and not of the last, images of two cameras come in turn.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Generic, NamedTuple

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.config import TrackerConfig
from mocap_ros.keypoints.association import (
    MIN_SHARED_JOINTS,
    VELOCITY_SPAN_S,
    KnownPerson,
    SeenPeople,
    expect_people,
    measure_distances,
)
from mocap_ros.keypoints.matching import (
    GATE,
    GATE_GROWTH_PER_S,
    DetectedBody,
    Matches,
    P,
    match_detections,
)
from mocap_ros.skeleton import CORE_COUNT
from mocap_ros.units import NS_PER_S

# What a new person must have been seen for.
MIN_FRAMES = 3  # frames; at a low frame rate a wrong detection is in one or two
MIN_AGE_S = 0.06  # s; at a high frame rate it lasts for several frames; three frames at 30 Hz last 0.067 s
TENTATIVE_FORGET_S = 0.2  # s; a detector misses a person for a few frames, and a new one must not be new again
RETURN_S = 10.0  # s; who comes back later, at the same position, may as well be another person
MAX_NAMES = 1000  # names that are remembered
MAX_EXCHANGES, EXCHANGE_MEMORY_S = 3, 10.0  # frames, s; a detector that tracks people confuses them less often
MIN_COUNT, MAX_COUNT = 10, 100  # frames of a `Tally`: for a decision, and when the older ones count half
IN_TURN_GATE = 0.3  # person sizes, about 0.15 m; within 1 / 30 s nobody moves so far and back
IN_TURN_RATIO = 3.0  # 1; of the distances to the people of the last image and of that before
IN_TURN_SHARE = 0.3  # 1, share of images; of a camera with half the rate of the other, a third
EXCHANGED_IDS = 'ids of people change places from frame to frame, as numbers of a list do; they are ignored'

DOUBLES = 'people are detected twice in most images, with joints that coincide; each is taken as one'
IN_TURN = (
    'people are elsewhere in every other image, as where two cameras send in turn; give the images of one camera, '
    'or run a node for each'
)


@dataclass
class Tally:
    """In how many of the newest frames something was so."""

    frames: int = 0
    count: int = 0

    def add(self, *, is_so: bool) -> None:
        """Add a frame."""
        if self.frames == MAX_COUNT:
            self.frames, self.count = self.frames // 2, self.count // 2
        self.frames, self.count = self.frames + 1, self.count + is_so

    def is_beyond(self, share: float) -> bool:
        """Return whether it was so in at least this share of the frames, and in `MIN_COUNT`."""
        return self.count >= max(MIN_COUNT, share * self.frames)


def is_new(frames_seen: int, age_s: float) -> bool:
    """Return whether a person has not been seen for long enough to be certain."""
    return frames_seen < MIN_FRAMES or age_s <= MIN_AGE_S


def find_absence(settings: TrackerConfig) -> float:
    """Return the time in s without people after which everything is forgotten, and none waits to be shown."""
    return max(settings.forget_all_after, settings.forget_after, settings.lag)


class FormerPerson(NamedTuple):
    """A person who may come again: name, stamp of the last frame in ns, and the person expected in it."""

    name: str
    stamp_ns: int
    expected: SeenPeople  # of one person


class Names(NamedTuple):
    """What is kept of names where all else is forgotten."""

    numbered: int = 0  # names that were given to people without an id
    people: tuple[FormerPerson, ...] = ()


class Identities(Generic[P]):
    """The identities of the people before one camera.

    Args:
        settings: parameters; `forget_after`, `forget_all_after` and `lag` apply.

    Attributes:
        newest_ns: ns, stamp of the newest frame; None before the first.
        newest_person_ns: ns, stamp of the newest frame with a detection that can be used; None likewise.
        are_ids_ignored: whether the detector's ids have turned out to say nothing.
        doubles: by the names of people who have turned out to be others, detected twice, the others' names.
    """

    def __init__(self, settings: TrackerConfig) -> None:
        self._settings = settings
        self.newest_ns: int | None = None
        self.newest_person_ns: int | None = None
        self.are_ids_ignored = False
        self.doubles: dict[str, str] = {}
        self._pairs: dict[tuple[str, str], Tally] = {}  # people who coincided in a frame, by name
        self._twice, self._in_turn = Tally(), Tally()
        self._seen: list[SeenPeople] = []  # in the last two frames in which anybody was
        self._exchanges_ns: list[int] = []
        self._lost: list[FormerPerson] = []
        self._names: deque[str] = deque(maxlen=MAX_NAMES)
        self._name_count = 0  # names that were given to people without an id

    def is_everybody_gone(self, stamp_ns: int) -> bool:
        """Return whether no person was there for so long that everything is forgotten."""
        newest_ns = self.newest_person_ns
        return newest_ns is not None and stamp_ns - newest_ns > find_absence(self._settings) * NS_PER_S

    def find_lost(self, stamp_ns: int, people: Sequence[P]) -> list[P]:
        """Return those who were not detected for `tracker.forget_after`, tentative ones sooner, and `doubles`."""
        longest_ns, lost = self._settings.forget_after * NS_PER_S, []
        for person in people:
            age_ns = stamp_ns - person.stamps_ns[-1]
            was_missed = person.stamps_ns[-1] != self.newest_ns
            is_misdetection = person.is_tentative and was_missed and age_ns > TENTATIVE_FORGET_S * NS_PER_S
            if person.id in self.doubles:
                lost.append(person)
            elif age_ns > longest_ns or is_misdetection:
                lost.append(person)
                if not (person.is_tentative and was_missed):
                    self._lost.append(_leave(person))
        return lost

    def list_names(self, people: Sequence[P]) -> Names:
        """Return the names of the people who are known, and of those who were lost."""
        return Names(self._name_count, (*self._lost, *map(_leave, people)))

    def recall(self, names: Names) -> None:
        """Take people for those who were known, and had these names, where they were less than `RETURN_S` ago."""
        self._name_count = names.numbered
        self._lost = [*names.people]
        self._names.extend(person.name for person in names.people)

    def match(self, stamp_ns: int, people: Sequence[P], detections: Sequence[DetectedBody]) -> Matches[P]:
        """Match the detections of a frame, stamp in ns, with the people who are known."""
        if self.are_ids_ignored:
            detections = [replace(d, given_id='') for d in detections]
        matches = match_detections(stamp_ns, people, detections)
        if matches.are_ids_exchanged:
            oldest_ns = stamp_ns - EXCHANGE_MEMORY_S * NS_PER_S
            self._exchanges_ns = [s for s in self._exchanges_ns if s >= oldest_ns] + [stamp_ns]
            self.are_ids_ignored = len(self._exchanges_ns) >= MAX_EXCHANGES
        self._find_doubles(people, matches)
        self._find_turns(detections)
        return matches

    def list_faults(self) -> list[str]:
        """Return what seems wrong with the detections so far, in words."""
        is_so = {
            EXCHANGED_IDS: self.are_ids_ignored,
            DOUBLES: self._twice.is_beyond(0.5),
            IN_TURN: self._in_turn.is_beyond(IN_TURN_SHARE),
        }
        return [words for words, holds in is_so.items() if holds]

    def _find_doubles(self, people: Sequence[P], matches: Matches[P]) -> None:
        if matches.detections:
            self._twice.add(is_so=bool(matches.doubles))
        order = {person.id: n for n, person in enumerate(people)}
        found = {person.id: person for person in matches.tracks if person is not None}
        pairs = ((matches.tracks[d], matches.tracks[e]) for d, e in matches.doubles if d != e)
        near = {(a.id, b.id) if order[a.id] < order[b.id] else (b.id, a.id) for a, b in pairs if a and b}
        self._pairs = {pair: tally for pair, tally in self._pairs.items() if set(pair) <= order.keys()}
        self.doubles = {}
        for pair in sorted({*near, *self._pairs}, key=lambda pair: (order[pair[0]], order[pair[1]])):
            if set(pair) <= found.keys():
                tally = self._pairs.setdefault(pair, Tally())
                tally.add(is_so=pair in near)
                kept, other = sorted(pair, key=lambda name: found[name].is_tentative)
                if tally.is_beyond(0.5) or (pair in near and found[other].is_tentative):
                    self.doubles.setdefault(other, self.doubles.get(kept, kept))

    def _find_turns(self, detections: Sequence[DetectedBody]) -> None:
        if not detections:
            return
        seen = SeenPeople(np.array([d.rays for d in detections]), np.array([d.weight for d in detections]))
        best = seen.weight.sum(axis=1).argmax()
        person = SeenPeople(*(a[best : best + 1] for a in seen))
        if len(self._seen) == 2:
            earlier, last = (float(measure_distances(s, person, MIN_SHARED_JOINTS)[0].min()) for s in self._seen)
            self._in_turn.add(is_so=last > IN_TURN_GATE and earlier < last / IN_TURN_RATIO)
        self._seen = [*self._seen[-1:], seen]

    def restart(self) -> Identities[P]:
        """Return identities that know of no person, but give no number a second time."""
        new = Identities[P](self._settings)
        new.newest_ns, new._name_count = self.newest_ns, self._name_count
        return new

    def is_first_tentative(self, stamp_ns: int) -> bool:
        """Return whether new people are tentative; they are not in a stream too slow to know anybody again."""
        before_ns = stamp_ns if self.newest_ns is None else self.newest_ns
        return stamp_ns - before_ns <= self._settings.forget_after * NS_PER_S

    def name(self, stamp_ns: int, detection: DetectedBody, used: set[str]) -> str:
        """Return a name for a person who is new in a frame, and add it to those in use."""
        self._lost = [p for p in self._lost if stamp_ns - p.stamp_ns <= RETURN_S * NS_PER_S and p.name not in used]
        name = detection.given_id
        if self._lost and name not in self._names:
            lost = SeenPeople(*map(np.concatenate, zip(*(p.expected for p in self._lost), strict=True)))
            distances = measure_distances(lost, SeenPeople(detection.rays[None], detection.weight[None]))[0][0]
            if distances.min() < GATE + GATE_GROWTH_PER_S * self._settings.forget_after:
                name = self._lost[int(distances.argmin())].name
        while not name or name in used:
            self._name_count += 1
            name = f'person_{self._name_count}'
        used.add(name)
        self._names.append(name)
        return name

    def end_frame(self, stamp_ns: int, *, has_people: bool) -> None:
        """Remember the stamp of a frame, in ns, and whether a detection could be used."""
        self.newest_ns = stamp_ns
        self.newest_person_ns = stamp_ns if has_people else self.newest_person_ns


def _leave(person: KnownPerson) -> FormerPerson:
    stamp_ns = person.stamps_ns[-1]
    return FormerPerson(person.id, stamp_ns, expect_people([person], stamp_ns))


@dataclass(eq=False)
class FollowedPerson:
    """What `Identities` needs of a person; the attributes are those of `tracking.track.Track`."""

    id: str
    first_ns: int
    is_tentative: bool
    stamps_ns: tuple[int, ...] = ()
    rays: Array = field(default_factory=lambda: np.zeros((0, CORE_COUNT, 2)))
    weight: Array = field(default_factory=lambda: np.zeros((0, CORE_COUNT)))
    given_id: str = ''
    has_newest_id: bool = False
    frames_seen: int = 0

    def add_frame(self, stamp_ns: int, detection: DetectedBody) -> None:
        """Add a frame, stamp in ns, and drop those that are older by more than `VELOCITY_SPAN_S`."""
        kept = slice(bisect_left(self.stamps_ns, stamp_ns - VELOCITY_SPAN_S * NS_PER_S), None)
        self.stamps_ns = (*self.stamps_ns[kept], stamp_ns)
        self.rays = np.concatenate([self.rays[kept], detection.rays[None]])
        self.weight = np.concatenate([self.weight[kept], detection.weight[None]])
        self.given_id, self.has_newest_id = detection.given_id or self.given_id, bool(detection.given_id)
        self.frames_seen += 1
        self.is_tentative &= is_new(self.frames_seen, (stamp_ns - self.first_ns) / NS_PER_S)
