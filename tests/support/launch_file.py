# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The launch file without the packages that `ros2 launch` needs, and what the policies for SROS2 allow."""

import sys
import xml.etree.ElementTree as ET
from types import ModuleType, SimpleNamespace
from typing import Any, NamedTuple

import pytest

from tests.support.paths import ROOT, load_module


class Recorded(SimpleNamespace):
    """What a class of `launch` was created with; it substitutes for all of them."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(args=args, **options)

    def perform(self, context: dict[str, str]) -> str:
        """Return the value of a launch argument."""
        return context[self.args[0]]


class RecordingModule(ModuleType):
    """A module that has every class."""

    def __getattr__(self, name: str) -> type[Recorded]:
        return Recorded


def load_launch_file(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Return the launch file, with substitutes for the packages that it imports."""
    for part in ('', '.actions', '.conditions', '.substitutions', '.parameter_descriptions'):
        for package in ('launch', 'launch_ros'):
            monkeypatch.setitem(sys.modules, package + part, RecordingModule(package + part))
    return load_module(ROOT / 'config' / 'launch' / 'mocap.launch.py')


POLICY_PATH = ROOT / 'config' / 'mocap_ros.policy.xml'


class Permissions(NamedTuple):
    """Names of topics and services as the policies write them.

    Attributes:
        publish: topics that a node may publish.
        subscribe: topics to which it may subscribe.
        reply: services that it may offer.
        request: services that it may call.
    """

    publish: frozenset[str]
    subscribe: frozenset[str]
    reply: frozenset[str]
    request: frozenset[str]


def read_permissions(node: str) -> Permissions:
    """Return what the policies allow to a node."""
    profile = ET.parse(POLICY_PATH).find(f'.//profile[@node="{node}"]')
    assert profile is not None

    def names(kind: str, permission: str) -> frozenset[str]:
        lists = profile.findall(f'{kind}s[@{permission}="ALLOW"]/{kind}')
        return frozenset(element.text or '' for element in lists)

    return Permissions(
        publish=names('topic', 'publish'),
        subscribe=names('topic', 'subscribe'),
        reply=names('service', 'reply'),
        request=names('service', 'request'),
    )
