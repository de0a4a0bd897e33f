# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The repository as a whole: packages, messages, metadata, and the imports between modules."""

import os
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path

import pytest

from tests.support.paths import ROOT

MESSAGES = sorted((ROOT / 'msg_defs' / 'msg').glob('*.msg'))
# Folders of the repository's root that no build needs.
BUILD_OUTPUTS = {'.git', '.venv', 'build', 'demo_output', 'dist', 'install', 'log'}
# One compiled module and one message with its part stand for the others: `make setup` and the wheel have all.
COMPILED, BUILT_MESSAGES = 'geometry.pyx', 'Keypoints2D'


def test_both_packages_have_the_same_version() -> None:
    manifests = ROOT / 'package.xml', ROOT / 'msg_defs' / 'package.xml'
    versions = {ET.parse(manifest).findtext('version') for manifest in manifests}
    assert len(versions) == 1


@pytest.mark.parametrize('message', MESSAGES, ids=lambda path: path.stem)
def test_every_message_field_is_commented(message: Path) -> None:
    lines = ['', *message.read_text(encoding='utf-8').splitlines()]
    uncommented = [
        line for above, line in pairwise(lines) if line and '#' not in line and not above.startswith('#')
    ]
    assert not uncommented


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
