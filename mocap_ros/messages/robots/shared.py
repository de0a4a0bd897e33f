# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What the messages for robots share: reliability of people, boxes around them, and how well they are turned."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mocap_ros.messages.cdr import Array
from mocap_ros.messages.stacked_people import StackedPeople
from mocap_ros.people import HIPS, Person3D

RELIABILITY_FADE_S = 1.0  # s; the reliability of a person who has not been seen for so long is a third
FLESH_M = 0.1  # m; how far a body reaches beyond its joints: half a trunk's depth, a hand beyond its wrist


class Boxes(NamedTuple):
    """The boxes around N people, along the axes of the frame.

    Attributes:
        centre: (N, 3) m.
        size: (N, 3) m.
    """

    centre: Array
    size: Array


def compute_reliability(person: Person3D) -> float:
    """Return how sure it is that a person is there: 1 for one who is seen, less the longer one is not."""
    return math.exp(-person.unseen_for / RELIABILITY_FADE_S)


def compute_boxes(people: StackedPeople) -> Boxes:
    """Return the boxes around the joints of people and the flesh about them."""
    low, high = people.joints.min(axis=1) - FLESH_M, people.joints.max(axis=1) + FLESH_M
    return Boxes((low + high) / 2, high - low)


def compute_heading_stds(people: StackedPeople) -> Array:
    """Return the standard deviations (N,) in rad of bodies' directions: hips that are off turn the line between.

    Across the line of sight, the line of length b turns by sqrt(4/3) std / b, as two thirds of the variances lie
    along it (`models/joint_std.py`); otherwise placed it turns less. Where nothing is known of the joints, it is
    the deviation of a direction of which nothing is known.
    """
    left, right = HIPS
    breadth = np.linalg.norm(people.joints[:, left] - people.joints[:, right], axis=1)
    std = math.sqrt(4 / 3) * (people.std[:, left] + people.std[:, right]) / 2 / np.maximum(breadth, FLESH_M)
    unknown = math.pi / math.sqrt(3)
    return np.where(np.isfinite(std), np.minimum(std, unknown), unknown)
