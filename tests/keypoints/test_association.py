"""Tests of the association of detections with expected people."""

import numpy as np
import pytest

from mocap_ros.keypoints.association import (
    BASE_GATE,
    FORBIDDEN_COST,
    GATE_GROWTH_PER_S,
    MIN_DETECTION_SIZE,
    UNPREDICTED_GATE_GROWTH_PER_S,
    ExpectedExtent,
    Extent,
    _compute_costs,
    associate,
    associate_keypoints,
    compute_distance,
    compute_gate,
    compute_keypoint_distance,
    measure_extent,
)
from mocap_ros.keypoints.person import Person2D
from mocap_ros.skeleton import keypoint_layout

FRAME_S = 1 / 30


def expected(x: float, size: float = 0.1, age_s: float = FRAME_S) -> ExpectedExtent:
    return ExpectedExtent(x, 0.0, size, age_s)


def detected(x: float, size: float = 0.1) -> Extent:
    return Extent(x, 0.0, size)


def test_the_extent_is_the_centre_and_rms_radius_of_the_seen_joints() -> None:
    points = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 2.0], [np.nan, 50.0]])
    x, y, size = measure_extent(points, np.array([1.0, 0.5, 0.2, 0.0]))
    assert (x, y) == pytest.approx((0.0, 2 / 3))
    assert size == pytest.approx(np.sqrt(np.mean([1 + 4 / 9, 1 + 4 / 9, 16 / 9])))


def test_joints_that_are_all_in_one_place_show_no_person() -> None:
    assert measure_extent(np.full((5, 2), 0.3), np.ones(5)).is_one_place
    assert measure_extent(np.ones((5, 2)), np.zeros(5)).is_one_place, 'nothing is seen'
    rays = np.full((5, 2), 0.3)
    rays[0] += 10 * MIN_DETECTION_SIZE
    assert not measure_extent(rays, np.ones(5)).is_one_place
    assert measure_extent(rays, np.array([0.0, 1, 1, 1, 1])).is_one_place


def test_the_distance_and_the_gate_are_those_of_the_formula() -> None:
    assert compute_distance(expected(0.0, 0.1), detected(0.3, 0.2)) == pytest.approx(0.3 / 0.2 + np.log(2))
    assert compute_distance(expected(0.0, 0.2), detected(0.3, 0.1)) == pytest.approx(0.3 / 0.2 + np.log(2))
    assert compute_gate(expected(0.0, age_s=0.5)) == pytest.approx(BASE_GATE + 0.5 * GATE_GROWTH_PER_S)


def test_the_costs_of_all_pairs_are_those_of_each(rng: np.random.Generator) -> None:
    people = [ExpectedExtent(*row) for row in rng.uniform([-1, -1, 0.1, 0], [1, 1, 0.5, 0.6], (40, 4))]
    detections = [Extent(*row) for row in rng.uniform([-1, -1, 0.1], [1, 1, 0.5], (30, 3))]
    cost, is_within_gate = _compute_costs(np.array(people), np.array(detections))
    expected_cost = np.full((30, 40), FORBIDDEN_COST)
    for d, p in np.ndindex(30, 40):
        distance = compute_distance(people[p], detections[d])
        if distance < compute_gate(people[p]):
            expected_cost[d, p] = distance + GATE_GROWTH_PER_S * people[p].age_s
    assert cost == pytest.approx(expected_cost)
    assert is_within_gate.tolist() == (expected_cost < FORBIDDEN_COST).tolist()
    assert 100 < is_within_gate.sum() < 1100, 'some pairs are within the gate and some are not'


def test_crossing_people_keep_their_ids_by_position_and_size() -> None:
    """Two people walk past each other, one of them 1.5 times as far away; detections come in changing order."""
    steps = np.linspace(-0.3, 0.3, 31)
    swapped_size_is_near = 0
    for number, x in enumerate(steps[1:], start=1):
        last = steps[number - 1]
        people = [expected(last, 0.15), expected(-last, 0.10)]
        detections = [detected(x, 0.15), detected(-x, 0.10)]
        swapped_size_is_near += abs(2 * x) < 0.1
        assert associate(people, detections) == [0, 1]
        assert associate(people, detections[::-1]) == [1, 0]
    assert swapped_size_is_near > 2


