# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The arrays of .npz files from anywhere, read with bounded memory and checked by key, type and shape."""

from __future__ import annotations

import sys
import zipfile
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array, copy_as_float64
from mocap_ros.errors import InputError, describe_read_error
from mocap_ros.input_file import open_input_file
from mocap_ros.npz_file import open_npz
from mocap_ros.skeleton import canonical_joint_names

MAX_FILE_BYTES = 1 << 30  # unpacked; guards the memory against files that unpack to much more than their size


def list_keys(path: Path) -> frozenset[str]:
    """Return the keys of the arrays in an .npz file without reading them, or nothing if it is no such file."""
    with (
        suppress(OSError, zipfile.BadZipFile, ValueError, NotImplementedError),
        open_input_file(path) as stream,
        zipfile.ZipFile(stream) as archive,
    ):
        return frozenset(n.removesuffix('.npy') for n in archive.namelist() if n.endswith('.npy'))
    return frozenset()


def iterate_arrays(
    path: Path, keys: Collection[str], kind: str, max_bytes: int = MAX_FILE_BYTES
) -> Iterator[tuple[str, NDArray[np.generic]]]:
    """Yield those of the keys that an .npz file has, in its order, and their arrays.

    `kind` says in messages what the file should be, with article.
    """
    key = ''
    try:
        with open_npz(path, max_bytes) as archive:
            for key in (k for k in archive.files if k in keys):
                yield key, archive[key]
    except InputError as error:
        raise InputError(f'not {kind}: {error}') from None
    except OSError as error:
        raise InputError(error.strerror or str(error)) from None
    except Exception as error:  # NumPy's zip and array readers raise almost any exception on malformed bytes
        where = f'{key}: ' if key else f'not {kind}: '
        raise InputError(f'{where}{describe_read_error(error)}') from None


@dataclass(frozen=True, eq=False)
class ArrayReader:
    """The arrays of a file by key, with the checks that all of them need.

    Each method raises an InputError that names the key where the array is missing, has another shape than the
    expected, in which None stands for any length, or holds something else.
    """

    array_by_key: Mapping[str, NDArray[np.generic]]

    def __contains__(self, key: str) -> bool:
        return key in self.array_by_key

    def read_numbers(self, key: str, shape: tuple[int | None, ...]) -> Array:
        """Return an array of numbers as float64."""
        return copy_as_float64(self._get(key, 'fiu', 'numbers', shape))

    def read_flags(self, key: str, shape: tuple[int | None, ...]) -> NDArray[np.bool_]:
        """Return an array of true and false."""
        return self._get(key, 'b', 'true or false', shape).astype(np.bool_)

    def read_joint_names(self, key: str) -> tuple[str, ...]:
        """Return joint names in the spelling of this package."""
        return canonical_joint_names(self.read_texts(key, (None,)))

    def read_texts(self, key: str, shape: tuple[int | None, ...]) -> list[str]:
        """Return the texts of an array."""
        array = self._get(key, 'U', 'names', shape)
        code_points = np.ascontiguousarray(array).view(array.dtype.byteorder.replace('|', '=') + 'u4')
        if (code_points > sys.maxunicode).any():
            raise InputError(f'{key}: holds characters that do not exist')
        return [str(text) for text in array.flat]

    def _get(self, key: str, dtype_kinds: str, content: str, shape: tuple[int | None, ...]) -> NDArray[np.generic]:
        if key not in self.array_by_key:
            raise InputError(f'{key}: missing; the file has {", ".join(self.array_by_key) or "no known key"}')
        array = self.array_by_key[key]
        if array.dtype.kind not in dtype_kinds:
            raise InputError(f'{key}: holds {array.dtype}, expected {content}')
        if len(shape) != array.ndim or any(n not in (None, m) for n, m in zip(shape, array.shape, strict=True)):
            expected = ', '.join('n' if n is None else str(n) for n in shape)
            raise InputError(f'{key}: shape {array.shape}, expected ({expected})')
        return array
