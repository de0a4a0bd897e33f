# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Write the versions and hashes of all packages of this environment, except this package and its messages.

    .venv/bin/python config/env/lock.py > config/env/locked-TAG.txt

TAG says for which Python and platform the wheels are: `lock.py --tag` prints it. `make setup LOCKED=1` installs
exactly what the file for this Python lists, and refuses whatever has another hash.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import sysconfig
from importlib.metadata import distributions
from tempfile import NamedTemporaryFile
from typing import Any

OWN = {'mocap-ros', 'mocap-ros-msgs'}
PIP = [sys.executable, '-m', 'pip', '--quiet', '--disable-pip-version-check']
HEADER = """\
# Versions and hashes of wheels for {tag}. Made by `config/task.sh lock`; `make setup LOCKED=1` installs them.
"""


def find_tag() -> str:
    """Return the tag of this Python and platform, such as cp311-linux-x86_64."""
    return f'cp{sys.version_info.major}{sys.version_info.minor}-{sysconfig.get_platform()}'


def list_installed() -> dict[str, str]:
    """Return the version of every installed wheel by name; the message packages in wheels of ROS have no own."""
    versions = {}
    for distribution in distributions(path=[sysconfig.get_path('purelib')]):
        name = re.sub(r'[-_.]+', '-', distribution.metadata['Name']).lower()
        if name not in OWN and distribution.read_text('WHEEL') is not None:
            versions[name] = distribution.version
    return versions


def resolve(versions: dict[str, str]) -> list[dict[str, Any]]:
    """Return what pip would install for these versions, with the hashes that the index states."""
    with NamedTemporaryFile('w', suffix='.txt') as pins, NamedTemporaryFile('r', suffix='.json') as report:
        pins.write(''.join(f'{name}=={version}\n' for name, version in sorted(versions.items())))
        pins.flush()
        command = [*PIP, 'install', '--dry-run', '--no-deps', '--ignore-installed', '-r', pins.name]
        subprocess.run([*command, '--report', report.name], check=True, stdout=subprocess.DEVNULL)  # noqa: S603
        found: list[dict[str, Any]] = json.load(report)['install']
        return found


def main() -> None:
    """Print the file."""
    if sys.argv[1:] == ['--tag']:
        print(find_tag())
        return
    lines = []
    for entry in resolve(list_installed()):
        name = re.sub(r'[-_.]+', '-', entry['metadata']['name']).lower()
        digest = entry['download_info']['archive_info']['hashes']['sha256']
        lines.append(f'{name}=={entry["metadata"]["version"]} --hash=sha256:{digest}\n')
    print(HEADER.format(tag=find_tag()) + ''.join(sorted(lines)), end='')


if __name__ == '__main__':
    main()
