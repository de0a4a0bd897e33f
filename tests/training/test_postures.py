# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Synthetic postures: bones keep their lengths, and limbs point where the posture says."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.lifter_input import HISTORY_SLOTS_S
from mocap_ros.skeleton import BODY26, CORE_COUNT
from mocap_ros.training.postures import POSTURES, joint_indices, take_postures
from mocap_ros.training.random_arrays import Array, RandomArrays

EXAMPLES = 2000
KNEELING = 2  # index in `POSTURES`


@pytest.fixture(scope='module')
def standing(walk_model: BasePoses) -> Array:
    """Bone vectors of the same standing person in all examples."""
    root = BODY26.parents.index(-1)
    parents = [root if p < 0 else p for p in BODY26.parents]
    body = np.pad(walk_model.mean, [(0, len(parents) - CORE_COUNT), (0, 0)])
    for side in 'lr':
        body[BODY26.index(side + 'toe')] = body[BODY26.index(side + 'ankle')] + [0.15, 0, -0.05]
        body[BODY26.index(side + 'hand')] = body[BODY26.index(side + 'wrist')] + [0, 0, -0.08]
    vectors = (body - body[parents]).astype(np.float32)
    return np.broadcast_to(vectors, (EXAMPLES, len(HISTORY_SLOTS_S), *vectors.shape)).copy()


@pytest.fixture(scope='module')
def taken(standing: Array) -> Array:
    return take_postures(standing, RandomArrays(3))


def find_shanks(vectors: Array) -> Array:
    """Directions (N, 2, 3) of the shanks in the newest frame."""
    shanks = vectors[:, 0, joint_indices('lankle', 'rankle')]
    return np.asarray(shanks / np.linalg.norm(shanks, axis=-1, keepdims=True))


def test_bones_keep_their_lengths(standing: Array, taken: Array) -> None:
    longer = np.linalg.norm(taken, axis=-1) - np.linalg.norm(standing, axis=-1)
    assert np.abs(longer).max() < 1e-5


def test_people_kneel_with_shanks_on_the_floor_behind_them(standing: Array, taken: Array) -> None:
    shares = np.array([p.share for p in POSTURES])
    assert POSTURES[KNEELING].shank[1] < -60
    level = find_shanks(taken)[..., 2].mean(axis=1) > -np.sin(np.radians(35))
    kneeling = level & (taken != standing).any(axis=(1, 2, 3))
    low = shares[KNEELING:].sum()  # these and those who sit on their heels or are on all fours
    assert kneeling.mean() == pytest.approx(low, abs=0.25 * low)
    assert (find_shanks(taken[kneeling])[..., 0] < 0).mean() > 0.95, 'behind the knee'
    toes = taken[kneeling][:, 0, joint_indices('ltoe', 'rtoe')]
    assert (toes[..., 2] < 0.1).all(), 'm, not above the ankle'
