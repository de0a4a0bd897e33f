# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Opening input files without waiting for a pipe and without reading a device that never ends."""

from __future__ import annotations

import errno
from pathlib import Path
from typing import BinaryIO

NEITHER_FILE_NOR_FOLDER = 'neither a file nor a folder'  # ends a message that begins with the path


def is_special_file(path: Path) -> bool:
    """Return whether a path exists and is neither a file nor a folder, but a pipe, a device or a socket.

    Raises:
        OSError: the path cannot be examined.
    """
    return path.exists() and not (path.is_file() or path.is_dir())


def open_input_file(path: str | Path) -> BinaryIO:
    """Open a file for reading bytes.

    Raises:
        OSError: the path is not that of a file, or the file cannot be opened; `strerror` says why.
    """
    if is_special_file(Path(path)):
        raise OSError(errno.EINVAL, NEITHER_FILE_NOR_FOLDER, str(path))
    return Path(path).open('rb')
