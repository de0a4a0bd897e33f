# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Images are ordered by the times, the numbers or the natural order of their names, and two are never one."""

from __future__ import annotations

import random

import pytest

from mocap_ros.errors import InputError
from mocap_ros.formats.image_names import ImageName, order_images
from mocap_ros.units import NS_PER_S

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
