# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A recording with its people in 3D, which is reconstructed, or read from a result."""

from __future__ import annotations

from typing import NamedTuple

from mocap_ros.formats.detections import Detections
from mocap_ros.people import PoseSequence
from mocap_ros.summary import UNKNOWN_SUMMARY, StoredSummary, Summary


class Drop(NamedTuple):
    """An input that the recorded run dropped."""

    stamp_ns: int  # of the skeletons before
    reason: str


class Recording(NamedTuple):
    """The people of a recording, and what they rest on."""

    people: tuple[PoseSequence, ...]
    summary: Summary | StoredSummary = UNKNOWN_SUMMARY  # of all people together
    notes: tuple[str, ...] = ()  # lines for the user about what was chosen, assumed and left out
    detections: Detections | None = None  # the keypoints beside the skeletons of a bag
    drops: tuple[Drop, ...] = ()
