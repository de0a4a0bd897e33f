# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The keyframe method from 2D to 3D, and on the command line with real files."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from mocap_ros.bags.reader import is_bag
from mocap_ros.cli.main import main
from mocap_ros.config import Config, with_settings
from mocap_ros.demo.scene import make_recording
from mocap_ros.formats.sequence_file import save_sequence
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.models.model_file import load_base_pose_models
from mocap_ros.offline.keyframes.keyframe_method import reconstruct
from mocap_ros.skeleton import CMU15
from tests.support.swinging_body import make_swinging_body

CAMERA = Intrinsics(900.0, (640.0, 360.0), is_focal_known=True)
CONFIG = with_settings(Config(), {'keyframes.poses': 'lifter'})
MODELS = load_base_pose_models('all')


def compute_mpjpe(found: np.ndarray, truth: np.ndarray) -> float:
    a, b = (p - p.mean(axis=1, keepdims=True) for p in (found, truth))
    a = a * (a * b).sum() / (a * a).sum()
    return float(np.linalg.norm(a - b, axis=-1).mean() * 1e3)


def make_walk(frames: int = 240) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Keypoints (F, 15, 3), times (F,) and truth (F, 15, 3) m in the camera's frame."""
    poses, times = make_swinging_body(frames)
    c, s = np.cos(0.9), np.sin(0.9)
    poses = poses @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    position = np.stack([0.5 * np.sin(0.6 * times), 0 * times, 4 + 0.5 * np.cos(0.6 * times)], axis=-1)
    truth = poses + position[:, None]
    return np.concatenate([CAMERA.project(truth), np.ones((frames, 15, 1))], axis=-1), times, truth


def test_a_projected_motion_is_reconstructed_with_and_without_outliers() -> None:
    keypoints, times, truth = make_walk()
    clean = reconstruct(keypoints, CMU15.joints, times, CAMERA, MODELS, CONFIG)
    assert compute_mpjpe(clean.result.joints, truth) < 1.1 * 58.5  # mm, measured
    distance = np.linalg.norm(clean.result.joints.mean(axis=1) - truth.mean(axis=1), axis=-1)
    assert distance.mean() < 1.1 * 0.0852  # m, measured
    reprojection_error = np.linalg.norm(CAMERA.project(clean.result.joints) - keypoints[..., :2], axis=-1)
    assert reprojection_error.max() < 1.1 * 23.5  # px, measured
    assert np.ptp(CMU15.bone_lengths(clean.result.joints), axis=0).max() < 1e-6
    assert not clean.outliers.any()

    rng = np.random.default_rng(1)
    wrong = rng.random(keypoints.shape[:2]) < 0.04
    corrupted = keypoints.copy()
    corrupted[wrong, :2] += 100 * np.sign(rng.normal(size=(wrong.sum(), 2)))
    corrupted[100:112] = [np.nan, np.nan, 0]
    wrong[100:112] = False
    found = reconstruct(corrupted, CMU15.joints, times, CAMERA, MODELS, CONFIG)
    assert (found.outliers == wrong).all()
    assert not found.result.seen[found.outliers].any()
    assert compute_mpjpe(found.result.joints, truth) < 1.1 * 60.3  # mm, measured


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('case', ['one frame', 'still', 'no legs', 'two frames seen', 'a last frame much later'])
def test_degenerate_keypoints(case: str) -> None:
    keypoints, times, _ = make_walk(1 if case == 'one frame' else 60)
    if case == 'still':
        keypoints[:] = keypoints[0]
    elif case == 'no legs':
        keypoints[:, 9:] = [np.nan, np.nan, 0]
    elif case == 'two frames seen':
        keypoints[1:59] = np.nan
    elif case == 'a last frame much later':
        times[59] = 1e4
        keypoints[59, :, :2] += np.random.default_rng(0).normal(0, 3000.0, (15, 2))  # px
    found = reconstruct(keypoints, CMU15.joints, times, CAMERA, MODELS, CONFIG)
    assert np.isfinite(found.result.joints).all()
    assert (found.outliers[-1].sum() > 10) == (case == 'a last frame much later')


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A real bag of the demo's first keypoints."""
    folder = tmp_path_factory.mktemp('keyframes')
    whole = make_recording().sequence()
    first = replace(
        whole,
        keypoints=whole.keypoints[:150],
        timestamps=whole.timestamps[:150],
        recorded_ns=whole.recorded_ns[:150],
        truth=None,
    )
    save_sequence(folder / 'demo.npz', first)
    out = folder / 'demo.mcap'
    assert main(['reconstruct', str(folder / 'demo.npz'), '-o', str(out), '--method', 'keyframes']) == 0
    assert is_bag(out)
    return out


def test_the_commands_read_a_bag(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / 'k.yaml'
    assert main(['keyframes', str(bag), '-o', str(out)]) == 0
    said = capsys.readouterr().out
    assert 'upper body: ' in said
    assert said.endswith(f'{out}\n{tmp_path}/k.png\n{tmp_path}/k_distances.png\n')
    for picture in ('k.png', 'k_distances.png'):
        assert (tmp_path / picture).read_bytes()[:4] == b'\x89PNG'
    keyframes = yaml.safe_load(out.read_text())['keyframes']
    assert {k['half'] for k in keyframes} == {'upper', 'lower'}
    assert sum(k['represents'] for k in keyframes if k['half'] == 'upper') > 100

    plain, chosen = tmp_path / 'plain.npz', tmp_path / 'chosen.npz'
    upper = max((k for k in keyframes if k['half'] == 'upper'), key=lambda k: k['represents'])
    upper['forward'] = ['lelbow', 'rwrist']
    out.write_text(yaml.safe_dump({'keyframes': keyframes}))
    command = ['reconstruct', str(bag), '--method', 'keyframes', '-o']
    assert main([*command, str(plain)]) == 0
    assert main([*command, str(chosen), '--choices', str(out)]) == 0
    with np.load(plain) as a, np.load(chosen) as b:
        assert a['joints3d'].shape == b['joints3d'].shape == (150, 15, 3)
        assert np.abs(a['joints3d'] - b['joints3d']).max() > 0.05


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        (['keyframes', 'nothing.npz'], 'nothing.npz: No such file'),
        (['keyframes', 'BAG', '-o', 'k.txt'], 'k.txt: unknown file type; expected .yaml'),
        (['reconstruct', 'BAG', '--choices', 'c.yaml'], 'c.yaml: --choices needs --method keyframes'),
        (['reconstruct', 'BAG', '--method', 'keyframes', '--choices', 'no.yaml'], 'no.yaml: No such file'),
        (['reconstruct', 'BAG', '--method', 'keyframes', '--choices', 'c.yaml'], 'c.yaml: not YAML'),
        (['reconstruct', 'BAG', '--method', 'keyframes', '--choices', 'd.yaml'], 'd.yaml: keyframes[0]: '),
    ],
)
def test_bad_input_is_one_line(
    bag: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'c.yaml').write_text('{')
    (tmp_path / 'd.yaml').write_text('keyframes: [{half: upper, time: 99, forward: [lelbow]}]')
    assert main([str(bag) if a == 'BAG' else a for a in arguments]) == 1
    error = capsys.readouterr().err.splitlines()[-1]
    assert message in error
