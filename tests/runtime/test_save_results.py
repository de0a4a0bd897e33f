"""The results of `reconstruct` hold the same motion in every format."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mocap_ros.bags.reader import Bag
from mocap_ros.cli.main import main
from mocap_ros.formats.mocap.bvh import load_bvh
from mocap_ros.formats.mocap.joint_maps import map_to_model
from mocap_ros.formats.mocap.trials import load_trials
from mocap_ros.formats.sequence_file import KeypointSequence, save_sequence
from mocap_ros.keypoints.joint_map import build_joint_map
from mocap_ros.messages.cdr import decode
from mocap_ros.messages.skeletons import SKELETONS
from mocap_ros.skeleton import CMU15
from tests.support.keypoint_files import FRAMES, make_walker
from tests.support.motion_files import Z_UP_TO_Y_UP


@pytest.fixture(scope='module')
def walker() -> KeypointSequence:
    return make_walker()


@pytest.fixture(scope='module')
def results(tmp_path_factory: pytest.TempPathFactory, walker: KeypointSequence) -> Path:
    """Return a folder that holds the reconstruction of the walk in every format."""
    folder = tmp_path_factory.mktemp('results')
    save_sequence(folder / 'walk.npz', walker)
    for suffix in ('npz', 'csv', 'mcap', 'bvh', 'trc'):
        quick = ['--model', 'walk', '--set', 'solver.max_iterations=5']
        assert main(['reconstruct', str(folder / 'walk.npz'), '-o', str(folder / f'r.{suffix}'), *quick]) == 0
    return folder


def test_cameras_project_the_joints_to_the_keypoints(results: Path, walker: KeypointSequence) -> None:
    result = np.load(results / 'r.npz')
    body = result['joints3d'] - result['joints3d'].mean(axis=1, keepdims=True)
    image = result['scale'][:, None, None] * body[..., :2] + result['translation'][:, None]
    points, score = build_joint_map(walker.joint_names).apply(walker.keypoints[..., :2], walker.keypoints[..., 2])
    error = np.linalg.norm(image - points, axis=-1)[score > 0]
    assert np.sqrt((error**2).mean()) < 1.2 * np.sqrt((result['residual_px'] ** 2).mean())
    rotation = result['rotation']
    assert rotation @ np.swapaxes(rotation, 1, 2) == pytest.approx(
        np.broadcast_to(np.eye(3), rotation.shape), abs=1e-6
    )


def load_joints_y_up(folder: Path) -> np.ndarray:
    """Return the joints (F, 15, 3) in m of the .npz file, in the axes of BVH and TRC."""
    return np.load(folder / 'r.npz')['joints3d'] * np.array([1, -1, -1])


def test_bag_holds_the_joints(results: Path) -> None:
    joints = np.load(results / 'r.npz')['joints3d']
    with Bag(results / 'r.mcap') as bag:
        assert {'/keypoints', '/skeletons', '/cameras', '/markers', '/skeleton_definition'} <= bag.topics.keys()
        skeletons = [decode(m.raw, SKELETONS) for m in bag.messages(['/skeletons'])]
    assert len(skeletons) == FRAMES
    points = np.array([[(p.x, p.y, p.z) for p in m.people[0].joints] for m in skeletons])
    assert points == pytest.approx(joints, abs=1e-5)
    assert not list(results.glob('.*'))


def test_bvh_has_constant_bones_and_the_same_joints(results: Path) -> None:
    bvh = load_bvh(results / 'r.bvh')
    assert bvh.frame_time == pytest.approx(1 / 30)
    joints = load_joints_y_up(results)
    positions = dict(zip(bvh.names, np.moveaxis(bvh.compute_positions() / 100, 1, 0), strict=True))
    bvh_joints = map_to_model(positions)
    lengths = np.stack([np.linalg.norm(joints[:, a] - joints[:, b], axis=1) for a, b in CMU15.bones])
    length_variation = np.abs(lengths - np.median(lengths, axis=1)[:, None]).max(axis=1).sum()
    assert np.linalg.norm(bvh_joints - joints, axis=-1).max() < length_variation + 1e-4
    assert np.linalg.norm(bvh_joints - joints, axis=-1).max() < 0.03
    for a, b in CMU15.bones:
        assert np.ptp(np.linalg.norm(bvh_joints[:, a] - bvh_joints[:, b], axis=1)) < 1e-4
    assert np.abs(np.diff(bvh.motion, axis=0)).max() < 180
    (trial,) = load_trials(results / 'r.bvh')
    assert trial.poses - trial.poses.mean(axis=1, keepdims=True) == pytest.approx(
        (joints - joints.mean(axis=1, keepdims=True)) @ Z_UP_TO_Y_UP, abs=0.03
    )


def test_trc_holds_the_joints(results: Path) -> None:
    lines = (results / 'r.trc').read_text().splitlines()
    assert lines[0] == 'PathFileType\t4\t(X/Y/Z)\tr.trc'
    assert lines[1].split('\t')[:5] == ['DataRate', 'CameraRate', 'NumFrames', 'NumMarkers', 'Units']
    assert lines[2].split('\t') == ['30', '30', '40', '15', 'mm', '30', '1', '40']
    assert lines[3].split('\t')[:6] == ['Frame#', 'Time', 'head', '', '', 'neck']
    assert lines[4].split('\t')[:5] == ['', '', 'X1', 'Y1', 'Z1']
    assert {len(line.split('\t')) for line in (lines[3], lines[4], *lines[6:])} == {2 + 45}
    assert not lines[5]
    table = np.loadtxt(results / 'r.trc', skiprows=6)
    assert table[:, 0].tolist() == list(range(1, FRAMES + 1))
    assert table[:, 1] == pytest.approx(np.arange(FRAMES) / 30, abs=1e-5)
    assert table[:, 2:].reshape(-1, 15, 3) / 1000 == pytest.approx(load_joints_y_up(results), abs=1e-6)


def test_uneven_times_are_resampled_at_a_constant_rate(tmp_path: Path, walker: KeypointSequence) -> None:
    kept = [f for f in range(FRAMES) if f not in (9, 10, 11)]
    uneven = KeypointSequence(
        walker.keypoints[kept], walker.joint_names, walker.timestamps[kept], walker.image_size
    )
    save_sequence(tmp_path / 'w.npz', uneven)
    quick = ['--model', 'walk', '--set', 'solver.max_iterations=3']
    assert main(['reconstruct', str(tmp_path / 'w.npz'), '-o', str(tmp_path / 'w.bvh'), *quick]) == 0
    bvh = load_bvh(tmp_path / 'w.bvh')
    assert (len(bvh.motion), bvh.frame_time) == (FRAMES, pytest.approx(1 / 30))
