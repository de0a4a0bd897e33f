# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What the policies for SROS2 allow to each node."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import NamedTuple

from tests.support.paths import ROOT

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
