# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Errors of synthetic detectors: swapped joints keep their scores, points are missing as often as usual."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_ros.models.lifter_input import HISTORY_SLOTS_S, JOINT_COUNT, MIRROR_PERMUTATION
from mocap_ros.skeleton import CMU15
from mocap_ros.training.detector_errors import SWAP_SHARE, DetectorErrors
from mocap_ros.training.postures import joint_indices
from mocap_ros.training.random_arrays import Array, RandomArrays

EXAMPLES = 400
SLOTS = len(HISTORY_SLOTS_S)
ALWAYS = np.ones((EXAMPLES, SLOTS), bool)
NEVER_PRECISE = np.zeros(EXAMPLES, bool)
NO_DEPTH = np.zeros((EXAMPLES, JOINT_COUNT), np.float32)
ALL_JOINTS = np.ones((EXAMPLES, JOINT_COUNT), bool)
LIMBS = tuple(name for name in CMU15.joints if name not in ('head', 'neck', 'pelvis'))


@pytest.fixture
def errors() -> DetectorErrors:
    return DetectorErrors(RandomArrays(0))


def make_image() -> Array:
    return np.zeros((EXAMPLES, SLOTS, JOINT_COUNT, 2), np.float32)


def test_a_swap_exchanges_points_with_their_scores(errors: DetectorErrors) -> None:
    number = np.broadcast_to(np.arange(JOINT_COUNT, dtype=np.float32), (EXAMPLES, SLOTS, JOINT_COUNT))
    image, score = errors._swap_sides(np.stack([number, -number], axis=-1), number / np.float32(100))
    np.testing.assert_array_equal(image[..., 0], -image[..., 1])
    np.testing.assert_allclose(score, image[..., 0] / 100, rtol=1e-6)
    swapped = image[..., 0] != number
    assert np.isin(image[..., 0], number).all()
    np.testing.assert_array_equal(
        image[..., 0][swapped], np.broadcast_to(MIRROR_PERMUTATION, swapped.shape)[swapped]
    )
    share = swapped.any(axis=(1, 2)).mean()
    assert 0.75 * SWAP_SHARE < share < 1.25 * SWAP_SHARE


def test_detections_are_near_the_truth_where_they_are_seen(errors: DetectorErrors) -> None:
    found, score = errors.detect(make_image(), NO_DEPTH, ALWAYS, ALL_JOINTS, NEVER_PRECISE)
    seen = score > 0
    assert found.shape == (EXAMPLES, SLOTS, JOINT_COUNT, 2)
    assert ((score >= 0) & (score <= 1)).all()
    assert 0.6 < seen[..., joint_indices(*LIMBS)].mean() < 0.95
    assert 0.01 < np.median(np.abs(found[seen])) < 0.03, 'm'


def test_a_state_is_kept_from_slot_to_slot(errors: DetectorErrors) -> None:
    share, length = 0.3, 0.5
    shares = np.full((20 * EXAMPLES, JOINT_COUNT), share, np.float32)
    inside = errors._draw_times(shares, np.full((20 * EXAMPLES, 1), length, np.float32))
    newer, older = inside[:, 0], inside[:, -1]
    keep = np.exp(-HISTORY_SLOTS_S[-1] / (length * (1 - share)))
    assert older[newer].mean() == pytest.approx(share + (1 - share) * keep, abs=0.01)
    assert older[~newer].mean() == pytest.approx(share - share * keep, abs=0.01)
