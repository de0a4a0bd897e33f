# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The repository as a whole: packages, messages, metadata, and the imports between modules."""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
import xml.etree.ElementTree as ET
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path

import pytest
import yaml

from tests.support.paths import ROOT

MESSAGES = sorted((ROOT / 'msg_defs' / 'msg').glob('*.msg'))
# Folders of the repository's root that no build needs.
BUILD_OUTPUTS = {'.git', '.venv', 'build', 'demo_output', 'dist', 'install', 'log'}

IMPORT_ALL_BUT_ROS = """
import importlib, pkgutil, sys

ROS = {"rclpy", "mocap_ros_msgs"}
attempts = []

class NoRos:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ROS:
            attempts.append(name)
            raise ImportError(f"only mocap_ros.ros may import {name}")

def import_all(name):
    try:
        module = importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name not in ("torch", "dask", "distributed", "fsspec", "pyarrow", "upath"):  # optional
            raise
        return
    for found in pkgutil.iter_modules(getattr(module, "__path__", ())):
        if found.name != "__main__" and (name, found.name) != ("mocap_ros", "ros"):
            import_all(f"{name}.{found.name}")

sys.meta_path.insert(0, NoRos())
import_all("mocap_ros")
assert not attempts, attempts
assert not ROS & sys.modules.keys()
"""


def run_python(code: str, **env: str) -> None:
    subprocess.run([sys.executable, '-c', code], cwd=ROOT, env={**os.environ, **env}, check=True)


def test_only_the_ros_package_imports_ros() -> None:
    run_python(IMPORT_ALL_BUT_ROS, MPLBACKEND='Agg')


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


def test_the_hooks_before_a_commit_are_the_checks_of_make_lint() -> None:
    recipe = re.search(r'^lint:.*\n((?:\t.*\n)+)', (ROOT / 'Makefile').read_text(encoding='utf-8'), re.MULTILINE)
    assert recipe is not None
    checks = [line.strip().removeprefix('@').replace('$(BIN)', '.venv/bin') for line in recipe[1].splitlines()]
    (repository,) = yaml.safe_load((ROOT / '.pre-commit-config.yaml').read_text(encoding='utf-8'))['repos']
    assert [hook['entry'] for hook in repository['hooks']] == checks


# What pip-audit 2.10 prints, its exit status, and whether that is an audit: its database knows all packages but
# those of other indexes; it answers that it knows none; it does not answer.
AUDITS = {
    'known': ('No known vulnerabilities found', 'rclpy Dependency not found on PyPI and could not be audited', 0),
    'holes': ('Found 1 known vulnerability in 1 package', 'numpy 1.0 PYSEC-2018-33 1.16.3', 1),
    'none': ('No known vulnerabilities found', 'numpy  Dependency not found on PyPI and could not be audited', 0),
    'unreachable': ('Traceback (most recent call last):\nrequests.exceptions.ProxyError: pypi.org', '', 1),
}


def write_tool(folder: Path, name: str, script: str) -> list[str]:
    """Write a program that stands for a tool of .venv/bin; return the command of make that takes it."""
    if not shutil.which('make'):
        pytest.skip('make is not installed')
    tool = folder / 'bin' / name
    tool.parent.mkdir()
    (folder / 'msg_defs').mkdir()  # in which the Makefile looks for messages
    tool.write_text(f'#!/bin/sh\n{script}\n')
    tool.chmod(0o755)
    return ['make', '-f', str(ROOT / 'Makefile'), '-C', str(folder), '-s', '--assume-old=setup', 'BIN=bin']


@pytest.mark.parametrize('audit', AUDITS)
def test_an_audit_without_its_database_fails_in_one_line(tmp_path: Path, audit: str) -> None:
    summary, table, status = AUDITS[audit]
    make = write_tool(tmp_path, 'pip-audit', f"echo '{summary}' >&2\necho '{table}'\nexit {status}")
    result = subprocess.run([*make, 'audit'], capture_output=True, text=True, check=False)
    if audit in ('none', 'unreachable'):
        line, of_make = result.stderr.splitlines()
        assert line.startswith('make audit: nothing was audited, ')
        assert 'Error 2' in of_make
        assert (result.returncode, result.stdout) == (2, '')
    else:
        assert result.stdout == f'{summary}\n{table}\n'
        assert (result.returncode == 0) == (status == 0)


def test_an_interrupted_list_of_what_is_installed_leaves_no_file(tmp_path: Path) -> None:
    """Its tool creates the file first, and fills it at the end."""
    make = write_tool(
        tmp_path, 'cyclonedx-py', ': > "$4"\nif [ -e wait ]; then touch waits; exec sleep 60; fi\necho {} > "$4"'
    )
    subprocess.run([*make, 'sbom'], check=True)
    assert {path.name: path.read_text() for path in (tmp_path / 'build').iterdir()} == {'sbom.json': '{}\n'}
    (tmp_path / 'build' / 'sbom.json').unlink()
    (tmp_path / 'wait').touch()
    process = subprocess.Popen([*make, 'sbom'], stderr=subprocess.DEVNULL, start_new_session=True)
    while not (tmp_path / 'waits').exists():
        assert process.poll() is None
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGINT)
    assert process.wait(timeout=30) != 0
    assert not list((tmp_path / 'build').iterdir())


@pytest.mark.ros
@pytest.mark.slow
def test_colcon_builds_both_packages(tmp_path: Path) -> None:
    tools = Path(sys.executable).parent
    path = os.pathsep.join([str(tools), os.environ['PATH']])
    if not shutil.which('colcon', path=path):
        pytest.skip('colcon is not installed')
    if not find_spec('rclpy'):
        pytest.skip('rclpy is not installed')

    workspace = tmp_path / 'workspace'
    shutil.copytree(ROOT, workspace, symlinks=True, ignore=ignore_build_outputs)
    prefixes = os.environ.get('AMENT_PREFIX_PATH', sys.prefix)
    env = {**os.environ, 'PATH': path, 'AMENT_PREFIX_PATH': prefixes, 'HOME': str(tmp_path)}
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
    script = 'source "$0/setup.bash" && exec "$1" -c "$2"'
    use_install = f"""
import mocap_ros, mocap_ros_msgs.msg
from rclpy.serialization import serialize_message
serialize_message(mocap_ros_msgs.msg.Keypoints2DArray())
assert all(module.__file__.startswith({str(install)!r}) for module in (mocap_ros, mocap_ros_msgs))
"""
    command = ['bash', '-c', script, str(install), sys.executable, use_install]
    subprocess.run(command, cwd=tmp_path, env=env, check=True)


def ignore_build_outputs(folder: str, names: list[str]) -> set[str]:
    return BUILD_OUTPUTS & set(names) if Path(folder) == ROOT else set()
