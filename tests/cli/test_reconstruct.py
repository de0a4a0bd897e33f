# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The commands `reconstruct`, `view`, `train`, `detect` and `evaluate`."""

import csv
import itertools
import json
import os
import re
import signal
import socket
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap_ros.api.evaluate import evaluate
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.bags.topics import Source
from mocap_ros.cli.main import main
from mocap_ros.config import RecorderConfig, with_values
from mocap_ros.demo.scene import make_recording
from mocap_ros.errors import InputError
from mocap_ros.formats.bvh import load_bvh, save_bvh
from mocap_ros.formats.detections import Detections
from mocap_ros.formats.export.armature import build_armature
from mocap_ros.formats.export.joint_angles import COORDINATES, POSITIONS
from mocap_ros.formats.mocap.joint_maps import map_to_model
from mocap_ros.formats.sequence_file import load_sequence, save_sequence
from mocap_ros.formats.video import VideoImage, VideoReader
from mocap_ros.keypoints.keypoint_sequence import GroundTruth
from mocap_ros.messages.cdr import decode
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.messages.skeletons import SKELETONS
from mocap_ros.models.model_file import load_base_poses
from mocap_ros.people import PoseSequence
from mocap_ros.recordings import detect_people, save_results
from mocap_ros.recordings.playback import encode_sequence
from mocap_ros.recordings.save_results import save_detections
from mocap_ros.skeleton import CMU15
from mocap_ros.training.fit_base_poses import fit_base_poses
from mocap_ros.units import NS_PER_S
from tests.support.blob_people import draw, save_detector, save_multi_pose_movenet, walk, write_video
from tests.support.input_files import (
    QUICK_OPTIONS,
    Z_UP_TO_Y_UP,
    flatten_keypoints,
    make_poses,
    make_walker,
)
from tests.support.pipeline_inputs import FAST_CONFIG, make_calibrated


def test_several_files_of_one_reconstruction_agree(short_recording: Path, tmp_path: Path) -> None:
    names = ('r.npz', 'r.angles.csv', 'r.trc', 'r.csv')
    outputs = [word for name in names for word in ('-o', str(tmp_path / name))]
    options = ['--set', 'solver.method=alternation', '--pitch', '-16.26', *QUICK_OPTIONS]
    assert main(['reconstruct', str(short_recording), *outputs, *options]) == 0
    assert {path.name for path in tmp_path.iterdir()} == {short_recording.name, *names}
    with np.load(tmp_path / 'r.npz') as result:
        joints, upward = result['joints3d'], result['vertical'].mean(axis=0)
        assert np.linalg.norm(result['orientation'], axis=-1) == pytest.approx(np.ones((20, 26)), abs=1e-5)
        assert (result['orientation_order'], result['turn_inferred'].shape) == ('xyzw', (20, 26))
        assert 0 < result['turn_inferred'].mean() < 1
    with (tmp_path / 'r.angles.csv').open() as file:
        header, *rows = csv.reader(file)
    assert header == ['time_s', *(f'{n}_m' if n in POSITIONS else f'{n}_deg' for n in COORDINATES)]
    pelvis = joints[:, CMU15.index('pelvis')]
    position = np.array(rows, float)[:, [1 + COORDINATES.index(name) for name in POSITIONS]]
    assert position[0, [0, 2]] == pytest.approx(0.0, abs=1e-6)
    heights = pelvis @ upward / np.linalg.norm(upward)
    assert position[:, 1] - position[0, 1] == pytest.approx(heights - heights[0], abs=1e-5)
    moved = [np.linalg.norm(p - p[0], axis=1) for p in (position, pelvis)]
    assert moved[0] == pytest.approx(moved[1], abs=1e-5)


