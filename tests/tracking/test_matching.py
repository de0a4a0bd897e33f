"""Tests of which known person a detection is."""

from dataclasses import replace

import numpy as np
import pytest

from mocap_ros.keypoints.person import Person2D
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.window import Array
from mocap_ros.tracking.detection import Detection
from mocap_ros.tracking.matching import match_detections
from mocap_ros.tracking.track import Track
from tests.support.synthetic_walk import make_walk
from tests.support.tracks import CAMERA, STEP_NS, make_detection, make_track

NEXT_NS = STEP_NS


@pytest.fixture(scope='module')
def points(walk_model: BasePoses) -> Array:
    return make_walk(walk_model, 1)[2][0]


def make_known(points: Array, name: str, given_id: str = '') -> Track:
    track = make_track(points[None])
    return replace(track, id=name, seen=replace(track.seen, given_id=given_id))


def test_the_detectors_ids_decide_before_the_position(points: Array) -> None:
    ann, bob = make_known(points, 'ann', 'a'), make_known(points + [150, 0], 'bob', 'b')
    detections = [make_detection(points, 'b'), make_detection(points + [150, 0], 'a')]
    matches = match_detections(NEXT_NS, (ann, bob), detections)
    assert matches.tracks == (bob, ann)
    assert matches.replaced_ids == frozenset()


def test_people_without_an_id_are_matched_by_position(points: Array) -> None:
    left, right = make_known(points - [200, 0], 'left'), make_known(points + [200, 0], 'right')
    named = make_known(points, 'named', 'n')
    detections = [make_detection(points + [x, 0]) for x in (205.0, 2.0, -190.0)]
    matches = match_detections(NEXT_NS, (left, named, right), detections)
    assert matches.tracks == (right, None, left), 'the person with an id is nobody for a detection without one'


def test_an_id_far_away_was_given_to_another_person(points: Array) -> None:
    ann = make_known(points, 'the first ann', 'a')
    near = match_detections(NEXT_NS, (ann,), [make_detection(points + [300, 0], 'a')])
    assert (near.tracks, near.replaced_ids) == ((ann,), frozenset())
    far = match_detections(NEXT_NS, (ann,), [make_detection(points + [3000, 0], 'a')])
    assert (far.tracks, far.replaced_ids) == ((None,), frozenset({'the first ann'}))


def test_an_id_that_is_there_twice_is_one_known_person(points: Array) -> None:
    ann = make_known(points, 'ann', 'a')
    detections = [make_detection(points, 'a'), make_detection(points + [20, 0], 'a')]
    assert match_detections(NEXT_NS, (ann,), detections).tracks == (ann, None)


def test_nobody_known_and_nobody_seen(points: Array) -> None:
    assert match_detections(NEXT_NS, (), [make_detection(points)]).tracks == (None,)
    assert match_detections(NEXT_NS, (make_known(points, 'ann'),), []).tracks == ()


@pytest.mark.parametrize(('seen', 'is_usable'), [(5, False), (6, True)])
def test_a_detection_needs_enough_joints(points: Array, seen: int, is_usable: bool) -> None:
    score = np.where(np.arange(15) < seen, 0.5, 0.05)
    person = Person2D('a', CMU15.joints, points, score)
    detection = Detection.from_person(person, CAMERA, min_score=0.1, min_joints=6)
    assert (detection is not None) is is_usable
    if detection is not None:
        assert (detection.weight > 0).sum() == seen
        in_px = CAMERA.focal * np.array(detection.extent[:2]) + CAMERA.center
        assert in_px == pytest.approx(points[:seen].mean(axis=0))
