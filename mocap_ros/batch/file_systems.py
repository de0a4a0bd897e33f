# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The file system of a path or URL.

What has no `://` is a local path, whatever else is in its name, such as `::`, by which fsspec chains file systems.
Everything else is a URL of fsspec, such as `s3://bucket/folder`.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import fsspec
from fsspec.implementations.local import LocalFileSystem

URL_MARK = '://'  # what tells a URL from a local path


def find_file_system(url: str) -> tuple[Any, str]:
    """Return the file system of a path or URL, and the path on it.

    Raises:
        ValueError: the URL is of no known file system.
        ImportError: a library for the file system is not installed.
    """
    if URL_MARK in url:
        fs, path = fsspec.url_to_fs(url)
        return fs, str(path)
    return LocalFileSystem(), str(LocalFileSystem._strip_protocol(url))


def is_local(url: str) -> bool:
    """Return whether a path or URL is on the local file system."""
    return isinstance(find_file_system(url)[0], LocalFileSystem)


def list_sizes(fs: Any, path: str) -> Iterator[tuple[str, int]]:
    """Yield every file in a folder and in all folders in it, or the file itself, with its size in bytes.

    Links to files and folders are followed, each folder once; links to nothing are left out.

    Raises:
        OSError: it cannot be read.
    """
    if isinstance(fs, LocalFileSystem):
        found = _walk(path) if Path(path).is_dir() else [path]
        yield from ((file, Path(file).stat().st_size) for file in found if Path(file).is_file())
        return
    for file, info in fs.find(path, detail=True).items():
        yield file, int(info['size'] if 'size' in info else fs.size(file))


def choose_one_name(paths: Iterable[str]) -> set[str]:
    """Return one path of each local file: that without links where it is among them, else the first by name."""
    chosen: dict[str, str] = {}
    for path in sorted(paths):
        place = os.path.realpath(path)
        if place not in chosen or path == place:
            chosen[place] = path
    return set(chosen.values())


def _walk(top: str) -> Iterator[str]:
    """Yield all that is no folder in a folder and in all folders in it; what is behind links comes last."""
    seen: set[str] = set()
    waiting, linked = [top], list[str]()
    while waiting or linked:
        folder = waiting.pop() if waiting else linked.pop(0)
        place = os.path.realpath(folder)
        if place in seen:
            continue
        seen.add(place)
        for entry in sorted(os.scandir(folder), key=lambda entry: entry.name):
            path = f'{folder}/{entry.name}'
            if not entry.is_dir():
                yield path
            elif entry.is_symlink():
                linked.append(path)
            else:
                waiting.append(path)
