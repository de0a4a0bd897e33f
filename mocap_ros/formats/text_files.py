# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Reading text and JSON files of limited size, replacing files by whole new ones, and one-line errors for both."""

from __future__ import annotations

import errno
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from mocap_ros.errors import InputError, MocapError, describe_parse_error
from mocap_ros.input_file import NEITHER_FILE_NOR_FOLDER, open_input_file

MAX_FILE_BYTES = 256 << 20  # guards the memory; an hour of one person's COCO results at 30 Hz is about 100 MB
MAX_QUOTED_CHARACTERS = 60  # of a line in an error message
# Positions of all joints in all frames of motion capture, of some 100 bytes each with the rotations. An hour of 80
# joints at 120 Hz has 35 million; a frame may take two bytes of a file, so the size of the file is no limit.
MAX_POSITIONS = 40_000_000


def read_text(path: Path, errors: str = 'strict', max_bytes: int = MAX_FILE_BYTES) -> str:
    """Read a UTF-8 file of at most `max_bytes`, with or without a byte-order mark.

    `errors` says what to do about bytes that are not UTF-8, as in `bytes.decode`.
    """
    try:
        with open_input_file(path) as file:
            size = os.fstat(file.fileno()).st_size
            content = file.read(min(size or max_bytes, max_bytes) + 1)  # files of /proc state no size
    except OSError as error:
        raise InputError(f'{path}: {error.strerror or error}') from None
    if len(content) > max_bytes:
        raise InputError(f'{path}: larger than {max_bytes >> 20} MiB')
    try:
        return content.decode('utf-8-sig', errors)
    except UnicodeDecodeError as error:
        raise InputError(f'{path}: not UTF-8 at byte {error.start}') from None


def read_json(path: Path) -> Any:
    """Read a JSON file; InputError where it cannot be read, as in `read_text`, or is not JSON."""
    text = read_text(path)
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f'{path}: not JSON: {describe_parse_error(error)}') from None


def quote_line(line: str) -> str:
    """Return the beginning of a line, quoted, for an error message."""
    return repr(line.strip()[:MAX_QUOTED_CHARACTERS])


def check_position_count(frames: int, joints: int) -> None:
    """Check that the positions of all joints in all frames fit into the memory; else raise an InputError."""
    if frames * joints > MAX_POSITIONS:
        raise InputError(f'{frames} frames of {joints} joints, more than {MAX_POSITIONS} positions')


def check_output(path: Path, *sources: Path) -> None:
    """Check that a file can be written, and is none of the sources, before the work that produces its content."""
    if path.exists() and any(source.exists() and path.samefile(source) for source in sources):
        raise MocapError(f'{path}: not written, because it is the input file')
    if path.is_dir():
        raise MocapError(f'{path}: cannot be written: is a folder')
    # Opening a named pipe would wait for a reader; an open pipe such as /dev/stdout has no path.
    if Path(os.path.realpath(path)).is_fifo():
        raise MocapError(f'{path}: cannot be written: {NEITHER_FILE_NOR_FOLDER}')
    nearest = next(place for place in (path, *path.absolute().parents) if place.exists())
    if nearest != path and not nearest.is_dir():
        raise MocapError(f'{path}: cannot be written: {nearest} is no folder')
    if not os.access(nearest, os.W_OK):
        raise MocapError(f'{path}: cannot be written: {os.strerror(errno.EACCES)}')


@contextmanager
def replace_output(path: Path, *sources: Path) -> Iterator[Path]:
    """Yield the path to which a file is to be written, and put that file in place when all of it is written.

    The yielded path has the name of the file, in a temporary folder beside it; missing folders are made. An error
    or an interrupt in the block leaves the old file as it was, and nothing of the new one. A link stays, and the
    file that it points to is replaced; an existing file keeps its permissions. Paths in /dev and /proc and devices
    are written directly: then `path` itself is yielded.
    """
    check_output(path, *sources)
    if path.exists() and (not path.is_file() or path.absolute().parts[1:2] in (('dev',), ('proc',))):
        with _naming_output(path):
            yield path
        return
    place = Path(os.path.realpath(path))
    with _naming_output(path):
        place.parent.mkdir(parents=True, exist_ok=True)
    with _naming_output(path), TemporaryDirectory(dir=place.parent, prefix='.mocap_ros_') as folder:
        unfinished = Path(folder) / path.name
        try:
            yield unfinished
        except MocapError as error:
            raise type(error)(str(error).replace(str(unfinished), str(path))) from None
        if place.exists():
            shutil.copymode(place, unfinished)
        unfinished.replace(place)


@contextmanager
def _naming_output(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise MocapError(f'{path}: cannot be written: {error.strerror or error}') from None
