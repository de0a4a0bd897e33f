# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The package as a wheel in a plain virtual environment, without ROS, used as in a notebook."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import venv
from pathlib import Path

import pytest

from tests.support.paths import ROOT

BUILD_OUTPUTS = {'.git', '.venv', 'build', 'demo_output', 'dist', 'install', 'log'}
ROS_VARIABLES = ('PYTHONPATH', 'PYTHONHOME', 'AMENT_PREFIX_PATH', 'LD_LIBRARY_PATH', 'ROS_DISTRO')
NO_INDEX = ('Temporary failure in name resolution', 'NewConnectionError', 'ProxyError', 'ConnectTimeoutError')

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


def run(command: list[object], folder: Path) -> str:
    """Run a program without ROS; return its output, or skip the test where pip cannot reach a package index."""
    env = {name: value for name, value in os.environ.items() if name not in ROS_VARIABLES}
    process = subprocess.run(
        [str(word) for word in command],
        cwd=folder,
        env={**env, 'OMP_NUM_THREADS': '1', 'PIP_DISABLE_PIP_VERSION_CHECK': '1'},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    if process.returncode and 'pip' in command and any(reason in process.stdout for reason in NO_INDEX):
        pytest.skip('pip reaches no package index')
    assert process.returncode == 0, process.stdout
    return process.stdout


def ignore_build_outputs(folder: str, names: list[str]) -> set[str]:
    return BUILD_OUTPUTS & set(names) if Path(folder) == ROOT else set()


@pytest.mark.slow
def test_the_wheel_works_without_ros(tmp_path: Path) -> None:
    source, wheels, environment = tmp_path / 'source', tmp_path / 'wheels', tmp_path / 'environment'
    shutil.copytree(ROOT, source, symlinks=True, ignore=ignore_build_outputs)
    run([sys.executable, '-m', 'pip', 'wheel', '--no-deps', '--wheel-dir', wheels, source], tmp_path)
    (wheel,) = wheels.glob('mocap_ros-*.whl')

    venv.create(environment, with_pip=True)
    python = environment / 'bin' / 'python'
    run([python, '-m', 'pip', 'install', wheel], tmp_path)

    notebook = tmp_path / 'notebook'
    notebook.mkdir()
    (notebook / 'notebook.py').write_text(NOTEBOOK, encoding='utf-8')
    (package,) = environment.glob('lib/*/site-packages/mocap_ros')
    compiled = 'compiled/__pycache__'  # of this installation; to compile it all once more takes a minute
    shutil.copytree(ROOT / 'mocap_ros' / compiled, package / compiled, dirs_exist_ok=True)
    printed = run([python, '-W', 'error', 'notebook.py'], notebook)
    assert 'Evaluation: MPJPE' in printed
    assert {p.suffix for p in notebook.iterdir()} == {'.py', '.npz', '.csv', '.mcap', '.bvh', '.trc'}
