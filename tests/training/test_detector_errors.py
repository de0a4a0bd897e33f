"""Errors of synthetic detectors: swapped joints keep their scores, and no more is missing than detectors miss."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_ros.models.lifter_input import HISTORY_SLOTS_S, JOINT_COUNT, MIRROR_PERMUTATION
from mocap_ros.training.detector_errors import SWAP_SHARE, DetectorErrors
from mocap_ros.training.random_arrays import RandomArrays

EXAMPLES = 400
SLOTS = len(HISTORY_SLOTS_S)


@pytest.fixture(scope='module')
def errors() -> DetectorErrors:
    return DetectorErrors(RandomArrays(0))


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
    assert 0.5 * SWAP_SHARE < share <= 1.2 * SWAP_SHARE, 'some spans end before the history begins'


def test_detections_are_near_the_truth_where_they_are_seen(errors: DetectorErrors) -> None:
    image = np.zeros((EXAMPLES, SLOTS, JOINT_COUNT, 2), np.float32)
    found, score = errors.detect(image, np.ones((EXAMPLES, SLOTS), bool))
    seen = score > 0
    assert found.shape == image.shape
    assert ((score >= 0) & (score <= 1)).all()
    assert 0.6 < seen.mean() < 0.95
    assert np.median(np.abs(found[seen])) < 0.03, 'm'
