"""The commands, on real files: what they write, and one line for what is wrong."""

import argparse
import csv
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mocap_ros.bags.recorder import Recorder
from mocap_ros.cli.main import main, parser
from mocap_ros.config import RecorderConfig
from mocap_ros.demo.scene import make_recording
from mocap_ros.errors import InputError
from mocap_ros.formats.sequence_file import Truth, load_sequence, save_sequence
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.models.model_file import load_base_poses
from mocap_ros.runtime.sequence_messages import sequence_samples
from mocap_ros.skeleton import CMU15, layout
from mocap_ros.viewing import plots
from tests.support.evaluation_data import shared
from tests.support.paths import ROOT


@pytest.fixture(scope='module')
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp('cli') / 'demo.npz'
    save_sequence(path, make_recording().sequence())
    return path


def test_the_embedded_recording_is_what_the_generator_makes(recording: Path) -> None:
    shipped = load_sequence(ROOT / 'mocap_ros' / 'demo' / 'demo.npz')
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
    titles, units, row, legend = capsys.readouterr().out.splitlines()
    assert titles.split()[:2] == ['MPJPE', 'PA-MPJPE']
    assert {'mm', 'cm', 'px', 'fps', 's'} == set(units.split())
    assert re.fullmatch(r'demo\.npz( +\d+\.\d+){7} +390 +0 +30 +\d+\.\d', row)
    assert 'one similarity a frame' in legend


def test_evaluate_doubts_a_truth_in_mm(recording: Path, tmp_path: Path, capsys) -> None:
    sequence = load_sequence(recording)
    assert sequence.truth is not None
    truth = Truth(sequence.truth.joints * 1000, sequence.truth.joint_names)
    save_sequence(tmp_path / 'mm.npz', replace(sequence, truth=truth))
    for path, doubted in ((recording, ''), (tmp_path / 'mm.npz', 'mm.npz: joints3d: looks like mm; m expected\n')):
        assert main(['evaluate', str(path), '--set', 'solver.max_iterations=1']) == 0
        assert capsys.readouterr().err.endswith(doubted)
        assert doubted or not capsys.readouterr().err


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


def test_results_go_into_the_current_folder(recording: Path, tmp_path: Path, monkeypatch) -> None:
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


