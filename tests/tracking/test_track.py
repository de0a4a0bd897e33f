# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Tracks: which known person a detection is, frames that come and go, and the solution that follows."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from mocap_ros.arrays import Array
from mocap_ros.geometry.distortion import Distortion
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.matching import NEW_ID_GATE, NEW_ID_GATE_GROWTH_PER_S, Detection, match_detections
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.lifter import LiftedPoses
from mocap_ros.models.model_file import load_base_poses
from mocap_ros.tracking.solution import TrackSolution
from mocap_ros.tracking.track import Track
from tests.support.synthetic_walk import make_walk
from tests.support.tracks import CAMERA, MIRROR, STEP_NS, UPPER, change, make_detection, make_track, see

FRAMES = 12


@pytest.fixture(scope='module')
def points(walk_model: BasePoses) -> Array:
    return make_walk(walk_model, FRAMES)[2] + [200.0, -50.0]  # px; off the optical axis


@pytest.fixture
def solution() -> TrackSolution:
    number = np.arange(float(FRAMES))
    return TrackSolution(
        model_name='walk',
        model=load_base_poses('walk'),
        theta=number[:, None] + [0.1, 0.2],
        rotation=np.eye(3) * (1 + number)[:, None, None],
        roots=np.stack([number, -number, 4 + number], axis=-1),
        bone_lengths=np.tile(number[:, None], 14),
        noise=0.01,
        stature_ratio=1.0,
        joint_std=np.full(15, 0.02),
        residual=0.01,
        frame_residuals=np.full(FRAMES, 2.0),
    )


def test_frames_that_are_too_old_leave_the_window_and_the_solution(points: Array, solution: TrackSolution) -> None:
    lifted = LiftedPoses(np.arange(FRAMES * 45.0).reshape(FRAMES, 15, 3), np.ones((FRAMES, 15, 3)))
    track = make_track(points)
    rays, weight = track.rays, np.linspace(0.2, 1.0, FRAMES * 15).reshape(FRAMES, 15)
    track.weight, track.observed = weight, replace(track.observed, lifted=lifted)
    track.solution = solution
    track.add_frame(FRAMES * STEP_NS, make_detection(points[0]), window_s=5.5 * STEP_NS / 1e9)
    assert track.stamps_ns == tuple(i * STEP_NS for i in range(7, 13))
    np.testing.assert_array_equal(track.rays[:-1], rays[7:])
    np.testing.assert_array_equal(track.weight[:-1], weight[7:])
    assert track.swap_filter.is_swapped.shape == (6, 3)
    assert track.observed.lifted is not None
    np.testing.assert_array_equal(track.observed.lifted.joints, lifted.joints[7:])
    assert track.has_unsolved_frame
    assert track.solved.theta[:, 0] == pytest.approx(np.arange(7, 12) + 0.1)
    assert track.solved.roots[:, 2] == pytest.approx(np.arange(11, 16))
    assert track.solved.rotation[:, 0, 0] == pytest.approx(np.arange(8, 13))
    assert track.solved.bone_lengths[:, 3] == pytest.approx(np.arange(7, 12))
    assert track.first_ns == 0
    track.add_frame(10**11, make_detection(points[0]), window_s=2.0)
    assert len(track.stamps_ns) == 1
    with pytest.raises(ValueError, match='not solved'):
        _ = track.solved


def test_swapped_sides_are_put_right_and_later_frames_may_change_the_decision(points: Array) -> None:
    """The first frame alone cannot show that its sides are swapped; a few more frames can."""
    seen_points = points.copy()
    seen_points[0] = points[0][MIRROR]
    tracks = [make_track(seen_points[: n + 1]) for n in range(FRAMES)]
    decisions = [[bool(frame.all()) for frame in t.swap_filter.is_swapped] for t in tracks]
    changed = next(n for n, decision in enumerate(decisions) if decision[0])
    assert 1 < changed < 10
    assert not any(d[0] for d in decisions[:changed])
    before, after = tracks[changed - 1], tracks[changed]
    assert after.observed.rays[0] == pytest.approx(after.rays[0][MIRROR])
    assert before.observed.rays[0] == pytest.approx(after.rays[0])

    for track, frame, is_relabelled in ((before, changed, True), (after, changed + 1, False)):
        lifted = LiftedPoses(np.ones((frame, 15, 3)), np.ones((frame, 15, 3)))
        track.observed = replace(track.observed, lifted=lifted)
        track.schedule.check_at(10**12)
        track.add_frame(frame * STEP_NS, make_detection(seen_points[frame]), window_s=2.0)
        assert (track.observed.lifted is None) is is_relabelled
        assert track.schedule.next_check_ns == (frame * STEP_NS if is_relabelled else 10**12)


