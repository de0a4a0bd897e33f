"""Opening .npz files of strangers: no pickles, and no more in memory than expected."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import numpy as np
from numpy.lib.npyio import NpzFile

from mocap_ros.errors import InputError


@contextmanager
def opened(file: str | Path | IO[bytes], largest: int) -> Iterator[NpzFile]:
    """The file open for reading.

    Args:
        file: to open.
        largest: bytes that all its arrays may take, unpacked.

    Raises:
        InputError: a single array, or more than that.
        OSError: it cannot be opened.
        Exception: the zip and array readers raise almost anything on garbage, also inside the block.
    """
    with np.load(file, allow_pickle=False) as archive:
        if not isinstance(archive, NpzFile) or archive.zip is None:
            raise InputError('a single array, expected .npz')
        if sum(i.file_size for i in archive.zip.infolist()) > largest:
            raise InputError(f'holds more than {largest >> 20} MiB')
        yield archive