def test_a_picture_says_what_its_colours_and_lines_are(recording: Path) -> None:
    sequence = load_sequence(recording)
    assert sequence.truth is not None
    result = plots.Result(
        times=sequence.timestamps,
        keypoints=sequence.keypoints,
        keypoint_skeleton=layout('coco17'),
        joints=sequence.truth.joints,
        seen=np.ones((390, 15), bool),
        skeleton=CMU15,
        truth=sequence.truth.joints,
    )
    figure = plots.poses_figure(result, [0, 100], 'title', ['a', 'b'])
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
    trained = load_base_poses(model)
    assert trained.name == 'run'
    assert not any(str(t).startswith('35_') for t in trained.provenance['trials'])


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        (['reconstruct', 'nowhere.npz'], 'nowhere.npz'),
        (['reconstruct', 'RECORDING', '-o', 'x.docx'], 'x.docx: can write .npz, .csv, .mcap, .bvh, .trc'),
        (['reconstruct', 'RECORDING', '--model', 'moonwalk'], "no base-pose model 'moonwalk'"),
        (
            ['reconstruct', 'RECORDING', '--set', 'solver.speed=1'],
            "unknown parameter 'solver.speed'; `mocap-ros config`",
        ),
        (
            ['plot', 'RECORDING', '--set', 'solver.bone_wait=1'],
            "'solver.bone_wait'; did you mean 'solver.bone_weight'?",
        ),
        (['evaluate', 'BAG'], 'bag: is a bag, expected a sequence file'),
        (['replay', 'BAG', '-o', 'bag'], 'bag: exists already; choose another -o'),
        (['reconstruct', 'RECORDING', '-o', '/nowhere/x.npz'], '/nowhere/x.npz'),
        (['evaluate', 'GARBAGE'], 'garbage.npz'),
        (['train', 'GARBAGE', '-o', 'x.npz'], 'garbage.npz'),
        (['train', 'RECORDING', '-o', 'x.npz'], '_joints'),
        (['replay', 'nowhere', '-o', 'x'], 'nowhere'),
        (['config', '--config', 'nowhere.yaml'], 'nowhere.yaml'),
        (['config', '--config', 'FOLDER'], 'folder: Is a directory'),
        (['config', '--config', 'BOMB'], 'bomb.yaml: not YAML: line 2: aliases are not allowed'),
        (['config', '--set', f'solver.components=1{"0" * 400}'], 'expected 1 to 60'),
        (
            ['config', '--set', f'solver.components={"[" * 9999}'],
            '--set solver.components: not YAML: nested too deep',
        ),
        (['reconstruct', 'FOLDER'], 'folder: no *_keypoints.json in it'),
        (['reconstruct', 'RECORDING', '--fps', '30'], 'demo.npz: a sequence file; --person'),
        (['evaluate', 'FOLDER'], 'folder: Is a directory'),
        (['train', 'FOLDER', '-o', 'x.npz'], 'folder: no .amc, .bvh, .c3d in it'),
        (['plot', 'RECORDING', '-o', 'x.xyz'], 'x.xyz: no picture; can write'),
        (['plot', 'RECORDING', '-o', 'picture'], 'picture: no picture; can write'),
        (['train', 'TRIALS', '--manifest', 'LATIN', '-o', 'x.npz'], 'latin.csv: not UTF-8 at byte 14'),
        (['train', 'TRIALS', '-o', 'x.npz'], 'trial 1_1: a body 0 m tall'),
    ],
)
def test_failures_are_one_line_on_stderr(recording, tmp_path, monkeypatch, capsys, arguments, message) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'garbage.npz').write_bytes(b'PK\x03\x04 and then nothing of use')
    (tmp_path / 'bag').mkdir()
    (tmp_path / 'bag' / 'metadata.yaml').touch()
    (tmp_path / 'folder').mkdir()
    (tmp_path / 'bomb.yaml').write_text('a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]')
    (tmp_path / 'latin.csv').write_bytes(b'trial,subject\n\xff')
    np.savez(tmp_path / 'trials.npz', **{'_joints': np.array(CMU15.joints), '1_1': np.zeros((9, 15, 3))})
    known = {
        'RECORDING': str(recording),
        'GARBAGE': 'garbage.npz',
        'BAG': 'bag',
        'FOLDER': 'folder',
        'BOMB': 'bomb.yaml',
        'LATIN': 'latin.csv',
        'TRIALS': 'trials.npz',
    }
    assert main([known.get(a, a) for a in arguments]) == 1
    error = capsys.readouterr().err
    assert error.count('\n') == 1
    assert message in error
    assert 'pickle' not in error


QUICK = ('--model', 'walk', '--set', 'solver.max_iterations=2')


@pytest.fixture
def short(recording: Path, tmp_path: Path) -> Path:
    """Twenty frames, in a file whose name would be mathematics."""
    whole = load_sequence(recording)
    assert whole.truth is not None
    truth = Truth(whole.truth.joints[:20], whole.truth.joint_names)
    path = tmp_path / '$x^{_$.npz'
    save_sequence(
        path, replace(whole, keypoints=whole.keypoints[:20], timestamps=whole.timestamps[:20], truth=truth)
    )
    return path


@pytest.mark.skipif(not Path('/dev/full').exists(), reason='no /dev/full here')
@pytest.mark.parametrize('ending', ['.npz', '.csv', '.bvh', '.trc', '.png', '.json'])
def test_a_full_disk_is_told_with_the_file(short: Path, tmp_path: Path, capsys, ending: str) -> None:
    out = tmp_path / f'full{ending}'
    out.symlink_to('/dev/full')
    command = {'.png': ['plot', '-o'], '.json': ['evaluate', '--json']}.get(ending, ['reconstruct', '-o'])
    assert main([command[0], str(short), command[1], str(out), *QUICK]) == 1
    assert capsys.readouterr().err == f'mocap-ros: {out}: cannot be written: No space left on device\n'


