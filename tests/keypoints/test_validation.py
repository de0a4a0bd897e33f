# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Keypoints that cannot be used are found with their field and index; those that were not seen are marked."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_ros.keypoints.validation import find_first_fault, mark_unseen


def test_a_point_far_outside_any_image_is_a_fault() -> None:
    points = np.full((5, 2), 100.0)
    assert find_first_fault(points, np.ones(5)) is None
    points[3, 1] = 1e10
    fault = find_first_fault(points, np.ones(5))
    assert fault is not None
    assert (fault.field, fault.index) == ('y', (3,))


def test_a_score_above_a_hundred_is_a_fault_and_one_of_a_simcc_head_is_not() -> None:
    assert find_first_fault(np.full((2, 2), 50.0), np.array([0.3, 9.7])) is None
    fault = find_first_fault(np.full((2, 2), 50.0), np.array([9.7, 101.0]))
    assert fault is not None
    assert (fault.field, fault.index) == ('score', (1,))


@pytest.mark.parametrize('point', [(0, 0), (-1, -1), (np.nan, 5), (5, np.inf)])
def test_what_detectors_write_for_a_point_that_they_do_not_see_is_not_seen_whatever_its_score(
    point: tuple[float, float],
) -> None:
    points, score = mark_unseen(np.array([point, (0.0, 5.0), (5.0, -1.0)]), np.array([0.4, 0.5, 0.6]))
    assert np.isnan(points[0]).all()
    np.testing.assert_array_equal(points[1:], [(0, 5), (5, -1)])
    np.testing.assert_array_equal(score, [0, 0.5, 0.6])


def test_scores_of_a_person_are_divided_by_the_largest_of_those_seen_if_it_exceeds_one() -> None:
    points = np.full((3, 4, 2), 50.0)
    points[2, 3] = 0.0
    given = np.array([[0.2, 0.9, 1.0, np.nan], [0.5, 2.0, 4.0, -1e-4], [0.5, 1.0, 2.0, 8.0]])
    expected = [[0.2, 0.9, 1.0, 0], [0.125, 0.5, 1.0, 0], [0.25, 0.5, 1.0, 0]]
    np.testing.assert_array_equal(mark_unseen(points, given)[1], expected)
