# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Find the recordings of a corpus: what a folder, a pattern or a list names, on any file system of fsspec.

What has no `://` is a local path. Everything else is a URL of fsspec, such as `s3://bucket/folder`, whose path has
the methods of a local one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import pairwise
from pathlib import Path, PurePosixPath
from typing import NamedTuple, cast

from fsspec.core import has_magic
from upath import UPath

from mocap_ros.bags.reader import ROS1_SUFFIX, ROS2_SUFFIXES, is_bag
from mocap_ros.bags.rosbag2 import METADATA
from mocap_ros.errors import InputError
from mocap_ros.formats.detector_json import FILE_SUFFIX as OPENPOSE_SUFFIX
from mocap_ros.recordings.input_kind import VIDEO_SUFFIXES

# Ends of the paths of files of recordings
SUFFIXES = (f'/{METADATA}', *ROS2_SUFFIXES, ROS1_SUFFIX, '.npz', '.json', *VIDEO_SUFFIXES)


class BatchInput(NamedTuple):
    """A bag or a file of keypoints."""

    path: Path  # file or folder, on any file system
    name: str  # of the results: the path below the folder that was searched, without a suffix


def open_path(text: str) -> Path:
    """Return the absolute path that a text names, or that of a URL on its file system."""
    try:
        path = cast(Path, UPath(text)) if '://' in text else Path(text).absolute()
        path.exists()  # or what the file system needs is not installed
    except (ImportError, ValueError, TypeError, NotImplementedError) as error:
        raise InputError(f'{text}: {error}') from None
    return path


def list_files(path: Path) -> list[Path]:
    """Return the files of a recording, sorted: the file that it is, or those of the folder."""
    return sorted((file for file in path.iterdir() if file.is_file()), key=str) if path.is_dir() else [path]


def find_recordings(
    source: str, report: Callable[[str], None], *, only_bags: bool, leave_out: Iterable[Path] = ()
) -> list[BatchInput]:
    """Find the recordings in a folder, or those that a pattern or a list names, largest first.

    The source is a path or a URL: a recording; a folder, which is searched with all folders in it; a pattern with
    `*`; or a text file (`.txt`) with one of these in each line, whose results are named by their whole paths.
    Links are followed, and a folder that is reached in several ways is searched once; the folders `leave_out` are
    not. A folder with the description of a bag, or with files of OpenPose, is one recording. `report` gets a line
    about recordings that are no bags, where only bags are wanted.
    """
    sources, is_list = [source], source.endswith('.txt')
    if is_list:
        lines = map(str.strip, open_path(source).read_text('utf-8-sig').splitlines())
        sources = [line for line in lines if line and not line.startswith('#')]
    seen, names = {folder.resolve() for folder in leave_out}, dict[Path, PurePosixPath]()
    for pattern in map(open_path, sources):
        base = pattern
        while has_magic(str(base)) and not base.exists():
            base = base.parent
        if not base.exists():
            raise InputError(f'{base}: No such file or directory')
        matches = [base] if base == pattern else base.glob(str(pattern.relative_to(base)))
        for path in (path for match in matches for path in _search(match, seen)):
            folder = path.anchor if is_list else base if base in path.parents else path.parent
            below = PurePosixPath(str(path.relative_to(folder)))
            names[path] = below if path.is_dir() else below.with_suffix('')
    bags = {path: name for path, name in names.items() if is_bag(path)}
    if only_bags and (others := len(names) - len(bags)):
        report(f'{source}: {others} recordings are no bags and are left out; --work reconstruct takes them')
        names = bags
    if not names:
        raise InputError(f'{source}: there is no {"bag" if only_bags else "bag or file of keypoints"}')
    for first, second in pairwise(sorted(names.values())):
        if second.is_relative_to(first):
            reason = f'the results of {first} and {second} would overwrite each other; rename one of them'
            raise InputError(f'{source}: {reason}')
    sizes = {path: sum(file.stat().st_size for file in list_files(path)) for path in names}
    largest_first = sorted(names, key=lambda path: (-sizes[path], str(path)))
    return [BatchInput(path, str(names[path])) for path in largest_first]


def _search(path: Path, seen: set[Path]) -> Iterator[Path]:
    """Yield the recordings at or below a path, some repeatedly, but not those of folders that were `seen`."""
    if path.is_dir():
        folder = path.resolve()
        if folder not in seen:
            seen.add(folder)
            for each in path.iterdir():
                yield from _search(each, seen)
    elif str(path).lower().endswith(SUFFIXES) and path.is_file():
        is_part = (path.parent / METADATA).exists() or path.name.endswith(OPENPOSE_SUFFIX)
        yield path.parent if is_part else path