def test_what_was_read_is_not_written_over(short: Path, tmp_path: Path, capsys) -> None:
    bag = tmp_path / 'bag'
    with Recorder(bag, RecorderConfig()) as recorder:
        for due_ns, raw in sequence_samples(load_sequence(short)):
            recorder.write('/keypoints', KEYPOINTS, raw, due_ns, due_ns)
    (tmp_path / 'link.npz').symlink_to(short)
    for command, source, out in (
        ('reconstruct', short, tmp_path / 'link.npz'),
        ('reconstruct', bag, bag / 'bag_0.mcap'),
        ('reconstruct', bag / 'bag_0.mcap', bag / 'bag_0.mcap'),
        ('evaluate', short, short),
    ):
        before = out.read_bytes()
        option = '--json' if command == 'evaluate' else '-o'
        assert main([command, str(source), option, str(out), *QUICK]) == 1
        assert capsys.readouterr().err.splitlines()[-1] == f'mocap-ros: {out}: not written: it is what was read'
        assert out.read_bytes() == before


@pytest.mark.filterwarnings('error')
def test_any_file_name_may_be_the_title_of_a_picture(short: Path, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(['plot', str(short), '--poses', '2', *QUICK]) == 0
    assert (tmp_path / '$x^{_$.png').stat().st_size > 1000


@pytest.mark.filterwarnings('error')
def test_truth_may_be_known_in_part(short: Path, tmp_path: Path, capsys) -> None:
    whole = load_sequence(short)
    assert whole.truth is not None
    out = tmp_path / 'e.json'

    def evaluated(change: object) -> int:
        joints = whole.truth.joints.copy()
        joints[change] = np.nan
        save_sequence(tmp_path / 't.npz', replace(whole, truth=Truth(joints, whole.truth.joint_names)))
        return main(['evaluate', str(tmp_path / 't.npz'), '--json', str(out), *QUICK])

    for change, joints, frames in (((slice(5), 3), 15, 15), ((slice(None), 3), 14, 20)):
        assert evaluated(change) == 0
        (record,) = json.loads(out.read_text())
        assert (record['joints'], record['frames']) == (joints, frames)
        assert record['mpjpe_mm'] < 500
    assert evaluated(slice(None)) == 1
    assert 't.npz: joints3d: no joint is known in any frame' in capsys.readouterr().err
    save_sequence(tmp_path / 'f.npz', replace(whole, truth=Truth(whole.truth.joints, tuple('abcdefghijklmno'))))
    assert main(['evaluate', str(tmp_path / 'f.npz'), *QUICK]) == 1
    assert 'f.npz: only 0 joints in common' in capsys.readouterr().err


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('ending', ['.npz', '.mcap', '.bvh', '.trc', '.png'])
@pytest.mark.parametrize('case', ['one frame', 'one point', 'one line', 'still'])
def test_degenerate_keypoints_give_no_warnings(short: Path, tmp_path: Path, case: str, ending: str) -> None:
    whole = replace(load_sequence(short), truth=None)
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
    assert main([command, str(path), '-o', str(tmp_path / f'o{ending}'), *QUICK]) == 0


def test_every_option_is_explained_with_its_default() -> None:
    (commands,) = [a for a in parser()._actions if isinstance(a, argparse._SubParsersAction)]
    for name, command in commands.choices.items():
        assert command.description, name
        for action in command._actions:
            text = f'{action.help} {command.formatter_class("")._get_help_string(action)}'
            assert action.help, (name, action.dest)
            assert action.required or action.dest == 'help' or 'default' in text, (name, action.dest)


def test_usage_errors_exit_with_2() -> None:
    for arguments in ([], ['evaluate'], ['dance']):
        with pytest.raises(SystemExit) as stopped:
            main(arguments)
        assert stopped.value.code == 2
