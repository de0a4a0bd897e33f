# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""People that the tracker gives: their velocities, face, feet and hands, and how certain all of it is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from mocap_ros.config import Config, with_values
from mocap_ros.demo.scene import FOCAL_LENGTH_PX, IMAGE_SIZE, make_recording
from mocap_ros.geometry.interpolation import central_velocity
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.person import Person2D
from mocap_ros.models.model_file import load_base_pose_models
from mocap_ros.people import Person3D
from mocap_ros.skeleton import BODY26, CMU15, CORE_COUNT
from mocap_ros.tracking.body_size import ROOT_FACTOR, BodySize, estimate_root_covariance
from mocap_ros.tracking.tracker import Tracker

FRAMES = 75  # 2.5 s of the demo, in which the person walks
FIRST = 30  # the first second, until the filter knows the jitter, is not judged
STEP_NS = 33_333_333  # ns; 30 Hz
CAMERA = Intrinsics(FOCAL_LENGTH_PX, (IMAGE_SIZE[0] / 2, IMAGE_SIZE[1] / 2), is_focal_known=True)


def track_demo(values: dict[str, object], frames: Sequence[int]) -> dict[int, Person3D]:
    """Return the person of each output; frames that are not listed are empty."""
    config = with_values(Config(), {'tracker.model': 'walk', **values})
    tracker, sequence = Tracker(load_base_pose_models('walk'), config), make_recording().sequence()
    found = {}
    for frame in range(max(frames) + 1):
        people = (sequence.person(frame, 'anna'),) if frame in frames else ()
        for person in tracker.update(sequence.stamps_ns[frame], people, CAMERA):
            found[sequence.stamps_ns.index(tracker.output_stamp_ns)] = person
    return found


def test_velocities_of_the_live_output_are_better_than_its_differences_and_as_good_as_they_say() -> None:
    people, recording = track_demo({}, range(FRAMES)), make_recording()
    truth = central_velocity(recording.timestamps, recording.truth)
    frames = range(FIRST, FRAMES)
    errors, differences, std = [], [], []
    for frame in frames:
        errors.append(np.linalg.norm(people[frame].velocity[:CORE_COUNT] - truth[frame], axis=1))
        difference = (people[frame].core - people[frame - 1].core) / (STEP_NS / 1e9)
        differences.append(np.linalg.norm(difference - truth[frame], axis=1))
        std.append(people[frame].velocity_std[:CORE_COUNT])
        assert people[frame].age == pytest.approx(frame * STEP_NS / 1e9, abs=1e-6)
        assert people[frame].unseen_for == 0
    assert np.sqrt(np.mean(np.square(errors))) < 0.9 * np.sqrt(np.mean(np.square(differences)))
    assert 0.5 < np.mean(np.array(errors) < np.array(std)) < 0.97
    for person in (people[f] for f in frames):
        assert (np.linalg.eigvalsh(person.root_velocity_covariance) > 0).all()


def test_with_a_lag_velocities_are_those_of_the_smooth_solution_without_deviations() -> None:
    people, recording = track_demo({'tracker.lag': 0.2}, range(FRAMES)), make_recording()
    truth = central_velocity(recording.timestamps, recording.truth)
    errors = [np.linalg.norm(p.velocity[:CORE_COUNT] - truth[f], axis=1) for f, p in people.items() if f >= FIRST]
    assert np.sqrt(np.mean(np.square(errors))) < 0.7 * np.sqrt((truth[FIRST:FRAMES] ** 2).sum(axis=-1).mean())
    assert all(np.isnan(p.velocity_std).all() for p in people.values())


def test_the_position_of_a_body_is_least_certain_along_the_line_of_sight() -> None:
    root, share, ratios = np.array([1.0, -0.5, 4.0]), 0.06, (1.0, 1.0, 0.7)
    sizes = [BodySize(ratio, share, focal) for ratio, focal in zip(ratios, (0.0, 0.2, 0.0), strict=True)]
    covariance, wider, small = estimate_root_covariance(np.tile(root, (3, 15, 1)), np.full((3, 15), 0.06), sizes)
    variances, axes = np.linalg.eigh(covariance)
    own = (ROOT_FACTOR * 0.06) ** 2
    np.testing.assert_allclose(variances, [own / 6, own / 6, own * 2 / 3 + share**2 * root @ root], rtol=1e-9)
    assert abs(axes[:, 2] @ root) == pytest.approx(np.linalg.norm(root))
    np.testing.assert_allclose(wider - covariance, np.diag([0, 0, (0.2 * root[2]) ** 2]), atol=1e-12)
    np.testing.assert_allclose(small, 0.7**2 * covariance, rtol=1e-12)


WHOLE_FRAMES = 24
FACE = [BODY26.index(n) for n in ('nose', 'leye', 'reye', 'lear', 'rear')]


def track(frames: int = WHOLE_FRAMES, **values: object) -> list[tuple[Person3D, ...]]:
    """Return the people of the demo frame by frame, and those predicted for the frame after the last."""
    config = with_values(Config(), {f'tracker.{name}': value for name, value in values.items()})
    tracker, sequence = Tracker(load_base_pose_models('auto'), config), make_recording().sequence()
    found = []
    for frame in range(frames + 1):
        seen: list[Person2D] = [sequence.person(frame)] if frame < frames else []
        found.append(tracker.update(frame * STEP_NS, seen, sequence.intrinsics(1.0)))
        tracker.run_deferred_work()
    return found


@pytest.fixture(scope='module')
def whole() -> list[tuple[Person3D, ...]]:
    return track()


def test_without_face_feet_and_hands_people_have_the_same_core(whole: list[tuple[Person3D, ...]]) -> None:
    for (one,), (other,) in zip(whole, track(skeleton='cmu15'), strict=True):
        assert (one.skeleton, other.skeleton) == (BODY26, CMU15)
        for name in ('joints', 'std', 'inferred', 'velocity', 'orientation', 'turn_inferred'):
            np.testing.assert_array_equal(getattr(one, name)[:CORE_COUNT], getattr(other, name))
        np.testing.assert_array_equal(one.core, other.joints)


def test_what_the_detector_gives_is_seen_and_the_rest_inferred(whole: list[tuple[Person3D, ...]]) -> None:
    (last,), (predicted,) = whole[-2:]
    others = [j for j in range(CORE_COUNT, len(BODY26.joints)) if j not in FACE]
    assert not last.inferred[FACE].any()  # of coco17
    assert last.inferred[others].all()
    assert predicted.predicted
    assert predicted.inferred.all()
    assert predicted.turn_inferred.all()
    for person in (last, predicted):
        assert (person.std[CORE_COUNT:] > 0).all()
        assert np.isfinite(person.velocity).all()
        assert np.linalg.norm(person.orientation, axis=1) == pytest.approx(np.ones(len(BODY26.joints)))
    moved = np.linalg.norm(
        (predicted.joints - predicted.core.mean(axis=0)) - (last.joints - last.core.mean(axis=0)), axis=1
    )
    assert moved.max() < 0.15  # m in one frame
