"""Files in general: text and JSON of strangers, bounded, and one clear line for whatever goes wrong."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from mocap_ros.errors import InputError, MocapError

LARGEST_FILE = 256 << 20


def read_text(path: Path, errors: str = 'strict', largest: int = LARGEST_FILE) -> str:
    """The content of a UTF-8 file.

    Args:
        path: of the file.
        errors: what to do about other bytes, as of `bytes.decode`.
        largest: bytes.

    Raises:
        InputError: no such file, too large, or not UTF-8; names it.
    """
    try:
        with path.open('rb') as file:
            content = file.read(largest + 1)
    except OSError as error:
        raise InputError(f'{path}: {error.strerror or error}') from None
    if len(content) > largest:
        raise InputError(f'{path}: larger than {largest >> 20} MiB')
    try:
        return content.decode('utf-8-sig', errors)
    except UnicodeDecodeError as error:
        raise InputError(f'{path}: not UTF-8 at byte {error.start}') from None


def read_json(path: Path) -> Any:
    """The content of a JSON file.

    Raises:
        InputError: as `read_text`, or not JSON.
    """
    text = read_text(path)
    try:
        return json.loads(text)
    except ValueError as error:
        raise InputError(f'{path}: not JSON: {error}') from None
    except RecursionError:
        raise InputError(f'{path}: not JSON: nested too deep') from None


@contextmanager
def writing(path: Path, *sources: Path) -> Iterator[None]:
    """Around whatever writes `path`: a failing disk is a MocapError that names the file.

    Args:
        path: to write.
        sources: files that it is made from, which are not written over.
    """
    if path.exists() and any(source.exists() and path.samefile(source) for source in sources):
        raise MocapError(f'{path}: not written: it is what was read')
    try:
        yield
    except OSError as error:
        raise MocapError(f'{path}: cannot be written: {error.strerror or error}') from None
