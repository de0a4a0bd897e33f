# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The distributions hold what users need, the wheel works without ROS, and the version is that of package.xml."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tarfile
import venv
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.support.paths import ROOT

VERSION = ET.parse(ROOT / 'package.xml').findtext('version')
ROS_VARIABLES = ('PYTHONPATH', 'PYTHONHOME', 'AMENT_PREFIX_PATH', 'LD_LIBRARY_PATH', 'ROS_DISTRO')
NO_INDEX = ('Temporary failure in name resolution', 'NewConnectionError', 'ProxyError', 'ConnectTimeoutError')
BUILD_SDIST = 'import sys; from setuptools import build_meta; print(build_meta.build_sdist(sys.argv[1]))'


class NoIndexError(Exception):
    """Pip cannot reach a package index."""


def run_without_ros(command: Sequence[object], folder: Path, **variables: str) -> str:
    """Run a program without ROS, and return its output."""
    env = {name: value for name, value in os.environ.items() if name not in ROS_VARIABLES}
    process = subprocess.run(
        [str(word) for word in command],
        cwd=folder,
        env={**env, 'OMP_NUM_THREADS': '1', 'PIP_DISABLE_PIP_VERSION_CHECK': '1', **variables},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    if process.returncode and 'pip' in command and any(reason in process.stdout for reason in NO_INDEX):
        raise NoIndexError
    assert process.returncode == 0, process.stdout
    return process.stdout


@pytest.fixture(scope='module')
def distributions(tmp_path_factory: pytest.TempPathFactory, quick_compiler: dict[str, str]) -> Path:
    """Folder with the source distribution of what the repository holds, unpacked too, and the wheel made of it.

    The wheel is built in an environment of its own, where pip reaches an index.
    """
    source, out = tmp_path_factory.mktemp('source'), tmp_path_factory.mktemp('distributions')
    for name in ('config', 'examples', 'mocap_ros', 'msg_defs', 'resource'):
        ignored = shutil.ignore_patterns('__pycache__', 'node_modules', '*.so')
        shutil.copytree(ROOT / name, source / name, symlinks=True, ignore=ignored)
    for file in ROOT.iterdir():
        if file.is_file():
            shutil.copy(file, source)
    run_without_ros([sys.executable, '-c', BUILD_SDIST, out], source)
    (sdist,) = out.glob('*.tar.gz')
    with tarfile.open(sdist) as archive:
        archive.extractall(out, filter='data')
    command = [sys.executable, '-m', 'pip', 'wheel', '--no-deps', '--wheel-dir', out, sdist]
    try:
        run_without_ros(command, source, **quick_compiler)
    except NoIndexError:
        run_without_ros([*command, '--no-build-isolation'], source, **quick_compiler)
    return out


def read_first_version() -> tuple[str, str]:
    """The version at the head of the changelog, and what stands behind it."""
    heading = re.search(r'^## (\S+) (.*)$', (ROOT / 'CHANGELOG.md').read_text(encoding='utf-8'), re.MULTILINE)
    assert heading is not None
    return heading[1], heading[2]


def test_the_changelog_begins_with_the_version_of_the_package() -> None:
    version, state = read_first_version()
    assert version == VERSION
    assert re.fullmatch(r'\(unreleased\)|- \d{4}-\d\d-\d\d', state)


def test_the_wheel_holds_every_file_of_the_package(distributions: Path) -> None:
    package = ROOT / 'mocap_ros'
    sources = {'.pyx', '.pxd', '.so'}  # of the engine, which the wheel holds compiled
    files = {path.relative_to(ROOT).as_posix() for path in package.rglob('*.*') if path.suffix not in sources}
    files |= {f'mocap_ros/messages/msg/{path.name}' for path in (ROOT / 'msg_defs' / 'msg').glob('*.msg')}
    (wheel,) = distributions.glob('*.whl')
    held = set(zipfile.ZipFile(wheel).namelist())
    assert {file for file in files if '__pycache__' not in file} - held == set()
    compiled = {name.partition('.')[0] for name in held if name.endswith('.so')}
    modules = {path.stem for path in package.glob('engine/*.pyx')} | {'_shared'}
    assert compiled == {f'mocap_ros/engine/{name}' for name in modules}
    shared = {name.partition('.data/data/')[2] for name in held} - {''}
    assert shared >= {
        'share/ament_index/resource_index/packages/mocap_ros',
        'share/mocap_ros/package.xml',
        *(f'share/mocap_ros/config/mocap_ros.{suffix}' for suffix in ('foxglove.json', 'rviz', 'yaml')),
        'share/mocap_ros/launch/mocap.launch.py',
    }


def test_the_source_distribution_is_enough_to_set_up_the_package(distributions: Path) -> None:
    (sdist,) = distributions.glob('*.tar.gz')
    with tarfile.open(sdist) as archive:
        held = {name.partition('/')[2] for name in archive.getnames()}
    needed = [
        path for folder in ('msg_defs', 'config/env') for path in (ROOT / folder).rglob('*') if path.is_file()
    ]
    assert {path.relative_to(ROOT).as_posix() for path in needed} - held == set()
    assert {'Makefile', 'CHANGELOG.md', 'LICENSE', 'colcon_defaults.yaml'} <= held


def test_the_description_for_package_indexes_has_no_relative_links(distributions: Path) -> None:
    (metadata,) = distributions.glob('*/PKG-INFO')
    links = re.findall(r'\]\(([^)\s]+)', metadata.read_text(encoding='utf-8'))
    assert links
    assert [link for link in links if not link.startswith(('https://', '#'))] == []


NOTEBOOK = """
import importlib.util
import sys
from importlib.resources import files

import mocap_ros

assert not {'numpy', 'scipy', 'matplotlib', 'rosbags'} & set(sys.modules)
assert mocap_ros.__file__.startswith(sys.prefix), mocap_ros.__file__
assert not any(importlib.util.find_spec(name) for name in ('rclpy', 'mocap_ros_msgs'))

import numpy as np

demo = mocap_ros.read(str(files('mocap_ros') / 'demo' / 'demo.npz'))
keypoints, times = demo.keypoints[:60], demo.timestamps[:60]
truth = mocap_ros.GroundTruth(demo.truth.joints[:60], demo.truth.joint_names)
result = mocap_ros.reconstruct(keypoints, demo.joint_names, times, image_size=demo.image_size)
whole = mocap_ros.evaluate(result, truth)
print(demo, result, whole, sep='\\n')
assert whole.mpjpe_mm < 60
tracker = mocap_ros.Tracker('coco17', image_size=demo.image_size)
assert all(len(tracker.update(t, [k])) == 1 for t, k in zip(times, keypoints))
for suffix in ('npz', 'csv', 'mcap', 'bvh', 'trc'):
    mocap_ros.write(f'demo_3d.{suffix}', result)
again = mocap_ros.read('demo_3d.mcap')
assert np.nanmax(np.abs(again.keypoints - keypoints)) < 1e-3
assert 'rclpy' not in sys.modules
"""


@pytest.mark.slow
def test_the_wheel_works_without_ros(distributions: Path, tmp_path: Path) -> None:
    (wheel,) = distributions.glob('mocap_ros-*.whl')
    environment, notebook = tmp_path / 'environment', tmp_path / 'notebook'
    venv.create(environment)
    python = environment / 'bin' / 'python'
    try:
        install = [sys.executable, '-m', 'pip', '--python', python, 'install', '--no-compile', wheel]
        run_without_ros(install, tmp_path)
    except NoIndexError:
        pytest.skip('pip reaches no package index')

    notebook.mkdir()
    (notebook / 'notebook.py').write_text(NOTEBOOK, encoding='utf-8')
    printed = run_without_ros([python, '-W', 'error', 'notebook.py'], notebook)
    assert 'Evaluation: MPJPE' in printed
    assert {p.suffix for p in notebook.iterdir()} == {'.py', '.npz', '.csv', '.mcap', '.bvh', '.trc'}
