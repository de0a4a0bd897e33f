"""C3D files."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from mocap_ros.errors import InputError, MocapError
from mocap_ros.formats.mocap.joint_maps import load_marker_map
from mocap_ros.formats.mocap.trials import TrialOptions, load_trials
from mocap_ros.skeleton import CMU15
from tests.support.motion_files import FRAMES, check_refusal


def test_markers_give_the_poses(tmp_path: Path, poses: np.ndarray) -> None:
    ezc3d = pytest.importorskip('ezc3d')
    content = ezc3d.c3d()
    content['parameters']['POINT']['RATE']['value'] = [100]
    content['parameters']['POINT']['UNITS']['value'] = ['mm']
    content['parameters']['POINT']['LABELS']['value'] = [f'anna:{j}' for j in CMU15.joints]
    points = np.ones((4, 15, FRAMES))
    points[:3] = np.moveaxis(poses, 0, -1).transpose(1, 0, 2) * 1000
    points[:3, 4, 7] = np.nan
    content['data']['points'] = points
    path = tmp_path / 'anna_1.c3d'
    content.write(str(path))
    (trial,) = load_trials(path)
    assert trial.subject == 'anna'
    assert trial.poses == pytest.approx(np.delete(poses, 7, axis=0), abs=1e-4)

    marker_map = tmp_path / 'markers.yaml'
    lines = [f'{joint}: {joint}' for joint in CMU15.joints if joint != 'pelvis']
    marker_map.write_text('\n'.join([*lines, 'pelvis: [lhip, rhip]']))
    (trial,) = load_trials(path, TrialOptions(markers=load_marker_map(marker_map)))
    hips = (trial.poses[:, CMU15.index('lhip')] + trial.poses[:, CMU15.index('rhip')]) / 2
    assert trial.poses[:, CMU15.index('pelvis')] == pytest.approx(hips)
    marker_map.write_text('\n'.join([*lines, 'pelvis: [LASI, RASI]']))
    with pytest.raises(InputError, match=r'anna_1\.c3d: no LASI, RASI; there are head, neck'):
        load_trials(path, TrialOptions(markers=load_marker_map(marker_map)))


def test_the_missing_library_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, 'ezc3d', None)
    (tmp_path / 'a.c3d').write_bytes(b'')
    with pytest.raises(MocapError, match=r"a\.c3d: C3D needs ezc3d: pip install 'mocap_ros\[c3d\]'"):
        load_trials(tmp_path)


def test_an_invalid_file_is_refused_in_one_line(tmp_path: Path) -> None:
    pytest.importorskip('ezc3d')
    check_refusal(tmp_path / 'a.c3d', 'nothing of use', r'a\.c3d: not a C3D file')
