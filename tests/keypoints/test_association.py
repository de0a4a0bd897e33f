# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Who is who: detections and expected people, in a whole recording and live; which side is left."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import fractional_matrix_power
from scipy.optimize import linear_sum_assignment

from mocap_ros.arrays import Array
from mocap_ros.config import Config
from mocap_ros.formats.detections import Detections, associate_people, create_person
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints import association
from mocap_ros.keypoints.association import SeenPeople, choose_pairs, measure_distances, measure_sizes
from mocap_ros.keypoints.identities import DOUBLES, EXCHANGED_IDS, IN_TURN, FollowedPerson
from mocap_ros.keypoints.left_right import BodySides, SwapFilter, ViterbiPaths, exchange_sides, find_swapped_parts
from mocap_ros.keypoints.person import Person2D
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.skeleton import CMU15
from mocap_ros.tracking.tracker import PeopleTracker
from mocap_ros.units import NS_PER_S
from tests.support.synthetic_walk import make_walk

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
    ('see', 'frames_by_person', 'fault'),
    [
        (lambda f: [(300.0 + f, '' if f % 3 or 20 <= f < 30 else '7')], [60], ''),
        (lambda f: [(300.0 + f, '149'[f // 20])], [60], ''),
        (lambda f: [(300.0 + f, '-1')], [60], ''),
        (lambda f: [(300.0, '')] if f < 15 or f >= 53 else [], [22], ''),  # back after 1.3 s
        (lambda f: [(300.0, 'a'), (700.0, 'b')][:: 1 - 2 * (f % 2)], [60, 60], ''),
        (lambda f: list(zip((300.0, 700.0)[:: 1 - 2 * (f % 2)], '01', strict=True)), [60, 60], EXCHANGED_IDS),
        (lambda f: list(zip((500.0, 620.0)[:: 1 - 2 * (f // 5 % 2)], '01', strict=True)), [60, 60], EXCHANGED_IDS),
        (count_people, [40, 60, 60], ''),
        (walk_past, [60, 60], ''),
        (lambda f: walk_past(f, range(22, 38)), [60, 60], ''),
        (lambda f: walk_out(f, '12'), [25, 25], ''),
        (lambda f: walk_out(f, ('', '')), [25, 25], ''),
        (lambda f: [(300.0 + 500 * (f % 2), '')], [30, 30], IN_TURN),
        (lambda f: [(300.0 + 500 * (f % 3 == 1), '')], [40, 20], IN_TURN),
    ],
)  # fmt: skip
def test_people_are_the_same_whole_and_live(
    walk_model: PoseModel, see: Callable[[int], Seen], frames_by_person: list[int], fault: str
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
    assert [*lines] == [fault] * bool(fault)
    for track in tracks:
        x = np.array([p.points[0, 0] for p in track.detection_by_frame.values()])
        steps = np.diff(x) / np.diff([*track.detection_by_frame])
        assert np.ptp(steps) < 1, 'the same direction throughout'
    tracker, camera = PeopleTracker(walk_model, Config()), Intrinsics.from_image_size(*SIZE, 0.75)
    for frame, (stamp_ns, seen) in enumerate(zip(stamps, people, strict=True)):
        tracked = tracker.update(stamp_ns, seen, camera)
        live = [p.id for p in tracked.people if not p.predicted]
        by_person = {id(t.detection_by_frame.get(frame)): t.id for t in tracks}
        assert live == [by_person[id(p)] for p in seen]
    assert [*tracked.faults] == [*lines]


def see_twice(f: int, ids: Sequence[str], rng: np.random.Generator) -> list[Person2D]:
    """Return two detections of a person who walks, 3 cm apart, but 20 cm in the first five frames."""
    away = [0.0, 20.0 if f < 5 else 3.0]  # px; the person is 173 px tall
    both = [BODY + [300 + 2 * f + x, 500] + rng.normal(0, 1, BODY.shape) for x in away]
    score = np.full((17, 1), 0.9)
    shown = [create_person(np.hstack([k, score]), 'coco17', i) for k, i in zip(both, ids, strict=True)]
    return shown if f % 5 != 3 else shown[f // 5 % 2 :][:1]


def see_hug(_: int, ids: Sequence[str], rng: np.random.Generator) -> list[Person2D]:
    """Return two people before the camera who hug, one seen from the front and the other from behind."""
    bodies = [BODY + [500, 500], BODY * [-1, 1] + [503, 500]]
    score = np.full((17, 1), 0.9)
    return [
        create_person(np.hstack([k + rng.normal(0, 2, k.shape), score]), 'coco17', i)
        for k, i in zip(bodies, ids, strict=True)
    ]


@pytest.mark.parametrize('ids', [('', ''), ('7', '8')])
@pytest.mark.parametrize(('see', 'count', 'faults'), [(see_twice, 1, [DOUBLES]), (see_hug, 2, [])])
def test_a_person_who_is_detected_twice_is_one_and_people_who_hug_are_two(
    walk_model: PoseModel, rng: np.random.Generator, see: Any, count: int, faults: list[str], ids: tuple[str, str]
) -> None:
    stamps = [f * NS_PER_S // RATE_HZ for f in range(FRAMES)]
    people = [see(f, ids, rng) for f in range(FRAMES)]
    tracks, lines = associate_people(Detections(people, stamps, SIZE))
    assert [len(t.detection_by_frame) for t in tracks] == [FRAMES] * count
    assert [*lines] == faults
    tracker, camera = PeopleTracker(walk_model, Config()), Intrinsics.from_image_size(*SIZE, 0.75)
    live = [tracker.update(stamp_ns, seen, camera) for stamp_ns, seen in zip(stamps, people, strict=True)]
    assert len(live[4].people) == 2
    assert [len(frame.people) for frame in live[25:]] == [count] * (FRAMES - 25)
    assert [*live[-1].faults] == faults


ENTER_PROBABILITY, LEAVE_PROBABILITY = np.array([0.0005, 0.003, 0.003]), np.array([0.2, 0.55, 0.55])
INITIAL_COST = np.array([7.0, 5.0, 5.0])
PREDICTION_STD, PREDICTION_STD_PER_S, PREDICTION_STD_PER_S2 = 0.05, 1.0, 2.0
OUTLIER_PROBABILITY, OUTLIER_STD, CONFUSION_COST = 0.1, 0.3, 12.0
ATTACHMENT_COST, ATTACHMENT_SCALE, ATTACHMENT_TIME_S = 5.0, 0.25, 0.1
VELOCITY_TIME_S, MAX_VELOCITY_GAP_S, MIN_STEP_S = 0.08, 0.2, 1e-3

SIDES = BodySides.of(CMU15)
SWAP_FRAMES = 90
TIMES = np.arange(SWAP_FRAMES) / 30
SEEN = np.ones((SWAP_FRAMES, 15))
WHOLE, LEGS, ARMS = np.array([1, 1, 1], bool), np.array([0, 1, 0], bool), np.array([0, 0, 1], bool)
# The parts of the eight states, by the bits of the state: whole body, legs, arms.
STATE_PARTS = np.array([[s & 1, (s >> 1 ^ s) & 1, (s >> 2 ^ s) & 1] for s in range(8)], bool)


@pytest.fixture
def walk(walk_model: PoseModel, rng: np.random.Generator) -> np.ndarray:
    _, _, points, _ = make_walk(walk_model, frames=SWAP_FRAMES)
    return points + rng.normal(0, 1.0, points.shape)


def swap_frames(frames: np.ndarray, parts: np.ndarray = WHOLE) -> np.ndarray:
    return np.isin(np.arange(SWAP_FRAMES), frames)[:, None] & parts


def swap(points: np.ndarray, is_swapped: np.ndarray) -> np.ndarray:
    """Return points (F, J, ...) with left and right exchanged in parts (F, 3)."""
    of_joint = np.where(SIDES.part >= 0, is_swapped[:, SIDES.part], False)
    source = np.where(of_joint, SIDES.mirror, np.arange(JOINTS))
    return np.ascontiguousarray(points[np.arange(len(points))[:, None], source])


def run_filter(swap_filter: SwapFilter, points: np.ndarray, weight: np.ndarray = SEEN) -> SwapFilter:
    for time_s, image, score in zip(TIMES, points, weight, strict=False):
        (size,) = measure_sizes(image[None], score[None])
        swap_filter = swap_filter.update(float(time_s), image, score, float(size))
    return swap_filter


@pytest.mark.parametrize('parts', [WHOLE, LEGS, ARMS])
@pytest.mark.parametrize(('first', 'last'), [(20, 20), (30, 34), (86, 89)])
def test_an_injected_swap_is_found_and_undone(walk: np.ndarray, first: int, last: int, parts: np.ndarray) -> None:
    is_swapped = swap_frames(np.arange(first, last + 1), parts)
    disturbed = swap(walk, is_swapped)
    found = find_swapped_parts(TIMES, disturbed, SEEN, SIDES)
    np.testing.assert_array_equal(found, is_swapped)
    np.testing.assert_array_equal(exchange_sides(disturbed, SEEN, found, SIDES)[0], walk)
    at_once = run_filter(SwapFilter(SIDES), disturbed[: first + 1]).is_swapped
    np.testing.assert_array_equal(at_once, is_swapped[: first + 1])


@pytest.mark.parametrize('frames', [slice(0, 1), slice(0, 3), slice(40, 42)])
def test_a_bad_frame_decides_nothing_about_those_after_it(
    walk: np.ndarray, rng: np.random.Generator, frames: slice
) -> None:
    """Frames with exchanged sides and points that are far off, of low scores, leave the others as they are."""
    points, weight = walk.copy(), SEEN.copy()
    points[frames] = points[frames][:, SIDES.mirror] + rng.normal(0, 12.0, points[frames].shape)
    weight[frames] = 0.4
    whole, live = find_swapped_parts(TIMES, points, weight, SIDES), run_filter(SwapFilter(SIDES), points, weight)
    for found in (whole, live.is_swapped):
        assert not np.delete(found, np.r_[frames], axis=0).any()


@pytest.mark.parametrize('seen', [0, 2])
def test_frames_that_show_nothing_are_not_swapped(walk: np.ndarray, seen: int) -> None:
    """Frames with all points at one position or without any change nothing around them."""
    points, weight, is_swapped = walk.copy(), SEEN.copy(), swap_frames(np.array([40, 41]))
    for frames in (slice(0, 3), slice(60, 62)):
        points[frames], weight[frames] = 5.0, 0.0
        weight[frames, :seen] = 1.0
    found = find_swapped_parts(TIMES, swap(points, is_swapped), weight, SIDES)
    np.testing.assert_array_equal(found, is_swapped)
    assert not find_swapped_parts(TIMES, points, np.zeros_like(SEEN), SIDES).any()


def test_the_filter_decides_as_the_whole_sequence_does(walk: np.ndarray, rng: np.random.Generator) -> None:
    disturbed = swap(walk, rng.random((SWAP_FRAMES, 3)) < 0.2)
    found = run_filter(SwapFilter(SIDES), disturbed).is_swapped
    np.testing.assert_array_equal(found, find_swapped_parts(TIMES, disturbed, SEEN, SIDES))
    assert found.any()


@pytest.mark.parametrize('enabled', [True, False])
def test_frames_that_are_dropped_leave_the_decisions_about_later_ones(walk: np.ndarray, enabled: bool) -> None:
    before = run_filter(SwapFilter(SIDES, enabled), swap(walk, swap_frames(np.array([5, 40, 41]))))
    newest = (SWAP_FRAMES / 30, walk[-1], SEEN[-1], 60.0)
    whole, shortened = before.update(*newest), before.update(*newest, dropped=30)
    assert whole.is_swapped.shape == (SWAP_FRAMES + 1, 3)
    assert whole.is_swapped[40].all() == enabled
    assert shortened.is_swapped.tolist() == whole.is_swapped[30:].tolist()
    if enabled:
        assert whole.paths is not None
        assert shortened.paths is not None
        np.testing.assert_array_equal(shortened.paths.states, whole.paths.states[:, 30:])
        np.testing.assert_array_equal(shortened.paths.cost, whole.paths.cost)
    assert before.update(*newest, dropped=SWAP_FRAMES).is_swapped.shape == (1, 3)


def find_transition_cost(elapsed_s: float) -> np.ndarray:
    """Return -log P(z_t | z_(t-1)), (8, 8), of three independent chains."""
    chances, steps = zip(ENTER_PROBABILITY, LEAVE_PROBABILITY, strict=True), max(elapsed_s, MIN_STEP_S) * 30
    chains = (np.array([[1 - begins, begins], [ends, 1 - ends]]) for begins, ends in chances)
    whole, legs, arms = (fractional_matrix_power(chain, steps) for chain in chains)
    return -np.log(np.kron(arms, np.kron(legs, whole)))


def find_attachment_cost(points: np.ndarray, weight: np.ndarray, body_size: float) -> np.ndarray:
    """Return what it costs to exchange left and right of a part, but not of the shoulders, (3,)."""
    paths = SwapFilter(SIDES).update(0.0, points, weight, body_size).paths
    assert paths is not None
    return paths.cost[[1, 2, 4]] - INITIAL_COST


def find_likelihoods(error: np.ndarray, age: np.ndarray, score: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the likelihoods of errors in body sizes if the points are inliers, and if they are outliers."""
    sigma = (2 - score) * (PREDICTION_STD + PREDICTION_STD_PER_S * age + PREDICTION_STD_PER_S2 * age**2)
    inlier = (1 - OUTLIER_PROBABILITY) * np.exp(-((error / sigma) ** 2) / 2) / sigma**2
    return inlier, OUTLIER_PROBABILITY / (sigma**2 + OUTLIER_STD**2)


def step_plainly(
    paths: ViterbiPaths, time_s: float, points: np.ndarray, weight: np.ndarray, body_size: float
) -> ViterbiPaths:
    """Continue the paths by a frame, by the formulas of the module."""
    mirror, part = SIDES.mirror, SIDES.part
    seen_points, score = np.stack([points, points[mirror]]), np.stack([weight, weight[mirror]])  # by label
    last_points, last_velocity = paths.joints[..., :2], paths.joints[..., 2:4]
    last_seen_s = paths.joints[..., 4]
    age = time_s - last_seen_s
    horizon = VELOCITY_TIME_S * (1 - np.exp(-age / VELOCITY_TIME_S))
    with np.errstate(invalid='ignore', divide='ignore', over='ignore'):
        predicted = last_points + horizon[..., None] * last_velocity
        error = np.linalg.norm(seen_points - predicted[:, None], axis=-1) / body_size  # path, label, joint
        loss = -np.log(sum(find_likelihoods(error, age[:, None], score)))
    loss = np.where((score > 0) & np.isfinite(age)[:, None], loss, 0)
    label_cost = np.stack([loss[:, :, part == p].sum(axis=-1) for p in range(3)], axis=1)  # path, part, label
    confused = label_cost[..., ::-1] + CONFUSION_COST < label_cost
    label_cost = np.minimum(label_cost, label_cost[..., ::-1] + CONFUSION_COST)
    of_state = sum(label_cost[:, p][:, STATE_PARTS[:, p].astype(int)] for p in range(3))  # path, state
    elapsed_s = time_s - last_seen_s[0].max()
    total = paths.cost[:, None] + of_state + find_transition_cost(elapsed_s)
    predecessor = total.argmin(axis=0)
    bits = np.arange(8)[:, None] >> np.arange(3) & 1
    attachment = find_attachment_cost(points, weight, body_size)
    cost = total.min(axis=0) + bits @ attachment * min(elapsed_s / ATTACHMENT_TIME_S, 1)
    joints = np.empty_like(paths.joints)
    for state, path in enumerate(predecessor):
        for j in range(JOINTS):
            label = int(part[j] >= 0 and STATE_PARTS[state, part[j]])
            before = mirror[j] if part[j] >= 0 and confused[path, part[j], label] else j
            old = [a[path, before] for a in (last_points, last_velocity, last_seen_s)]
            if score[label, j] > 0:
                step_s, velocity = max(time_s - old[2], MIN_STEP_S), np.zeros(2)
                if step_s < MAX_VELOCITY_GAP_S:
                    blend = 1 - np.exp(-step_s / VELOCITY_TIME_S)
                    moved = seen_points[label, j] - old[0]
                    inlier, outlier = find_likelihoods(
                        np.linalg.norm(moved - old[1] * VELOCITY_TIME_S * blend) / body_size,
                        step_s,
                        score[label, j],
                    )
                    velocity = old[1] + blend * inlier / (inlier + outlier) * (moved / step_s - old[1])
                old = [seen_points[label, j], velocity, time_s]
            joints[state, j] = np.hstack(old)
    states = np.append(paths.states[predecessor], np.arange(8)[:, None], axis=1)
    return ViterbiPaths(cost - cost.min(), states, joints)


def test_the_compiled_steps_are_those_of_the_formulas(walk: np.ndarray, rng: np.random.Generator) -> None:
    weight = rng.random(SEEN.shape) * (rng.random(SEEN.shape) > 0.2)
    weight[:30, 3] = 0  # a joint that is first seen in frame 30
    times = np.cumsum(rng.choice([1 / 30, 1 / 15, 0.3], SWAP_FRAMES, p=[0.8, 0.1, 0.1]))
    points = swap(walk, rng.random((SWAP_FRAMES, 3)) < 0.3)
    swap_filter = SwapFilter(SIDES).update(float(times[0]), points[0], weight[0], 60.0)
    predecessors = set()
    for frame in range(1, SWAP_FRAMES):
        before = swap_filter.paths
        assert before is not None
        swap_filter = swap_filter.update(float(times[frame]), points[frame], weight[frame], 60.0)
        found, expected = swap_filter.paths, step_plainly(before, times[frame], points[frame], weight[frame], 60.0)
        assert found is not None
        for name in ('cost', 'joints'):
            np.testing.assert_allclose(getattr(found, name), getattr(expected, name), 1e-9, 1e-9, err_msg=name)
        np.testing.assert_array_equal(found.states, expected.states)
        np.testing.assert_array_equal(swap_filter.is_swapped, STATE_PARTS[expected.states[expected.cost.argmin()]])
        predecessors |= {(int(s[-2]), int(s[-1])) for s in found.states}
    assert len(predecessors) > 16, 'many kinds of steps were compared'


def test_exchanged_lower_joints_cost_by_how_much_their_lines_get_longer() -> None:
    joints = {'lshoulder': (10.0, 0.0), 'rshoulder': (-10.0, 0.0), 'lhip': (8.0, 40.0), 'rhip': (-8.0, 40.0)}
    joints |= {'lelbow': (-12.0, 5.0), 'relbow': (12.0, 5.0)}  # arms crossed in front of the body
    points, weight = np.zeros((15, 2)), np.ones(15)
    for name, point in joints.items():
        points[CMU15.index(name)] = point
    longer = 2 * np.hypot(18, 40) - 2 * np.hypot(2, 40)
    cost = find_attachment_cost(points, weight, 30.0)
    assert cost == pytest.approx([0, ATTACHMENT_COST * np.tanh(longer / 30 / ATTACHMENT_SCALE), 0])
    weight[CMU15.index('rhip')] = 0
    assert find_attachment_cost(points, weight, 30.0) == pytest.approx(np.zeros(3))
