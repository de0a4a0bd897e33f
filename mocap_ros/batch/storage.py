# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Reading recordings and writing results on any file system of fsspec; results are written whole or not at all."""

from __future__ import annotations

import errno
import json
import shutil
import uuid
from pathlib import Path
from typing import Any, cast

from fsspec.implementations.local import LocalFileSystem
from upath import UPath

from mocap_ros.bags.reader import ROS2_SUFFIXES
from mocap_ros.bags.rosbag2 import METADATA
from mocap_ros.batch.file_systems import find_file_system, is_local
from mocap_ros.batch.recordings import Recording
from mocap_ros.errors import DiskFull, InputError, RecordingError
from mocap_ros.runtime.save_results import SUFFIXES

FREE_BYTES = 200_000_000  # bytes that a temporary copy leaves free, as much as a recording (recorder.min_free_mb)
# Ends of the names of files that a result may consist of; nothing else is ever removed.
RESULT_SUFFIXES = (*ROS2_SUFFIXES, '.yaml', '.png', '.json', *SUFFIXES)
FULL = (errno.ENOSPC, errno.EDQUOT)  # error numbers of a disk, or a quota, that is used up


def join_url(url: str, *parts: str) -> str:
    """Return the URL of something in a folder."""
    return '/'.join((url.rstrip('/'), *parts))


def provide_locally(recording: Recording, scratch: Path, copy_limit_bytes: int) -> Path:
    """Return a path under which a recording can be read.

    This is the place of a local recording. A remote one in MCAP is read where it is, by ranges. Any other remote
    one is copied into a temporary folder first.

    Args:
        recording: the recording.
        scratch: temporary folder.
        copy_limit_bytes: size of a recording above which it is not copied.

    Raises:
        InputError: the recording is too large to be copied.
        DiskFull: the disk has no space for the copy.
        OSError: the recording cannot be read.
    """
    if is_local(recording.url):
        return Path(recording.url)
    if all(url.endswith(('.mcap', f'/{METADATA}')) for url in recording.files):
        return cast(Path, UPath(recording.url))  # has the methods of a path that the reader of bags uses
    if recording.size_bytes > copy_limit_bytes:
        raise InputError(
            f'{recording.url}: must be copied to be read, and has {recording.size_bytes / 1e9:.2f} GB, more than '
            f'the {copy_limit_bytes / 1e9:.2f} GB of --copy-limit; a bag in MCAP is read without a copy'
        )
    if recording.size_bytes + FREE_BYTES > shutil.disk_usage(scratch).free:
        raise DiskFull(f'{scratch}: no space for a copy of {recording.url}')
    copy = scratch / recording.url.rpartition('/')[2]
    for url in recording.files:
        target = copy.parent / url[len(recording.url) - len(copy.name) :]
        target.parent.mkdir(parents=True, exist_ok=True)
        fs, path = find_file_system(url)
        fs.get_file(path, str(target))
    return copy


def publish(finished: Path, url: str) -> None:
    """Move a finished file or folder of the local disk to its place, and replace what is there.

    On the local file system it is renamed. On others the files are sent one by one, each of them whole, and the
    description of a bag last, without which its other files are no bag.

    Raises:
        DiskFull: the disk has no space.
        RecordingError: something is at that place that is no result.
        OSError: the file system fails.
    """
    fs, path = find_file_system(url)
    remove_result(url)
    if isinstance(fs, LocalFileSystem):
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        finished.replace(path)
        return
    files = [finished] if finished.is_file() else sorted(f for f in finished.rglob('*') if f.is_file())
    for file in sorted(files, key=lambda f: f.name == METADATA):
        target = path if file == finished else f'{path}/{file.relative_to(finished).as_posix()}'
        fs.makedirs(target.rpartition('/')[0], exist_ok=True)
        fs.put_file(str(file), target)


def remove_result(url: str) -> None:
    """Remove a result, if there is one.

    Raises:
        RecordingError: there is a file that no run writes; nothing is removed.
    """
    fs, path = find_file_system(url)
    fs.invalidate_cache()
    if not fs.exists(path):
        return
    for file in fs.find(path):
        if not file.endswith(RESULT_SUFFIXES):
            raise RecordingError(f'{url}: not replaced, because no run writes the file {file}')
    fs.rm(path, recursive=True)


def write_whole(url: str, data: bytes) -> None:
    """Write a file so that it is never seen incomplete.

    Raises:
        OSError: the file cannot be written.
    """
    fs, path = find_file_system(url)
    fs.makedirs(path.rpartition('/')[0], exist_ok=True)
    if not isinstance(fs, LocalFileSystem):
        fs.pipe_file(path, data)
        return
    temporary = f'{path}.{uuid.uuid4().hex}.tmp'
    Path(temporary).write_bytes(data)
    Path(temporary).replace(path)


def list_sizes(url: str) -> dict[str, int]:
    """Return the size in bytes of every file at or below a URL, by its path below it; empty if there is none."""
    fs, path = find_file_system(url)
    fs.invalidate_cache()
    if not fs.exists(path):
        return {}
    return {
        file[len(path) :]: int(info['size'] if 'size' in info else fs.size(file))
        for file, info in fs.find(path, detail=True).items()
    }


def read_json_file(url: str) -> dict[str, Any]:
    """Return the content of a JSON file; empty if there is none, or if it is damaged."""
    fs, path = find_file_system(url)
    try:
        content = json.loads(fs.cat_file(path))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def is_disk_full(error: BaseException) -> bool:
    """Return whether an error, or one of those that it was raised for, says that a disk is used up."""
    found: BaseException | None = error
    while found is not None:
        if isinstance(found, DiskFull) or (isinstance(found, OSError) and found.errno in FULL):
            return True
        found = found.__cause__ or found.__context__
    return False
