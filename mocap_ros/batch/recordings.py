# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Find the recordings of a corpus: what a folder, a pattern or a list names, on any file system of fsspec."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import PurePosixPath
from typing import Any

from fsspec.core import has_magic
from fsspec.implementations.local import LocalFileSystem

from mocap_ros.bags.reader import ROS1_SUFFIX, ROS2_SUFFIXES
from mocap_ros.bags.rosbag2 import METADATA
from mocap_ros.batch.file_systems import choose_one_name, find_file_system, is_local, list_sizes
from mocap_ros.errors import InputError
from mocap_ros.formats.detector_json import FILE_SUFFIX as OPENPOSE_SUFFIX
from mocap_ros.runtime.input_kind import VIDEO_SUFFIXES

LIST_SUFFIX = '.txt'  # of a list of recordings, one in each line
DISTANCES_SUFFIX = '_distances.png'  # of the picture of the distances between keyframes
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
    """A bag or a file of keypoints.

    Attributes:
        url: path, or URL of fsspec, of the file or folder.
        name: name of the results: the path below the folder that was searched, without a suffix.
        files: URLs of all its files, sorted.
        size_bytes: bytes in all of them.
    """

    url: str
    name: str
    files: tuple[str, ...]
    size_bytes: int


def find_recordings(
    source: str, work: Work, leave_out: Sequence[str] = (), report: Callable[[str], None] = lambda _: None
) -> list[Recording]:
    """Find the recordings in a folder, or those that a pattern or a list names, largest first.

    Links are followed, and a recording that is reached in several ways is taken once.

    Args:
        source: a recording; a folder, which is searched with all folders in it; a pattern with `*`; or a text file
            (`.txt`) with one of these in each line. Each of them a path or a URL of fsspec.
        work: what is to be done; only bags are replayed.
        leave_out: paths or URLs of folders that are not searched, as those of the results.
        report: function that is called with a line about files that are no bags, where only bags are taken.

    Raises:
        InputError: there is nothing, it cannot be read, or the results of two recordings
            would have the same place.
    """
    sources = _read_list(source) if source.endswith(LIST_SUFFIX) else [source]
    sizes: dict[str, int] = {}
    for each in sources:
        sizes.update(_list_files(each))
    left_out = tuple(_write_url(folder).rstrip('/') + '/' for folder in leave_out)
    sizes = {url: size for url, size in sizes.items() if not url.startswith(left_out)}
    once = choose_one_name(url for url in sizes if is_local(url))
    sizes = {url: size for url, size in sizes.items() if url in once or not is_local(url)}
    groups = _group_files(sizes, work)
    if not groups:
        kind = 'bag' if work is Work.REPLAY else 'bag or file of keypoints'
        raise InputError(f'{source}: there is no {kind}')
    if work is Work.REPLAY and (others := len(_group_files(sizes, Work.RECONSTRUCT).keys() - groups)):
        report(f'{source}: {others} recordings are no bags and are left out; --work reconstruct takes them')
    base = _find_base(sources, list(groups))
    names = {url: _make_name(url, base, is_folder=files != [url]) for url, files in groups.items()}
    name, count = Counter(names.values()).most_common(1)[0]
    if count > 1:
        raise InputError(f'{source}: {count} recordings would have results of the name {name}')
    _refuse_nested_names(source, names.values())
    if work is Work.KEYFRAMES:
        _refuse_shared_pictures(source, names.values())
    found = [
        Recording(url, names[url], tuple(sorted(files)), sum(sizes[file] for file in files))
        for url, files in groups.items()
    ]
    return sorted(found, key=lambda r: (-r.size_bytes, r.name))


def _refuse_nested_names(source: str, names: Iterable[str]) -> None:
    """Raise InputError if the results of one recording would be in the folder of another's."""
    known = set(names)
    for name in sorted(known):
        parents = (name[:i] for i, letter in enumerate(name) if letter == '/')
        if (parent := next((p for p in parents if p in known), None)) is not None:
            raise InputError(
                f'{source}: the result of {name} would be inside that of {parent}; rename one of the recordings'
            )


def _refuse_shared_pictures(source: str, names: Iterable[str]) -> None:
    """Raise InputError if one recording's picture of distances would be another's picture of keyframes."""
    known = set(names)
    for name in sorted(known):
        other = name + DISTANCES_SUFFIX.removesuffix('.png')
        if other in known:
            raise InputError(f'{source}: {name} and {other} would share a picture; rename one of the recordings')


