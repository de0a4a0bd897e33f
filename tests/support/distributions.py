# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The source distribution, and the wheel that pip builds from it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
from collections.abc import Sequence
from pathlib import Path

from tests.support.paths import ROOT

ROS_VARIABLES = ('PYTHONPATH', 'PYTHONHOME', 'AMENT_PREFIX_PATH', 'LD_LIBRARY_PATH', 'ROS_DISTRO')
NO_INDEX = ('Temporary failure in name resolution', 'NewConnectionError', 'ProxyError', 'ConnectTimeoutError')
BUILD_SDIST = 'import sys; from setuptools import build_meta; print(build_meta.build_sdist(sys.argv[1]))'


class NoIndexError(Exception):
    """Pip cannot reach a package index."""


def run_without_ros(command: Sequence[object], folder: Path) -> str:
    """Run a program without ROS, and return its output."""
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
        raise NoIndexError
    assert process.returncode == 0, process.stdout
    return process.stdout


def build_distributions(source: Path, out: Path) -> None:
    """Build both from a copy of what the repository holds, and unpack the source distribution beside them.

    The wheel is built in an environment of its own, where pip reaches an index.
    """
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
        run_without_ros(command, source)
    except NoIndexError:
        run_without_ros([*command, '--no-build-isolation'], source)
