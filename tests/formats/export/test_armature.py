# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The armature of a motion, as it is read back from its file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mocap_ros.formats.bvh import load_bvh, save_bvh
from mocap_ros.formats.export.armature import build_armature
from mocap_ros.formats.mocap.joint_maps import map_to_model
from mocap_ros.skeleton import BODY26, CMU15
from tests.support.motion_files import Z_UP_TO_Y_UP

PELVIS = CMU15.joints.index('pelvis')


def write_and_read(path: Path, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Write joints (F, 15, 3) in m, y up, as a BVH file.

    Returns:
        (F, 15, 3) joints and (F, N, 3) all nodes, as they are read back, in m.
    """
    save_bvh(path, build_armature(joints, 30.0))
    bvh = load_bvh(path)
    nodes = bvh.compute_positions() / 100
    return map_to_model(dict(zip(bvh.names, np.moveaxis(nodes, 1, 0), strict=True))), nodes


def compute_allowed_error(joints: np.ndarray) -> np.ndarray:
    """Return (15,) m, how far bones of constant length may move each joint, by the bones from it to the pelvis."""
    allowed = np.zeros(len(CMU15.joints))
    for joint in range(len(CMU15.joints)):
        child = joint
        while (parent := CMU15.parents[child]) >= 0:
            length = np.linalg.norm(joints[:, child] - joints[:, parent], axis=1)
            allowed[joint] += np.abs(length - np.median(length)).max()
            child = parent
    return allowed


def test_joints_are_those_of_the_motion_moved_along_y(tmp_path: Path, poses: np.ndarray) -> None:
    joints = poses @ Z_UP_TO_Y_UP.T - [0.0, 1.5, 4.0]
    read, _ = write_and_read(tmp_path / 'a.bvh', joints)
    moved = (read - joints)[:, PELVIS]
    assert moved[:, [0, 2]] == pytest.approx(0.0, abs=1e-6)
    assert np.ptp(moved[:, 1]) < 1e-6
    error = np.linalg.norm(read - joints - moved[:, None], axis=-1).max(axis=0)
    assert (error < compute_allowed_error(joints) + 1e-3).all()
    again, _ = write_and_read(tmp_path / 'b.bvh', read - [0.0, 1.5, 0.0])  # the bones of `read` are constant
    assert compute_allowed_error(read).max() < 5e-3
    assert np.linalg.norm(again - read, axis=-1).max() < 1e-3


@pytest.mark.parametrize('height', [-2.0, 0.0, 5.0])
def test_the_lowest_point_of_all_frames_is_at_0(tmp_path: Path, poses: np.ndarray, height: float) -> None:
    jumping = poses @ Z_UP_TO_Y_UP.T + height
    jumping[:10, :, 1] += 0.3
    _, nodes = write_and_read(tmp_path / 'a.bvh', jumping)
    lowest = nodes[..., 1].min(axis=1)
    assert lowest[10:].min() == pytest.approx(0.0, abs=1e-5)
    assert lowest[:10].min() > 0.25


@pytest.mark.filterwarnings('error')
def test_degenerate_bodies_give_finite_angles_and_bones() -> None:
    point = np.zeros((3, 15, 3))
    line = np.repeat(np.linspace([0, 0, 0], [0, 2, 0], 15)[None], 3, axis=0)
    for joints in (point, line):
        bvh = build_armature(joints, 30.0)
        assert np.isfinite(bvh.motion).all()
        assert (np.linalg.norm(bvh.offsets[1:], axis=1) > 0.99).all()


def test_a_foot_is_as_long_as_in_the_motion(poses: np.ndarray) -> None:
    body = np.full((len(poses), len(BODY26.joints), 3), np.nan)
    body[:, : len(CMU15.joints)] = poses @ Z_UP_TO_Y_UP.T
    for side in 'lr':
        ankle, toe, hand, wrist = (BODY26.index(side + name) for name in ('ankle', 'toe', 'hand', 'wrist'))
        body[:, toe] = body[:, ankle] + [0.0, -0.12, 0.16]  # 20 cm
        body[:, hand] = body[:, wrist] + [0.0, -0.08, 0.0]
    bvh = build_armature(body, 30.0)
    ends = [bvh.parents.index(bvh.names.index(name)) for name in ('LeftFoot', 'RightFoot')]
    np.testing.assert_allclose(np.linalg.norm(bvh.offsets[ends], axis=1), 20.0, rtol=1e-6)
