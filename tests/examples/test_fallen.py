# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The example that says who has fallen."""

from dataclasses import replace

from mocap_ros.messages.cdr import Header, decode
from mocap_ros.messages.skeletons import SKELETONS, encode_skeletons
from mocap_ros.people import Posture
from tests.support.bodies import gather, make_person_3d
from tests.support.paths import ROOT, load_module


def test_who_lies_after_standing_has_fallen() -> None:
    falls = load_module(ROOT / 'examples' / 'fallen.py').Falls()
    steps = [
        (0.0, Posture.LYING, Posture.STANDING, False),  # who lay when first seen has not fallen
        (1.0, Posture.LYING, Posture.LYING, False),
        (2.0, Posture.LYING, Posture.UNKNOWN, False),
        (3.0, Posture.LYING, Posture.LYING, True),
        (4.0, Posture.LYING, Posture.SITTING, False),
        (9.0, Posture.LYING, Posture.LYING, False),
    ]
    for time_s, first, second, has_fallen in steps:
        people = gather([replace(make_person_3d(i), posture=p) for i, p in (('a', first), ('b', second))])
        message = decode(encode_skeletons(Header(round(time_s * 1e9), 'camera'), people), SKELETONS)
        assert falls.update(message) is has_fallen, time_s
