# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Reading text and JSON files of limited size, and one-line errors for files that cannot be read or written."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from mocap_ros.errors import InputError, MocapError
from mocap_ros.input_file import NEITHER_FILE_NOR_FOLDER, open_input_file

MAX_FILE_BYTES = 256 << 20  # guards the memory; an hour of one person's COCO results at 30 Hz is about 100 MB


def read_text(path: Path, errors: str = 'strict', max_bytes: int = MAX_FILE_BYTES) -> str:
    """Read a UTF-8 file, with or without a byte-order mark.

    Args:
        path: path of the file.
        errors: what to do about bytes that are not UTF-8, as in `bytes.decode`.
        max_bytes: size of the file in bytes above which it is refused.

    Raises:
        InputError: the path is not that of a file, or the file is too large or not UTF-8; the error names the
            path.
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
    """Read a JSON file.

    Raises:
        InputError: the file cannot be read, as in `read_text`, or is not JSON; the error names the file.
    """
    text = read_text(path)
    try:
        return json.loads(text)
    except ValueError as error:
        raise InputError(f'{path}: not JSON: {error}') from None
    except RecursionError:
        raise InputError(f'{path}: not JSON: nested too deep') from None


def check_output(path: Path, *sources: Path) -> None:
    """Check that a file can be written, before the work that produces its content.

    Args:
        path: path of the file.
        sources: input files, which must not be overwritten.

    Raises:
        MocapError: `path` is one of the sources, a folder or a named pipe, or its folder does not exist or is not
            writable; the error names the file.
    """
    if path.exists() and any(source.exists() and path.samefile(source) for source in sources):
        raise MocapError(f'{path}: not written, because it is the input file')
    if path.is_dir():
        raise MocapError(f'{path}: cannot be written: is a folder')
    if (
        path.resolve().is_fifo()
    ):  # opening it would wait for a reader; an open pipe such as /dev/stdout has no path
        raise MocapError(f'{path}: cannot be written: {NEITHER_FILE_NOR_FOLDER}')
    if not path.parent.is_dir():
        raise MocapError(f'{path}: cannot be written: there is no folder {path.parent}')
    if not os.access(path if path.exists() else path.parent, os.W_OK):
        raise MocapError(f'{path}: cannot be written: {os.strerror(errno.EACCES)}')


@contextmanager
def guard_output(path: Path, *sources: Path) -> Iterator[None]:
    """Guard the code that writes a file.

    Args:
        path: path of the file that is written.
        sources: input files, which must not be overwritten.

    Raises:
        MocapError: `check_output` refuses the path, or the file cannot be written; the error names the file.
    """
    check_output(path, *sources)
    try:
        yield
    except OSError as error:
        raise MocapError(f'{path}: cannot be written: {error.strerror or error}') from None