def compute_content_key(recording: Recording) -> str:
    """Return a checksum of the content of a recording, as hexadecimals.

    A file on a file system that keeps a checksum of it is not read. Times of change do not matter.

    Raises:
        OSError: a file cannot be read.
    """
    digest = hashlib.sha256()
    for url in recording.files:
        fs, path = find_file_system(url)
        digest.update(url[len(recording.url) :].encode() + b'\0')
        checksum = '' if isinstance(fs, LocalFileSystem) else _find_checksum(fs, path)
        if checksum:
            digest.update(checksum.encode())
            continue
        with fs.open(path, 'rb') as stream:
            while block := stream.read(READ_BYTES):
                digest.update(block)
    return digest.hexdigest()


def _find_checksum(fs: Any, path: str) -> str:
    """Return the checksum of a file's content that its file system keeps; empty if it keeps none."""
    fs.invalidate_cache()
    info: Mapping[str, Any] = fs.info(path)
    return next((str(info[key]) for key in CHECKSUM_KEYS if info.get(key)), '')


def _read_list(source: str) -> list[str]:
    try:
        fs, path = find_file_system(source)
        with fs.open(path, 'rt', encoding='utf-8-sig') as file:
            lines = [line.strip() for line in file]
    except (OSError, ValueError, ImportError) as error:
        raise InputError(f'{source}: {_describe(error)}') from None
    return [line for line in lines if line and not line.startswith('#')]


def _list_files(source: str) -> dict[str, int]:
    """Return the size in bytes of every file in a folder or under a pattern, by URL; or of the file itself."""
    try:
        fs, path = find_file_system(source)
        matches = fs.glob(path) if has_magic(path) and not fs.exists(path) else [path]
        found: dict[str, int] = {}
        for match in matches:
            found.update((_write_url_of(fs, file), size) for file, size in list_sizes(fs, match))
    except (OSError, ValueError, TypeError, ImportError, NotImplementedError) as error:
        raise InputError(f'{source}: {_describe(error)}') from None
    if not found:
        raise InputError(f'{source}: no such file, and no folder with files')
    return found


def _describe(error: Exception) -> str:
    """Return in one line why a file system could not be used."""
    if isinstance(error, FileNotFoundError):
        return 'No such file or directory'
    return ' '.join(str(error).split()) or type(error).__name__


def _write_url_of(fs: Any, path: str) -> str:
    """Return the URL of a path on a file system; a local path stays a path."""
    return path if isinstance(fs, LocalFileSystem) else str(fs.unstrip_protocol(path))


def _write_url(url: str) -> str:
    """Return a URL as `_list_files` writes it."""
    try:
        return _write_url_of(*find_file_system(url))
    except (ValueError, ImportError) as error:
        raise InputError(f'{url}: {_describe(error)}') from None


def _group_files(files: Iterable[str], work: Work) -> dict[str, list[str]]:
    """Return the files of each recording, by the URL of the recording: a folder, or a file of its own."""
    files = list(files)
    folders = {_parent(url) for url in files if _name(url) == METADATA}
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


def _find_base(sources: list[str], recordings: list[str]) -> str:
    """Return the URL below which the paths of recordings are their names."""
    if len(sources) > 1:
        parents = [_parent(url).split('/') for url in recordings]
        shared = [parts[0] for parts in zip(*parents, strict=False) if len(set(parts)) == 1]
        is_prefix = [all(p[: i + 1] == parents[0][: i + 1] for p in parents) for i in range(len(shared))]
        return '/'.join(parents[0][: sum(is_prefix)])
    source = sources[0]
    base = _write_url(source)
    if base in recordings:
        return _parent(base)
    fs, path = find_file_system(base)
    while has_magic(base) and not fs.exists(path):
        base = _parent(base)
        fs, path = find_file_system(base)
    return base.rstrip('/')


def _make_name(url: str, base: str, *, is_folder: bool) -> str:
    relative = PurePosixPath(url[len(base) :].lstrip('/'))
    return str(relative if is_folder else relative.with_suffix(''))


def _parent(url: str) -> str:
    return url.rpartition('/')[0]


def _name(url: str) -> str:
    return url.rpartition('/')[2]
