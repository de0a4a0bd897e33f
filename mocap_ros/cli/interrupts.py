# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Interrupts by Ctrl-C that arrive while compiled code or a library's callback runs.

Python raises KeyboardInterrupt wherever the program happens to be. Inside compiled code it comes out as a
SystemError, and inside a callback it is lost, so that work which reports the errors of single items would go on.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TypeVar

T = TypeVar('T')


@contextmanager
def interrupt_between_items() -> Iterator[Callable[[Iterable[T]], Iterator[T]]]:
    """Let SIGINT end an iteration between two items only; a second SIGINT is raised at once.

    Entering the context, which only the main thread may do, returns the function that wraps the items. It raises
    KeyboardInterrupt in place of the item that follows the signal. Where SIGINT is ignored, it stays ignored.
    """
    is_requested = False

    def request(_number: int, _frame: FrameType | None) -> None:
        nonlocal is_requested
        is_requested = True
        signal.signal(signal.SIGINT, signal.default_int_handler)

    def wrap(items: Iterable[T]) -> Iterator[T]:
        for item in items:
            if is_requested:
                raise KeyboardInterrupt
            yield item

    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:  # ignored, or handled by somebody else
        yield wrap
        return
    signal.signal(signal.SIGINT, request)
    try:
        yield wrap
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if is_requested:
        raise KeyboardInterrupt


def is_interrupt(error: BaseException) -> bool:
    """Return whether an error is a KeyboardInterrupt or came of one, as a SystemError of compiled code does."""
    cause: BaseException | None = error
    while cause is not None and not isinstance(cause, KeyboardInterrupt):
        cause = cause.__cause__ or cause.__context__
    return cause is not None
