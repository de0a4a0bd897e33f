# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The distributions hold what users need, both packages build, and the wheel works without ROS."""

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
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path

import pytest

from mocap_ros.engine import rays
from tests.support.paths import ROOT

VERSION = ET.parse(ROOT / 'package.xml').findtext('version')
ROS_VARIABLES = ('PYTHONPATH', 'PYTHONHOME', 'AMENT_PREFIX_PATH', 'LD_LIBRARY_PATH', 'ROS_DISTRO')
COMPILED = 'rays.pyx'
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

    One compiled module stands for the others, which `make setup` has compiled by the same means. The wheel is
    built in an environment of its own, where pip reaches an index.
    """
    source, out = tmp_path_factory.mktemp('source'), tmp_path_factory.mktemp('distributions')
    others = {path.name for path in ROOT.glob('mocap_ros/engine/*.pyx')} - {COMPILED}
    ignored = shutil.ignore_patterns('__pycache__', 'node_modules', '*.so', *others)
    for name in ('config', 'examples', 'mocap_ros', 'msg_defs', 'resource'):
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


def test_the_changelog_begins_with_the_version_of_the_package() -> None:
    heading = re.search(r'^## (\S+) (.*)$', (ROOT / 'CHANGELOG.md').read_text(encoding='utf-8'), re.MULTILINE)
    assert heading is not None
    assert heading[1] == VERSION
    assert re.fullmatch(r'\(unreleased\)|- \d{4}-\d\d-\d\d', heading[2])


def test_the_wheel_holds_every_file_of_the_package(distributions: Path) -> None:
    package = ROOT / 'mocap_ros'
    sources = {'.pyx', '.pxd', '.so'}  # of the engine, which the wheel holds compiled
    files = {path.relative_to(ROOT).as_posix() for path in package.rglob('*.*') if path.suffix not in sources}
    files |= {f'mocap_ros/messages/msg/{path.name}' for path in (ROOT / 'msg_defs' / 'msg').glob('*.msg')}
    (wheel,) = distributions.glob('*.whl')
    held = set(zipfile.ZipFile(wheel).namelist())
    assert {file for file in files if '__pycache__' not in file} - held == set()
    compiled = {name.partition('.')[0] for name in held if name.endswith('.so')}
    assert compiled == {f'mocap_ros/engine/{name}' for name in (COMPILED.removesuffix('.pyx'), '_shared')}
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
    needed = [p for folder in ('msg_defs', 'config/env') for p in (ROOT / folder).rglob('*') if p.is_file()]
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
print(whole)
assert whole.mpjpe_mm < 60
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

    (installed,) = environment.glob('lib/python*/site-packages/mocap_ros/engine')
    for path in Path(rays.__file__).parent.glob('*.so'):
        shutil.copy(path, installed)
    notebook.mkdir()
    (notebook / 'notebook.py').write_text(NOTEBOOK, encoding='utf-8')
    printed = run_without_ros([python, '-W', 'error', 'notebook.py'], notebook)
    assert 'Evaluation: MPJPE' in printed
    assert {p.suffix for p in notebook.iterdir()} == {'.py', '.npz', '.csv', '.mcap', '.bvh', '.trc'}


MESSAGES = sorted((ROOT / 'msg_defs' / 'msg').glob('*.msg'))
# Folders of the repository's root that no build needs.
BUILD_OUTPUTS = {'.git', '.venv', 'build', 'demo_output', 'dist', 'install', 'log'}
# One compiled module and one message with its part stand for the others: `make setup` has all.
BUILT_MESSAGES = 'Keypoints2D'


def test_both_packages_have_the_same_version() -> None:
    manifests = ROOT / 'package.xml', ROOT / 'msg_defs' / 'package.xml'
    versions = {ET.parse(manifest).findtext('version') for manifest in manifests}
    assert len(versions) == 1


@pytest.mark.parametrize('message', MESSAGES, ids=lambda path: path.stem)
def test_every_message_field_is_commented(message: Path) -> None:
    lines = ['', *message.read_text(encoding='utf-8').splitlines()]
    bare = [line for above, line in pairwise(lines) if line and '#' not in line and not above.startswith('#')]
    assert not bare


def test_message_definitions_in_the_package_link_to_their_only_home() -> None:
    assert (ROOT / 'mocap_ros' / 'messages' / 'msg').resolve() == ROOT / 'msg_defs' / 'msg'


@pytest.mark.ros
@pytest.mark.slow
def test_colcon_builds_both_packages(tmp_path: Path, quick_compiler: dict[str, str]) -> None:
    tools = Path(sys.executable).parent
    path = os.pathsep.join([str(tools), os.environ['PATH']])
    if not shutil.which('colcon', path=path):
        pytest.skip('colcon is not installed')
    if not find_spec('rclpy'):
        pytest.skip('rclpy is not installed')

    workspace = tmp_path / 'workspace'
    shutil.copytree(ROOT, workspace, symlinks=True, ignore=ignore_what_is_not_built)
    prefixes = os.environ.get('AMENT_PREFIX_PATH', sys.prefix)
    env = {**os.environ, **quick_compiler, 'PATH': path, 'AMENT_PREFIX_PATH': prefixes, 'HOME': str(tmp_path)}
    build = subprocess.run(
        ['colcon', 'build'],
        cwd=workspace,
        env=env,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    assert build.returncode == 0, build.stdout

    install = workspace / 'install'
    assert os.access(install / 'mocap_ros' / 'lib' / 'mocap_ros' / 'mocap_node', os.X_OK)
    assert [*install.glob(f'mocap_ros/**/{COMPILED.removesuffix(".pyx")}*.so')]
    script = 'source "$0/setup.bash" && exec "$1" -c "$2"'
    use_install = f"""
import mocap_ros, mocap_ros_msgs.msg
from rclpy.serialization import serialize_message
serialize_message(mocap_ros_msgs.msg.Keypoints2DArray())
assert all(module.__file__.startswith({str(install)!r}) for module in (mocap_ros, mocap_ros_msgs))
"""
    command = ['bash', '-c', script, str(install), sys.executable, use_install]
    subprocess.run(command, cwd=tmp_path, env=env, check=True)


def ignore_what_is_not_built(folder: str, names: list[str]) -> set[str]:
    path = Path(folder)
    return {
        name
        for name in names
        if (path == ROOT and name in BUILD_OUTPUTS)
        or (path.name == 'engine' and name.endswith(('.so', '.pyx')) and name != COMPILED)
        or (name.endswith('.msg') and not name.startswith(BUILT_MESSAGES))
    }
