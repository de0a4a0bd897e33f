# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Find the recordings of a corpus: what a folder, a pattern or a list names, on any file system of fsspec.

What has no `://` is a local path, whatever else is in its name, such as `::`, by which fsspec chains file systems.
Everything else is a URL of fsspec, such as `s3://bucket/folder`.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise, takewhile
from pathlib import Path, PurePosixPath
from typing import Any

import fsspec
from fsspec.core import has_magic
from fsspec.implementations.local import LocalFileSystem

from mocap_ros.bags.reader import ROS1_SUFFIX, ROS2_SUFFIXES
from mocap_ros.bags.rosbag2 import METADATA
from mocap_ros.errors import InputError
from mocap_ros.formats.detector_json import FILE_SUFFIX as OPENPOSE_SUFFIX
from mocap_ros.runtime.input_kind import VIDEO_SUFFIXES

LIST_SUFFIX = '.txt'  # of a list of recordings, one in each line
BAG_SUFFIXES = (*ROS2_SUFFIXES, ROS1_SUFFIX)
OTHER_SUFFIXES = ('.npz', '.json', *VIDEO_SUFFIXES)  # of what can be reconstructed and is no bag
# Checksums of the content that file systems keep, so that a file need not be read: S3 (and others), Google, Azure.
CHECKSUM_KEYS = ('ETag', 'md5Hash', 'content_md5')
READ_BYTES = 1 << 20  # bytes of a file that are read at a time for its checksum; bounds the memory


class Work(str, Enum):
    """What is done with every recording."""

    REPLAY = 'replay'
    RECONSTRUCT = 'reconstruct'
    KEYFRAMES = 'keyframes'


@dataclass(frozen=True)
class Recording:
    """A bag or a file of keypoints."""

    url: str  # path, or URL of fsspec, of the file or folder
    name: str  # name of the results: the path below the folder that was searched, without a suffix
    files: tuple[str, ...]  # URLs of all its files, sorted
    size_bytes: int  # bytes in all of them


def open_file_system(url: str) -> tuple[Any, str]:
    """Return the file system of a path or URL, and the path on it."""
    if '://' in url:
        fs, path = fsspec.url_to_fs(url)
        return fs, str(path)
    return LocalFileSystem(), str(LocalFileSystem._strip_protocol(url))


def is_local(url: str) -> bool:
    """Return whether a path or URL is on the local file system."""
    return isinstance(open_file_system(url)[0], LocalFileSystem)


def find_recordings(
    source: str, work: Work, leave_out: Sequence[str] = (), report: Callable[[str], None] = lambda _: None
) -> list[Recording]:
    """Find the recordings in a folder, or those that a pattern or a list names, largest first.

    The source is a path or a URL of fsspec: a recording; a folder, which is searched with all folders in it; a
    pattern with `*`; or a text file (`.txt`) with one of these in each line. Links are followed, and a folder that
    is reached in several ways is searched once; the folders `leave_out`, as of the results, are not. Only bags are
    replayed, and `report` gets a line about other files.
    """
    left_out = tuple(f'{_write_url(*open_file_system(folder))}/' for folder in leave_out)
    sizes: dict[str, int] = {}
    try:
        sources = _read_list(source) if source.endswith(LIST_SUFFIX) else [source]
        for each in sources:
            base, found = _list_files(each)
            sizes |= {url: size for url, size in found.items() if not url.startswith(left_out)}
    except (OSError, ValueError, TypeError, ImportError, NotImplementedError) as error:
        reason = (
            'No such file or directory' if isinstance(error, FileNotFoundError) else ' '.join(str(error).split())
        )
        raise InputError(f'{source}: {reason or type(error).__name__}') from None
    groups = _group_files(sizes, work)
    if not groups:
        raise InputError(f'{source}: there is no {"bag" if work is Work.REPLAY else "bag or file of keypoints"}')
    if work is Work.REPLAY and (others := len(_group_files(sizes, Work.RECONSTRUCT).keys() - groups)):
        report(f'{source}: {others} recordings are no bags and are left out; --work reconstruct takes them')
    if len(sources) > 1 or base in groups:
        parts = zip(*(url.split('/')[:-1] for url in groups), strict=False)
        base = '/'.join(part for part, *_ in takewhile(lambda same: len(set(same)) == 1, parts))
    recordings = []
    for url, files in groups.items():
        name = PurePosixPath(url[len(base) :].lstrip('/'))
        name = name.with_suffix('') if files == [url] else name
        recordings.append(Recording(url, str(name), tuple(sorted(files)), sum(sizes[file] for file in files)))
    for first, second in pairwise(sorted(recording.name.split('/') for recording in recordings)):
        if second[: len(first)] == first:
            one, other = '/'.join(first), '/'.join(second)
            raise InputError(
                f'{source}: the results of {one} and {other} would overwrite each other; rename one of them'
            )
    return sorted(recordings, key=lambda r: (-r.size_bytes, r.name))