@pytest.mark.parametrize('lens', [Distortion(), Distortion('plumb_bob', (-0.1, 0.02, 0.001, -0.001, 0.0))])
def test_a_change_of_the_camera_keeps_the_image(points: Array, solution: TrackSolution, lens: Distortion) -> None:
    track = change(make_track(points), solution=solution)
    other = Intrinsics(650.0, (300.0, 260.0), is_focal_known=True, aspect=1.1, distortion=lens)
    changed = track.copy()
    changed.change_camera(other, focal=650.0)
    assert changed.intrinsics == other
    assert changed.observed.focal == 650.0
    directions = np.concatenate([changed.rays, np.ones((FRAMES, 15, 1))], axis=-1)
    assert other.project(directions) == pytest.approx(points, abs=1e-6)
    assert other.project(changed.solved.roots) == pytest.approx(CAMERA.project(track.solved.roots), abs=1e-6)
    assert changed.solved.roots[:, 2] == pytest.approx(track.solved.roots[:, 2] * 650 / 500)
    back = changed.copy()
    back.change_camera(CAMERA, CAMERA.focal)
    assert back.rays == pytest.approx(track.rays, abs=1e-9)
    assert back.observed.virtual_camera.rotation == pytest.approx(track.observed.virtual_camera.rotation, abs=1e-9)
    assert back.solved.roots == pytest.approx(track.solved.roots, abs=1e-7)


def test_the_best_seen_frame_of_each_step_is_selected(points: Array) -> None:
    track = make_track(points)
    track.weight[:, 0] = [0.1, 0.5, 0.9, 0.1, 0.9, 0.2, 0.3, 0.4, 0.8, 0.1, 0.2, 0.0]
    # Steps of 0.1 s about the ages 0, 0.1, 0.2, ... s: frames 0 | 1 to 3 | 4 to 6 | 7 to 9 | 10 and 11
    assert track.select_frames(0.1, 1.0).tolist() == [0, 2, 4, 8, 11], 'the newest frame in any case'
    assert track.select_frames(0.1, 0.25).tolist() == [4, 8, 11]


# the frame in which a person is certain
@pytest.mark.parametrize(('fps', 'frames'), [(5, 3), (10, 3), (25, 3), (30, 3), (60, 5), (100, 8)])
@pytest.mark.parametrize('window_s', [2.0, 0.1])
def test_a_new_track_is_tentative_for_a_while(points: Array, fps: int, frames: int, window_s: float) -> None:
    track = make_track(points[:1])
    tentative = [track.is_tentative]
    for frame in range(1, 12):
        track.add_frame(int(frame * 1e9 / fps), make_detection(points[0]), window_s)
        tentative.append(track.is_tentative)
    if window_s > 1:
        assert tentative == [True] * (frames - 1) + [False] * (13 - frames)
    track.add_frame(10**11, make_detection(points[0]), window_s)
    assert not track.is_tentative, 'who was certain stays so, when all frames have left the window'


@pytest.fixture(scope='module')
def image(walk_model: BasePoses) -> Array:
    return make_walk(walk_model, 1).points[0]


def make_known(image: Array, name: str, given_id: str = '') -> Track:
    return change(make_track(image[None]), id=name, given_id=given_id, is_tentative=False)


def match(tracks: Sequence[Track], *detections: Detection, stamp_ns: int = STEP_NS) -> list[Track | None]:
    """Return the track of each detection in the frame after the first; no person is replaced by another."""
    matches = match_detections(stamp_ns, tracks, detections)
    assert matches.replaced == []
    return matches.tracks


def test_ids_decide_before_the_position(image: Array) -> None:
    ann, bob = make_known(image, 'ann', 'a'), make_known(image + [150, 0], 'bob', 'b')
    detections = [make_detection(image, 'b'), make_detection(image + [150, 0], 'a'), make_detection(image, 'b')]
    assert match((ann, bob), *detections) == [bob, ann]
    left, right = make_known(image - [200, 0], 'left'), make_known(image + [200, 0], 'right')
    unnamed = [make_detection(image + [x, 0]) for x in (205.0, 2.0, -190.0)]
    found = match((left, ann, right), *unnamed)
    assert found == [right, ann, left], 'a detection without an id may be a person who had one'
    assert match((), unnamed[0]) == [None]


def test_an_id_far_away_was_given_to_another_person(image: Array) -> None:
    ann = make_known(image, 'the first ann', 'a')
    assert match((ann,), make_detection(image + [300, 0], 'a')) == [ann]
    far = match_detections(STEP_NS, (ann,), [make_detection(image + [3000, 0], 'a')])
    assert (far.tracks, far.replaced) == ([None], [ann])


