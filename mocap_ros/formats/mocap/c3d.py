# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Reader of C3D files, which hold labelled markers; it needs the library `ezc3d` of the extra `c3d`."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
from collections import Counter
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.errors import InputError, MocapError, tell_installation

METRES_BY_UNIT = {'m': 1.0, 'dm': 0.1, 'cm': 0.01, 'mm': 0.001}  # length in m of each unit that a file may name
MEMORY_BYTES = 2 << 30  # address space of the reader without the file; it takes a quarter of it at the start
MEMORY_PER_FILE_BYTE = 40  # bytes of a point in ezc3d's objects and in the arrays, by those in the file
TIME_S = 5  # s of processor time of the reader without the file; the start takes a quarter of a second
BYTES_PER_S = 500_000  # bytes of a file that are read in a second of processor time, at least
READER = Path(__file__).with_name('c3d_process.py')  # the program that reads a file


def load_c3d(path: Path) -> tuple[dict[str, Array], float | None]:
    """Read the positions of all markers, in a process of its own, which a damaged file may crash.

    Returns the positions (F, 3) of each marker in the file's frame and unit, NaN where it was not seen, by its
    label without the subject's name (`anna:`), unless several subjects have such a marker; and the unit in m, None
    where the file does not name it.
    """
    try:
        is_installed = find_spec('ezc3d') is not None
    except ValueError:  # sys.modules says that there is none
        is_installed = False
    if not is_installed:
        raise MocapError(f'{path}: C3D needs ezc3d: {tell_installation("c3d")}')
    if not path.is_file():
        raise InputError(f'{path}: no such file')
    size = path.stat().st_size
    memory = MEMORY_BYTES + MEMORY_PER_FILE_BYTE * size
    seconds = TIME_S + size // BYTES_PER_S
    result = subprocess.run(  # noqa: S603, the program is the package's own
        [sys.executable, str(READER), str(path.resolve()), str(memory), str(seconds)],
        stdin=subprocess.DEVNULL,
        env={**os.environ, 'OPENBLAS_NUM_THREADS': '1'},  # each thread would take 40 MB of the address space
        capture_output=True,
        check=False,
    )
    if result.returncode:
        reason = result.stderr.decode(errors='replace').strip().rpartition('\n')[2]
        if result.returncode == -signal.SIGXCPU:
            reason = f'its reader did not end within {seconds} s of processor time'
        elif result.returncode < 0:
            reason = f'its reader ended by {signal.Signals(-result.returncode).name}'
        raise InputError(f'{path}: not a C3D file ({reason})')
    with np.load(io.BytesIO(result.stdout), allow_pickle=False) as archive:
        points = archive['points']
        labels = archive['labels'].tolist()
        unit = str(archive['unit'])
    bare = {label: label.rpartition(':')[2].strip() for label in labels}
    subjects = Counter(bare.values())
    names = [bare[label] if subjects[bare[label]] == 1 else label.strip() for label in labels]
    positions = np.moveaxis(points, 0, -1)
    metres = METRES_BY_UNIT.get(unit.strip().lower())
    return {name: positions[i] for i, name in enumerate(names) if i < len(positions)}, metres
