# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A file system in memory that forgets: after a power cut it holds what was synced, and a random part of the rest.

It is mounted by FUSE (`pip install fusepy`, libfuse2 and /dev/fuse). To make a folder `cut N` in it is a power
cut: what the disk would hold is written to the folder N of `images`, and the file system goes on.
"""

from __future__ import annotations

import errno
import os
import stat
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

SECTOR_BYTES = 512  # that a disk writes as a whole
CUT = '/cut '  # begins the name of a folder whose creation is a power cut


class _Node:
    """A file or a folder: what programs see of it, what is synced, and what was written since."""

    def __init__(self, *, is_folder: bool) -> None:
        self.is_folder = is_folder
        self.content = bytearray()
        self.synced = b''
        self.writes: list[tuple[int, bytes]] = []  # since the last sync
        self.sizes: list[int] = []  # to which the file was truncated since

    def make_image(self, rng: np.random.Generator) -> bytes:
        """Return what may be on the disk: each sector written since the last sync is there or not."""
        size = max([len(self.synced), len(self.content), *(start + len(data) for start, data in self.writes)])
        image, share = bytearray(self.synced.ljust(size, b'\0')), rng.choice([0.0, 0.5, 0.9, 1.0])
        for start, data in self.writes:
            position = start
            while position < start + len(data):
                end = min((position // SECTOR_BYTES + 1) * SECTOR_BYTES, start + len(data))
                if rng.random() < share:
                    image[position:end] = data[position - start : end - start]
                position = end
        sizes = [len(self.synced), len(self.content), *self.sizes, *(s + len(d) for s, d in self.writes)]
        low = min(len(self.synced), *self.sizes) if self.sizes else len(self.synced)
        kept = rng.choice(sizes) if rng.random() < 0.5 else rng.integers(low, size + 1)
        return bytes(image[: int(kept)])


class ForgetfulDisk:
    """The operations of the file system, as `fuse.FUSE` calls them.

    Args:
        images: Folder into which each power cut writes what the disk holds.
        sync_s: Time that the disk takes for each sync, in s.
        seed: Of the random parts.
    """

    def __init__(self, images: Path, sync_s: float, seed: int) -> None:
        self._images = images
        self._sync_s = sync_s
        self._rng = np.random.default_rng(seed)
        self._lock = threading.RLock()
        self._nodes = {'/': _Node(is_folder=True)}
        self._synced_names = dict(self._nodes)

    def __call__(self, operation: str, *arguments: Any) -> Any:
        act = getattr(self, operation, None)
        if act is None:
            raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))
        if operation == 'fsync':
            return act(*arguments)
        with self._lock:
            return act(*arguments)

    def access(self, *_: Any) -> int:
        return 0

    flush = release = utimens = chmod = opendir = releasedir = access

    def statfs(self, *_: Any) -> dict[str, int]:
        return {'f_bsize': 4096, 'f_frsize': 4096, 'f_blocks': 1 << 20, 'f_bfree': 1 << 20, 'f_bavail': 1 << 20}

    def getattr(self, path: str, *_: Any) -> dict[str, Any]:
        node = self._get(path)
        kind = stat.S_IFDIR | 0o777 if node.is_folder else stat.S_IFREG | 0o666
        return {'st_mode': kind, 'st_nlink': 1, 'st_size': len(node.content)}

    def readdir(self, path: str, *_: Any) -> list[str]:
        return ['.', '..', *(Path(p).name for p in self._nodes if p != '/' and str(Path(p).parent) == path)]

    def mkdir(self, path: str, *_: Any) -> None:
        if path.startswith(CUT):
            self._cut(self._images / path.removeprefix(CUT))
        self._nodes[path] = _Node(is_folder=True)

    def create(self, path: str, *_: Any) -> int:
        self._nodes[path] = _Node(is_folder=False)
        return 0

    def open(self, path: str, *_: Any) -> int:
        self._get(path)
        return 0

    def read(self, path: str, size: int, offset: int, *_: Any) -> bytes:
        return bytes(self._get(path).content[offset : offset + size])

    def write(self, path: str, data: bytes, offset: int, *_: Any) -> int:
        node = self._get(path)
        node.content.extend(bytes(max(offset - len(node.content), 0)))
        node.content[offset : offset + len(data)] = data
        node.writes.append((offset, bytes(data)))
        return len(data)

    def truncate(self, path: str, length: int, *_: Any) -> None:
        node = self._get(path)
        node.content = node.content[:length].ljust(length, b'\0')
        node.sizes.append(length)

    def unlink(self, path: str) -> None:
        self._get(path)
        del self._nodes[path]

    rmdir = unlink

    def rename(self, old: str, new: str) -> None:
        self._nodes[new] = self._nodes.pop(old)

    def fsync(self, path: str, *_: Any) -> None:
        with self._lock:
            node = self._get(path)
            content, writes, sizes = bytes(node.content), len(node.writes), len(node.sizes)
        time.sleep(self._sync_s)  # meanwhile the file may be written and the power cut
        with self._lock:
            node.synced, node.writes, node.sizes = content, node.writes[writes:], node.sizes[sizes:]

    def fsyncdir(self, path: str, *_: Any) -> None:
        names = {p: n for p, n in self._synced_names.items() if p == '/' or str(Path(p).parent) != path}
        self._synced_names = names | {p: n for p, n in self._nodes.items() if str(Path(p).parent) == path}

    def _get(self, path: str) -> _Node:
        if path not in self._nodes:
            raise OSError(errno.ENOENT, os.strerror(errno.ENOENT))
        return self._nodes[path]

    def _cut(self, image: Path) -> None:
        """Write what the disk may hold now: of a name that was not synced, the old or the new file, or none."""
        image.mkdir()
        for path in sorted(self._nodes | self._synced_names):
            states = self._nodes.get(path), self._synced_names.get(path)
            node = states[self._rng.integers(2)]
            place = image / path[1:]
            if node is None or not place.parent.is_dir() or path == '/' or path.startswith(CUT):
                continue
            if node.is_folder:
                place.mkdir()
            else:
                place.write_bytes(node.make_image(self._rng))


@contextmanager
def mount(disk: ForgetfulDisk, place: Path) -> Iterator[None]:
    """Mount a file system at a folder, in a process of its own."""
    from fuse import FUSE

    pid = os.fork()
    if pid == 0:
        try:
            FUSE(disk, str(place), foreground=True, nothreads=False, attr_timeout=0, entry_timeout=0)
        finally:
            os._exit(0)
    try:
        while not place.is_mount():
            time.sleep(0.01)
        yield
    finally:
        subprocess.run(['umount', '-l', place], check=True)
        os.waitpid(pid, 0)
