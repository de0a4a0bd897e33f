# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Builds foreign interface packages for tests, once, into build/foreign."""

import hashlib
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from mocap_ros.messages.foreign_types import DEFINITIONS
from tests.support.paths import ROOT

PREFIX = ROOT / 'build' / 'foreign'
SITE = f'lib/python{sys.version_info[0]}.{sys.version_info[1]}/site-packages'
PACKAGES = ('yolo_msgs', 'hri_msgs', 'tf2_msgs')
TEXTS: Mapping[str, str] = {**DEFINITIONS, 'tf2_msgs/msg/TFMessage': 'geometry_msgs/TransformStamped[] transforms'}


def environment(env: dict[str, str]) -> dict[str, str]:
    """Return an environment in which the packages are found, after building what is not there yet."""
    build()

    def before(name: str, folder: Path) -> dict[str, str]:
        return {name: os.pathsep.join([str(folder), *filter(None, [env.get(name)])])}

    return {
        **env,
        **before('PYTHONPATH', PREFIX / SITE),
        **before('LD_LIBRARY_PATH', PREFIX / 'lib'),
        **before('AMENT_PREFIX_PATH', PREFIX),
    }


def build() -> None:
    env = {**os.environ, 'AMENT_PREFIX_PATH': os.environ.get('AMENT_PREFIX_PATH', sys.prefix)}
    for package in PACKAGES:
        texts = {n.rpartition('/')[2]: t for n, t in TEXTS.items() if n.startswith(f'{package}/')}
        key = hashlib.sha256(repr(sorted(texts.items())).encode()).hexdigest()
        done = PREFIX / f'{package}.done'
        if done.is_file() and done.read_text() == key:
            continue
        source = PREFIX / 'src' / package
        shutil.rmtree(source, ignore_errors=True)
        (source / 'msg').mkdir(parents=True)
        for name, text in texts.items():
            (source / 'msg' / f'{name}.msg').write_text(text + '\n')
        for file in ('CMakeLists.txt', 'package.xml'):
            text = (ROOT / 'msg_defs' / file).read_text().replace('mocap_ros_msgs', package)
            (source / file).write_text(add_dependencies(text, package, texts))
        options = [
            '-DBUILD_TESTING=OFF',
            f'-DCMAKE_INSTALL_PREFIX={PREFIX}',
            f'-DCMAKE_PREFIX_PATH={PREFIX};{env["AMENT_PREFIX_PATH"].replace(":", ";")}',
            f'-DPYTHON_INSTALL_DIR={SITE}',
            f'-DPython3_EXECUTABLE={sys.executable}',
        ]
        binary = f'{source}_build'
        for command in (
            ['cmake', '-S', str(source), '-B', binary, *options],
            ['cmake', '--build', binary, '--parallel', '2'],
            ['cmake', '--install', binary],
        ):
            ran = subprocess.run(command, capture_output=True, text=True, check=False, env=env)
            assert ran.returncode == 0, ran.stdout[-2000:] + ran.stderr[-2000:]
        done.write_text(key)


def add_dependencies(text: str, package: str, definitions: Mapping[str, str]) -> str:
    """Return a CMakeLists.txt with the packages whose types these definitions use besides the usual ones."""
    used = {name for d in definitions.values() for name in re.findall(r'^(\w+)/', d, re.MULTILINE)}
    for name in sorted(used - {package, 'geometry_msgs', 'std_msgs'}):
        usual = 'find_package(std_msgs REQUIRED)'
        text = text.replace(usual, f'find_package({name} REQUIRED)\n{usual}')
        text = text.replace('DEPENDENCIES geometry_msgs', f'DEPENDENCIES {name} geometry_msgs')
    return text
