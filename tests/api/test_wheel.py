# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The package as a wheel in a plain virtual environment, without ROS, used as in a notebook."""

from __future__ import annotations

import venv
from pathlib import Path

import pytest

from tests.support.distributions import NoIndexError, run_without_ros

NOTEBOOK = """
import importlib.util
import sys
from importlib.resources import files

import mocap_ros

assert not {'numpy', 'scipy', 'matplotlib', 'rosbags'} & set(sys.modules)
assert mocap_ros.__file__.startswith(sys.prefix), mocap_ros.__file__
assert not any(importlib.util.find_spec(name) for name in ('rclpy', 'mocap_ros_msgs'))

import numpy as np

# reconstruct the demo
sequence = mocap_ros.read(str(files('mocap_ros') / 'demo' / 'demo.npz'))
result = mocap_ros.reconstruct(
    sequence.keypoints, sequence.joint_names, sequence.timestamps, image_size=sequence.image_size
)
print(sequence, result, sep='\\n')
assert result.joints.shape == (390, 26, 3)
whole = mocap_ros.evaluate(result, sequence.truth)
print(whole)
assert whole.failed_frames == 0
assert whole.mpjpe_mm < 45.5, 'measured: 44.3'

# track it frame by frame
tracker = mocap_ros.Tracker('coco17', image_size=sequence.image_size)
joints = np.full(result.joints.shape, np.nan)
for frame, (time_s, keypoints) in enumerate(zip(sequence.timestamps, sequence.keypoints)):
    people = tracker.update(time_s, [keypoints])
    assert len(people) == 1
    joints[frame] = people[0].joints
live = mocap_ros.evaluate(joints, sequence.truth, times=sequence.timestamps)
print(people, live, sep='\\n')
assert live.mpjpe_mm < 51.5, 'measured: 50.1'

# write it and read it back
for suffix in ('npz', 'csv', 'mcap', 'bvh', 'trc'):
    mocap_ros.write(f'demo_3d.{suffix}', result)
stored = np.load('demo_3d.npz')['joints3d']
assert abs(mocap_ros.evaluate(stored, sequence.truth).mpjpe_mm - whole.mpjpe_mm) < 1e-3
table = np.loadtxt('demo_3d.csv', delimiter=',', skiprows=1)[:, 1:].reshape(-1, 26, 3)
assert np.abs(table - result.joints).max() < 1e-6
again = mocap_ros.read('demo_3d.mcap')
assert np.nanmax(np.abs(again.keypoints - sequence.keypoints)) < 1e-3

assert 'rclpy' not in sys.modules
"""


@pytest.mark.slow
def test_the_wheel_works_without_ros(distributions: Path, tmp_path: Path) -> None:
    (wheel,) = distributions.glob('mocap_ros-*.whl')
    environment, notebook = tmp_path / 'environment', tmp_path / 'notebook'
    venv.create(environment, with_pip=True)
    python = environment / 'bin' / 'python'
    try:
        run_without_ros([python, '-m', 'pip', 'install', wheel], tmp_path)
    except NoIndexError:
        pytest.skip('pip reaches no package index')

    notebook.mkdir()
    (notebook / 'notebook.py').write_text(NOTEBOOK, encoding='utf-8')
    printed = run_without_ros([python, '-W', 'error', 'notebook.py'], notebook)
    assert 'Evaluation: MPJPE' in printed
    assert {p.suffix for p in notebook.iterdir()} == {'.py', '.npz', '.csv', '.mcap', '.bvh', '.trc'}