def compute_content_key(recording: Recording) -> str:
    """Return a checksum of the content of a recording, as hexadecimals.

    A file on a file system that keeps a checksum of it is not read. Times of change do not matter.
    """
    digest = hashlib.sha256()
    for url in recording.files:
        fs, path = open_file_system(url)
        fs.invalidate_cache()
        digest.update(url[len(recording.url) :].encode('utf-8', 'surrogateescape') + b'\0')
        info: Mapping[str, Any] = fs.info(path)
        if checksum := next((str(info[key]) for key in CHECKSUM_KEYS if info.get(key)), ''):
            digest.update(checksum.encode())
            continue
        with fs.open(path, 'rb') as stream:
            while block := stream.read(READ_BYTES):
                digest.update(block)
    return digest.hexdigest()


def _read_list(source: str) -> list[str]:
    fs, path = open_file_system(source)
    with fs.open(path, 'rt', encoding='utf-8-sig') as file:
        lines = [line.strip() for line in file]
    return [line for line in lines if line and not line.startswith('#')]


def _list_files(source: str) -> tuple[str, dict[str, int]]:
    """Return the folder that a source is, or its pattern begins with, and the bytes of each file by URL."""
    fs, path = open_file_system(source)
    is_pattern = has_magic(path) and not fs.exists(path)
    sizes: dict[str, int] = {}
    for match in fs.glob(path) if is_pattern else [path]:
        if isinstance(fs, LocalFileSystem):
            files = _walk(match) if Path(match).is_dir() else [match]
            sizes |= {file: Path(file).stat().st_size for file in files if Path(file).is_file()}
        else:
            found = fs.find(match, detail=True).items()
            sizes |= {_write_url(fs, file): int(info.get('size') or fs.size(file)) for file, info in found}
    if not sizes:
        raise InputError(f'{source}: no such file, and no folder with files')
    base = _write_url(fs, path)
    return (_parent(re.split(r'[*?[]', base)[0]) if is_pattern else base), sizes


def _walk(top: str) -> Iterator[str]:
    """Yield all files below a folder; each folder is searched once, those behind links last."""
    tops, seen = [top], set[str]()
    for each in tops:
        for folder, folders, files in os.walk(each, onerror=_refuse):
            path = os.path.realpath(folder)
            if path in seen:
                folders.clear()
                continue
            seen.add(path)
            folders.sort()
            tops += [path for path in (f'{folder}/{name}' for name in folders) if Path(path).is_symlink()]
            yield from (f'{folder}/{name}' for name in files)


def _refuse(error: OSError) -> None:
    raise error


def _group_files(files: Iterable[str], work: Work) -> dict[str, list[str]]:
    """Return the files of each recording, by the URL of the recording: a folder, or a file of its own."""
    files = list(files)
    folders = {_parent(url) for url in files if url.endswith(f'/{METADATA}')}
    if work is not Work.REPLAY:
        folders |= {_parent(url) for url in files if url.endswith(OPENPOSE_SUFFIX)}
    others = () if work is Work.REPLAY else OTHER_SUFFIXES
    groups: dict[str, list[str]] = {}
    for url in files:
        if _parent(url) in folders:
            groups.setdefault(_parent(url), []).append(url)
        elif url.endswith(BAG_SUFFIXES) or url.lower().endswith(others):
            groups[url] = [url]
    return groups


def _write_url(fs: Any, path: str) -> str:
    """Return the URL of a path on a file system; a local path stays a path."""
    return path if isinstance(fs, LocalFileSystem) else str(fs.unstrip_protocol(path)).rstrip('/')


def _parent(url: str) -> str:
    return url.rpartition('/')[0]
