# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What a tracker remembers of people who have gone, and that it forgets all after a long time."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_ros.config import Config, with_settings
from mocap_ros.errors import FrameDropped
from mocap_ros.keypoints.person import Person2D
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.people import Person3D
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.window import Array
from mocap_ros.tracking.tracker import Tracker
from tests.support.frozen_state import list_values
from tests.support.synthetic_walk import make_walk
from tests.support.tracks import CAMERA, STEP_NS

FORGET_ALL_S = 3.0  # s, in these tests
FRAMES = 20  # of a visit


def make_tracker(model: BasePoses, **values: float) -> Tracker:
    settings = {'solver.components': 8, 'solver.prior': 'pca', 'tracker.forget_all_after': FORGET_ALL_S, **values}
    return Tracker(model, with_settings(Config(), settings))


def visit(tracker: Tracker, first_frame: int, points: Array) -> list[tuple[Person3D, ...]]:
    """Track two people without ids for some frames."""
    output = []
    for frame in range(FRAMES):
        people = [Person2D('', CMU15.joints, points[frame] + [shift, 0], np.ones(15)) for shift in (0, 400)]
        output.append(tracker.update((first_frame + frame) * STEP_NS, people, CAMERA))
    return output


def wait(tracker: Tracker, first_frame: int, seconds: float) -> int:
    """Track empty images, and return the number of the next frame."""
    last = first_frame + round(seconds * 30)
    for frame in range(first_frame, last):
        assert tracker.update(frame * STEP_NS, [], CAMERA) == () or frame < first_frame + 30
    return last


@pytest.mark.parametrize('lag', [0.0, 0.2])
def test_after_a_long_absence_a_tracker_is_as_new(walk_model: BasePoses, lag: float) -> None:
    points = make_walk(walk_model, FRAMES)[2]
    used, new = (make_tracker(walk_model, **{'tracker.lag': lag}) for _ in range(2))
    visit(used, 0, points)
    back = wait(used, FRAMES, FORGET_ALL_S + 1.0)
    for tracker in (used, new):
        tracker.update(back * STEP_NS, [], CAMERA)
    later = [visit(tracker, back + 1, points) for tracker in (used, new)]
    assert list_values(tuple(later[0])) == list_values(tuple(later[1]))
    assert {p.id for p in later[0][-1]} == {'person_1', 'person_2'}
    with pytest.raises(FrameDropped):
        used.update((back - 1) * STEP_NS, [], CAMERA)


def test_after_a_shorter_absence_names_are_remembered(walk_model: BasePoses) -> None:
    points = make_walk(walk_model, FRAMES)[2]
    tracker = make_tracker(walk_model)
    visit(tracker, 0, points)
    back = wait(tracker, FRAMES, FORGET_ALL_S - 1.0)
    assert {p.id for p in visit(tracker, back, points)[-1]} == {'person_1', 'person_2'}
