# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The commands `reconstruct` and `plot`."""

from __future__ import annotations

import csv
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mocap_ros.cli.main import main
from mocap_ros.demo.scene import make_recording
from mocap_ros.errors import InputError
from mocap_ros.formats.detections import Detections
from mocap_ros.formats.export.joint_angles import COORDINATES, POSITIONS
from mocap_ros.formats.sequence_file import load_sequence, save_sequence
from mocap_ros.runtime.save_results import save_detections
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
        assert joints.shape == (390, 26, 3)
        assert np.isfinite(joints).all()
        assert np.linalg.norm(z['orientation'], axis=-1) == pytest.approx(np.ones((390, 26)), abs=1e-5)
        assert z['turn_inferred'].shape == (390, 26)
        assert 0 < z['turn_inferred'].mean() < 1
    with (tmp_path / 'r.csv').open() as file:
        rows = list(csv.reader(file))
    assert len(rows) == 391
    assert np.array(rows[1][1:], float).reshape(26, 3) == pytest.approx(joints[0], abs=1e-5)


@pytest.mark.parametrize('method', ['whole', 'keyframes'])
def test_the_nominal_focal_length_is_that_of_the_parameter(
    short_recording: Path, tmp_path: Path, method: str
) -> None:
    depths = []
    for focal in (1.0, 2.0):
        out = tmp_path / f'{focal}.npz'
        options = ['--set', f'tracker.nominal_focal_length={focal}', *QUICK_OPTIONS]
        assert main(['reconstruct', str(short_recording), '-o', str(out), '--method', method, *options]) == 0
        with np.load(out) as arrays:
            depths.append(np.nanmean(arrays['joints3d'][..., 2]))
    assert depths[1] == pytest.approx(2 * depths[0], rel=0.1)


