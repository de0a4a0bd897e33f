# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The command `evaluate`."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mocap_ros.bags.recorder import Recorder
from mocap_ros.bags.topics import Source
from mocap_ros.cli.main import main
from mocap_ros.config import RecorderConfig, with_values
from mocap_ros.formats.sequence_file import GroundTruth, load_sequence, save_sequence
from mocap_ros.messages.skeletons import SKELETONS
from mocap_ros.runtime.playback import encode_sequence
from tests.support.pipeline_inputs import FAST_CONFIG, make_calibrated


def test_the_table_and_the_json(short_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / 'e.json'
    assert main(['evaluate', str(short_recording), '--json', str(out)]) == 0
    (record,) = json.loads(out.read_text())
    assert 10 < record['pa_mpjpe_mm'] < record['mpjpe_mm'] < 60
    assert record['failed_frames'] == 0
    assert {'bone_std_mm', 'residual_px', 'fps', 'seconds', 'e_paper_cm'} <= record.keys()
    titles, units, row, legend = capsys.readouterr().out.splitlines()
    assert titles.split()[:2] == ['MPJPE', 'PA-MPJPE']
    assert {'mm', 'cm', 'px', 'fps', 's'} == set(units.split())
    assert re.fullmatch(r'\$x\^\{_\$\.npz( +\d+\.\d+){7} +20 +0 +30 +\d+\.\d', row)
    assert 'PA-MPJPE: after one similarity transform per frame' in legend


def test_results_are_compared(short_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    quick = ['--set', 'solver.max_iterations=2']
    names = [str(tmp_path / name) for name in ('r.npz', 'r.mcap')]
    for name in names:
        assert main(['reconstruct', str(short_recording), '-o', name, *quick]) == 0
    assert main(['evaluate', str(short_recording), '--json', str(tmp_path / 's.json'), *quick]) == 0
    arguments = ['--truth', str(short_recording), '--json', str(tmp_path / 'e.json')]
    assert main(['evaluate', *names, *arguments]) == 0
    (solved,) = json.loads((tmp_path / 's.json').read_text())
    for record in json.loads((tmp_path / 'e.json').read_text()):
        assert 'seconds' not in record
        expected = {k: solved[k] for k in solved if k not in ('file', 'seconds')}
        assert {k: record[k] for k in record if k != 'file'} == pytest.approx(expected, rel=1e-4, abs=1e-4)
    capsys.readouterr()
    for wrong, message in (
        ([names[0]], 'r.npz: holds no truth'),
        ([names[0], *arguments, '--model', 'walk'], 'r.npz: --model does not apply to a result'),
        ([names[1], *arguments, '--person', '9'], "r.mcap: no person '9'; there are person_1 (20)"),
        ([names[0], '--truth', names[0]], 'r.npz: is a result of reconstruct'),
    ):
        assert main(['evaluate', *wrong]) == 1
        (line,) = capsys.readouterr().err.splitlines()
        assert message in line


def test_times_are_those_of_the_truth(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    whole = load_sequence(recording)
    assert whole.truth is not None
    rows = slice(20, 60, 2)
    truth = GroundTruth(whole.truth.joints[rows], whole.truth.joint_names)
    part = replace(whole, keypoints=whole.keypoints[rows], timestamps=whole.timestamps[rows] + 4e-4, truth=truth)
    save_sequence(tmp_path / 'part.npz', part)
    save_sequence(tmp_path / 'late.npz', replace(part, timestamps=part.timestamps + 99))
    np.savez(
        tmp_path / 'r.npz',
        joints3d=np.where(np.arange(390)[:, None, None] < 30, np.nan, whole.truth.joints),
        joint_names=whole.truth.joint_names,
        timestamps=whole.timestamps,
        seen=np.ones((390, 15), bool),
        residual_px=np.ones(390),
        theta=np.zeros((390, 1)),
    )
    out, truth_file = tmp_path / 'e.json', tmp_path / 'part.npz'
    assert main(['evaluate', str(tmp_path / 'r.npz'), '--truth', str(truth_file), '--json', str(out)]) == 0
    (record,) = json.loads(out.read_text())
    assert (record['frames'], record['failed_frames'], record['fps']) == (20, 5, pytest.approx(15))
    assert record['abs_mpjpe_mm'] == pytest.approx(0, abs=1e-3)
    assert not capsys.readouterr().err
    times = whole.timestamps
    drifting = times + np.where(np.arange(390) < 100, 0, 0.01)
    for name, changed, truth_file, code, reason in (
        ('ms', times * 1000, recording, 1, 'ms.npz: timestamps: '),
        ('drift', drifting, recording, 0, 'drift.npz: timestamps: only 100 of 390 frames are compared'),
        ('head', times + times[360], recording, 1, 'head.npz: no frame has a skeleton at a time of the truth'),
        ('late', times, tmp_path / 'late.npz', 1, 'late.npz: timestamps: none of 0.000 to 12.967 s'),
    ):
        path = tmp_path / 'changed' / f'{name}.npz'
        path.parent.mkdir(exist_ok=True)
        with np.load(tmp_path / 'r.npz') as arrays:
            np.savez(path, **{**arrays, 'timestamps': changed})
        assert main(['evaluate', str(path), '--truth', str(truth_file)]) == code
        assert reason in capsys.readouterr().err


def test_covariances_in_any_frame(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sequence = load_sequence(recording)
    frames = [*encode_sequence(sequence)][:60]
    found = {}
    in_map = {'node.output_frame': 'map', 'node.camera_pose': '3 2 1.5 0.1 0.2 0.7'}
    for name, values in (('camera', {}), ('map', in_map)):
        pipeline = make_calibrated(with_values(FAST_CONFIG, {'tracker.vertical': 'none', **values}))  # map has one
        with Recorder(tmp_path / name, RecorderConfig()) as recorder:
            for frame in frames:
                outputs = pipeline.feed(Source.KEYPOINTS, frame.raw).outputs
                (skeletons,) = (o for o in outputs if o.topic == 'skeletons')
                recorder.write('/skeletons', SKELETONS, skeletons.data, frame.due_ns, frame.due_ns)
        out = tmp_path / f'{name}.json'
        assert main(['evaluate', str(tmp_path / name), '--truth', str(recording), '--json', str(out)]) == 0
        (record,) = json.loads(out.read_text())
        found[name] = {key: record[key] for key in ('joints68', 'joints95', 'roots68', 'roots95', 'mpjpe_mm')}
        shares = [f'{100 * record[key]:.0f}' for key in ('joints68', 'joints95')]
        assert f'{name}: covariances: {shares[0]} and {shares[1]} of 100' in capsys.readouterr().out
    assert found['map'] == pytest.approx(found['camera'], rel=1e-6)
    assert 0.5 < found['map']['roots95'] <= 1
