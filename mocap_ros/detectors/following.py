# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Several people by a network that sees one person in a rectangle: who is there is found, and then followed.

Another detector, which sees the whole image, finds people; each gets a rectangle, at which the network looks
twice, since the first look shows better where the rectangle should be. From image to image the rectangle follows
from the keypoints in it. Whoever is not seen any more, or is seen in the rectangle of somebody else, loses it.
While fewer people are followed than may be, the others are looked for every `SEARCH_S`, and while there are none,
in every image.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.detectors.detector import Detector, Image
from mocap_ros.detectors.regions import Box
from mocap_ros.skeleton import keypoint_layout

KEYPOINTS = len(keypoint_layout('coco17').joints)
MIN_SHARED_SCORE = 0.2  # 1; of keypoints that are compared
MIN_SEEN = 6  # keypoints; with fewer there is no saying where the person is
WORKERS = 2  # threads, in which people are looked at; more would leave nothing to other programs
SEARCH_S = 0.5  # s; who comes is seen so late, and the search takes a tenth of the time that two people take
# 1; two people are one whose keypoints are so near each other, at the median, as a share of the person's diagonal
DOUBLE_SHARE = 0.08


class PersonNetwork(ABC):
    """A network that sees one person in a rectangle."""

    name: str  # name of the network and its model
    keypoint_count: int  # number J of its keypoints
    min_score: float  # score of a keypoint that is probably right

    @abstractmethod
    def estimate(self, image: Image, region: Box) -> Array:
        """Return the keypoints (J, 3) in px and with scores that the network gives for a region of the image."""

    @abstractmethod
    def choose_region(self, keypoints: Array) -> Box | None:
        """Return the region of a person with these keypoints, of COCO or its own; None where it is not known."""


class FollowingDetector:
    """Detector that finds people by another one, which sees COCO's keypoints, and follows them with a network."""

    def __init__(self, network: PersonNetwork, finder: Detector, max_people: int) -> None:
        self.name = network.name
        self._network, self._finder, self._max_people = network, finder, max_people
        self._regions: list[Box] = []  # in which the people of the last image are expected
        self._searched_s = -np.inf
        self._pool = ThreadPoolExecutor(WORKERS, 'person')

    def detect(self, image: Image, time_s: float) -> Array:
        """Find the people; see `Detector`."""
        found: list[Array] = []
        for keypoints in self._pool.map(partial(self._network.estimate, image), self._regions):
            self._add(keypoints, found)
        if not found or (len(found) < self._max_people and time_s - self._searched_s >= SEARCH_S):
            self._searched_s = time_s
            for keypoints in self._finder.detect(image, time_s):
                if len(found) < self._max_people and not is_known(keypoints, found):
                    self._look_twice(image, keypoints, found)
        regions = map(self._network.choose_region, found)
        self._regions = [region for region in regions if region is not None]
        return np.array(found).reshape(-1, self._network.keypoint_count, 3)

    def close(self) -> None:
        """Forget the people; the networks go with the object."""
        self._regions = []
        self._pool.shutdown()

    def _add(self, keypoints: Array, found: list[Array]) -> None:
        """Add a person to those found, if it is one who is not among them."""
        if is_seen(keypoints, self._network.min_score) and not is_known(keypoints, found):
            found.append(keypoints)

    def _look_twice(self, image: Image, keypoints: Array, found: list[Array]) -> None:
        """Add the person whom the finder sees, if the network sees one there."""
        region = self._network.choose_region(keypoints)
        if region is None:
            return
        closer = self._network.choose_region(self._network.estimate(image, region))
        self._add(self._network.estimate(image, closer or region), found)


def is_seen(keypoints: Array, min_score: float) -> bool:
    """Return whether keypoints (J, 3) are those of a person."""
    return int((keypoints[:, 2] >= min_score).sum()) >= MIN_SEEN


def is_known(keypoints: Array, found: Sequence[Array]) -> bool:
    """Return whether keypoints (J, 3) are those of one of the people found, by COCO's, which come first."""
    for person in found:
        seen = np.minimum(keypoints[:KEYPOINTS, 2], person[:KEYPOINTS, 2]) >= MIN_SHARED_SCORE
        if seen.any():
            a, b = keypoints[:KEYPOINTS][seen, :2], person[:KEYPOINTS][seen, :2]
            size = np.linalg.norm(np.ptp(person[:KEYPOINTS, :2], axis=0))
            if np.median(np.linalg.norm(a - b, axis=1)) < DOUBLE_SHARE * size:
                return True
    return False
