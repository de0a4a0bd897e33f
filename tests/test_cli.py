"""The commands, on real files: what they write, and one line for what is wrong."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from conftest import shared

from mocap_ros.base_poses import load_model
from mocap_ros.cli.main import main
from mocap_ros.demo.scene import make_recording
from mocap_ros.io.sequence import load_sequence, save_sequence


@pytest.fixture(scope='module')
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp('cli') / 'demo.npz'
    save_sequence(path, make_recording().sequence())
    return path


def test_the_embedded_recording_is_what_the_generator_makes(recording: Path) -> None:
    shipped = load_sequence(Path(__file__).parents[1] / 'mocap_ros' / 'data' / 'demo.npz')
    made = load_sequence(recording)
    assert shipped.keypoints == pytest.approx(made.keypoints, abs=1e-3, nan_ok=True)
    assert shipped.truth is not None
    assert made.truth is not None
    assert shipped.truth.joints == pytest.approx(made.truth.joints, abs=1e-5)


def test_evaluate_reports_and_writes_json(recording: Path, tmp_path: Path, capsys) -> None:
    out = tmp_path / 'e.json'
    assert main(['evaluate', str(recording), '--json', str(out)]) == 0
    (record,) = json.loads(out.read_text())
    assert record['mpjpe_mm'] < 80
    assert record['failed_frames'] == 0
    assert {'bone_std_mm', 'residual_px', 'fps', 'seconds', 'e_paper_cm'} <= record.keys()
    assert 'MPJPE' in capsys.readouterr().out


@pytest.mark.parametrize('method', ['joint', 'alternation'])
def test_reconstruct_writes_npz_and_csv(recording: Path, tmp_path: Path, method: str) -> None:
    options = ['--set', f'solver.method={method}', '--set', 'solver.max_iterations=5']
    assert main(['reconstruct', str(recording), '-o', str(tmp_path / 'r.npz'), *options]) == 0
    assert main(['reconstruct', str(recording), '-o', str(tmp_path / 'r.csv'), *options]) == 0
    with np.load(tmp_path / 'r.npz') as z:
        joints = z['joints3d']
        assert joints.shape == (390, 15, 3)
        assert np.isfinite(joints).all()
    with (tmp_path / 'r.csv').open() as file:
        rows = list(csv.reader(file))
    assert len(rows) == 391
    assert np.array(rows[1][1:], float).reshape(15, 3) == pytest.approx(joints[0], abs=1e-5)


def test_plot_draws_a_picture(recording: Path, tmp_path: Path) -> None:
    assert main(['plot', str(recording), '-o', str(tmp_path / 'p.png'), '--set', 'solver.max_iterations=3']) == 0
    assert (tmp_path / 'p.png').read_bytes().startswith(b'\x89PNG')


def test_evaluate_agrees_with_the_protocol(protocol, tmp_path: Path) -> None:
    data = np.load(shared('data/cmu/cmu15_30fps.npz'))
    view = protocol.make_view(data['07_01'], data['_joints'], heading=45)
    np.savez(tmp_path / 'v.npz', **view)
    arguments = [str(tmp_path / 'v.npz'), '--model', 'walk']
    assert main(['evaluate', *arguments, '--json', str(tmp_path / 'e.json')]) == 0
    assert main(['reconstruct', *arguments, '-o', str(tmp_path / 'r.npz')]) == 0
    (record,) = json.loads((tmp_path / 'e.json').read_text())
    r = np.load(tmp_path / 'r.npz')
    theirs = protocol.score(r['joints3d'], r['joint_names'], view['joints3d'], view['joints3d_names'])
    assert {k: record[k] for k in theirs} == pytest.approx(theirs, abs=0.01, rel=1e-4)


def test_train_on_motion_capture(tmp_path: Path, capsys) -> None:
    data = shared('data/cmu/cmu15_30fps.npz')
    model = tmp_path / 'm.npz'
    arguments = ['train', str(data), '--category', 'run', '--without-subject', '35', '-o', str(model)]
    assert main(arguments) == 0
    assert 'base poses from' in capsys.readouterr().out
    trained = load_model(model)
    assert trained.name == 'run'
    assert not any(str(t).startswith('35_') for t in trained.provenance['trials'])


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        (['reconstruct', 'nowhere.npz'], 'nowhere.npz'),
        (['reconstruct', 'RECORDING', '-o', 'x.docx'], 'x.docx: can write .npz or .csv'),
        (['reconstruct', 'RECORDING', '--model', 'moonwalk'], "no base-pose model 'moonwalk'"),
        (['reconstruct', 'RECORDING', '--set', 'solver.speed=1'], "unknown parameter 'solver.speed'"),
        (['reconstruct', 'RECORDING', '-o', '/nowhere/x.npz'], '/nowhere/x.npz'),
        (['evaluate', 'GARBAGE'], 'garbage.npz'),
        (['train', 'GARBAGE', '-o', 'x.npz'], 'garbage.npz'),
        (['train', 'RECORDING', '-o', 'x.npz'], '_joints'),
        (['replay', 'nowhere', '-o', 'x'], 'nowhere'),
        (['config', '--config', 'nowhere.yaml'], 'nowhere.yaml'),
    ],
)
def test_failures_are_one_line_on_stderr(recording, tmp_path, monkeypatch, capsys, arguments, message) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'garbage.npz').write_bytes(b'PK\x03\x04 and then nothing of use')
    known = {'RECORDING': str(recording), 'GARBAGE': 'garbage.npz'}
    assert main([known.get(a, a) for a in arguments]) == 1
    error = capsys.readouterr().err
    assert error.count('\n') == 1
    assert message in error


def test_usage_errors_exit_with_2() -> None:
    for arguments in ([], ['evaluate'], ['dance']):
        with pytest.raises(SystemExit) as stopped:
            main(arguments)
        assert stopped.value.code == 2
