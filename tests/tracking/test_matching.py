# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of which known person a detection is."""

import numpy as np
import pytest
from numpy.typing import NDArray

from mocap_ros.keypoints.matching import NEW_ID_GATE, NEW_ID_GATE_GROWTH_PER_S, Detection, match_detections
from mocap_ros.keypoints.person import Person2D
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.window import Array
from mocap_ros.tracking.track import Track
from tests.support.synthetic_walk import make_walk
from tests.support.tracks import CAMERA, STEP_NS, change, make_detection, make_track

NEXT_NS = STEP_NS


@pytest.fixture(scope='module')
def points(walk_model: BasePoses) -> Array:
    return make_walk(walk_model, 1)[2][0]


def make_known(points: Array, name: str, given_id: str = '') -> Track:
    track = make_track(points[None])
    return change(track, id=name, given_id=given_id, is_tentative=False)


def test_ids_decide_before_the_position(points: Array) -> None:
    ann, bob = make_known(points, 'ann', 'a'), make_known(points + [150, 0], 'bob', 'b')
    detections = [make_detection(points, 'b'), make_detection(points + [150, 0], 'a'), make_detection(points, 'b')]
    matches = match_detections(NEXT_NS, (ann, bob), detections)
    assert (matches.tracks, matches.replaced) == ([bob, ann], [])
    left, right = make_known(points - [200, 0], 'left'), make_known(points + [200, 0], 'right')
    unnamed = [make_detection(points + [x, 0]) for x in (205.0, 2.0, -190.0)]
    found = match_detections(NEXT_NS, (left, ann, right), unnamed).tracks
    assert found == [right, ann, left], 'a detection without an id may be a person who had one'
    assert match_detections(NEXT_NS, (), unnamed[:1]).tracks == [None]


def test_an_id_far_away_was_given_to_another_person(points: Array) -> None:
    ann = make_known(points, 'the first ann', 'a')
    near = match_detections(NEXT_NS, (ann,), [make_detection(points + [300, 0], 'a')])
    assert (near.tracks, near.replaced) == ([ann], [])
    far = match_detections(NEXT_NS, (ann,), [make_detection(points + [3000, 0], 'a')])
    assert (far.tracks, far.replaced) == ([None], [ann])


LOWER_JOINTS = ('pelvis', 'lhip', 'lknee', 'lankle', 'rhip', 'rknee', 'rankle')
UPPER = ~np.isin(CMU15.joints, LOWER_JOINTS)


def see_part(points: Array, joints: NDArray[np.bool_], name: str = '') -> Detection:
    """Return the detection of a person of whom only some joints were seen."""
    person = Person2D(name, CMU15.joints, points, np.where(joints, 0.9, 0.0))
    (detection,) = Detection.from_people([person], CAMERA, min_score=0.1, min_joints=6)
    assert detection is not None
    return detection


@pytest.mark.parametrize('ids', [('', ''), ('x', ''), ('', 'x'), ('x', 'y'), ('a', 'x'), ('x', 'a'), ('a', 'a')])
@pytest.mark.parametrize('known_id', ['a', ''])
def test_two_parts_of_a_person_are_the_person(points: Array, ids: tuple[str, str], known_id: str) -> None:
    ann, bob = make_known(points, 'ann', known_id), make_known(points + [150, 0], 'bob', 'b')
    moved = points + [4, 0]
    parts = [see_part(moved, UPPER, ids[0]), see_part(moved, ~UPPER, ids[1])]
    for order in ([0, 1], [1, 0]):
        detections = [parts[i] for i in order] + [make_detection(points + [150, 0], 'b')]
        matches = match_detections(NEXT_NS, (bob, ann), detections)
        assert matches.tracks == [ann, bob]
        assert matches.replaced == []
        whole = matches.detections[0]
        assert (whole.weight > 0).all()
        assert CAMERA.focal * whole.rays + CAMERA.center == pytest.approx(moved)
        assert whole.size == pytest.approx(make_detection(moved).size)


