# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The distributions hold what users need, and the version stands in package.xml alone."""

from __future__ import annotations

import re
import tarfile
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

from tests.support.paths import ROOT

VERSION = ET.parse(ROOT / 'package.xml').findtext('version')


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
