# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A disk that fails at a chosen step: real files, below a folder whose operations are counted."""

from __future__ import annotations

import errno
import io
import os
import shutil
import signal
import time
from collections.abc import Callable
from pathlib import Path, PosixPath
from typing import Any

SLOW_S = 0.02  # s, which a step of the slow disk takes


class Disk:
    """Counts the steps on a disk and lets them fail.

    Args:
        fault: `none`, `kill` (the process is killed in the middle of the step), `full` (the step takes a part of
            the data, and then every step that needs space fails), `full once` (the step takes nothing, and the
            next ones work), `read-only` (every step fails from there on), `removed` (the folder is removed before
            the step) or `slow` (every step takes `SLOW_S`).
        at: Number of the step at which the fault begins.
        folder: Folder that is removed.

    Attributes:
        steps: Names of the steps so far.
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
