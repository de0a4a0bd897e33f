# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The command `cameras`: results of several cameras in, a file and a picture out."""

from pathlib import Path

import numpy as np
import pytest

from mocap_ros.cli.main import main
from mocap_ros.formats.cameras_file import load_cameras
from mocap_ros.geometry.rigid_transform import format_camera_pose
from mocap_ros.recordings.save_results import save
from tests.support.walkers import FLOOR_M, place_camera, see

CAMERAS = place_camera(0), place_camera(70, clock_s=0.3)


def write_results(folder: Path, seconds: float) -> list[str]:
    paths = [folder / f'cam{c}.npz' for c in range(2)]
    for c, path in enumerate(paths):
        save(path, see(CAMERAS[c], [0], seconds, c)[0])
    return [str(path) for path in paths]


def test_cameras_are_printed_and_saved_in_a_level_frame(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths, out, picture = write_results(tmp_path, 12.0), tmp_path / 'out' / 'c.yaml', tmp_path / 'above.png'
    distance = float(np.linalg.norm(CAMERAS[0].pose[:3, 3] - CAMERAS[1].pose[:3, 3]))
    options = ['-o', str(out), '--picture', str(picture), '--distance', 'cam1', 'cam0', str(distance)]
    assert main(['cameras', *paths, *options]) == 0
    found = load_cameras(out)
    assert found.names == ('cam0', 'cam1')
    assert found.clock_offsets == pytest.approx([0, -0.3], abs=0.01)
    # in the world of the tests y is down; in the file z is up, x where the first camera looks, from the floor
    from_world = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, FLOOR_M], [0, 0, 0, 1.0]])
    expected = from_world @ [camera.pose for camera in CAMERAS]
    expected[:, :2, 3] -= expected[0, :2, 3]
    assert found.poses == pytest.approx(expected, abs=0.08)
    assert found.poses[:, :3, :3] == pytest.approx(expected[:, :3, :3], abs=0.02)
    assert np.linalg.norm(np.diff(found.poses[:, :3, 3], axis=0)) == pytest.approx(distance, abs=1e-3)
    printed = capsys.readouterr().out
    assert all(f"node.camera_pose:='{format_camera_pose(pose)}'" in printed for pose in found.poses)
    assert picture.stat().st_size > 10_000


@pytest.mark.parametrize(
    ('seconds', 'options', 'place'),
    [
        (1.0, [], 'cam1: its rotation is known to'),
        (4.0, ['--distance', 'cam0', 'cam9', '2'], "--distance: no camera 'cam9'"),
        (4.0, ['--distance', 'cam0', 'cam0', '2'], '--distance: cam0'),
        (4.0, ['--distance', 'cam0', 'cam1', '-2'], '--distance: -2'),
        (4.0, ['--picture', 'x.pgf'], 'x.pgf: unknown file type'),
        (4.0, ['-o', 'cam0.npz'], 'cam0.npz: not written'),
        (4.0, ['--fps', '30'], 'cam0.npz: is a result of reconstruct, to which --fps'),
    ],
)
def test_what_is_wrong_is_named(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    seconds: float,
    options: list[str],
    place: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(['cameras', *write_results(tmp_path, seconds), *options]) == 1
    assert place in capsys.readouterr().err


def test_one_recording_is_too_few(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['cameras', write_results(tmp_path, 1.0)[0]]) == 1
    assert 'cam0.npz: one recording' in capsys.readouterr().err
