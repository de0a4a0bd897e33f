# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Markers, model and joint angles for OpenSim, which reads them itself where it is installed."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from mocap_ros.formats.export.joint_angles import COORDINATES, POSITIONS, compute_joint_angles
from mocap_ros.formats.export.opensim_model import (
    BODY_MASS_KG,
    RANGE_DEG,
    RANGE_M,
    place_markers,
    save_mot,
    save_osim,
)
from mocap_ros.formats.export.trc import save_trc
from mocap_ros.skeleton import CMU15
from tests.support.motion_files import FRAMES, Z_UP_TO_Y_UP
from tests.support.opensim_kinematics import compute_joints, read_markers, require_opensim

FPS = 29.97  # Hz, a rate that is not an integer
UNSEEN = [0, 1, FRAMES - 1]  # frames without a skeleton


def test_opensim_reads_markers_unit_rate_and_frames(tmp_path: Path, poses: np.ndarray) -> None:
    opensim = require_opensim()
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


def save_all(folder: Path, joints: np.ndarray) -> None:
    """Write markers, model and joint angles."""
    angles = compute_joint_angles(joints, FPS)
    save_trc(folder / 'walk.trc', CMU15.joints, joints, FPS)
    save_osim(folder / 'walk.osim', '</a> /\0', place_markers(joints, angles))  # any id of a person
    save_mot(folder / 'walk.mot', angles, np.arange(len(joints)) / FPS)


def test_the_model_is_a_body_whose_parts_hang_together(tmp_path: Path, poses: np.ndarray) -> None:
    save_all(tmp_path, poses @ Z_UP_TO_Y_UP.T)
    model = ET.parse(tmp_path / 'walk.osim')
    bodies = {body.get('name'): body for body in model.iter('Body')}

    def read(element: ET.Element, name: str) -> np.ndarray:
        return np.array(element.findtext(name, '').split(), float)

    assert sum(read(body, 'mass') for body in bodies.values()) == pytest.approx([BODY_MASS_KG], rel=1e-3)
    for body in bodies.values():
        a, b, c, *products = read(body, 'inertia')
        assert min(a, b, c) > 0
        assert a + b > c, 'no body turns otherwise'
        assert a + c > b
        assert b + c > a
        assert products == [0, 0, 0]
        assert 0.02 < 2 * np.linalg.norm(read(body, 'mass_center')) < 0.7, 'm'
    ranges = {c.get('name'): read(c, 'range').tolist() for c in model.iter('Coordinate')}
    assert set(ranges) == set(COORDINATES)
    for name, (low, high) in ranges.items():
        assert high == -low == pytest.approx(RANGE_M if name in POSITIONS else np.radians(RANGE_DEG))
    parents = {frame.findtext('socket_parent', '') for frame in model.iter('PhysicalOffsetFrame')}
    assert parents == {'/ground', *(f'/bodyset/{name}' for name in bodies)}
    on = {marker.get('name'): marker.findtext('socket_parent_frame', '') for marker in model.iter('Marker')}
    assert on.keys() == set(CMU15.joints)
    assert set(on.values()) <= parents


def test_the_model_in_the_pose_of_the_angles_has_its_markers_at_the_joints(
    tmp_path: Path, poses: np.ndarray
) -> None:
    opensim = require_opensim()
    joints = poses @ Z_UP_TO_Y_UP.T
    save_all(tmp_path, joints)
    angles = compute_joint_angles(joints, FPS)
    expected = compute_joints(angles.values, place_markers(joints, angles))
    model = opensim.Model(str(tmp_path / 'walk.osim'))
    state = model.initSystem()
    table = opensim.TimeSeriesTable(str(tmp_path / 'walk.mot'))
    assert tuple(table.getColumnLabels()) == COORDINATES
    assert table.getTableMetaDataString('inDegrees') == 'yes'
    for frame in range(0, FRAMES, 7):
        row = table.getRowAtIndex(frame)
        for i, name in enumerate(COORDINATES):
            value = row[i] if name in POSITIONS else np.radians(row[i])
            model.getCoordinateSet().get(name).setValue(state, value, False)
        model.realizePosition(state)
        for j, joint in enumerate(CMU15.joints):
            place = model.getMarkerSet().get(joint).getLocationInGround(state).to_numpy()
            assert place == pytest.approx(expected[frame, j], abs=1e-5), (frame, joint)


def test_inverse_kinematics_runs_on_the_markers_and_gives_the_angles(tmp_path: Path, poses: np.ndarray) -> None:
    opensim = require_opensim()
    joints = poses @ Z_UP_TO_Y_UP.T
    angles = compute_joint_angles(joints, FPS)
    rigid = compute_joints(angles.values, place_markers(joints, angles))  # bones of constant length
    save_all(tmp_path, rigid)
    tool = opensim.InverseKinematicsTool()
    model = opensim.Model(str(tmp_path / 'walk.osim'))  # the tool only refers to it
    tool.setModel(model)
    tool.setMarkerDataFileName(str(tmp_path / 'walk.trc'))
    tool.setOutputMotionFileName(str(tmp_path / 'ik.mot'))
    tool.setResultsDir(str(tmp_path))
    for joint in CMU15.joints:
        task = opensim.IKMarkerTask()
        task.setName(joint)
        task.setWeight(1.0)
        tool.getIKTaskSet().cloneAndAppend(task)
    assert tool.run()
    errors = opensim.TimeSeriesTable(str(tmp_path / '_ik_marker_errors.sto'))
    assert errors.getDependentColumn('marker_error_RMS').to_numpy().max() < 0.002, 'm'
    found = opensim.TimeSeriesTable(str(tmp_path / 'ik.mot'))
    for i, name in enumerate(COORDINATES):
        difference = found.getDependentColumn(name).to_numpy() - angles.values[:, i]
        assert np.sqrt((difference**2).mean()) < 1.0, name
    assert read_markers(opensim, str(tmp_path / 'walk.trc')) == pytest.approx(rigid, abs=1e-6)
