"""The command `evaluate`."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mocap_ros.cli.main import main
from mocap_ros.formats.sequence_file import GroundTruth, load_sequence, save_sequence
from tests.support.evaluation_data import shared
from tests.support.quick_options import QUICK_OPTIONS


def test_evaluate_prints_a_table_and_writes_json(recording: Path, tmp_path: Path, capsys) -> None:
    out = tmp_path / 'e.json'
    assert main(['evaluate', str(recording), '--json', str(out)]) == 0
    (record,) = json.loads(out.read_text())
    assert record['mpjpe_mm'] < 80
    assert record['failed_frames'] == 0
    assert {'bone_std_mm', 'residual_px', 'fps', 'seconds', 'e_paper_cm'} <= record.keys()
    titles, units, row, legend = capsys.readouterr().out.splitlines()
    assert titles.split()[:2] == ['MPJPE', 'PA-MPJPE']
    assert {'mm', 'cm', 'px', 'fps', 's'} == set(units.split())
    assert re.fullmatch(r'demo\.npz( +\d+\.\d+){7} +390 +0 +30 +\d+\.\d', row)
    assert 'PA-MPJPE: after one similarity transform per frame' in legend


def test_evaluate_warns_about_a_truth_in_mm(recording: Path, tmp_path: Path, capsys) -> None:
    sequence = load_sequence(recording)
    assert sequence.truth is not None
    truth = GroundTruth(sequence.truth.joints * 1000, sequence.truth.joint_names)
    save_sequence(tmp_path / 'mm.npz', replace(sequence, truth=truth))
    warning_in_mm = 'mm.npz: joints3d: the values look like mm, but m are expected\n'
    for path, warning in ((recording, ''), (tmp_path / 'mm.npz', warning_in_mm)):
        assert main(['evaluate', str(path), '--set', 'solver.max_iterations=1']) == 0
        error = capsys.readouterr().err
        assert error.endswith(warning)
        assert warning or not error


def test_evaluate_agrees_with_the_measuring_protocol(protocol, tmp_path: Path) -> None:
    data = np.load(shared('data/cmu/cmu15_30fps.npz'))
    view = protocol.make_view(data['07_01'], data['_joints'], heading=45)
    np.savez(tmp_path / 'v.npz', **view)
    arguments = [str(tmp_path / 'v.npz'), '--model', 'walk']
    assert main(['evaluate', *arguments, '--json', str(tmp_path / 'e.json')]) == 0
    assert main(['reconstruct', *arguments, '-o', str(tmp_path / 'r.npz')]) == 0
    (record,) = json.loads((tmp_path / 'e.json').read_text())
    r = np.load(tmp_path / 'r.npz')
    expected = protocol.score(r['joints3d'], r['joint_names'], view['joints3d'], view['joints3d_names'])
    assert {k: record[k] for k in expected} == pytest.approx(expected, abs=0.01, rel=1e-4)


@pytest.mark.filterwarnings('error')
def test_evaluate_leaves_out_unknown_parts_of_the_truth(short_recording: Path, tmp_path: Path, capsys) -> None:
    whole = load_sequence(short_recording)
    assert whole.truth is not None
    out = tmp_path / 'e.json'

    def evaluate_without(unknown: object) -> int:
        joints = whole.truth.joints.copy()
        joints[unknown] = np.nan
        save_sequence(tmp_path / 't.npz', replace(whole, truth=GroundTruth(joints, whole.truth.joint_names)))
        return main(['evaluate', str(tmp_path / 't.npz'), '--json', str(out), *QUICK_OPTIONS])

    for unknown, joints, frames in (((slice(5), 3), 15, 15), ((slice(None), 3), 14, 20)):
        assert evaluate_without(unknown) == 0
        (record,) = json.loads(out.read_text())
        assert (record['joints'], record['frames']) == (joints, frames)
        assert record['mpjpe_mm'] < 500
    assert evaluate_without(slice(None)) == 1
    assert 't.npz: joints3d: no joint is known in any frame' in capsys.readouterr().err
    foreign_truth = GroundTruth(whole.truth.joints, tuple('abcdefghijklmno'))
    save_sequence(tmp_path / 'f.npz', replace(whole, truth=foreign_truth))
    assert main(['evaluate', str(tmp_path / 'f.npz'), *QUICK_OPTIONS]) == 1
    assert 'f.npz: only 0 joints in common' in capsys.readouterr().err