@pytest.mark.parametrize('ids', [('', ''), ('x', ''), ('', 'x'), ('x', 'y'), ('a', 'x'), ('x', 'a'), ('a', 'a')])
@pytest.mark.parametrize('known_id', ['a', ''])
def test_two_parts_of_a_person_are_the_person(image: Array, ids: tuple[str, str], known_id: str) -> None:
    ann, bob = make_known(image, 'ann', known_id), make_known(image + [150, 0], 'bob', 'b')
    moved = image + [4, 0]
    parts = [make_detection(moved, name, 0.9 * seen) for name, seen in zip(ids, (UPPER, ~UPPER), strict=True)]
    for both in (parts, parts[::-1]):
        matches = match_detections(STEP_NS, (bob, ann), [*both, make_detection(image + [150, 0], 'b')])
        assert (matches.tracks, matches.replaced) == ([ann, bob], [])
        whole = matches.detections[0]
        assert (whole.weight > 0).all()
        assert CAMERA.focal * whole.rays + CAMERA.center == pytest.approx(moved)
        assert whole.size == pytest.approx(make_detection(moved).size)


def test_a_new_person_beside_another_is_no_part(image: Array) -> None:
    ann = make_known(image, 'ann', 'a')
    new = make_detection(image[:, ::-1] + [40, -30], 'x')  # in another pose, at nearly the same position
    assert match((ann,), make_detection(image, 'a'), new) == [ann, None]


def test_a_new_id_goes_on_with_a_person_who_is_near(image: Array) -> None:
    ann, size = make_known(image, 'a', 'a'), CAMERA.focal * make_detection(image).size
    gate = size * (NEW_ID_GATE + NEW_ID_GATE_GROWTH_PER_S * STEP_NS / 1e9)
    within, beyond = (make_detection(image + [share * gate, 0], 'x') for share in (0.98, 1.02))
    assert (match((ann,), within), match((ann,), beyond)) == ([ann], [None])
    for other in (change(ann, is_tentative=True), make_known(image, 'a'), make_known(image, 'a', 'old')):
        assert match((other,), beyond) == [other], 'whose id was not steady may have another one'


def test_a_person_of_half_the_size_is_not_the_person(image: Array) -> None:
    """A detector that makes a small whole person of half of a person, with the person's id."""
    small = image.mean(axis=0) + (image - image.mean(axis=0)) / 2
    ann, large = make_known(image, 'ann', 'ann'), make_known(small, 'ann', 'ann')
    assert match((ann,), make_detection(small, 'ann')) == [None]
    assert match((large,), make_detection(image, 'ann')) == [large]
    assert match((ann,), make_detection(small, 'ann'), stamp_ns=10**9) == [ann], 'later it may be'


def test_a_known_person_gets_a_detection_sooner_than_a_tentative_one(image: Array) -> None:
    ann, near = make_known(image, 'ann'), make_detection(image + [3, 0])
    ghost = change(make_known(image, 'ghost'), is_tentative=True)
    assert match((ann, ghost), near) == match((ghost, ann), near) == [ann]
    new = change(ghost, stamps_ns=(9 * STEP_NS,))
    found = match((ann, new), near, stamp_ns=10 * STEP_NS)
    assert found == [new], 'but who was lost does not take the detection of a new person'


def test_a_new_person_does_not_make_people_change_their_names(image: Array) -> None:
    """Bob was lost 0.9 s ago, within his reach of where ann is; ghost may be no person, and is nearer."""
    ann, bob = make_known(image, 'ann'), make_known(image + [90, 0], 'bob')
    ann = change(ann, stamps_ns=(27 * STEP_NS,))
    ghost = change(ann, id='ghost', is_tentative=True)
    nearly, another = make_detection(image + [4, 0]), make_detection(image + [3000, 0])
    for tracks in ((ann, bob), (bob, ann), (ann, ghost)):
        for detections in ([nearly], [nearly, another], [another, nearly]):
            found = match(tracks, *detections, stamp_ns=28 * STEP_NS)
            assert found == [ann if d is nearly else None for d in detections]


@pytest.mark.parametrize(('seen', 'is_usable'), [(5, False), (6, True)])
def test_a_detection_needs_enough_joints(image: Array, seen: int, is_usable: bool) -> None:
    person = see(image, score=np.where(np.arange(15) < seen, 0.5, 0.05))
    (detection,) = Detection.from_people([person], CAMERA, min_score=0.1, min_joints=6)
    assert (detection is not None) is is_usable
    if detection is not None:
        assert (detection.weight > 0).sum() == seen
        assert CAMERA.focal * detection.size == pytest.approx(np.sqrt(2 * image[:seen].var(axis=0).mean()))
