# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""C3D files."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from mocap_ros.errors import InputError, MocapError
from mocap_ros.formats.mocap import c3d
from mocap_ros.formats.mocap.joint_maps import load_marker_map
from mocap_ros.formats.mocap.trials import TrialOptions, load_trials
from mocap_ros.skeleton import CMU15
from tests.support.motion_files import FRAMES, check_refusal
from tests.support.paths import ROOT


def write_c3d(path: Path, labels: Sequence[str], positions: np.ndarray) -> None:
    """Write markers (F, M, 3) in m as a C3D file in mm."""
    ezc3d = pytest.importorskip('ezc3d')
    content = ezc3d.c3d()
    content['parameters']['POINT']['RATE']['value'] = [100]
    content['parameters']['POINT']['UNITS']['value'] = ['mm']
    content['parameters']['POINT']['LABELS']['value'] = list(labels)
    points = np.ones((4, len(labels), len(positions)))
    points[:3] = positions.transpose(2, 1, 0) * 1000
    content['data']['points'] = points
    content.write(str(path))


def test_the_markers_of_two_people_make_no_body(tmp_path: Path, poses: np.ndarray) -> None:
    path = tmp_path / 'two_1.c3d'
    labels = [f'{name}:{joint}' for name in ('anna', 'ben') for joint in CMU15.joints]
    write_c3d(path, labels[:-1], np.concatenate([poses, poses[:, :-1] + [3, 0, 0]], axis=1))
    with pytest.raises(InputError, match=r'two_1\.c3d: joints of no known rig; .*anna:head.* by --markers'):
        load_trials(path)
    marker_map = tmp_path / 'markers.yaml'
    names = {joint: f'anna:{joint}' for joint in CMU15.joints[:-1]} | {CMU15.joints[-1]: CMU15.joints[-1]}
    marker_map.write_text('\n'.join(f'{joint}: "{name}"' for joint, name in names.items()))
    (trial,) = load_trials(path, TrialOptions(markers=load_marker_map(marker_map)))
    assert trial.poses == pytest.approx(poses, abs=1e-4)


def test_labels_are_read_beyond_the_first_list(tmp_path: Path, poses: np.ndarray) -> None:
    """A list of labels holds 255."""
    path = tmp_path / 'a_1.c3d'
    others = [f'other{i}' for i in range(260)]
    write_c3d(path, [*others, *CMU15.joints], np.concatenate([np.zeros((FRAMES, 260, 3)), poses], axis=1))
    (trial,) = load_trials(path)
    assert trial.poses == pytest.approx(poses, abs=1e-4)


def test_markers_give_the_poses(tmp_path: Path, poses: np.ndarray) -> None:
    path = tmp_path / 'anna_1.c3d'
    positions = poses.copy()
    positions[7, 4] = np.nan
    write_c3d(path, [f'anna:{j}' for j in CMU15.joints], positions)
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


@pytest.mark.parametrize(
    ('name', 'reason'),
    [
        ('endless_reading', 'its reader did not end within 1 s of processor time'),
        ('crash_of_the_library', 'its reader ended by SIG'),
    ],
)
def test_files_that_stop_the_library_are_refused_with_the_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, reason: str
) -> None:
    pytest.importorskip('ezc3d')
    monkeypatch.setattr(c3d, 'TIME_S', 1)
    (tmp_path / 'a.c3d').write_bytes((ROOT / 'tests' / 'fuzz' / 'failed' / 'c3d' / name).read_bytes())
    with pytest.raises(InputError, match=rf'a\.c3d: not a C3D file \({reason}'):
        load_trials(tmp_path / 'a.c3d')
