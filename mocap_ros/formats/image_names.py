# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The order of images by their names: times, numbers of frames, or the natural order.

Two images never become one frame. In this order,

- names that hold a time give it: seconds, milliseconds, microseconds or nanoseconds since 1970 (`1305031102.1753`,
  `1403636579763555584`), dates with the time of day, or decimal seconds. Times are believed if they differ and are
  at least `MIN_STEP_S` apart. Dates with numbers below 60, as in `20240101_000007`, are no times: all would be in
  the first minute after midnight;
- a number that stands at the same place in all names, and increases in their natural order, in which 10 follows 9,
  is the number of the frame. Of several such numbers, that with the smallest range is;
- other names are taken in their natural order, as frames without a gap.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from datetime import datetime, timezone
from itertools import pairwise
from pathlib import PurePosixPath
from typing import NamedTuple, TypeAlias

import numpy as np

from mocap_ros.errors import InputError
from mocap_ros.units import NS_PER_S

ImageName: TypeAlias = int | str  # number of a frame, or the name of an image's file

MIN_STEP_S = 0.002  # s; median distance of images from which on numbers are times; nearer ones are counters
CLOCK_RANGE_S = 978_307_200, 4_102_444_800  # s since 1970; the years 2001 to 2099
MAX_DIGITS = 19  # of a number; those of hashes may have more
MAX_FRAME_NUMBER = 10**12  # larger numbers are times, or no numbers of frames
DIGITS_OF_UNIT = {13: 3, 16: 6, 19: 9}  # digits of a time since 1970, and how many of them are a fraction of a s
FRACTION_DIGITS = (3, 6, 9)  # of fractions of a second that follow other characters than a point

# What distinguishes cameras and videos that see the same frames.
_SOURCE = re.compile(
    r'(cam|camera|view|video|vid|seq|clip|kinect|device)[\W_]*\d{1,2}(?![\d.])|left|right', re.IGNORECASE
)
SEVERAL_SOURCES = 'images {!r} and {!r}: of two cameras or videos; a file must hold one video'
_SUFFIX = re.compile(r'\.[A-Za-z][A-Za-z0-9]{0,4}$')
_NUMBER = re.compile(rf'(\d{{1,{MAX_DIGITS}}})')
_EPOCH = re.compile(r'(?<!\d)(\d{9,10})([._-])(\d{1,9})(?!\d)')
_WHOLE_EPOCH = re.compile(r'(?<!\d)(\d{13}|\d{16}|\d{19})(?!\d)')
_DATE = re.compile(r'(?<!\d)((?:19|20)\d\d)\D?' + r'(\d\d)\D?' * 4 + r'(\d\d)(?:(\D?)(\d{1,9}))?(?!\d)')
_COUNTED = re.compile(r'\d\D0000\d\d$')  # a date with a number of six digits that is no later time of day
_DECIMAL = re.compile(r'(?<![\d.])(\d{1,6})(\.)(\d{1,9})(?![\d.])')


class ImageOrder(NamedTuple):
    """The numbers of the frames or, where the names are times, the times in ns; each by name, in that order."""

    numbers: dict[ImageName, int]
    stamps_ns: dict[ImageName, int]
    note: str = ''


def order_images(names: Iterable[ImageName]) -> ImageOrder:
    """Return the order of different images."""
    names = list(names)
    if all(isinstance(name, int) and abs(name) < MAX_FRAME_NUMBER for name in names):
        return ImageOrder({name: int(name) for name in sorted(names, key=int)}, {})
    stems = [_SUFFIX.sub('', str(name)) for name in names]
    if times := _read_times(stems):
        sources = [[match[0] for match in _SOURCE.finditer(stem)] for stem in stems]
        if other := next((i for i, source in enumerate(sources) if source != sources[0]), 0):
            raise InputError(SEVERAL_SOURCES.format(names[0], names[other]))
        return ImageOrder({}, dict(sorted(zip(names, times, strict=True), key=lambda pair: pair[1])))
    _check_one_source(stems, names)
    parts = [_NUMBER.split(stem) for stem in stems]
    keys = [[(int(p), '') if i % 2 else (0, p) for i, p in enumerate(part)] for part in parts]
    ordered = [i for _, _, i in sorted(zip(keys, map(str, names), range(len(names)), strict=True))]
    numbers = _read_numbers([parts[i] for i in ordered])
    if numbers:
        return ImageOrder({names[i]: number for i, number in zip(ordered, numbers, strict=True)}, {})
    first, last = names[ordered[0]], names[ordered[-1]]
    note = f'images are taken in the order of their names, from {first!r} to {last!r}, without gaps'
    return ImageOrder({names[i]: number for number, i in enumerate(ordered)}, {}, note)


