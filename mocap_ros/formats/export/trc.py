# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Writer of TRC files, the marker files of OpenSim."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mocap_ros.arrays import Array

MM_PER_M = 1000.0  # TRC files are written in mm

# The names of the values in the third line of a file.
HEADINGS = 'DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames'


def save_trc(path: Path, names: Sequence[str], joints: Array, fps: float, first: int = 0) -> None:
    """Write joints (F, J, 3) in m, y up, as the markers of a TRC file; NaN leaves the fields of a marker empty.

    The number of the `first` frame counts from 0, which is at 0 s.
    """
    frames = len(joints)
    numbers = range(1, len(names) + 1)
    lines = [
        f'PathFileType\t4\t(X/Y/Z)\t{path.name}',
        HEADINGS,
        f'{fps:.6g}\t{fps:.6g}\t{frames}\t{len(names)}\tmm\t{fps:.6g}\t{first + 1}\t{frames}',
        'Frame#\tTime\t' + '\t\t\t'.join(names) + '\t\t',
        '\t\t' + '\t'.join(f'X{n}\tY{n}\tZ{n}' for n in numbers),
        '',
    ]
    for frame, row in enumerate(joints.reshape(frames, -1) * MM_PER_M, first):
        fields = ['' if np.isnan(value) else f'{value:.4f}' for value in row]
        end = '' if fields[-1] else '\t'  # without it, OpenSim does not count the last field, which is empty
        lines.append(f'{frame + 1}\t{frame / fps:.6f}\t' + '\t'.join(fields) + end)
    path.write_text('\n'.join(lines) + '\n', encoding='utf-8', errors='backslashreplace')  # of the file's name
