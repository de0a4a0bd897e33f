"""Reading and writing .npz files: no pickles, bounded memory, and the same arrays give the same bytes."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib.npyio import NpzFile
from numpy.typing import NDArray

from mocap_ros.errors import InputError
from mocap_ros.input_file import open_input_file


@contextmanager
def open_npz(file: str | Path | IO[bytes], max_bytes: int) -> Iterator[NpzFile]:
    """Open an .npz file for reading.

    Args:
        file: path or open file.
        max_bytes: largest size in bytes of all arrays together, unpacked.

    Raises:
        InputError: The file is cut off, or holds a single array, or arrays larger than `max_bytes`.
        OSError: The path is not that of a file, or the file cannot be opened.
        Exception: NumPy's zip and array readers raise almost any exception on malformed bytes, also inside the
            `with` block.
    """
    with ExitStack() as stack:
        stream = stack.enter_context(open_input_file(file)) if isinstance(file, (str, Path)) else file
        start = stream.read(len(np.lib.format.MAGIC_PREFIX))
        stream.seek(0)
        if start == np.lib.format.MAGIC_PREFIX:
            raise InputError('a single array, expected .npz')
        try:
            archive = stack.enter_context(np.load(stream, allow_pickle=False))
        except zipfile.BadZipFile:
            raise InputError('the file is cut off or damaged') from None
        if sum(i.file_size for i in archive.zip.infolist()) > max_bytes:
            raise InputError(f'holds more than {max_bytes >> 20} MiB')
        yield archive


def write_npz(file: str | Path | IO[bytes], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays without time stamps, so that the same arrays give the same bytes.

    Args:
        file: path or open file.
        arrays: arrays by name, in the order in which they are written.
    """
    with zipfile.ZipFile(file, 'w', zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays.items():
            buffer = io.BytesIO()
            np.lib.format.write_array(buffer, array, allow_pickle=False)
            archive.writestr(zipfile.ZipInfo(f'{name}.npy'), buffer.getvalue(), zipfile.ZIP_DEFLATED)