def _read_numbers(parts: Sequence[Sequence[str]]) -> list[int]:
    """Return the number of each frame, of sorted names that are split at numbers; nothing if there is none."""
    if len({len(part) for part in parts}) > 1 or len(parts[0]) < 2:
        return []
    columns = [[int(part[i]) for part in parts] for i in range(1, len(parts[0]), 2)]
    if len(parts) == 1:
        return columns[-1]
    increasing = [column for column in columns if all(a < b for a, b in pairwise(column))]
    return min(increasing, key=lambda column: column[-1] - column[0], default=[])


def _check_one_source(stems: Sequence[str], names: Sequence[ImageName]) -> None:
    """Raise InputError if the images are of several cameras or videos, where the same numbers repeat."""
    files = [PurePosixPath(stem).name for stem in stems]
    frames = [_SOURCE.sub('', file) for file in files]
    keys = frames if len(set(frames)) > 1 else files
    if len(set(keys)) < len(names):
        first = next(i for i, key in enumerate(keys) if key in keys[:i])
        other, name = names[keys.index(keys[first])], names[first]
        raise InputError(SEVERAL_SOURCES.format(other, name))


def _read_times(stems: Sequence[str]) -> list[int]:
    for pattern, read in (
        (_EPOCH, _read_seconds),
        (_DATE, _read_dates),
        (_WHOLE_EPOCH, _read_whole),
        (_DECIMAL, _read_seconds),
    ):
        matches = [match for stem in stems if (match := pattern.search(PurePosixPath(stem).name))]
        if len(matches) < len(stems):
            continue
        times = read(matches)
        is_clock = pattern is not _DECIMAL
        if len(set(times)) < len(stems) or (len(stems) == 1 and not is_clock):
            continue
        if is_clock and not all(CLOCK_RANGE_S[0] <= t / NS_PER_S < CLOCK_RANGE_S[1] for t in times):
            continue
        if len(times) < 2 or float(np.median(np.diff(sorted(times)))) >= MIN_STEP_S * NS_PER_S:
            return times
    return []


def _read_seconds(matches: Sequence[re.Match[str]]) -> list[int]:
    """Read seconds and their fraction: decimals after a point, else milli-, micro- or nanoseconds."""
    fractions = _read_fractions([(match[2], match[3]) for match in matches])
    if fractions is None:
        return []
    return [int(match[1]) * NS_PER_S + fraction for match, fraction in zip(matches, fractions, strict=True)]


def _read_fractions(texts: Sequence[tuple[str, str]]) -> list[int] | None:
    """Return the ns of separators and the digits behind them; None if the digits are a counter."""
    width = max(len(digits) for _, digits in texts)
    if all(separator == '.' or not digits for separator, digits in texts):
        return [int(digits.ljust(9, '0')) for _, digits in texts]
    return [int(digits or 0) * 10 ** (9 - width) for _, digits in texts] if width in FRACTION_DIGITS else None


def _read_whole(matches: Sequence[re.Match[str]]) -> list[int]:
    return [int(match[1]) * 10 ** (9 - DIGITS_OF_UNIT[len(match[1])]) for match in matches]


def _read_dates(matches: Sequence[re.Match[str]]) -> list[int]:
    if all(_COUNTED.search(match[0]) for match in matches):
        return []
    try:
        dates = [datetime(*map(int, match.groups()[:6]), tzinfo=timezone.utc) for match in matches]  # type: ignore[misc, arg-type]
    except ValueError:
        return []
    fractions = _read_fractions([(match[7] or '', match[8] or '') for match in matches]) or [0] * len(dates)
    return [round(date.timestamp()) * NS_PER_S + ns for date, ns in zip(dates, fractions, strict=True)]
