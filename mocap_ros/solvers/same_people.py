# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Which people of several cameras are the same: one number for what the tracks of all cameras show of a person.

Two tracks a and b of different cameras show one person the better, the less they differ for what they know of
their roots r, with covariances C, and of their poses about them q, with deviations s:

    d_ab = (r_a - r_b)^T (C_a + C_b)^-1 (r_a - r_b) + mean_j 3 |q_aj - q_bj|^2 / (s_aj^2 + s_bj^2)

Of one person both parts are 3 in the mean. In single frames two people are confused, one behind the other before
one of the cameras or in step; so d is averaged over the time for which both were seen, at most `MEMORY_S`. The
tracks of each camera are assigned to the people whom the cameras before it show, by the least sum of the means
(Hungarian method), less `STAY` for who was the same before; a track that nobody fits better than `GATE` is a
person of its own. A person keeps the number that most of the tracks had, of several the oldest.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from mocap_ros.arrays import Array
from mocap_ros.people import People

MEMORY_S = 2.0  # s; longer than people are one behind the other on a line of sight, shorter than two walk in step
GATE = 25.0  # 1; of one person no mean of 240 was above 11
STAY = 6.0  # 1; d of one person in the mean, so that no single frame decides
FORGET_AFTER_S = 5.0  # s; a tracker gives a person who was away for longer another id
MAX_JUMP_M, MAX_SPEED_M_S = 1.0, 10.0  # of one person; a track that moves more has become another person's
Track = tuple[int, str]  # number of the camera, and the person's id there


class _Likeness(NamedTuple):
    """How little two tracks differ so far."""

    mean: float  # of d
    seconds: float  # s, for which both were seen, at most `MEMORY_S`


class SamePeople:
    """Numbers of people, by what several cameras show of them in successive frames."""

    def __init__(self, forget_after_s: float = FORGET_AFTER_S) -> None:
        self._forget_after_s = forget_after_s
        self._likeness: dict[tuple[Track, Track], _Likeness] = {}
        self._number_of: dict[Track, int] = {}
        self._seen: dict[Track, tuple[float, Array]] = {}  # s and (3,) m, when and where last
        self._new_numbers = itertools.count(1)

    @property
    def known_numbers(self) -> set[int]:
        """Numbers of the people who were seen lately."""
        return set(self._number_of.values())

    def update(self, time_s: float, step_s: float, views: Sequence[People]) -> list[list[int]]:
        """Return the numbers of the people of each camera at a time in s, in a common frame.

        A camera that does not see has nobody; `step_s` is the time in s since the frame before.
        """
        tracks = [[(camera, person_id) for person_id in people.ids] for camera, people in enumerate(views)]
        self._forget([t for t, (seen_s, _) in self._seen.items() if time_s - seen_s > self._forget_after_s])
        for own, people in zip(tracks, views, strict=True):
            for track, root in zip(own, people.roots, strict=True):
                before_s, before = self._seen.get(track, (time_s, root))
                if np.linalg.norm(root - before) > MAX_JUMP_M + MAX_SPEED_M_S * abs(time_s - before_s):
                    self._forget([track])
                self._seen[track] = time_s, root
                if track not in self._number_of:
                    self._number_of[track] = next(self._new_numbers)
        seeing = [camera for camera, own in enumerate(tracks) if own]
        for first, second in itertools.combinations(seeing, 2):
            found = compare_people(views[first], views[second])
            for row, a in enumerate(tracks[first]):
                for column, b in enumerate(tracks[second]):
                    self._add(a, b, float(found[row, column]), step_s)
        self._renumber(self._group(tracks))
        return [[self._number_of[track] for track in own] for own in tracks]

    def _forget(self, tracks: Sequence[Track]) -> None:
        gone = set(tracks)
        for track in gone:
            del self._seen[track], self._number_of[track]
        if gone:
            kept = self._likeness.items()
            self._likeness = {pair: value for pair, value in kept if not gone.intersection(pair)}

    def _add(self, a: Track, b: Track, found: float, step_s: float) -> None:
        before = self._likeness.get((a, b), _Likeness(found, 0.0))
        seconds = min(before.seconds + step_s, MEMORY_S)
        share = step_s / seconds if seconds > 0 else 1.0
        mean = before.mean + min(share, 1.0) * (found - before.mean)
        self._likeness[a, b] = self._likeness[b, a] = _Likeness(mean, seconds)

    def _group(self, tracks: Sequence[Sequence[Track]]) -> list[list[Track]]:
        """Return the tracks of each person, of those of each camera."""
        people: list[list[Track]] = []
        for own in tracks:
            known = len(people)
            cost = np.full((len(own), known + len(own)), GATE)
            for row, track in enumerate(own):
                for column, shown in enumerate(people):
                    cost[row, column] = np.mean([self._measure(track, other) for other in shown])
            for row, column in zip(*linear_sum_assignment(cost), strict=True):
                if column < known:
                    people[column].append(own[row])
                else:
                    people.append([own[row]])
        return people

    def _measure(self, a: Track, b: Track) -> float:
        return self._likeness[a, b].mean - (STAY if self._number_of[a] == self._number_of[b] else 0.0)

    def _renumber(self, people: Sequence[Sequence[Track]]) -> None:
        """Give each person one number, none twice."""
        votes = [(Counter(self._number_of[track] for track in shown), shown) for shown in people]
        taken = set[int]()
        for counts, shown in sorted(votes, key=lambda vote: (-max(vote[0].values()), min(vote[0]))):
            free = [number for number in counts if number not in taken]
            number = max(free, key=lambda n: (counts[n], -n)) if free else next(self._new_numbers)
            taken.add(number)
            self._number_of.update(dict.fromkeys(shown, number))


def compare_people(a: People, b: People) -> Array:
    """Return how much N people differ from M others in a common frame (N, M), d of the module."""
    apart = a.roots[:, None] - b.roots
    covariance = a.root_covariance[:, None] + b.root_covariance
    roots = (apart * np.linalg.solve(covariance, apart[..., None])[..., 0]).sum(axis=-1)
    poses = [people.joints - people.roots[:, None] for people in (a, b)]
    squares = ((poses[0][:, None] - poses[1]) ** 2).sum(axis=-1)
    variance = a.joint_std[:, None] ** 2 + b.joint_std**2
    return np.asarray(roots + (3 * squares / variance).mean(axis=-1))
