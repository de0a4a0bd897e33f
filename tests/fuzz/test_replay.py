# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What once failed under fuzz gives a result or one clear error again, with little memory and in little time."""

from __future__ import annotations

import re
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from mocap_ros.formats.mocap import c3d
from tests.fuzz.bombs import BOMBS
from tests.fuzz.examples import EXAMPLES
from tests.fuzz.targets import TARGETS, check

FAILED = Path(__file__).parent / 'failed'
pytestmark = pytest.mark.filterwarnings('error')
KEPT = sorted(path for path in FAILED.rglob('*') if path.is_file())
PROCESS = Path('/proc/self')
# resident memory that an input may take; chunks of 128 MiB are read as they are, and then copied
MEMORY_KB = 500_000
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


def skip_without_reader(source: str) -> None:
    if source == 'c3d':
        pytest.importorskip('ezc3d')


@pytest.mark.parametrize('source', TARGETS)
def test_valid_inputs_are_read(source: str) -> None:
    """Otherwise a run starts from nothing, and the targets may refuse everything."""
    skip_without_reader(source)
    read = [check(source, data) for data in EXAMPLES[source]()]
    assert any(read), read


@pytest.mark.parametrize('path', KEPT, ids=lambda path: '/'.join(path.parts[-2:]))
def test_kept_input(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(c3d, 'TIME_S', 1)
    skip_without_reader(path.parent.name)
    with bound():
        check(path.parent.name, path.read_bytes())


@pytest.mark.parametrize('name', BOMBS)
def test_bomb_is_refused(name: str) -> None:
    source, make = BOMBS[name]
    data = make()
    with bound():
        assert not check(source, data)