def test_a_result_is_sent_by_vmc(short_recording: Path, tmp_path: Path) -> None:
    osc_bundle = pytest.importorskip('pythonosc.osc_bundle')
    result, bvh = tmp_path / 'r.npz', tmp_path / 'r.bvh'
    assert main(['reconstruct', str(short_recording), '-o', str(result), '-o', str(bvh), *QUICK_OPTIONS]) == 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(('127.0.0.1', 0))
        receiver.settimeout(10.0)
        port = receiver.getsockname()[1]
        assert main(['play', str(result), '--vmc', f'127.0.0.1:{port}', '--rate', '4']) == 0
        bundles = [osc_bundle.OscBundle(receiver.recv(65536)) for _ in range(20)]
    messages = list(bundles[11])
    assert [m.address for m in messages[:3]] == ['/VMC/Ext/OK', '/VMC/Ext/T', '/VMC/Ext/Root/Pos']
    bones = {m.params[0]: np.array(m.params[1:]) for m in messages[3:] if m.address == '/VMC/Ext/Bone/Pos'}
    pelvis = load_bvh(bvh).compute_positions()[11, 0] / 100
    assert bones['Hips'][:3] == pytest.approx(pelvis * [-1, 1, 1], abs=1e-5)
    assert [np.linalg.norm(bone[3:]) for bone in bones.values()] == pytest.approx([1.0] * 19, abs=1e-5)


