# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of a track: frames come and go, the solution follows, and nothing that existed before changes."""

from dataclasses import replace

import numpy as np
import pytest

from mocap_ros.geometry.distortion import Distortion
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.association import measure_extent
from mocap_ros.keypoints.left_right import BodySides, SwapFilter
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.lifter import LiftedPoses
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.window import Array
from mocap_ros.tracking.solution import TrackSolution
from mocap_ros.tracking.track import Track
from tests.support.frozen_state import list_values
from tests.support.synthetic_walk import make_walk
from tests.support.tracks import CAMERA, MIRROR, STEP_NS, make_detection, make_track

FRAMES = 12


@pytest.fixture(scope='module')
def points(walk_model: BasePoses) -> Array:
    return make_walk(walk_model, FRAMES)[2] + [200.0, -50.0]  # px; off the optical axis


def make_solution(frames: int) -> TrackSolution:
    """Return a solution whose states differ in every frame."""
    number = np.arange(float(frames))
    return TrackSolution(
        model_name='walk',
        theta=number[:, None] + [0.1, 0.2],
        rotation=np.eye(3) * (1 + number)[:, None, None],
        roots=np.stack([number, -number, 4 + number], axis=-1),
        bone_lengths=np.tile(number[:, None], 14),
        noise=0.01,
        stature_ratio=1.0,
        joint_std=np.full(15, 0.02),
        residual=0.01,
        frame_residuals=np.full(len(number), 2.0),
    )


def test_a_new_frame_is_put_behind_the_others(points: Array) -> None:
    track = make_track(points)
    before = list_values(track)
    longer = track.add_frame(FRAMES * STEP_NS, make_detection(points[3] + [5, 0]), window_s=2.0)
    assert longer.seen.stamps_ns == tuple(i * STEP_NS for i in range(FRAMES + 1))
    assert longer.seen.age_s == pytest.approx(FRAMES / 30)
    np.testing.assert_array_equal(longer.seen.rays[:-1], track.seen.rays)
    assert CAMERA.focal * longer.seen.rays[-1] + CAMERA.center == pytest.approx(points[3] + [5, 0])
    assert longer.seen.observed.times == pytest.approx(np.arange(FRAMES + 1) / 30)
    assert list_values(track) == before


def test_the_virtual_camera_faces_the_person(points: Array) -> None:
    observed = make_track(points).seen.observed
    assert np.abs(observed.rays.mean(axis=(0, 1))).max() > 0.35, 'the person is off the optical axis'
    # The mean of rays is not exactly that of the rotated rays.
    facing_rays = observed.virtual_camera.view_rays(observed.rays, observed.weight, 1.0)
    assert facing_rays.mean(axis=(0, 1)) == pytest.approx([0, 0], abs=0.02)


def test_frames_that_are_too_old_leave_the_window_and_the_solution(points: Array) -> None:
    lifted = LiftedPoses(np.arange(FRAMES * 45.0).reshape(FRAMES, 15, 3), np.ones((FRAMES, 15, 3)))
    unsolved = make_track(points)
    weight = np.linspace(0.2, 1.0, FRAMES * 15).reshape(FRAMES, 15)
    seen = replace(unsolved.seen, weight=weight, observed=replace(unsolved.seen.observed, lifted=lifted))
    track = replace(unsolved, seen=seen, solution=make_solution(FRAMES))
    stamp_ns = FRAMES * STEP_NS
    track_after = track.add_frame(stamp_ns, make_detection(points[0]), window_s=5.5 * STEP_NS / 1e9)
    assert track_after.seen.stamps_ns == tuple(i * STEP_NS for i in range(7, 13))
    np.testing.assert_array_equal(track_after.seen.rays[:-1], seen.rays[7:])
    np.testing.assert_array_equal(track_after.seen.weight[:-1], seen.weight[7:])
    assert track_after.seen.swap_filter.is_swapped.shape == (6, 3)
    assert track_after.seen.observed.lifted is not None
    np.testing.assert_array_equal(track_after.seen.observed.lifted.joints, lifted.joints[7:])
    assert track_after.has_unsolved_frame
    assert track_after.solved.theta[:, 0] == pytest.approx(np.arange(7, 12) + 0.1)
    assert track_after.solved.roots[:, 2] == pytest.approx(np.arange(11, 16))
    assert track_after.solved.rotation[:, 0, 0] == pytest.approx(np.arange(8, 13))
    assert track_after.solved.bone_lengths[:, 3] == pytest.approx(np.arange(7, 12))
    assert track_after.seen.extents[:-1] == unsolved.seen.extents[7:]
    assert track_after.seen.first_stamp_ns == 0


