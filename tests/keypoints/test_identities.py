# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of who is who, in a whole recording and live, with ids as detectors give them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from mocap_ros.config import Config
from mocap_ros.formats.detections import Detections, associate_people, create_person
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.identities import EXCHANGED_IDS
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.tracking.tracker import Tracker
from mocap_ros.units import NS_PER_S

FRAMES, RATE_HZ, SIZE = 60, 30, (1280, 720)
# px, a person of COCO's joints who stands, about the middle of the feet
BODY = np.array([
    *([0, -170], [3, -173], [-3, -173], [7, -170], [-7, -170], [18, -140], [-18, -140], [22, -112], [-22, -112]),
    *([24, -85], [-24, -85], [11, -88], [-11, -88], [12, -45], [-12, -45], [13, 0], [-13, 0]),
])  # fmt: skip
Seen = list[tuple[float, str]]  # the people in a frame: x in px, and the id


def walk_past(f: int, without_id: range = range(0)) -> Seen:
    """Return a and b, who cross in the middle at frame 30; the ids are absent in some frames."""
    return [(x, '' if f in without_id else name) for x, name in ((400 + 8 * f, 'a'), (880 - 8 * f, 'b'))]


def walk_out(f: int, names: Sequence[str]) -> Seen:
    """Return somebody who leaves on the right, and somebody else who enters on the left 0.3 s later."""
    return [(900 + 12.0 * f, names[0])] if f < 25 else [(100 + 8.0 * (f - 35), names[1])] if f >= 35 else []


def count_people(f: int) -> Seen:
    """Return three people whose ids are their numbers in a list; the first leaves and comes back."""
    xs = [x for x in (200.0, 600.0, 1000.0) if x > 200 or not 20 <= f < 40]
    return [(x, str(i)) for i, x in enumerate(xs)]


@pytest.mark.parametrize(
    ('see', 'frames_by_person', 'has_line'),
    [
        (lambda f: [(300.0 + f, '' if f % 3 or 20 <= f < 30 else '7')], [60], False),
        (lambda f: [(300.0 + f, '149'[f // 20])], [60], False),
        (lambda f: [(300.0 + f, '-1')], [60], False),
        (lambda f: [(300.0, '')] if f < 15 or f >= 53 else [], [22], False),  # back after 1.3 s
        (lambda f: [(300.0, 'a'), (700.0, 'b')][:: 1 - 2 * (f % 2)], [60, 60], False),
        (lambda f: list(zip((300.0, 700.0)[:: 1 - 2 * (f % 2)], '01', strict=True)), [60, 60], True),
        (lambda f: list(zip((500.0, 620.0)[:: 1 - 2 * (f // 5 % 2)], '01', strict=True)), [60, 60], True),
        (count_people, [40, 60, 60], False),
        (walk_past, [60, 60], False),
        (lambda f: walk_past(f, range(22, 38)), [60, 60], False),
        (lambda f: walk_out(f, '12'), [25, 25], False),
        (lambda f: walk_out(f, ('', '')), [25, 25], False),
    ],
)  # fmt: skip
def test_people_are_the_same_whole_and_live(
    walk_model: BasePoses, see: Callable[[int], Seen], frames_by_person: list[int], has_line: bool
) -> None:
    """Each person is where the person was; names come from the first id, and never change."""
    stamps = [f * NS_PER_S // RATE_HZ for f in range(FRAMES)]
    score = np.full((17, 1), 0.9)
    people = [
        [create_person(np.hstack([BODY + [x, 500], score]), 'coco17', name) for x, name in see(f)]
        for f in range(FRAMES)
    ]
    tracks, lines = associate_people(Detections(people, stamps, SIZE))
    assert [len(t.detection_by_frame) for t in tracks] == frames_by_person
    assert lines == ((EXCHANGED_IDS,) if has_line else ())
    for track in tracks:
        x = np.array([p.points[0, 0] for p in track.detection_by_frame.values()])
        steps = np.diff(x) / np.diff([*track.detection_by_frame])
        assert np.ptp(steps) < 1, 'the same direction throughout'
    tracker, camera = Tracker(walk_model, Config()), Intrinsics.from_image_size(*SIZE, 0.75)
    for frame, (stamp_ns, seen) in enumerate(zip(stamps, people, strict=True)):
        live = [p.id for p in tracker.update(stamp_ns, seen, camera) if not p.predicted]
        by_person = {id(t.detection_by_frame.get(frame)): t.id for t in tracks}
        assert live == [by_person[id(p)] for p in seen]
    assert tracker.are_ids_ignored == has_line
