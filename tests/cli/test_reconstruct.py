"""The commands `reconstruct` and `plot`."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mocap_ros.cli.main import main
from mocap_ros.errors import InputError
from mocap_ros.formats.sequence_file import load_sequence, save_sequence
from mocap_ros.skeleton import CMU15, keypoint_layout
from mocap_ros.viewing import plots
from tests.support.quick_options import QUICK_OPTIONS


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


def test_results_are_written_into_the_current_folder(recording: Path, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    quick = ['--set', 'solver.max_iterations=3']
    beside = set(recording.parent.iterdir())
    assert main(['plot', str(recording), *quick]) == 0
    assert main(['reconstruct', str(recording), *quick]) == 0
    assert (tmp_path / 'demo.png').read_bytes().startswith(b'\x89PNG')
    assert {p.name for p in tmp_path.iterdir()} == {'demo.png', 'demo_3d.npz'}
    assert set(recording.parent.iterdir()) == beside
    with pytest.raises(InputError, match=r'demo_3d\.npz: not a sequence file: a result of reconstruct; give'):
        load_sequence('demo_3d.npz')


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('ending', ['.npz', '.mcap', '.bvh', '.trc', '.png'])
@pytest.mark.parametrize('case', ['one frame', 'one point', 'one line', 'still'])
def test_degenerate_keypoints_cause_no_warnings(
    short_recording: Path, tmp_path: Path, case: str, ending: str
) -> None:
    whole = replace(load_sequence(short_recording), truth=None)
    keypoints = whole.keypoints.copy()
    if case == 'one point':
        keypoints[..., :2] = 100
    elif case == 'one line':
        keypoints[..., 1] = 100
    elif case == 'still':
        keypoints[:] = keypoints[0]
    frames = 1 if case == 'one frame' else 20
    path = tmp_path / 'd.npz'
    save_sequence(path, replace(whole, keypoints=keypoints[:frames], timestamps=whole.timestamps[:frames]))
    command = 'plot' if ending == '.png' else 'reconstruct'
    assert main([command, str(path), '-o', str(tmp_path / f'o{ending}'), *QUICK_OPTIONS]) == 0


def test_a_picture_explains_its_colours_and_lines(recording: Path) -> None:
    sequence = load_sequence(recording)
    assert sequence.truth is not None
    result = plots.PlotData(
        times=sequence.timestamps,
        keypoints=sequence.keypoints,
        keypoint_skeleton=keypoint_layout('coco17'),
        joints=sequence.truth.joints,
        seen=np.ones((390, 15), bool),
        skeleton=CMU15,
        truth=sequence.truth.joints,
    )
    figure = plots.draw_poses_figure(result, [0, 100], 'title', ['a', 'b'])
    (colours,) = figure.legends
    assert [t.get_text() for t in colours.get_texts()] == [
        'left', 'right', 'middle', 'truth', 'not seen, filled in by the model',
    ]  # fmt: skip
    (errors, share) = figure.axes[-2:]
    assert (errors.get_ylabel(), share.get_ylabel()) == ('3D error, mm', 'joints not seen')
    assert [t.get_text() for t in share.get_legend().get_texts()] == [
        '3D error',
        'joints not seen',
        'frames above',
    ]


@pytest.mark.filterwarnings('error')
def test_any_file_name_is_a_valid_title_of_a_picture(short_recording: Path, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(['plot', str(short_recording), '--poses', '2', *QUICK_OPTIONS]) == 0
    assert (tmp_path / '$x^{_$.png').stat().st_size > 1000
