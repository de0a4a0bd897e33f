# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Limits on the memory and the time of one input."""

from __future__ import annotations

import re
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

PROCESS = Path('/proc/self')
MEMORY_KB = (
    500_000  # resident memory that an input may take; chunks of 128 MiB are read as they are, and then copied
)
CPU_S = 60.0  # s of processor time after which an input is taken as one that never ends; they take a second


class TooLong(BaseException):
    """An input took too long; it is no `Exception`, so that no reader takes it for damage."""


@contextmanager
def bound() -> Iterator[None]:
    """Bound what the code of the block takes.

    Raises:
        TooLong: the block took more than `CPU_S` of processor time.
        AssertionError: the block took more memory than `MEMORY_KB`.
    """

    def stop(*_: object) -> None:
        raise TooLong(f'more than {CPU_S:g} s')

    (PROCESS / 'clear_refs').write_text('5')  # the peak of the resident memory begins anew
    before = _read_kb('VmRSS')
    previous = signal.signal(signal.SIGVTALRM, stop)
    signal.setitimer(signal.ITIMER_VIRTUAL, CPU_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, previous)
    taken = _read_kb('VmHWM') - before
    assert taken < MEMORY_KB, f'{taken} kB'


def _read_kb(name: str) -> int:
    """Return a number of kB from the status of this process."""
    (number,) = re.findall(rf'^{name}:\s+(\d+) kB', (PROCESS / 'status').read_text(), re.MULTILINE)
    return int(number)
