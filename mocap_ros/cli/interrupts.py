# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Interrupts by Ctrl-C that arrive while compiled code or a library's callback runs.

Python raises KeyboardInterrupt wherever the program happens to be. Inside compiled code it comes out as a
SystemError, and inside a callback it is lost, so that work which reports the errors of single items would go on.
"""

from __future__ import annotations

import signal
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TypeVar

T = TypeVar('T')


class StopAtInterrupt:
    """Function that yields items until SIGINT comes, and raises KeyboardInterrupt in place of the next item.

    Attributes:
        is_requested: whether SIGINT has come; for items that could be waited for without an end.
    """

    def __init__(self) -> None:
        self.is_requested = False

    def __call__(self, items: Iterable[T]) -> Iterator[T]:
        """Yield the items; raises KeyboardInterrupt in place of the item that follows the signal."""
        for item in items:
            if self.is_requested:
                raise KeyboardInterrupt
            yield item


@contextmanager
def interrupt_between_items() -> Iterator[StopAtInterrupt]:
    """Let SIGINT end an iteration between two items only; a second SIGINT is raised at once.

    Entering the context, which only the main thread may do, returns the function that wraps the items. Where
    SIGINT is ignored, it stays ignored.
    """
    wrap = StopAtInterrupt()

    def request(_number: int, _frame: FrameType | None) -> None:
        wrap.is_requested = True
        signal.signal(signal.SIGINT, signal.default_int_handler)

    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:  # ignored, or handled by somebody else
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
