# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Reading and writing .npz files: no pickles, bounded memory, and the same arrays give the same bytes."""

from __future__ import annotations

import io
import math
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

UNPACKED_BYTES = 64 << 20  # of a file of any size; readers take up to five times as much memory
UNPACKED_PER_BYTE = 100  # bytes that a byte of a larger file may unpack to; motion capture packs to a half or less

# Readers of the header by the version of the array's form; the third version is for names of fields only.
_HEADER_READERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


@contextmanager
def open_npz(file: str | Path | IO[bytes], max_bytes: int) -> Iterator[NpzFile]:
    """Open an .npz file for reading, of at most `max_bytes` unpacked.

    InputError where it is cut off, or holds a single array, larger arrays or much larger ones than the file,
    arrays that state another size than they have, or a compression that NumPy does not write. NumPy's zip and
    array readers raise almost any exception on malformed bytes, also inside the `with` block.
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
        entries = archive.zip.infolist()
        unpacked = sum(entry.file_size for entry in entries)
        if unpacked > max_bytes:
            raise InputError(f'holds more than {max_bytes >> 20} MiB')
        packed = stream.seek(0, io.SEEK_END)  # of the file: entries may share their bytes
        if unpacked > UNPACKED_BYTES + UNPACKED_PER_BYTE * packed:
            raise InputError(f'unpacks to more than {UNPACKED_PER_BYTE} times its size')
        for entry in entries:
            _check_entry(archive.zip, entry)
        yield archive


def _check_entry(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> None:
    """Check what an entry states about itself, before NumPy takes as much memory; errors as of `open_npz`."""
    name = entry.filename.removesuffix('.npy')
    if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise InputError(f'{name!r} has a compression that NumPy does not write')
    if not entry.filename.endswith('.npy'):
        return
    with archive.open(entry) as stream:
        try:
            read_header = _HEADER_READERS[np.lib.format.read_magic(stream)]
        except (KeyError, ValueError):
            raise InputError(f'{name!r} is no array in a form that is read') from None
        shape, _, dtype = read_header(stream)
        stated = math.prod(shape) * dtype.itemsize
        if not dtype.hasobject and stated != entry.file_size - stream.tell():
            raise InputError(f'{name!r} is not as large as it states')
        if not dtype.itemsize and math.prod(shape) > 1:
            raise InputError(f'{name!r} holds {dtype}')


def write_npz(file: str | Path | IO[bytes], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays without time stamps, so that the same arrays give the same bytes.

    They are written in the order of the mapping.
    """
    with zipfile.ZipFile(file, 'w', zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays.items():
            buffer = io.BytesIO()
            np.lib.format.write_array(buffer, array, allow_pickle=False)
            archive.writestr(zipfile.ZipInfo(f'{name}.npy'), buffer.getvalue(), zipfile.ZIP_DEFLATED)
