# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What the commands print on a terminal, and what Ctrl-C does there.

A terminal obeys no name in a line that is printed. Progress is shown on a terminal only, not in a pipe or a file.
"""

from __future__ import annotations

import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, nullcontext
from types import FrameType
from typing import TYPE_CHECKING, Any, TextIO, TypeVar

from mocap_ros.errors import make_printable_line

if TYPE_CHECKING:
    from tqdm import tqdm

T = TypeVar('T')
Report = Callable[[float], None]  # gets the share of a computation, 0 to 1, that is done

ERASE_LINE = '\r\x1b[K'
SHARE_FORMAT = '{desc}: {percentage:3.0f}%|{bar}| {elapsed}, {remaining} left'
TICK_S = 0.5  # s between two drawings of a bar whose work takes long from one report to the next
MAX_GUESS = 0.99  # share that a bar shows at most before the end is reported
_has_loading_line = False


def show_loading(name: str) -> None:
    """Show on a terminal that a command loads; the line goes when anything else is shown."""
    global _has_loading_line  # noqa: PLW0603 # there is one terminal
    if sys.stderr.isatty():
        print(f'{name}: loading ...', end='', file=sys.stderr, flush=True)
        _has_loading_line = True


def end_loading() -> None:
    """Remove the line of `show_loading`, if it is still there."""
    global _has_loading_line  # noqa: PLW0603
    if _has_loading_line:
        print(ERASE_LINE, end='', file=sys.stderr, flush=True)
        _has_loading_line = False


def print_result(line: object, *, flush: bool = False) -> None:
    """Print a line on stdout; at once also where stdout is a pipe, if `flush` is set."""
    _print(make_printable_line(str(line)), sys.stdout, flush)


def print_note(line: object) -> None:
    """Print a line about the input or the work on stderr, with the name of the program."""
    _print(make_printable_line(f'mocap-ros: {line}'), sys.stderr, True)


def _print(line: str, file: TextIO, flush: bool) -> None:
    """Print a line above the bars, if there are some."""
    end_loading()
    with sys.modules['tqdm'].tqdm.external_write_mode(file) if 'tqdm' in sys.modules else nullcontext():
        print(line, file=file, flush=flush)


def finish(path: object, summary: object, is_wrong: bool, *, is_strict: bool) -> int:
    """Print the summary of a recording on stdout, and return the exit code."""
    print_result(f'{path}: {summary}')
    return int(is_strict and is_wrong)


def show_progress(items: Iterable[T], description: str, total: int | None = None) -> Iterable[T]:
    """Yield the items and show a progress bar; `total` is their number where `len(items)` does not give it."""
    return make_bar(items, desc=description, total=total)


def make_bar(items: Any = None, **options: Any) -> tqdm[Any]:
    """Return a bar on the terminal, which shows nothing anywhere else; the options are those of tqdm."""
    from tqdm import tqdm

    end_loading()
    is_terminal = sys.stderr.isatty()
    if is_terminal and 0 in os.get_terminal_size(sys.stderr.fileno()):  # of unknown size
        options |= {'ncols': 80, 'nrows': 24}
    return tqdm(items, disable=not is_terminal, leave=False, dynamic_ncols='ncols' not in options, **options)


class ShareBar:
    """Bar that shows the share of a computation that is done and the time left, from the first report on.

    Between two reports the work is taken to go on as fast as it has so far.
    """

    def __init__(self, description: str) -> None:
        self._description = description
        self._bar: tqdm[Any] | None = None
        self._total_s = math.inf  # s, of the whole computation, as the last report has it
        self._is_done = threading.Event()
        self._ticker = threading.Thread(target=self._tick, daemon=True)

    def __enter__(self) -> Report:
        """Return the function that gets the share, 0 to 1."""
        return self._report

    def __exit__(self, *_: object) -> None:
        """Remove the bar."""
        self._is_done.set()
        if self._ticker.is_alive():
            self._ticker.join()  # it refreshes the bar, which would bring a closed one back
        if self._bar is not None:
            self._bar.close()

    def _report(self, share: float) -> None:
        if self._bar is None:
            self._bar = make_bar(desc=self._description, total=1.0, bar_format=SHARE_FORMAT)
            if not self._bar.disable:
                self._ticker.start()
        elif share > 0 and not self._bar.disable:
            self._total_s = (time.time() - self._bar.start_t) / share

    def _tick(self) -> None:
        while self._bar is not None and not self._is_done.wait(TICK_S):
            self._bar.n = min(max((time.time() - self._bar.start_t) / self._total_s, self._bar.n), MAX_GUESS)
            self._bar.refresh()


@contextmanager
def show_stages() -> Iterator[Callable[[str], None]]:
    """Show the stage of a long computation and the time; yield the function that sets the stage."""
    with make_bar(bar_format='{desc} {elapsed}') as bar:
        yield bar.set_description_str


class StopAtInterrupt:
    """Function that yields items until SIGINT comes, and raises KeyboardInterrupt instead of the next item.

    `is_requested` says whether SIGINT has come, for items that could be waited for without an end.
    """

    def __init__(self) -> None:
        self.is_requested = False

    def __call__(self, items: Iterable[T]) -> Iterator[T]:
        """Yield the items; raises KeyboardInterrupt instead of the item that follows the signal."""
        for item in items:
            if self.is_requested:
                raise KeyboardInterrupt
            yield item


@contextmanager
def interrupt_between_items() -> Iterator[StopAtInterrupt]:
    """Let SIGINT end an iteration between two items only; a second SIGINT is raised at once.

    Python raises KeyboardInterrupt wherever the program happens to be. Inside compiled code it comes out as a
    SystemError, and inside a callback it is lost. Only the main thread may enter the context, which yields the
    function that wraps the items. Where SIGINT is ignored, it stays ignored.
    """
    wrap = StopAtInterrupt()

    def request(_number: int, _frame: FrameType | None) -> None:
        wrap.is_requested = True
        signal.signal(signal.SIGINT, signal.default_int_handler)

    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:  # ignored, or handled by another library
        yield wrap
        return
    signal.signal(signal.SIGINT, request)
    try:
        yield wrap
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if wrap.is_requested:
        raise KeyboardInterrupt


def is_interrupt(error: BaseException) -> bool:
    """Return whether an error is a KeyboardInterrupt or came of one, as a SystemError of compiled code does."""
    cause: BaseException | None = error
    while cause is not None and not isinstance(cause, KeyboardInterrupt):
        cause = cause.__cause__ or cause.__context__
    return cause is not None