def test_at_equal_positions_the_size_decides() -> None:
    people = [expected(0.0, 0.15), expected(0.0, 0.10)]
    assert associate(people, [detected(0.0, 0.11), detected(0.0, 0.14)]) == [1, 0]


def test_the_sum_of_distances_is_least_not_each_distance() -> None:
    people = [expected(0.0), expected(0.06)]
    assert associate(people, [detected(0.05), detected(0.12)]) == [0, 1]


def test_of_two_people_the_one_who_was_seen_more_recently_gets_the_detection() -> None:
    hidden, seen = expected(-0.1, age_s=0.13), expected(0.06, age_s=0.033)
    assert associate([hidden, seen], [detected(0.08)]) == [1]
    assert associate([expected(0.0, age_s=0.5), expected(0.02)], [detected(0.0)]) == [1]


def test_the_gate_widens_while_a_person_is_not_seen() -> None:
    assert associate([expected(-0.1, age_s=0.13)], [detected(0.02)]) == [0]
    assert associate([expected(-0.1, age_s=0.0)], [detected(0.02)]) == [None]
    assert associate([expected(-0.1, age_s=0.13)], [detected(0.5)]) == [None]


def test_nobody_expected_or_nobody_detected() -> None:
    assert associate([], [detected(0.0)]) == [None]
    assert associate([expected(0.0)], []) == []


def make_person(x: float, y: float = 0.0, seen: int = 17) -> Person2D:
    """Return a person 100 px tall whose upper left corner is at (x, y), of whom the first keypoints are seen."""
    points = np.stack([x + np.linspace(0, 30, 17), y + np.linspace(0, 100, 17)], axis=1)
    score = np.where(np.arange(17) < seen, 0.9, 0.0)
    return Person2D('', keypoint_layout('coco17').joints, np.where(score[:, None] > 0, points, np.nan), score)


def test_the_distance_of_keypoints_is_their_median_in_sizes_of_the_larger_person() -> None:
    size = measure_extent(make_person(0).points, np.ones(17)).size
    assert compute_keypoint_distance(make_person(0), make_person(60)) == pytest.approx(60 / size)
    assert compute_keypoint_distance(make_person(0, seen=5), make_person(60)) == pytest.approx(60 / size)
    moved = make_person(60)
    moved.points[3] += 1000  # one keypoint that was found elsewhere
    assert compute_keypoint_distance(make_person(0), moved) < 65 / size
    other_layout = Person2D('', ('a',), np.array([[15.0, 50.0]]), np.ones(1))
    assert compute_keypoint_distance(make_person(0), other_layout) == pytest.approx(0, abs=1e-9)


def test_keypoints_tell_people_apart_of_whom_little_is_seen() -> None:
    """Without its lower half the right person is nearest to the left one by centre and size."""
    known = [make_person(0), make_person(60)]
    assert associate_keypoints(known, [0.1, 0.1], [make_person(52, seen=6), make_person(2)]) == [1, 0]


def test_a_person_who_is_gone_does_not_push_others_to_wrong_people() -> None:
    """Both detections are within reach of other people, but the first is where the second person was."""
    known = [make_person(0), make_person(25)]
    assert associate_keypoints(known, [0.0, 0.0], [make_person(25), make_person(25, y=25)]) == [1, None]


def test_the_gate_of_keypoints_widens_with_the_time_since_a_person_was_seen() -> None:
    size = measure_extent(make_person(0).points, np.ones(17)).size
    for age_s in (0.0, 0.5, 2.0):
        gate = (BASE_GATE + UNPREDICTED_GATE_GROWTH_PER_S * age_s) * size
        assert associate_keypoints([make_person(0)], [age_s], [make_person(0.99 * gate)]) == [0]
        assert associate_keypoints([make_person(0)], [age_s], [make_person(1.01 * gate)]) == [None]
    assert associate_keypoints([], [], [make_person(0)]) == [None]
    assert associate_keypoints([make_person(0)], [0.0], []) == []