def test_a_new_person_beside_another_is_no_part(points: Array) -> None:
    ann = make_known(points, 'ann', 'a')
    new = make_detection(points[:, ::-1] + [40, -30], 'x')  # in another pose, at nearly the same position
    matches = match_detections(NEXT_NS, (ann,), [make_detection(points, 'a'), new])
    assert matches.tracks == [ann, None]


def test_a_new_id_goes_on_with_a_person_who_is_near(points: Array) -> None:
    ann, size = make_known(points, 'a', 'a'), CAMERA.focal * make_detection(points).size
    age_s = STEP_NS / 1e9
    gate = NEW_ID_GATE + NEW_ID_GATE_GROWTH_PER_S * age_s
    for share, is_ann in ((0.98, True), (1.02, False)):
        new = make_detection(points + [share * gate * size, 0], 'x')
        assert match_detections(NEXT_NS, (ann,), [new]).tracks == [ann if is_ann else None], share
    beyond = points + [1.02 * gate * size, 0]
    for other in (change(ann, is_tentative=True), make_known(points, 'a'), make_known(points, 'a', 'old')):
        tracks = match_detections(NEXT_NS, (other,), [make_detection(beyond, 'x')]).tracks
        assert tracks == [other], 'whose id was not steady may have another one'


def test_a_person_of_half_the_size_is_not_the_person(points: Array) -> None:
    """A detector that makes a small whole person of half of a person, with the person's id."""
    ann = make_known(points, 'ann', 'ann')
    small = points.mean(axis=0) + (points - points.mean(axis=0)) / 2
    matches = match_detections(NEXT_NS, (ann,), [make_detection(small, 'ann')])
    assert matches.tracks == [None]
    assert matches.replaced == [], 'nor is it another person'
    large = make_known(small, 'ann', 'ann')
    assert match_detections(NEXT_NS, (large,), [make_detection(points, 'ann')]).tracks == [large]
    assert match_detections(10**9, (ann,), [make_detection(small, 'ann')]).tracks == [ann], 'later it may be'


def test_a_known_person_gets_a_detection_sooner_than_a_tentative_one(points: Array) -> None:
    ann = make_known(points, 'ann')
    ghost = change(make_known(points, 'ghost'), is_tentative=True)
    for tracks in ((ann, ghost), (ghost, ann)):
        assert match_detections(NEXT_NS, tracks, [make_detection(points + [3, 0])]).tracks == [ann]
    lost_for_ns = 10 * STEP_NS
    new = change(ghost, stamps_ns=(lost_for_ns - STEP_NS,))
    found = match_detections(lost_for_ns, (ann, new), [make_detection(points + [3, 0])]).tracks
    assert found == [new], 'but who was lost does not take the detection of a new person'


def test_a_new_person_does_not_make_people_change_their_names(points: Array) -> None:
    """Bob was lost 0.9 s ago, within his reach of where ann is; ghost may be no person, and is nearer."""
    now_ns = 28 * STEP_NS
    ann, bob = make_known(points, 'ann'), make_known(points + [90, 0], 'bob')
    ann = change(ann, stamps_ns=(now_ns - STEP_NS,))
    ghost = change(ann, id='ghost', is_tentative=True)
    nearly, another = make_detection(points + [4, 0]), make_detection(points + [3000, 0])
    for tracks in ((ann, bob), (bob, ann), (ann, ghost)):
        for detections in ([nearly], [nearly, another], [another, nearly]):
            found = match_detections(now_ns, tracks, detections).tracks
            assert found == [ann if d is nearly else None for d in detections]


@pytest.mark.parametrize(('seen', 'is_usable'), [(5, False), (6, True)])
def test_a_detection_needs_enough_joints(points: Array, seen: int, is_usable: bool) -> None:
    score = np.where(np.arange(15) < seen, 0.5, 0.05)
    person = Person2D('a', CMU15.joints, points, score)
    (detection,) = Detection.from_people([person], CAMERA, min_score=0.1, min_joints=6)
    assert (detection is not None) is is_usable
    if detection is not None:
        assert (detection.weight > 0).sum() == seen
        assert CAMERA.focal * detection.size == pytest.approx(np.sqrt(2 * points[:seen].var(axis=0).mean()))
