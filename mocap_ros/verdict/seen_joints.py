# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""How many joints of people were seen over many images, and which parts of the body never were."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mocap_ros.skeleton import canonical_joint_names
from mocap_ros.verdict.accuracy import LIMB_JOINTS

MAX_UNSEEN_SHARE = 0.02  # 1, of the images of people; detectors guess a hidden joint now and then
MAX_CACHED_NAMES = 64  # lists of joint names; guards memory against messages that name ever new ones
HEAD = 'head'
# Keypoints that show a joint, any of them; each joint of the limbs is one itself.
SHOWN_BY = {HEAD: {HEAD, 'headtop', 'nose', 'leye', 'reye', 'lear', 'rear'}, **{j: {j} for j in LIMB_JOINTS}}
GROUPS = {'shoulders': ('shoulder',), 'arms': ('elbow', 'wrist'), 'hips': ('hip',), 'legs': ('knee', 'ankle')}


def _list_parts() -> Iterator[tuple[str, set[str]]]:
    """Yield names of parts of the body with their joints, every part before those that it consists of."""
    yield HEAD, {HEAD}
    for group, kinds in GROUPS.items():
        for name, members in ((group, kinds), *((f'{kind}s', (kind,)) for kind in kinds)):
            yield name, {side + member for side in 'lr' for member in members}
            for side in ('left', 'right'):
                yield f'{side} {name[:-1]}', {side[0] + member for member in members}


PARTS = tuple(_list_parts())


class SeenJoints:
    """How often joints were seen, over all images of all people."""

    def __init__(self) -> None:
        self._images = 0  # of people of whom something was seen
        self._shares = 0.0  # sum of the shares of the detector's points that were seen
        self._counts = np.zeros(len(SHOWN_BY))  # images in which each joint was seen

    def add(self, names: tuple[str, ...], is_seen: NDArray[np.bool_]) -> None:
        """Add whether points (F, J) of these names were seen of a person in F images."""
        shown = is_seen[is_seen.any(axis=1)]
        self._images += len(shown)
        self._shares += float(shown.mean(axis=1).sum())
        self._counts += (shown @ _find_points(names)).sum(axis=0)

    @property
    def share(self) -> float:
        """The mean share of the detector's points that were seen; NaN without images."""
        return self._shares / self._images if self._images else math.nan

    def name_unseen(self) -> str:
        """Return which parts of the body were hardly ever seen, such as `hips and legs`; else nothing."""
        is_unseen = self._counts <= MAX_UNSEEN_SHARE * self._images
        unseen = {joint for joint, missing in zip(SHOWN_BY, is_unseen, strict=True) if missing and self._images}
        names = []
        for name, joints in PARTS:
            if joints <= unseen:
                names.append(name)
                unseen -= joints
        return ' and '.join(filter(None, (', '.join(names[:-1]), *names[-1:])))


@lru_cache(maxsize=MAX_CACHED_NAMES)
def _find_points(names: tuple[str, ...]) -> NDArray[np.bool_]:
    """Return (J, 13) whether a point shows each joint of `SHOWN_BY`."""
    return np.array([[name in points for points in SHOWN_BY.values()] for name in canonical_joint_names(names)])