def test_a_track_whose_solved_frames_have_all_left_is_not_solved(points: Array) -> None:
    track = replace(make_track(points), solution=make_solution(FRAMES))
    assert not track.has_unsolved_frame
    after_gap = track.add_frame(10**11, make_detection(points[0]), window_s=2.0)
    assert len(after_gap.seen.stamps_ns) == 1
    assert after_gap.solution is None
    assert after_gap.has_unsolved_frame
    with pytest.raises(ValueError, match='track person is not solved yet'):
        _ = after_gap.solved


def test_swapped_sides_are_put_right_and_later_frames_may_change_the_decision(points: Array) -> None:
    """The first frame alone cannot show that its sides are swapped; a few more frames can."""
    seen_points = points.copy()
    seen_points[0] = points[0][MIRROR]
    tracks = [make_track(seen_points[: n + 1]) for n in range(FRAMES)]
    decisions = [[bool(frame.all()) for frame in t.seen.swap_filter.is_swapped] for t in tracks]
    changed = next(n for n, decision in enumerate(decisions) if decision[0])
    assert 1 < changed < 10
    assert not any(d[0] for d in decisions[:changed])
    before, after = tracks[changed - 1], tracks[changed]
    assert after.seen.observed.rays[0] == pytest.approx(after.seen.rays[0][MIRROR])
    assert before.seen.observed.rays[0] == pytest.approx(after.seen.rays[0])

    lifted = LiftedPoses(np.ones((changed, 15, 3)), np.ones((changed, 15, 3)))
    schedule = before.schedule.check_at(10**12)
    before = replace(before.append_lifted(lifted), schedule=schedule)
    detection = make_detection(seen_points[changed])
    relabelled = before.add_frame(changed * STEP_NS, detection, window_s=2.0)
    assert relabelled.seen.observed.lifted is None
    assert relabelled.schedule.next_check_ns == changed * STEP_NS

    steady = after.append_lifted(LiftedPoses(np.ones((changed + 1, 15, 3)), np.ones((changed + 1, 15, 3))))
    steady = replace(steady, schedule=schedule)
    steady = steady.add_frame((changed + 1) * STEP_NS, make_detection(points[changed + 1]), window_s=2.0)
    assert steady.seen.observed.lifted is not None
    assert steady.schedule.next_check_ns == 10**12


def test_lifted_poses_before_the_first_frame_with_another_decision_are_kept(points: Array) -> None:
    track = make_track(points[:10])
    lifted = LiftedPoses(np.arange(10 * 45.0).reshape(10, 15, 3), np.ones((10, 15, 3)))
    is_swapped = track.seen.swap_filter.is_swapped.copy()
    assert not is_swapped.any()
    is_swapped[[6, 8], 1] = True  # decisions that the next frame changes
    swap_filter = replace(track.seen.swap_filter, is_swapped=is_swapped)
    seen = replace(track.seen, swap_filter=swap_filter).append_lifted(lifted)
    later = seen.add_frame(10 * STEP_NS, make_detection(points[10]), dropped=2)
    assert later.is_relabelled
    assert seen.observed.lifted is not None
    assert later.observed.lifted is not None
    np.testing.assert_array_equal(later.observed.lifted.joints, seen.observed.lifted.joints[2:6])


@pytest.mark.parametrize('lens', [Distortion(), Distortion('plumb_bob', (-0.1, 0.02, 0.001, -0.001, 0.0))])
def test_a_change_of_the_camera_keeps_the_image(points: Array, lens: Distortion) -> None:
    track = replace(make_track(points), solution=make_solution(FRAMES))
    other = Intrinsics(650.0, (300.0, 260.0), is_focal_known=True, aspect=1.1, distortion=lens)
    changed = track.change_camera(other, focal=650.0)
    assert changed.seen.intrinsics == other
    assert changed.seen.observed.focal == 650.0
    directions = np.concatenate([changed.seen.rays, np.ones((FRAMES, 15, 1))], axis=-1)
    assert other.project(directions) == pytest.approx(points, abs=1e-6)
    assert other.project(changed.solved.roots) == pytest.approx(CAMERA.project(track.solved.roots), abs=1e-6)
    assert changed.solved.roots[:, 2] == pytest.approx(track.solved.roots[:, 2] * 650 / 500)
    back = changed.change_camera(CAMERA, CAMERA.focal)
    assert back.seen.rays == pytest.approx(track.seen.rays, abs=1e-9)
    for seen in (changed.seen, back.seen):
        measured = [measure_extent(rays, weight) for rays, weight in zip(seen.rays, seen.weight, strict=True)]
        assert np.array(seen.extents) == pytest.approx(np.array(measured))
    assert back.seen.observed.virtual_camera.rotation == pytest.approx(
        track.seen.observed.virtual_camera.rotation, abs=1e-9
    )
    assert back.solved.roots == pytest.approx(track.solved.roots, abs=1e-7)


