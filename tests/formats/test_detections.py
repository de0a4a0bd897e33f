# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""People are associated over time, one is selected, and images are ordered by their names."""

import random
from dataclasses import replace

import numpy as np
import pytest

from mocap_ros.errors import InputError
from mocap_ros.formats.detections import (
    MAX_FRAME_RATE_HZ,
    Detections,
    arrange_frames,
    associate_people,
    create_person,
    select_person,
)
from mocap_ros.formats.image_names import ImageName, order_images
from mocap_ros.formats.reading_options import ReadingOptions
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
    tracks, _ = associate_people(make_detections(people))
    left, right = sorted(tracks, key=lambda t: t.detection_by_frame[0].points[0, 0])
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
    arranged = arrange_frames(people, ReadingOptions(fps=50.0))
    assert arranged.stamps_ns == [round((start_s + t) * NS_PER_S) for t in (0, 0.04, 0.08, 0.12, 0.16)]
    assert [len(frame) for frame in arranged.people] == [1, 1, 1, 0, 1]


@pytest.mark.parametrize('fps', [1.1 * MAX_FRAME_RATE_HZ, 1e10, 1e300])
def test_a_rate_that_no_camera_has_is_refused(fps: float) -> None:
    people = {number: [make_standing_person(100)] for number in range(3)}
    with pytest.raises(InputError, match=r'^--fps: .* Hz, at most 10000 Hz expected$'):
        arrange_frames(people, ReadingOptions(fps=fps))
    times = select_person(arrange_frames(people, ReadingOptions(fps=MAX_FRAME_RATE_HZ)))[0].timestamps
    assert np.diff(times) == pytest.approx(1 / MAX_FRAME_RATE_HZ)


FRAMES = range(0, 60, 2)
NAMES_WITH_NUMBERS = [
    '{n}', '{n:06d}.jpg', 'frame_{n:04d}_cam0.jpg', '{n:04d}_640x480.png', 'clip2_{n:012d}', 'a/b 1/{n}.jpeg',
    'img{n}', 'f_{n:04d}_1080p.jpg', '2023-05-01_{n:03d}.png', 'frame_{n:04d}_{ms:06d}ms.png', '{n:05d}.rgb.png',
    '20230501_123005_{n:04d}.png', '20240101_{n:06d}.jpg', 'cam{n:04d}.png', 'GX010042_{n:05d}.JPG',
    'clip {n:03d} (edited 2).png',
]  # fmt: skip
NAMES_WITH_TIMES = [
    ('{s}.{us:06d}.png', 1_305_031_102), ('{s}.{ms3:03d}.png', 1_341_846_313), ('rgb/{s}.{us:06d}', 1_305_031_102),
    ('{s}{us:06d}000.png', 1_403_636_579), ('cam0_{s}{ms3:03d}.jpg', 1_403_636_579),
    ('{s}_{us:06d}.png', 1_700_000_000), ('{s}-{us:06d}000.png', 1_700_000_000),
    ('2023-11-14T22-13-{s2:02d}.{us:06d}Z.png', 1_700_000_000),
    ('IMG_20231114_2213{s2:02d}_{ms3:03d}.jpg', 1_700_000_000),
    ('{s0}.{us:06d}.png', 0), ('cam_{s0}.{ms3:03d}.png', 0),
    ('cam_{s}.{us:06d}.png', 1_700_000_000),
]  # fmt: skip


@pytest.mark.parametrize('pattern', NAMES_WITH_NUMBERS)
def test_names_with_numbers(pattern: str) -> None:
    names: list[ImageName] = [pattern.format(n=n, ms=33 * n + n % 3) for n in FRAMES]
    shuffled = random.Random(0).sample(names, len(names))
    assert order_images(shuffled) == (dict(zip(names, FRAMES, strict=True)), {}, '')


@pytest.mark.parametrize(('pattern', 'start'), NAMES_WITH_TIMES)
def test_names_with_times(pattern: str, start: int) -> None:
    offsets = [33_333 * n for n in FRAMES]
    names: list[ImageName] = []
    for offset in offsets:
        s, us = divmod(offset, 1_000_000)
        fields = {'s': start + s, 's0': s, 's2': 20 + s, 'us': us, 'ms3': us // 1000}
        names.append(pattern.format(**fields))
    order = order_images(random.Random(0).sample(names, len(names)))
    assert [*order.stamps_ns] == names
    times = [start * NS_PER_S + 1000 * offset for offset in offsets]
    assert [*order.stamps_ns.values()] == pytest.approx(times, abs=1e6)


@pytest.mark.parametrize(
    'names',
    [
        ['00_58', '00_59', '01_00', '01_01'],
        ['frame9.png', 'frame9b.png', 'frame10.png'],
        ['a.png', 'b.png', 'c.png'],
        [f'IMG_20240305_1459{s}_{n:02d}.jpg' for s in (58, 59) for n in range(9)],
        ['1.png', '01.png', '2.png'],
        ['1.0001.png', '1.0002.png', '2.0001.png', '2.0002.png'],
        [f'{"9" * 30}.png', f'{"9" * 31}.png', 'a.png'],
    ],
)
def test_other_names_are_taken_in_their_natural_order(names: list[ImageName]) -> None:
    order = order_images(names[::-1])
    assert order.numbers == {name: number for number, name in enumerate(names)} or names[0] == '1.png'
    assert sorted(order.numbers.values()) == [*range(len(names))]
    assert 'in the order of their names' in order.note


@pytest.mark.parametrize(
    'names',
    [
        ['cam1/7.png', 'cam2/7.png'],
        [f'cam{c}_{n:02d}' for c in (1, 2) for n in range(9)],
        [f'{n:04d}_{side}.png' for side in ('left', 'right') for n in range(9)],
        [f'video{c}/{n}.png' for c in (1, 2) for n in range(9)],
        [f'cam{c}/{1305031102 + n / 30 + c / 100:.6f}.png' for c in (1, 2) for n in range(9)],
    ],
)
def test_images_of_several_cameras_are_refused(names: list[ImageName]) -> None:
    with pytest.raises(InputError, match='two cameras or videos'):
        order_images(names)
