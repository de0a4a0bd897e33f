# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of what the benchmark of detectors counts."""

from __future__ import annotations

import numpy as np
import pytest
from experiments.detector_errors import BENT_OVER, CROUCHING, KNEELING, LEG_RAISED, UPRIGHT, classify_poses
from experiments.detector_ghosts import take_part
from experiments.detector_swaps import count_swaps

from mocap_ros.keypoints.person import Person2D
from mocap_ros.skeleton import CMU15

LEGS = [j for j, name in enumerate(CMU15.joints) if name.endswith(('hip', 'knee', 'ankle'))]
ARMS = [j for j, name in enumerate(CMU15.joints) if name.endswith(('elbow', 'wrist'))]
PAIRS = [j for j, m in enumerate(CMU15.mirror) if m != j]


def make_masks(frames: int = 12) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return that nothing is swapped, nothing exchanged and everything given."""
    nothing = np.zeros((frames, len(CMU15.joints)), bool)
    return nothing, nothing.copy(), ~nothing


def test_a_swap_is_undone_where_all_its_joints_are_exchanged() -> None:
    swapped, exchanged, given = make_masks()
    swapped[2:5, PAIRS] = True
    swapped[7:9, LEGS] = True
    swapped[10:11, ARMS] = True
    exchanged[2:4, PAIRS] = True
    exchanged[7, LEGS[1:]] = True
    exchanged[8, LEGS] = True
    found = count_swaps(swapped, exchanged, given)
    assert found['whole body'] == {'swaps': 1, 'frames': 3, 'undone': 2, 'single': 0, 'single undone': 0}
    assert found['legs'] == {'swaps': 1, 'frames': 2, 'undone': 1, 'single': 0, 'single undone': 0}
    assert found['arms'] == {'swaps': 0, 'frames': 0, 'undone': 0, 'single': 1, 'single undone': 0}
    assert found['wrong'] == 0


def test_joints_that_the_solver_does_not_get_need_not_be_exchanged() -> None:
    swapped, exchanged, given = make_masks()
    swapped[7:9, LEGS] = True
    exchanged[7:9, LEGS[1:]] = True
    given[:, LEGS[0]] = False
    assert count_swaps(swapped, exchanged, given)['legs']['undone'] == 2


def test_exchanging_joints_that_were_not_swapped_is_wrong() -> None:
    swapped, exchanged, given = make_masks()
    swapped[2:4, LEGS] = True
    exchanged[2:6, PAIRS] = True
    found = count_swaps(swapped, exchanged, given)
    assert (found['wrong'], found['wrong without swap'], found['longest wrong']) == (4, 2, 4)
    assert found['legs']['undone'] == 2


def make_body(**changes: tuple[float, float, float]) -> tuple[np.ndarray, list[str]]:
    """Return somebody who stands, (1, J, 3) m with y up, with other places of some joints."""
    place: dict[str, tuple[float, float, float]] = {'pelvis': (0, 0.95, 0), 'neck': (0, 1.45, 0)}
    for side, x in (('l', 0.1), ('r', -0.1)):
        place |= {side + 'hip': (x, 0.9, 0), side + 'knee': (x, 0.5, 0), side + 'ankle': (x, 0.1, 0)}
        place |= {side + 'toe': (x, 0.02, 0.15)}
    place |= changes
    return np.array([list(place.values())]), list(place)


@pytest.mark.parametrize(
    ('changes', 'kind'),
    [
        ({}, UPRIGHT),
        ({'neck': (0.0, 1.2, 0.45)}, BENT_OVER),
        ({'neck': (0.0, 1.35, 0.3)}, UPRIGHT),
        ({'lknee': (0.1, 0.9, 0.4), 'lankle': (0.1, 0.9, 0.8)}, LEG_RAISED),
        ({'lknee': (0.1, 0.1, 0.0), 'lankle': (0.1, 0.1, -0.4)}, KNEELING),
        ({'lhip': (0.1, 0.5, -0.4), 'rhip': (-0.1, 0.5, -0.4)}, CROUCHING),
    ],
)
def test_kinds_of_poses(changes: dict[str, tuple[float, float, float]], kind: str) -> None:
    assert classify_poses(*make_body(**changes)).tolist() == [kind]


def test_the_parts_of_a_broken_person_have_no_point_in_common_and_miss_none() -> None:
    points, score = np.arange(30.0).reshape(15, 2), np.full(15, 0.9)
    person = Person2D('p', CMU15.joints, points, score)
    upper, lower = (take_part(person, name, lower=name == 'lower') for name in ('upper', 'lower'))
    assert ((upper.score > 0) ^ (lower.score > 0)).all()
    assert {name for name, s in zip(CMU15.joints, lower.score, strict=True) if s > 0} >= {
        'lknee',
        'rankle',
        'lhip',
    }
    np.testing.assert_array_equal(np.isnan(upper.points[:, 0]), upper.score == 0)
