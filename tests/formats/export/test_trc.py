# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Markers for OpenSim: the file is parsed as its format is documented."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mocap_ros.formats.export.trc import save_trc

NAMES = ('neck', 'head')


def test_header_numbers_times_and_places(tmp_path: Path) -> None:
    joints = np.arange(18.0).reshape(3, 2, 3) / 7
    joints[1, 1] = np.nan
    save_trc(tmp_path / 'walk.trc', NAMES, joints, 50.0)
    lines = [line.split('\t') for line in (tmp_path / 'walk.trc').read_text().splitlines()]
    assert lines[0] == ['PathFileType', '4', '(X/Y/Z)', 'walk.trc']
    values = dict(zip(lines[1], lines[2], strict=True))
    assert [float(values[key]) for key in ('DataRate', 'CameraRate', 'OrigDataRate')] == [50.0] * 3
    assert [int(values[key]) for key in ('NumFrames', 'NumMarkers', 'OrigNumFrames')] == [3, 2, 3]
    assert (values['OrigDataStartFrame'], values['Units']) == ('1', 'mm')
    assert [name for name in lines[3] if name] == ['Frame#', 'Time', *NAMES]
    assert [name for name in lines[4] if name] == ['X1', 'Y1', 'Z1', 'X2', 'Y2', 'Z2']
    rows = lines[6:]
    assert [(int(row[0]), float(row[1])) for row in rows] == [(1, 0.0), (2, 0.02), (3, 0.04)]
    read = np.array([[float(value or 'nan') for value in row[2:8]] for row in rows])
    assert read == pytest.approx(1000 * joints.reshape(3, 6), abs=1e-4, nan_ok=True)
