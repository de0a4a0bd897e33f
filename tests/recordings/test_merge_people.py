# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Recordings of two cameras become one result, in Python and by the command, in every format."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mocap_ros
from mocap_ros.arrays import Array
from mocap_ros.cli.main import main
from mocap_ros.demo.scene import make_recording
from mocap_ros.errors import InputError
from mocap_ros.formats.cameras_file import Cameras, save_cameras
from mocap_ros.geometry.rotations import multiply_quaternions
from mocap_ros.people import PoseSequence
from mocap_ros.recordings.load_results import load_result
from mocap_ros.recordings.save_results import save
from mocap_ros.skeleton import find_roots
from tests.support.several_cameras import CENTRES, SIZE_STD, find_camera_pose

FRAMES, CLOCK_OFFSET_S, SIZE = 60, 0.4, 1.05


@pytest.fixture(scope='module')
def results() -> tuple[PoseSequence, PoseSequence]:
    """The beginning of the demo, and how a second camera at 15 Hz with another clock could have seen it."""
    whole, until = make_recording().sequence(), slice(FRAMES)
    sequence = replace(
        whole,
        keypoints=whole.keypoints[until],
        timestamps=whole.timestamps[until],
        camera_matrix=np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]]),
        truth=None,
    )
    first = mocap_ros.reconstruct(sequence, model='walk', parameters={'solver.max_iterations': 2})
    to_second = find_camera_pose(CENTRES[1]).inverse()
    joints = SIZE * to_second.apply(first.joints)
    roots = find_roots(joints)
    second = replace(
        first,
        joints=joints,
        root_covariance=0.02**2 * np.eye(3) + SIZE_STD**2 * roots[:, :, None] * roots[:, None],
        joint_orientation=multiply_quaternions(np.array(to_second.quaternion), first.joint_orientation),
        sequence=None,
    ).select(np.arange(FRAMES) % 2 == 0)
    return first, replace(second, times=second.times - CLOCK_OFFSET_S, recorded_ns=())


def list_poses() -> Array:
    poses = np.tile(np.eye(4), (2, 1, 1))
    pose = find_camera_pose(CENTRES[1])
    poses[1, :3, :3], poses[1, :3, 3] = pose.rotation, pose.translation
    return poses


def test_two_results_are_merged_at_the_times_of_the_first(results: tuple[PoseSequence, PoseSequence]) -> None:
    first, _ = results
    (merged,) = mocap_ros.merge(results, list_poses(), clock_offsets=[0.0, CLOCK_OFFSET_S])
    assert merged.stamps_ns == first.stamps_ns
    assert merged.sequence is first.sequence
    seen = merged.in_sight
    assert seen.all()
    off = np.linalg.norm(merged.joints - first.joints, axis=-1)
    assert 0 < off.mean() < 0.15  # a twentieth of the distance at most, as the second is larger
    turns = np.abs((merged.joint_orientation * first.joint_orientation).sum(axis=-1))
    assert turns.min() > 0.99
    deep = [np.sqrt(p.root_covariance[:, 2, 2]).mean() for p in (merged, first)]
    assert deep[0] < deep[1] / 3


def test_the_command_writes_every_format(
    results: tuple[PoseSequence, PoseSequence], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, poses in zip(('left', 'right'), results, strict=True):
        save(Path(f'{name}.npz'), poses)
    save_cameras(Path('cameras.yaml'), Cameras(('left', 'right'), list_poses(), np.array([0.0, CLOCK_OFFSET_S])))
    names = ('m.npz', 'm.mcap', 'm.bvh', 'm.trc', 'm.csv', 'm.angles.csv')
    outputs = [word for name in names for word in ('-o', name)]
    assert main(['merge', 'right.npz', 'left.npz', '--cameras', 'cameras.yaml', '-o', 'r.npz']) == 0
    assert main(['merge', 'left.npz', 'right.npz', '--cameras', 'cameras.yaml', *outputs]) == 0
    (expected,) = mocap_ros.merge(results, list_poses(), clock_offsets=[0.0, CLOCK_OFFSET_S])
    for name in ('m.npz', 'm.mcap'):
        found = load_result(Path(name))
        np.testing.assert_allclose(found.joints, expected.joints, atol=2e-4)
    assert load_result(Path('r.npz')).sequence is None
    assert all(Path(name).stat().st_size for name in names)


@pytest.mark.parametrize(
    ('change', 'place'),
    [
        ({'results': ()}, 'results'),
        ({'camera_poses': np.zeros((2, 4, 4))}, 'camera_poses'),
        ({'camera_poses': np.eye(4)}, 'camera_poses'),
        ({'clock_offsets': [0.0]}, 'clock_offsets'),
        ({'clock_offsets': [0.0, 100.0]}, 'results: recording 2'),
    ],
)
def test_bad_arguments_are_named(
    results: tuple[PoseSequence, PoseSequence], change: dict[str, object], place: str
) -> None:
    arguments = {'results': results, 'camera_poses': list_poses(), **change}
    with pytest.raises(InputError, match=f'^{place}'):
        mocap_ros.merge(**arguments)  # type: ignore[arg-type]


def test_results_of_older_versions_without_deviations_are_refused(
    results: tuple[PoseSequence, PoseSequence],
) -> None:
    old = replace(results[0], joint_std=np.full(results[0].joint_std.shape, np.nan))
    with pytest.raises(InputError, match=r'^results: recording 1: person .* reconstruct'):
        mocap_ros.merge([old, results[1]], list_poses())