def test_after_a_change_of_the_camera_left_and_right_are_where_they_were(points: Array) -> None:
    aside = points + [180.0, 0.0]
    other = Intrinsics(300.0, (320.0, 240.0), is_focal_known=True)
    track = make_track(aside[:6])
    known = track.seen.swap_filter.paths
    assert known is not None
    track = track.change_camera(other, focal=300.0)
    changed = track.seen.swap_filter.paths
    assert changed is not None
    assert changed.points == pytest.approx(known.points * 500 / 300)
    assert changed.velocity == pytest.approx(known.velocity * 500 / 300, abs=1e-9)
    for frame in range(6, FRAMES):
        track = track.add_frame(frame * STEP_NS, make_detection(aside[frame], camera=other), window_s=2.0)
    assert not track.seen.swap_filter.is_swapped.any()


def test_a_disabled_swap_filter_bears_a_change_of_the_camera(points: Array) -> None:
    believing = SwapFilter(BodySides.of(CMU15), enabled=False)
    track = Track.begin('person', 0, make_detection(points[0]), believing, CAMERA, CAMERA.focal)
    assert track.change_camera(CAMERA, CAMERA.focal).seen.swap_filter is track.seen.swap_filter


def test_the_best_seen_frame_of_each_step_is_selected(points: Array) -> None:
    track = make_track(points)
    weight = track.seen.weight.copy()
    weight[:, 0] = [0.1, 0.5, 0.9, 0.1, 0.9, 0.2, 0.3, 0.4, 0.8, 0.1, 0.2, 0.0]
    seen = replace(track.seen, weight=weight)
    # Steps of 0.1 s about the ages 0, 0.1, 0.2, ... s: frames 0 | 1 to 3 | 4 to 6 | 7 to 9 | 10 and 11
    assert seen.select_frames(0.1, 1.0).tolist() == [0, 2, 4, 8, 11], 'the newest frame in any case'
    assert seen.select_frames(0.1, 0.25).tolist() == [4, 8, 11]


def test_a_solution_has_the_same_frames_in_all_its_arrays() -> None:
    with pytest.raises(ValueError, match='4 frames with bone lengths, 5 with weights'):
        replace(make_solution(5), bone_lengths=np.ones((4, 14)))


def test_the_name_stays_with_the_track_and_the_detectors_newest_id_is_known(points: Array) -> None:
    track = replace(make_track(points[:2]), id='ann')
    longer = track.add_frame(2 * STEP_NS, make_detection(points[2], 'other'), window_s=2.0)
    assert (longer.id, longer.seen.given_id) == ('ann', 'other')
    assert longer.add_frame(3 * STEP_NS, make_detection(points[3]), window_s=2.0).seen.given_id == 'other'


@pytest.mark.parametrize(
    ('fps', 'frames'),
    [(5, 3), (10, 3), (25, 3), (30, 3), (60, 5), (100, 8)],  # the frame in which somebody is certain
)
def test_a_new_track_is_tentative_until_it_has_been_seen_for_a_while(points: Array, fps: int, frames: int) -> None:
    stamps_ns = [int(i * 1e9 / fps) for i in range(12)]
    track = make_track(points[:1])
    tentative = [track.is_tentative]
    for stamp_ns in stamps_ns[1:]:
        track = track.add_frame(stamp_ns, make_detection(points[0]), window_s=2.0)
        tentative.append(track.is_tentative)
    assert tentative == [True] * (frames - 1) + [False] * (13 - frames)
    solution = make_solution(len(track.seen.stamps_ns))
    short = make_track(points[:1])
    for stamp_ns in stamps_ns[1:]:
        short = short.add_frame(stamp_ns, make_detection(points[0]), window_s=0.1)
    assert not short.is_tentative, 'also where fewer frames than that are in the window'
    assert not track.begin_solution(solution).change_camera(CAMERA, 1.0).refine(solution).is_tentative
    after_gap = track.add_frame(10**11, make_detection(points[0]), window_s=2.0)
    assert not after_gap.is_tentative, 'who was certain stays so, when all frames have left the window'
