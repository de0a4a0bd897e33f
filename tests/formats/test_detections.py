# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""People are associated over time, and the person to reconstruct is selected."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocap_ros.errors import InputError
from mocap_ros.formats.detections import (
    MAX_FRAME_RATE_HZ,
    Detections,
    Video,
    arrange_frames,
    associate_people,
    create_person,
    select_person,
)
from mocap_ros.keypoints.person import Person2D
from mocap_ros.units import NS_PER_S


def make_standing_person(x: float, person_id: str = '') -> Person2D:
    """Return a person 100 px tall whose left edge is at x, in px."""
    points = np.stack([x + np.linspace(0, 30, 17), np.linspace(100, 200, 17), np.ones(17)], axis=1)
    return create_person(points, person_id=person_id)


def make_detections(people: list[list[Person2D]]) -> Detections:
    """Return frames at 25 Hz."""
    return Detections(people, [f * NS_PER_S // 25 for f in range(len(people))], (640, 480))


def test_people_without_ids_are_associated_by_position() -> None:
    on_left = [make_standing_person(100 + f) for f in range(30)]
    on_right = [make_standing_person(400 - f) for f in range(30)]
    people = [[a, b] if f % 2 else [b, a] for f, (a, b) in enumerate(zip(on_left, on_right, strict=True))]
    people[10:15] = [[a] for a in on_left[10:15]]
    left, right = sorted(
        associate_people(make_detections(people))[0], key=lambda t: t.detection_by_frame[0].points[0, 0]
    )
    assert (len(left.detection_by_frame), len(right.detection_by_frame)) == (30, 25)
    assert [p.points[0, 0] for p in left.detection_by_frame.values()] == list(range(100, 130))
    sequence, lines = select_person(make_detections(people))
    assert sequence.keypoints[0, 0, 0] == 100
    assert f'{left.id} (30), {right.id} (25)' in lines[0]
    sequence, _ = select_person(make_detections(people), right.id)
    assert sequence.keypoints[0, 0, 0] == 400


def test_whoever_comes_after_all_were_forgotten_is_another_person() -> None:
    """Live, everything is forgotten after a minute without people."""
    frames = [*range(12), *range(2000, 2020)]
    people = [[make_standing_person(100 if f < 12 else 400)] for f in frames]
    stamps = [f * NS_PER_S // 25 for f in frames]
    tracks, _ = associate_people(Detections(people, stamps, (640, 480)))
    assert [(t.id, len(t.detection_by_frame)) for t in tracks] == [('person_1', 12), ('person_2', 20)]


def test_the_size_that_is_assumed_holds_all_people() -> None:
    """Otherwise people before one camera would have several focal lengths."""
    people = [[make_standing_person(100, 'a'), make_standing_person(1500, 'b')] for _ in range(10)]
    unsized = replace(make_detections(people), image_size=(0, 0))
    for person_id in ('a', 'b'):
        sequence, lines = select_person(unsized, person_id)
        assert sequence.image_size == (1920, 1080)
        assert '--image-size' in lines[-1]


@pytest.mark.parametrize(('first', 'start_s'), [(0, 0.0), (1, 0.0), (100, 2.0), (10**6, 0.0)])
def test_frames_are_as_far_apart_as_their_numbers_allow(first: int, start_s: float) -> None:
    """Every second image of a video of 50 frames/s, without the fourth of them, is 25 frames/s with a gap.

    Times count from the first image of the video, also where the first person comes later.
    """
    people = {first + number: [make_standing_person(100)] for number in (0, 2, 4, 8)}
    arranged = arrange_frames(people, Video(fps=50.0))
    assert arranged.stamps_ns == [round((start_s + t) * NS_PER_S) for t in (0, 0.04, 0.08, 0.12, 0.16)]
    assert [len(frame) for frame in arranged.people] == [1, 1, 1, 0, 1]


@pytest.mark.parametrize('fps', [1.1 * MAX_FRAME_RATE_HZ, 1e10, 1e300])
def test_a_rate_that_no_camera_has_is_refused(fps: float) -> None:
    people = {number: [make_standing_person(100)] for number in range(3)}
    with pytest.raises(InputError, match=r'^--fps: .* Hz, at most 10000 Hz expected$'):
        arrange_frames(people, Video(fps=fps))
    times = select_person(arrange_frames(people, Video(fps=MAX_FRAME_RATE_HZ)))[0].timestamps
    assert np.diff(times) == pytest.approx(1 / MAX_FRAME_RATE_HZ)