def test_results_are_written_into_the_current_folder(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    quick = ['--set', 'solver.max_iterations=3']
    beside = set(recording.parent.iterdir())
    assert main(['plot', str(recording), *quick]) == 0
    assert main(['reconstruct', str(recording), *quick]) == 0
    assert (tmp_path / 'demo.png').read_bytes().startswith(b'\x89PNG')
    assert {p.name for p in tmp_path.iterdir()} == {'demo.png', 'demo_3d.npz'}
    assert set(recording.parent.iterdir()) == beside
    with pytest.raises(InputError, match=r'demo_3d\.npz: is a result of reconstruct; give the sequence file'):
        load_sequence('demo_3d.npz')


def test_the_summary_says_that_the_solver_did_not_converge(
    short_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ['reconstruct', str(short_recording), '-o', str(tmp_path / 'r.npz')]
    assert main([*command, *QUICK_OPTIONS]) == 0
    assert capsys.readouterr().out.endswith(
        ' iterations. Not converged: the largest number of iterations was reached.\n'
    )
    assert main([*command, '--model', 'walk']) == 0
    assert capsys.readouterr().out.endswith(' iterations\n')


def test_the_summary_says_that_distances_are_nominal_unless_a_field_of_view_is_given(
    short_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / 'r.npz'
    command = ['reconstruct', str(short_recording), '-o', str(out), *QUICK_OPTIONS]
    for options, is_known in (([], False), (['--hfov', '56'], True), (['--focal', '600'], True)):
        assert main([*command, *options]) == 0
        assert ('nominal focal length' in capsys.readouterr().out) != is_known
        with np.load(out) as arrays:
            assert bool(arrays['scale_known']) == is_known
    for wrong in (['--hfov', '0.5'], ['--hfov', '56', '--focal', '600']):
        with pytest.raises(SystemExit, match='2'):
            main([*command, *wrong])


def test_the_options_for_blender_are_printed_with_a_bvh_file(
    short_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for suffix in ('trc', 'bvh'):
        output = str(tmp_path / f'r.{suffix}')
        assert main(['reconstruct', str(short_recording), '-o', output, *QUICK_OPTIONS]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [' 0.01,' in line for line in lines] == [False, False, True]
    assert lines[-1].startswith(f'{tmp_path / "r.bvh"}: in cm, y up, as for a level camera. In Blender: ')


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('ending', ['.npz', '.mcap', '.bvh', '.trc', '.png'])
@pytest.mark.parametrize('case', ['one frame', 'one line', 'still'])
def test_degenerate_keypoints_cause_no_warnings(
    short_recording: Path, tmp_path: Path, case: str, ending: str
) -> None:
    whole = replace(load_sequence(short_recording), truth=None)
    keypoints = whole.keypoints.copy()
    if case == 'one line':
        keypoints[..., 1] = 100
    elif case == 'still':
        keypoints[:] = keypoints[0]
    frames = 1 if case == 'one frame' else 20
    path = tmp_path / 'd.npz'
    save_sequence(path, replace(whole, keypoints=keypoints[:frames], timestamps=whole.timestamps[:frames]))
    command = 'plot' if ending == '.png' else 'reconstruct'
    assert main([command, str(path), '-o', str(tmp_path / f'o{ending}'), *QUICK_OPTIONS]) == 0


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('command', [['reconstruct'], ['plot'], ['reconstruct', '--method', 'keyframes']])
def test_keypoints_in_one_place_are_refused_in_one_line(
    short_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], command: list[str]
) -> None:
    whole = replace(load_sequence(short_recording), truth=None)
    keypoints = whole.keypoints.copy()
    keypoints[..., :2] = 100
    path = tmp_path / 'd.npz'
    save_sequence(path, replace(whole, keypoints=keypoints))
    suffix = '.png' if command == ['plot'] else '.npz'
    assert main([*command, str(path), '-o', str(tmp_path / f'o{suffix}'), *QUICK_OPTIONS]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith('d.npz: all seen points lie in one place')


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
    legend = share.get_legend()
    assert legend is not None
    assert [t.get_text() for t in legend.get_texts()] == [
        '3D error',
        'joints not seen',
        'frames above',
    ]


@pytest.mark.filterwarnings('error')
def test_any_file_name_is_a_valid_title_of_a_picture(
    short_recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(['plot', str(short_recording), '--poses', '2', *QUICK_OPTIONS]) == 0
    assert (tmp_path / '$x^{_$.png').stat().st_size > 1000


def test_a_file_whose_name_is_no_utf_8_has_pictures(short_recording: Path, tmp_path: Path) -> None:
    path = tmp_path / os.fsdecode(b'walk\xff.npz')
    shutil.copy(short_recording, path)
    assert main(['plot', str(path), '--poses', '2', '-o', str(tmp_path / 'a.png'), *QUICK_OPTIONS]) == 0
    assert main(['keyframes', str(path), '-o', str(tmp_path / 'k.yaml')]) == 0
    assert (tmp_path / 'k.yaml').read_text(encoding='utf-8').startswith('# Keyframes of walk\\udcff.npz. ')
    assert all((tmp_path / name).stat().st_size > 1000 for name in ('a.png', 'k.png', 'k_distances.png'))


def test_a_result_is_drawn_as_it_is(
    short_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ('r.npz', 'r.mcap'):
        assert main(['reconstruct', str(short_recording), '-o', str(tmp_path / name), *QUICK_OPTIONS]) == 0
        assert main(['plot', str(tmp_path / name), '-o', str(tmp_path / 'p.png'), '--poses', '3']) == 0
        assert (tmp_path / 'p.png').read_bytes().startswith(b'\x89PNG')
        (tmp_path / 'p.png').unlink()
        capsys.readouterr()
        assert main(['plot', str(tmp_path / name), '-o', str(tmp_path / 'p.png'), '--model', 'walk']) == 1
        assert f'{name}: holds a result, which is drawn as it is; --topic' in capsys.readouterr().err
        assert not (tmp_path / 'p.png').exists()


def test_a_picture_without_input_shows_the_result_from_two_sides() -> None:
    joints = np.random.default_rng(0).normal(size=(3, 15, 3))
    joints[0] = np.nan
    data = plots.PlotData(np.arange(3) / 30, joints, np.ones((3, 15), bool), CMU15)
    figure = plots.draw_poses_figure(data, [0, 2], 'title', ['a', 'b'])
    assert [axes.get_ylabel() for axes in figure.axes] == ['3D, from the camera', '3D, from the side', '', '']
    assert [[t.get_text() for t in axes.texts] for axes in figure.axes] == [['no skeleton']] * 2 + [[]] * 2
    whole = replace(data, keypoints=np.ones((3, 17, 3)), keypoint_skeleton=keypoint_layout('coco17'))
    figure = plots.draw_poses_figure(whole, [2], 'title', ['a'])
    assert [axes.get_ylabel() for axes in figure.axes] == ['2D input', '3D, from the camera', '3D, from the side']


def test_several_files_of_one_reconstruction_agree(short_recording: Path, tmp_path: Path) -> None:
    names = ('r.npz', 'r.angles.csv', 'r.trc', 'r.csv')
    outputs = [word for name in names for word in ('-o', str(tmp_path / name))]
    assert main(['reconstruct', str(short_recording), *outputs, *QUICK_OPTIONS]) == 0
    assert {path.name for path in tmp_path.iterdir()} == {short_recording.name, *names}
    with (tmp_path / 'r.angles.csv').open() as file:
        header, *rows = csv.reader(file)
    assert header == ['time_s', *(f'{n}_m' if n in POSITIONS else f'{n}_deg' for n in COORDINATES)]
    result = np.load(tmp_path / 'r.npz')
    pelvis, upward = result['joints3d'][:, CMU15.index('pelvis')], result['vertical'].mean(axis=0)
    position = np.array(rows, float)[:, [1 + COORDINATES.index(name) for name in POSITIONS]]
    assert np.linalg.norm(position, axis=1) == pytest.approx(np.linalg.norm(pelvis, axis=1), abs=1e-5)
    assert position[:, 1] == pytest.approx(pelvis @ upward / np.linalg.norm(upward), abs=1e-5)


def test_files_are_replaced_when_all_of_them_are_written(
    short_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sequence = load_sequence(short_recording)
    path, outputs = tmp_path / 'fast.npz', [tmp_path / 'r.csv', tmp_path / 'r.bvh']
    save_sequence(path, replace(sequence, timestamps=sequence.timestamps * 1e-6))
    for output in outputs:
        output.write_text('old')
    command = ['reconstruct', str(path), *(word for output in outputs for word in ('-o', str(output)))]
    assert main([*command, *QUICK_OPTIONS]) == 1
    reason = 'timestamps: 3.33e-08 s from frame to frame; at most 10000 Hz fit the format'
    assert capsys.readouterr().err == f'mocap-ros: {path}: {reason}\n'
    assert {p: p.read_text() for p in tmp_path.iterdir() if p not in (path, short_recording)} == dict.fromkeys(
        outputs, 'old'
    )


def test_a_name_that_a_terminal_would_obey_is_escaped(
    short_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / 'a\x1b[2J\nb.csv'
    assert main(['reconstruct', str(short_recording), '-o', str(out), *QUICK_OPTIONS]) == 0
    (line,) = capsys.readouterr().out.splitlines()
    assert line.isprintable()
    assert line.startswith(f'{tmp_path}/a\\x1b[2J b.csv: 20 frames')
    assert out.is_file()


def write_two_people(path: Path, ids: tuple[str, str]) -> None:
    """Write a bag of a walker, a second person beside the walker, and one who is seen for three frames."""
    sequence = make_recording().sequence()
    people = []
    for frame in range(12):
        first, second = (sequence.person(frame, person_id) for person_id in ids)
        second = replace(second, points=second.points + [150.0, 0.0])
        third = replace(first, id='short', points=first.points - [150.0, 0.0])
        people.append([first, second, third] if frame < 3 else [first, second])
    save_detections(path, Detections(people, sequence.stamps_ns[:12], (640, 480)))


def test_all_people_are_written_into_files_of_their_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_two_people(tmp_path / 'two.mcap', ('a/b', 'a?b'))
    command = ['reconstruct', str(tmp_path / 'two.mcap'), '--all-people', *QUICK_OPTIONS]
    assert main([*command, '-o', str(tmp_path / 'r.bvh'), '-o', str(tmp_path / 'r.angles.csv')]) == 0
    written = {path.name for path in tmp_path.iterdir()} - {'two.mcap'}
    assert written == {'r_a_b.bvh', 'r_a_b.2.bvh', 'r_a_b.angles.csv', 'r_a_b.2.angles.csv'}
    line = '1 people are left out, who are seen in less than 10 frames'
    assert capsys.readouterr().err == f'mocap-ros: {tmp_path / "two.mcap"}: {line}\n'
    left, right = (np.genfromtxt(tmp_path / f'r_a_b{n}.angles.csv', delimiter=',', names=True) for n in ('', '.2'))
    assert (right['pelvis_tx_m'] > left['pelvis_tx_m'] + 0.5).all()


@pytest.mark.parametrize('arguments', [['reconstruct', '-o', 'a.npz'], ['view', '--person', 'a', '-o', 'a.html']])
def test_an_id_that_a_terminal_would_obey_is_escaped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arguments: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    write_two_people(tmp_path / 'two.mcap', ('a', '\x1b]0;x\x07'))
    assert main([*arguments, 'two.mcap', *QUICK_OPTIONS]) == 0
    (line,) = capsys.readouterr().err.splitlines()
    assert line.isprintable()
    assert r'\x1b]0;x\x07' in line


def test_one_who_cannot_be_reconstructed_does_not_stop_the_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sequence, people = make_recording().sequence(), []
    for frame in range(12):
        one = sequence.person(frame, 'b')
        few = replace(one, id='a', score=np.where(np.arange(len(one.joints)) < 3, one.score, 0.0))
        people.append([few, one])
    save_detections(tmp_path / 'two.mcap', Detections(people, sequence.stamps_ns[:12], (640, 480)))
    command = ['reconstruct', str(tmp_path / 'two.mcap'), '--all-people', *QUICK_OPTIONS]
    assert main([*command, '-o', str(tmp_path / 'r.npz')]) == 0
    assert {path.name for path in tmp_path.iterdir()} == {'two.mcap', 'r_b.npz'}
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith("no frame has four seen joints: nothing to reconstruct (person 'a' is left out)")


@pytest.mark.parametrize(
    ('options', 'reason'),
    [
        (['--all-people'], 'a sequence file holds one person; --all-people does not apply'),
        (['--all-people', '--person', 'x'], '--person and --all-people exclude each other'),
        (['-o', 'r.npz', '-o', 'r.fbx'], 'r.fbx: unknown file type; expected .npz, .csv, '),
    ],
)
def test_options_that_do_not_fit_are_named(
    short_recording: Path, capsys: pytest.CaptureFixture[str], options: list[str], reason: str
) -> None:
    assert main(['reconstruct', str(short_recording), *options]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert reason in line
