# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Blender's own importer reads the BVH files; `pip install bpy`, which is Blender as a module, runs this test."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mocap_ros.formats.bvh import BLENDER_IMPORT, END_SUFFIX, save_bvh
from mocap_ros.formats.export.armature import build_armature
from tests.support.motion_files import FRAMES, Z_UP_TO_Y_UP

Y_UP_TO_Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


def test_blender_shows_the_motion_in_metres_on_its_floor(
    tmp_path: Path, poses: np.ndarray, capfd: pytest.CaptureFixture[str]
) -> None:
    bpy = pytest.importorskip('bpy', reason='needs Blender: pip install bpy')
    bvh = build_armature(poses @ Z_UP_TO_Y_UP.T, 25.0)
    save_bvh(tmp_path / 'walk.bvh', bvh)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_anim.bvh(
        filepath=str(tmp_path / 'walk.bvh'),
        global_scale=0.01,
        axis_forward='-Z',
        axis_up='Y',
        update_scene_fps=True,
    )
    assert BLENDER_IMPORT.endswith('Scale 0.01, Forward -Z and Up Y')
    assert 'zero length' not in capfd.readouterr().out
    (armature,) = bpy.data.objects
    scene = bpy.context.scene
    assert scene.render.fps / scene.render.fps_base == pytest.approx(25.0, rel=1e-4)
    joints = [name for name in bvh.names if not name.endswith(END_SUFFIX)]
    assert set(armature.pose.bones.keys()) == set(joints)
    expected = bvh.compute_positions() / 100 @ Y_UP_TO_Z_UP.T
    for frame in range(FRAMES):
        scene.frame_set(frame + 1)
        for name, position in zip(bvh.names, expected[frame], strict=True):
            bone = armature.pose.bones[name.removesuffix(END_SUFFIX)]
            point = bone.tail if name.endswith(END_SUFFIX) else bone.head
            assert np.array(armature.matrix_world @ point) == pytest.approx(position, abs=1e-3), (name, frame)
