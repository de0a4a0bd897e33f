# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Disks for `faults.py`: one that fails at a chosen step, and one that forgets in a power cut.

The first are real files below a folder whose operations are counted. The second is a file system in memory,
mounted by FUSE (`pip install fusepy`, libfuse2 and /dev/fuse), that holds what was synced and a random part of
the rest after a power cut. To make a folder `cut N` in it is one: what the disk would hold is written to the
folder N of `images`, and the file system goes on.
"""

import errno
import io
import os
import shutil
import signal
import stat
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path, PosixPath
from typing import Any

import numpy as np

SLOW_S = 0.02  # s, which a step of the slow disk takes


class Disk:
    """Counts the steps on a disk, `steps`, and lets them fail from the step `at` on.

    The fault is `none`, `kill` (the process is killed in the middle of the step), `full` (the step takes a part of
    the data, and then every step that needs space fails), `full once` (the step takes nothing, and the next ones
    work), `read-only` (every step fails from there on), `removed` (the folder is removed before the step) or
    `slow` (every step takes `SLOW_S`).
    """

    def __init__(self, fault: str = 'none', at: int = 0, folder: Path | None = None) -> None:
        self.steps: list[str] = []
        self._fault = fault
        self._at = at
        self._folder = folder

    def step(self, name: str, act: Callable[[], Any], act_partly: Callable[[], Any] = lambda: None) -> Any:
        """Do a step, or let it fail; `act_partly` is what a step does that is interrupted."""
        number = len(self.steps)
        self.steps.append(name)
        fault, is_now = self._fault, number == self._at
        if fault == 'kill' and is_now:
            act_partly()
            os.kill(os.getpid(), signal.SIGKILL)
        if fault == 'removed' and is_now and self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)
        if fault == 'slow':
            time.sleep(SLOW_S)
        gives_space = name.partition(' ')[0] in ('unlink', 'truncate', 'close')
        if fault == 'read-only' and number >= self._at and not name.startswith('close'):
            raise OSError(errno.EROFS, os.strerror(errno.EROFS))
        if not gives_space and ((fault == 'full' and number >= self._at) or (fault == 'full once' and is_now)):
            if fault == 'full' and is_now and (taken := act_partly()) is not None:
                return taken
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return act()


class FaultyFile(io.FileIO):
    """An unbuffered file on a `Disk`."""

    def __init__(self, path: str, mode: str, disk: Disk) -> None:
        self._disk = disk
        self._name = Path(path).suffix
        super().__init__(path, mode)

    def write(self, data: Any) -> int:
        return int(
            self._disk.step(
                f'write {self._name}',
                lambda: super(FaultyFile, self).write(data),
                lambda: super(FaultyFile, self).write(bytes(data)[: len(data) // 2]),
            )
        )

    def truncate(self, size: int | None = None) -> int:
        return int(self._disk.step(f'truncate {self._name}', lambda: super(FaultyFile, self).truncate(size)))


class FaultyPath(PosixPath):
    """A path whose operations are steps of `disk`, one for the process."""

    disk = Disk()

    def open(self, mode: str = 'r', buffering: int = -1, encoding: Any = None, *_: Any, **__: Any) -> Any:
        if not set(mode) & set('wxa+'):
            return super().open(mode, buffering, encoding)
        raw = self.disk.step(
            f'open {self.suffix}', lambda: FaultyFile(str(self), mode.replace('b', ''), self.disk)
        )
        if buffering == 0:
            return raw
        buffered: Any = io.BufferedRandom(raw) if '+' in mode else io.BufferedWriter(raw)
        return buffered if 'b' in mode else io.TextIOWrapper(buffered, encoding=encoding)

    def mkdir(self, mode: int = 0o777, parents: bool = False, exist_ok: bool = False) -> None:
        make = super().mkdir
        self.disk.step('mkdir', lambda: make(mode, parents, exist_ok))

    def replace(self, target: Any) -> Any:
        return self.disk.step(f'rename {self.suffix}', lambda: super(FaultyPath, self).replace(target))

    def unlink(self, missing_ok: bool = False) -> None:
        self.disk.step(f'unlink {self.suffix}', lambda: super(FaultyPath, self).unlink(missing_ok))


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
    """The operations of the file system, as `fuse.FUSE` calls them; a sync takes `sync_s`."""

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
