"""OpenSim's own reader reads the TRC files; `pip install opensim` runs this test."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mocap_ros.formats.export.trc import save_trc
from mocap_ros.skeleton import CMU15
from tests.support.motion_files import FRAMES, Z_UP_TO_Y_UP

FPS = 29.97  # Hz, a rate that is not an integer
UNSEEN = [0, 1, FRAMES - 1]  # frames without a skeleton


def test_opensim_reads_markers_unit_rate_and_frames(tmp_path: Path, poses: np.ndarray) -> None:
    opensim = pytest.importorskip('opensim', reason='needs OpenSim: pip install opensim')
    joints = poses @ Z_UP_TO_Y_UP.T
    joints[UNSEEN] = np.nan
    save_trc(tmp_path / 'walk.trc', CMU15.joints, joints, FPS)
    table = opensim.TimeSeriesTableVec3(str(tmp_path / 'walk.trc'))
    assert tuple(table.getColumnLabels()) == CMU15.joints
    assert table.getTableMetaDataString('Units') == 'mm'
    assert float(table.getTableMetaDataString('DataRate')) == FPS
    assert np.array(table.getIndependentColumn()) == pytest.approx(np.arange(FRAMES) / FPS, abs=1e-6)
    rows = [table.getRowAtIndex(i) for i in range(table.getNumRows())]
    read = np.array([[row.getElt(0, j).to_numpy() for j in range(len(CMU15.joints))] for row in rows])
    assert read / 1000 == pytest.approx(joints, abs=1e-6, nan_ok=True)
    markers = opensim.MarkerData(str(tmp_path / 'walk.trc'))  # the older reader, which the tools use
    assert (markers.getNumFrames(), markers.getNumMarkers()) == joints.shape[:2]
    assert (markers.getDataRate(), markers.getUnits().getLabel()) == (FPS, 'millimeters')
    seen = markers.getFrame(FRAMES // 2)
    assert [seen.getMarker(j).to_numpy() for j in range(len(CMU15.joints))] == pytest.approx(
        joints[FRAMES // 2] * 1000, abs=1e-3
    )
