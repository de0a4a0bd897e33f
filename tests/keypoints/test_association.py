# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The association of detections with expected people, and who is who in a whole recording and live."""

import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from mocap_ros.arrays import Array
from mocap_ros.config import Config
from mocap_ros.formats.detections import Detections, associate_people, create_person
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints import association
from mocap_ros.keypoints.association import SeenPeople, choose_pairs, measure_distances, measure_sizes
from mocap_ros.keypoints.identities import EXCHANGED_IDS, FollowedPerson
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.tracking.tracker import Tracker
from mocap_ros.units import NS_PER_S

MIRROR = association.MIRROR
JOINTS = len(MIRROR)


def test_joints_that_coincide_show_no_person() -> None:
    rays, weight = np.full((4, 5, 2), 0.3), np.ones((4, 5))
    weight[1] = 0  # nothing is seen
    rays[2:, 0] += 10 * association.MIN_DETECTION_SIZE
    weight[3, 0] = 0
    assert association.show_people(measure_sizes(rays, weight)).tolist() == [False, False, True, False]


def make_body(rng: np.random.Generator, x: float = 0.0, size: float = 0.1) -> Array:
    """Return the points (J, 2) of a body whose RMS radius is about `size`."""
    return rng.normal(0, size / math.sqrt(2), (JOINTS, 2)) + [x, 0]


def compute_slowly(expected: Array, weight_expected: Array, points: Array, weight: Array) -> tuple[float, float]:
    """Return distance and growth of a pair by the formula."""

    def radius(those: Array) -> float:
        return float(np.sqrt(((those - those.mean(axis=0)) ** 2).sum(axis=1).mean()))

    known, seen = weight_expected > 0, weight > 0
    sizes = radius(expected[known]), radius(points[seen])
    candidates = []
    for labels in (np.arange(JOINTS), MIRROR):
        shared = known & seen[labels]
        a, b = expected[shared], points[labels][shared]
        if shared.sum() < association.MIN_SHARED_JOINTS:
            growth = math.log(sizes[1] / sizes[0])
            offset = float(np.linalg.norm(points[seen].mean(axis=0) - expected[known].mean(axis=0)))
        else:
            extra = association.RADIUS_OFFSET * max(sizes)
            growth = math.log((radius(b) + extra) / (radius(a) + extra))
            offset = float(np.median(np.linalg.norm(a - b, axis=1)))
        candidates.append((offset / max(sizes) + abs(growth), growth))
    return min(candidates, key=lambda c: c[0])


@given(seed=st.integers(0, 10**6), hidden=st.integers(0, 13))
def test_the_distances_of_all_pairs_are_those_of_the_formula(seed: int, hidden: int) -> None:
    rng = np.random.default_rng(seed)

    def choose() -> Array:
        return (rng.permutation(JOINTS) >= rng.integers(0, hidden + 1)).astype(float)

    people = [(make_body(rng, x, 0.2), choose()) for x in (0.0, 0.5, 2.0)]
    seen = [(make_body(rng, x), choose()) for x in (0.1, 0.4)]
    expected, detected = (SeenPeople(*map(np.array, zip(*those, strict=True))) for those in (people, seen))
    distances, growths = measure_distances(expected, detected)
    slowly = np.array([[compute_slowly(*p, *d) for p in people] for d in seen])
    assert distances == pytest.approx(slowly[..., 0], rel=1e-5)
    assert growths == pytest.approx(slowly[..., 1], abs=1e-5)


def test_a_person_is_expected_where_the_movement_goes(rng: np.random.Generator) -> None:
    body, step_s = make_body(rng), 1 / 30
    frames = np.stack([body + [0.02 * i, -0.01 * i] for i in range(6)])
    weight = np.ones((6, JOINTS))
    weight[3:, 2] = 0  # this joint was seen 3 frames before the newest
    weight[:, 5] = 0  # and this one never
    known = np.arange(JOINTS) != 5
    moved = np.array([0.02, -0.01]) / step_s
    for gap in (1, 2, 100):
        stamps_ns = tuple(round(f * step_s * NS_PER_S) for f in range(6))
        known_person = FollowedPerson('', 0, False, stamps_ns, frames, weight)
        (points,), (is_known,) = association.expect_people(
            [known_person], stamps_ns[-1] + round(gap * step_s * NS_PER_S)
        )
        span_s, longer_s = (min(g * step_s, association.VELOCITY_SPAN_S) for g in (gap, gap + 3))
        expected = body + [0.1, -0.05] + moved * span_s
        expected[2] = body[2] + [0.04, -0.02] + moved * longer_s
        assert points[known] == pytest.approx(expected[known])
        assert is_known.tolist() == known.astype(float).tolist()


@given(st.integers(0, 2**32 - 1), st.integers(1, 7), st.integers(1, 7), st.booleans())
def test_the_pairs_are_those_of_the_least_sum(seed: int, detections: int, people: int, has_ties: bool) -> None:
    cost = np.random.default_rng(seed).random((detections, people)) * 3
    if has_ties:
        cost = np.minimum(np.round(cost), 2)
    pairs = [(d, p) for d, p in enumerate(choose_pairs(cost, np.ones_like(cost, bool))) if p is not None]
    assert len(pairs) == len({p for _, p in pairs}) == min(cost.shape)
    assert sum(cost[pair] for pair in pairs) == pytest.approx(cost[linear_sum_assignment(cost)].sum())
    cost[-1, 0] = [math.nan, math.inf][seed % 2]
    with pytest.raises(ValueError, match='not finite'):
        choose_pairs(cost, np.ones_like(cost, bool))


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
