# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What the commands print on a terminal, and what Ctrl-C does there.

A terminal obeys no name in a line that is printed. Progress is shown on a terminal only, not in a pipe or a file.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, TypeVar

from mocap_ros.errors import make_printable_line

if TYPE_CHECKING:
    from mocap_ros.runtime.summary import Summary

T = TypeVar('T')


def print_result(line: object, *, flush: bool = False) -> None:
    """Print a line on stdout; at once also where stdout is a pipe, if `flush` is set."""
    print(make_printable_line(str(line)), flush=flush)


def print_note(line: object) -> None:
    """Print a line about the input or the work on stderr, with the name of the program."""
    print(make_printable_line(f'mocap-ros: {line}'), file=sys.stderr)


def finish(path: object, summary: Summary, *, is_strict: bool) -> int:
    """Print the summary of a recording on stdout, and return the exit code."""
    print_result(f'{path}: {summary}')
    return int(is_strict and summary.is_wrong)


def show_progress(items: Iterable[T], description: str, total: int | None = None) -> Iterable[T]:
    """Yield the items and show a progress bar; `total` is their number where `len(items)` does not give it."""
    from tqdm import tqdm

    return tqdm(items, desc=description, total=total, disable=not sys.stderr.isatty(), leave=False)


@contextmanager
def show_stages() -> Iterator[Callable[[str], None]]:
    """Show the stage of a long computation and the time; yield the function that sets the stage."""
    from tqdm import tqdm

    with tqdm(bar_format='{desc} {elapsed}', disable=not sys.stderr.isatty(), leave=False) as bar:
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
