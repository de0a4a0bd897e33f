# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Progress on a terminal; nothing is shown where stderr is a pipe or a file."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from typing import TypeVar

from tqdm import tqdm

T = TypeVar('T')


def show_progress(items: Iterable[T], description: str, total: int | None = None) -> Iterable[T]:
    """Yield the items and show a progress bar.

    Args:
        items: the items to iterate over.
        description: name of the work, shown before the bar.
        total: number of items where `len(items)` does not give it.
    """
    return tqdm(items, desc=description, total=total, disable=not sys.stderr.isatty(), leave=False)


class StageDisplay:
    """Context manager that shows the current stage of a long computation and the time that has passed.

    Entering the context returns the function that sets the name of the current stage.
    """

    def __enter__(self) -> Callable[[str], None]:
        self._bar = tqdm(bar_format='{desc} {elapsed}', disable=not sys.stderr.isatty(), leave=False)
        return self._bar.set_description_str

    def __exit__(self, *_: object) -> None:
        self._bar.close()
