# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap_ros.Tracker`: the same people as inside, and one error for each wrong argument."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mocap_ros
from mocap_ros.models.model_file import load_base_pose_models
from mocap_ros.tracking.tracker import Tracker

SIZE = (640, 480)


def make_tracker(**arguments: Any) -> mocap_ros.Tracker:
    return mocap_ros.Tracker(**{'joint_names': 'coco17', 'image_size': SIZE, **arguments})


@pytest.fixture
def keypoints(sequence: mocap_ros.KeypointSequence) -> np.ndarray:
    """One frame of one person, (17, 3)."""
    return sequence.keypoints[0].copy()


def test_the_people_are_those_of_the_node_s_tracker(sequence: mocap_ros.KeypointSequence) -> None:
    inside = Tracker(load_base_pose_models('auto'), mocap_ros.Config())
    tracker = make_tracker()
    for frame, (time_s, stamp_ns) in enumerate(zip(sequence.timestamps, sequence.stamps_ns, strict=True)):
        expected = inside.update(stamp_ns, [sequence.person(frame)], sequence.intrinsics(0.75))
        people = tracker.update(time_s, [sequence.keypoints[frame]])
        assert isinstance(people, list)
        assert len(people) == len(expected) == 1
        np.testing.assert_array_equal(people[0].joints, expected[0].joints)
        np.testing.assert_array_equal(people[0].std, expected[0].std)
        assert people[0].id == expected[0].id
    assert tracker.output_time_s == pytest.approx(sequence.timestamps[-1])
    assert '40 frames to 1.300 s' in repr(tracker)
    assert "'person_1'" in repr(people[0])
    assert len(people[0].joint_names) == len(people[0].joints)


def test_a_repeated_time_drops_the_frame(keypoints: np.ndarray) -> None:
    tracker = make_tracker()
    tracker.update(1.0, [keypoints])
    with pytest.raises(mocap_ros.FrameDropped, match=r'time_s: stamp .* repeats'):
        tracker.update(1.0, [keypoints])
    with pytest.raises(mocap_ros.FrameDropped, match=r'time_s: stamp .* is older'):
        tracker.update(0.9, [keypoints])
    assert len(tracker.update(1.1, [keypoints])) == 1


@pytest.mark.parametrize(
    ('arguments', 'kind', 'place'),
    [
        ({'joint_names': 'coco'}, mocap_ros.SkeletonError, 'joint_names: unknown'),
        ({'image_size': (0, 480)}, mocap_ros.InputError, 'image_size: 0 x 480 px'),
        ({'distortion': [0.1] * 4}, mocap_ros.InputError, 'distortion: needs a camera_matrix'),
        ({'model': 'dance'}, mocap_ros.ModelError, 'model: '),
        ({'parameters': {'tracker.lag': 'long'}}, mocap_ros.ConfigError, 'parameters: tracker.lag'),
    ],
)
def test_a_wrong_argument_of_the_tracker_is_one_error_that_names_it(
    arguments: dict[str, Any], kind: type[mocap_ros.MocapError], place: str
) -> None:
    with pytest.raises(mocap_ros.MocapError, match=f'^{place}') as caught:
        make_tracker(**arguments)
    assert type(caught.value) is kind


@pytest.mark.parametrize(
    ('change', 'place'),
    [
        ({'time_s': -1.0}, r'time_s: -1\.0'),
        ({'time_s': 1.7e12}, 'time_s: 1700000000000'),
        ({'time_s': 'now'}, "time_s: 'now'"),
        ({'people': np.zeros((1, 18, 3))}, r'people: shape \(1, 18, 3\), expected \(1, 17, 3\)'),
        ({'people': [np.zeros((17, 3)), np.zeros((18, 3))]}, 'people: rows of different lengths'),
        ({'people': np.full((1, 17, 3), 0.5)}, r'people\[0\]: x, y: looks normalised'),
        ({'ids': ['anna', 'ben']}, 'ids: 2 names for 1 people'),
        *(({'ids': ids}, 'ids: .* expected a list of names') for ids in (5, 'a', [b'anna'], [None])),
        ({'people': np.ones((2, 17, 3)) * [90, 90, 1], 'ids': ['a', 'a']}, "ids: id 'a' twice"),
    ],
)
def test_a_wrong_frame_is_one_error_and_changes_nothing(
    keypoints: np.ndarray, change: dict[str, Any], place: str
) -> None:
    tracker = make_tracker()
    with pytest.raises(mocap_ros.InputError, match=f'^{place}'):
        tracker.update(**{'time_s': 0.0, 'people': [keypoints], **change})
    assert len(tracker.update(0.0, [keypoints])) == 1


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'step': 33.3}, 'time_s: 33.3 s from frame to frame: looks like milliseconds; s expected'),
        ({'image_size': (480, 640), 'shift': 250.0}, 'image_size: .* width and height look transposed'),
    ],
)
def test_thirty_frames_show_a_wrong_unit_or_a_transposed_image(
    sequence: mocap_ros.KeypointSequence, change: dict[str, Any], message: str
) -> None:
    tracker = make_tracker(image_size=change.get('image_size', SIZE))
    shifted = sequence.keypoints + [change.get('shift', 0.0), 0.0, 0.0]
    times = np.arange(40) * change.get('step', 1 / 30)
    for frame in range(29):
        tracker.update(times[frame], [shifted[frame]])
    for frame in (29, 30):
        with pytest.raises(mocap_ros.InputError, match=message):
            tracker.update(times[frame], [shifted[frame]])