def test_a_summary_tells_the_scale(
    short_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / 'r.npz'
    command = ['reconstruct', str(short_recording), '-o', str(out), *QUICK_OPTIONS]
    for options, is_known in (([], False), (['--hfov', '56'], True), (['--focal', '600'], True)):
        assert main([*command, *options]) == 0
        *_, line = capsys.readouterr().out.splitlines()
        assert line.startswith(f'{short_recording}: good; 1 person in 20 frames; ')
        assert ('px, given' if is_known else 'px, nominal') in line
        with np.load(out) as arrays:
            assert bool(arrays['scale_known']) == is_known
            assert (arrays['grade'], f'{short_recording}: {arrays["summary"]}') == ('good', line)


def test_the_video_of_the_keypoints_gives_times_size_and_focal_length(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A size that is assumed is never good."""
    (folder := tmp_path / 'keypoints').mkdir()
    for frame, keypoints in enumerate(flatten_keypoints(make_walker())):
        text = json.dumps({'people': [{'pose_keypoints_2d': keypoints}]})
        (folder / f'{frame + 1:03d}_keypoints.json').write_text(text)
    times = np.cumsum([0.0, *[0.02, 0.06] * 20])[:FRAMES].round(3)
    grey = [np.full((480, 640, 3), 50, np.uint8)] * FRAMES
    tags: dict[str, Any] = {'FocalLengthIn35mmFilm': '26'}
    video = write_video(tmp_path / 'walk.mov', grey, times.tolist(), 'mpeg4', 'yuv420p', **tags)
    command = ['reconstruct', str(folder), '-o', str(tmp_path / 'r.npz'), *QUICK_OPTIONS]
    grades = []
    for given in (['--fps', '25'], ['--fps', '25', '--image-size', '640x480'], ['--video', str(video)]):
        assert main([*command, *given]) == 0
        grades.append(str(np.load(tmp_path / 'r.npz')['summary']).partition(';')[0])
    assert grades == ['doubtful: the image size of 640x480 px is assumed', 'good', 'good']
    with np.load(tmp_path / 'r.npz') as result:
        assert result['timestamps'] == pytest.approx(times, abs=1e-3)
        assert result['camera_matrix'][0, 0] == pytest.approx(26 / 43.27 * 800, rel=1e-3)
        assert f'focal length {26 / 43.27 * 800:.0f} px, from the video' in str(result['summary'])
    short = write_video(tmp_path / 'short.mkv', grey[:30], times[:30].tolist())
    capsys.readouterr()
    assert main([*command, '--video', str(short)]) == 1
    assert 'frames are numbered 1 to 40, beyond the 30 images of' in capsys.readouterr().err


def write_two_people(path: Path, ids: tuple[str, str], seen_joints: int = 17) -> list[str]:
    """Write a bag of a walker, another beside, and one who is seen for three frames; return a command."""
    sequence = make_recording().sequence()
    people = []
    for frame in range(12):
        first, second = (sequence.person(frame, person_id) for person_id in ids)
        score = np.where(np.arange(17) < seen_joints, second.score, 0.0)
        second = replace(second, points=second.points + [150.0, 0.0], score=score)
        third = replace(first, id='short', points=first.points - [150.0, 0.0])
        people.append([first, second, third] if frame < 3 else [first, second])
    save_detections(path, Detections(people, sequence.stamps_ns[:12], (640, 480)))
    return ['reconstruct', str(path), '--all-people', *QUICK_OPTIONS]


def test_all_people_have_files_of_their_own(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = write_two_people(tmp_path / 'two.mcap', ('a/b', 'a?b'))
    assert main([*command, '-o', str(tmp_path / 'r.bvh'), '-o', str(tmp_path / 'r.angles.csv')]) == 0
    written = {path.name for path in tmp_path.iterdir()} - {'two.mcap'}
    assert written == {'r_a_b.bvh', 'r_a_b.2.bvh', 'r_a_b.angles.csv', 'r_a_b.2.angles.csv'}
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f'mocap-ros: {tmp_path / "two.mcap"}: 1 people are left out, ')
    left, right = (np.genfromtxt(tmp_path / f'r_a_b{n}.angles.csv', delimiter=',', names=True) for n in ('', '.2'))
    apart = [right[f'pelvis_t{axis}_m'] - left[f'pelvis_t{axis}_m'] for axis in 'xz']
    assert (np.hypot(*apart) > 0.5).all(), 'in one world'


def test_people_of_one_recording_are_together_in_time(tmp_path: Path) -> None:
    """Time 0 is the first image of the recording, also for one who enters later."""
    sequence, enters, frames = make_recording().sequence(), 15, 30
    people = [[sequence.person(f, 'a')] for f in range(frames)]
    for frame in range(enters, frames):
        late = sequence.person(frame, 'b')
        people[frame].append(replace(late, points=late.points + [150.0, 0.0]))
    stamps = [1_760_000_000 * NS_PER_S + ns for ns in sequence.stamps_ns[:frames]]
    save_detections(tmp_path / 'in.mcap', Detections(people, stamps, (640, 480)))
    outputs = [f'-o{tmp_path / "r"}{suffix}' for suffix in ('.trc', '.bvh', '.angles.csv')]
    assert main(['reconstruct', str(tmp_path / 'in.mcap'), '--all-people', *outputs, *QUICK_OPTIONS]) == 0
    for name, first in (('a', 0), ('b', enters)):
        expected = pytest.approx(np.arange(first, frames) / 30, abs=1e-4)
        rows = [line.split('\t') for line in (tmp_path / f'r_{name}.trc').read_text().splitlines()]
        assert [float(row[1]) for row in rows[6:]] == expected
        assert [int(row[0]) for row in rows[6:]] == [*range(first + 1, frames + 1)]
        assert rows[2][6:] == [str(first + 1), str(frames - first)]
        assert np.genfromtxt(tmp_path / f'r_{name}.angles.csv', delimiter=',')[1:, 0] == expected
        motion = load_bvh(tmp_path / f'r_{name}.bvh').motion
        assert len(motion) == frames
        assert (motion[:first] == motion[0]).all()
        assert not np.array_equal(motion[first], motion[first + 1])


def test_one_who_cannot_be_saved_does_not_stop_the_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def save(path: Path, poses: PoseSequence) -> None:
        if poses.id == 'b':
            raise InputError('too long')
        path.touch()

    monkeypatch.setattr(save_results, 'save', save)
    command = write_two_people(tmp_path / 'two.mcap', ('b', 'a'))
    assert main([*command, '-o', str(tmp_path / 'r.npz')]) == 1
    assert {path.name for path in tmp_path.iterdir()} == {'two.mcap', 'r_a.npz'}


def test_one_who_is_hardly_seen_stops_no_other(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = write_two_people(tmp_path / 'two.mcap', ('b', 'a'), seen_joints=3)
    assert main([*command, '-o', str(tmp_path / 'r.npz')]) == 0
    assert {path.name for path in tmp_path.iterdir()} == {'two.mcap', 'r_b.npz'}
    assert '12 detections left out, of which fewer than 6 joints are seen' in capsys.readouterr().err


def test_useless_view_options(short_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result, page = tmp_path / 'result.npz', tmp_path / 'page.html'
    assert main(['reconstruct', str(short_recording), '-o', str(result), *QUICK_OPTIONS]) == 0
    capsys.readouterr()
    for option in (['--set', 'tracker.lag=0.2'], ['--model', 'walk'], ['--topic', '/keypoints']):
        assert main(['view', str(result), '-o', str(page), *option]) == 1
        assert f'is a result of reconstruct, to which {option[0]} does not' in capsys.readouterr().err
    assert not page.exists()
    for output in ('page.html', 'page.png'):
        assert main(['view', str(result), '-o', str(tmp_path / output)]) == 0


def test_train_on_bvh_gives_the_model_of_its_poses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bvh = build_armature(make_poses() @ Z_UP_TO_Y_UP.T, 30.0)
    positions = np.moveaxis(bvh.compute_positions() / 100, 1, 0)
    expected = fit_base_poses([map_to_model(dict(zip(bvh.names, positions, strict=True))) @ Z_UP_TO_Y_UP])
    for name in ('one_1.bvh', 'one_2.bvh'):
        save_bvh(tmp_path / name, bvh)
    options = ['-o', str(tmp_path / 'm.npz')]
    assert main(['train', str(tmp_path), *options]) == 0
    assert '2 trials, 80 poses' in capsys.readouterr().out
    model = load_base_poses(tmp_path / 'm.npz')
    assert model.mean == pytest.approx(expected.mean, abs=1e-4)
    assert model.std[:4] == pytest.approx(expected.std[:4], rel=1e-3)
    assert main(['train', str(tmp_path), '--every', '4', *options]) == 0
    assert '2 trials, 20 poses' in capsys.readouterr().out
    assert main(['train', str(tmp_path), '--category', 'swim', *options]) == 1
    assert 'the options select no trial' in capsys.readouterr().err


@pytest.mark.parametrize(
    ('options', 'name', 'alignment', 'mirror', 'bodies'),
    [([], 'all', 'rotation', False, 0), (['--category', 'walk'], 'walk', 'heading', True, 2)],
)
def test_one_category_has_other_defaults_than_all(
    tmp_path: Path, options: list[str], name: str, alignment: str, mirror: bool, bodies: int
) -> None:
    (tmp_path / 'walk').mkdir()
    save_bvh(tmp_path / 'walk' / 'one_1.bvh', build_armature(make_poses() @ Z_UP_TO_Y_UP.T, 30.0))
    source = ['--source', 'a test', '--acknowledgement', 'with thanks']
    assert main(['train', str(tmp_path / 'walk'), *options, *source, '-o', str(tmp_path / 'm.npz')]) == 0
    model = load_base_poses(tmp_path / 'm.npz')
    keys = 'alignment', 'mirror', 'bodies', 'source', 'acknowledgement'
    assert [model.provenance[key] for key in keys] == [alignment, mirror, bodies, 'a test', 'with thanks']
    assert model.name == name


FRAMES = 40
FPS = 30.0  # Hz, that of the demo


@pytest.fixture(scope='module')
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A video of a walker with four empty images at its beginning, and a network that finds the walker."""
    path = tmp_path_factory.mktemp('video')
    images = [draw([])] * 4 + [draw([person]) for person in walk(FRAMES)]
    write_video(path / 'walk.mp4', images, [i / FPS for i in range(len(images))], 'libx264', 'yuv420p')
    save_detector(path / 'detector.onnx')
    return path


def test_a_video_becomes_a_skeleton(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ['reconstruct', str(folder / 'walk.mp4'), '--detector', str(folder / 'detector.onnx')]
    assert main([*command, '-o', str(tmp_path / 'out.npz')]) == 0
    assert '1 person in 40 frames' in capsys.readouterr().out
    result = np.load(tmp_path / 'out.npz')
    assert result['timestamps'] == pytest.approx(np.arange(4, FRAMES + 4) / FPS, abs=1e-3)
    errors = evaluate(result['joints3d'].astype(float), GroundTruth(make_recording().truth[:FRAMES], CMU15.joints))
    assert errors.pa_mpjpe_mm is not None
    assert errors.pa_mpjpe_mm < 30.0, 'measured: 22.1'
    assert main([*command, '-o', str(tmp_path / 'out.bvh')]) == 0
    assert 'Frames: 44' in (tmp_path / 'out.bvh').read_text(), 'from the first image on'


def test_detect_writes_the_keypoints_of_one_person_or_a_bag_of_all(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    command = ['detect', str(folder / 'walk.mp4'), '--model', str(folder / 'detector.onnx')]
    assert main(command) == 0
    assert capsys.readouterr().out == 'walk_2d.npz: 17 keypoints of person_1, 40 frames in 1.3 s\n'
    assert len(load_sequence('walk_2d.npz')) == FRAMES
    assert main([*command, '--duration', '0.5', '-o', 'short.npz']) == 0
    assert len(load_sequence('short.npz')) == 11

    people = walk(6)
    images = [draw([person - [150.0, 0.0], person + [150.0, 0.0]]) for person in people]
    write_video(tmp_path / 'two.mkv', images, [i / FPS for i in range(6)])
    save_multi_pose_movenet(tmp_path / 'multi.onnx')
    command = ['detect', 'two.mkv', '--model', 'multi.onnx', '--max-people', '2', '-o', 'two.mcap']
    assert main(command) == 0
    assert capsys.readouterr().out.endswith('two.mcap: 2 people, 6 frames in 0.2 s\n')
    with Bag(tmp_path / 'two.mcap') as bag:
        messages = [decode(message.raw, KEYPOINTS) for message in bag.messages(['/keypoints'])]
    assert [[person.id for person in message.people] for message in messages] == [['person_1', 'person_2']] * 6
    assert {(m.image_width, m.image_height) for m in messages} == {(640, 480)}


def test_an_interrupt_keeps_the_detected(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class InterruptedCamera(VideoReader):
        """A video instead of a camera."""

        def __init__(self, path: Path, *, is_camera: bool) -> None:
            assert is_camera
            super().__init__(path)

        def __iter__(self) -> Iterator[VideoImage]:
            yield from itertools.islice(super().__iter__(), 20)
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(2.0)  # in which the command has ended, however busy the machine is
            yield from super().__iter__()

    monkeypatch.setattr(detect_people, 'VideoReader', InterruptedCamera)
    monkeypatch.setattr('mocap_ros.cli.detect.find_camera', Path)
    out = tmp_path / 'me.npz'
    command = ['detect', str(folder / 'walk.mp4'), '--model', str(folder / 'detector.onnx'), '-o', str(out)]
    assert main(command) == 0
    assert 0 < len(load_sequence(out)) <= 20 - 4


def test_the_table_and_the_json(short_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / 'e.json'
    assert main(['evaluate', str(short_recording), '--json', str(out)]) == 0
    (record,) = json.loads(out.read_text())
    assert record['joints'] == 15
    assert 10 < record['pa_mpjpe_mm'] < record['mpjpe_mm'] < 60
    assert record['failed_frames'] == 0
    assert {'bone_std_mm', 'residual_px', 'fps', 'seconds', 'e_paper_cm'} <= record.keys()
    titles, units, row, legend, *covariances = capsys.readouterr().out.splitlines()
    assert len(covariances) == 2  # of joints and of roots
    assert main(['evaluate', str(short_recording), '--limbs-only', '--json', str(out)]) == 0
    assert json.loads(out.read_text())[0]['joints'] == 12
    assert titles.split()[:2] == ['MPJPE', 'PA-MPJPE']
    assert {'mm', 'px', 'fps', 's'} == set(units.split())
    assert re.fullmatch(r'\$x\^\{_\$\.npz( +\d+\.\d+){6} +20 +0 +30 +\d+\.\d', row)
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
        ([names[0], *arguments, '--model', 'walk'], 'r.npz: is a result of reconstruct, to which --model does'),
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
    joints = np.where(np.arange(390)[:, None, None] < 30, np.nan, whole.truth.joints)
    others: Any = {'seen': np.ones((390, 15), bool), 'residual_px': np.ones(390), 'theta': np.zeros((390, 1))}
    names, times = whole.truth.joint_names, whole.timestamps
    np.savez(tmp_path / 'r.npz', joints3d=joints, joint_names=names, timestamps=times, **others)
    out, truth_file = tmp_path / 'e.json', tmp_path / 'part.npz'
    assert main(['evaluate', str(tmp_path / 'r.npz'), '--truth', str(truth_file), '--json', str(out)]) == 0
    (record,) = json.loads(out.read_text())
    assert (record['frames'], record['failed_frames'], record['fps']) == (20, 5, pytest.approx(15))
    assert record['abs_mpjpe_mm'] == pytest.approx(0, abs=1e-3)
    assert not capsys.readouterr().err
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
