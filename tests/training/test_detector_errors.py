# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Errors of synthetic detectors: swapped joints keep their scores, and no more is missing than detectors miss."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_ros.keypoints.joint_map import build_joint_map
from mocap_ros.models.lifter_input import HISTORY_SLOTS_S, JOINT_COUNT, MIRROR_PERMUTATION
from mocap_ros.skeleton import BODY26, CMU15
from mocap_ros.training import detector_errors
from mocap_ros.training.body_parts import joint_indices
from mocap_ros.training.detector_errors import MAX_PART_SWAP_SLOTS, SWAP_SHARE, DetectorErrors
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


def test_legs_or_arms_alone_are_swapped_for_a_short_time(errors: DetectorErrors) -> None:
    number = np.broadcast_to(np.arange(JOINT_COUNT, dtype=np.float32), (EXAMPLES, SLOTS, JOINT_COUNT))
    image, _ = errors._swap_sides(np.stack([number, number], axis=-1), np.ones_like(number))
    swapped = image[..., 0] != number
    knee, elbow = joint_indices('lknee', 'lelbow')
    alone = swapped[:, :, knee] ^ swapped[:, :, elbow]
    together = swapped[:, :, knee] & swapped[:, :, elbow]
    assert alone.any()
    assert alone.sum(axis=1).max() <= MAX_PART_SWAP_SLOTS < together.sum(axis=1).max()


def test_detections_are_near_the_truth_where_they_are_seen(errors: DetectorErrors) -> None:
    found, score = errors.detect(make_image(), NO_DEPTH, ALWAYS, ALL_JOINTS, NEVER_PRECISE)
    seen = score > 0
    assert found.shape == (EXAMPLES, SLOTS, JOINT_COUNT, 2)
    assert ((score >= 0) & (score <= 1)).all()
    assert 0.6 < seen[..., joint_indices(*LIMBS)].mean() < 0.95
    assert 0.01 < np.median(np.abs(found[seen])) < 0.03, 'm'


def test_precise_points_have_no_errors_but_for_lost_joints(
    errors: DetectorErrors, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(detector_errors, 'LOST_SHARE_RANGE', (1e-9, 1e-9))
    found, _ = errors._add_noise(make_image(), NO_DEPTH, ~NEVER_PRECISE)
    assert not found.any()


def test_states_last_as_long_and_are_as_frequent_as_stated(errors: DetectorErrors) -> None:
    share, length = 0.3, 0.5
    inside = np.mean(
        [
            errors._draw_times(
                np.full((EXAMPLES, JOINT_COUNT), share, np.float32), np.full((EXAMPLES, 1), length, np.float32)
            )
            for _ in range(10)
        ],
        axis=0,
    )
    assert inside.mean() == pytest.approx(share, abs=0.02)


def test_a_state_is_kept_from_slot_to_slot(errors: DetectorErrors) -> None:
    share, length = 0.3, 0.5
    shares = np.full((20 * EXAMPLES, JOINT_COUNT), share, np.float32)
    inside = errors._draw_times(shares, np.full((20 * EXAMPLES, 1), length, np.float32))
    newer, older = inside[:, 0], inside[:, -1]
    keep = np.exp(-HISTORY_SLOTS_S[-1] / (length * (1 - share)))
    assert older[newer].mean() == pytest.approx(share + (1 - share) * keep, abs=0.01)
    assert older[~newer].mean() == pytest.approx(share - share * keep, abs=0.01)


def test_errors_wander_with_their_time_constant(errors: DetectorErrors, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(detector_errors, 'WANDER_TIME_RANGE_S', (0.5, 0.5))
    error = errors._draw_wander(20 * EXAMPLES)
    correlation = (error[:, :1] * error).mean(axis=(0, 2, 3))
    assert correlation == pytest.approx(np.exp(-HISTORY_SLOTS_S / 0.5), abs=0.02)


def test_a_derived_midline_joint_lies_between_its_joints(
    errors: DetectorErrors, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(detector_errors, 'GIVEN_JOINTS', ((LIMBS, 1.0),))
    rng = np.random.default_rng(5)
    image = rng.standard_normal((EXAMPLES, SLOTS, JOINT_COUNT, 2)).astype(np.float32)
    score = rng.uniform(0.1, 1, (EXAMPLES, SLOTS, JOINT_COUNT)).astype(np.float32)
    score[:, :, joint_indices('lhip')] = 0
    pelvis, left, right, neck = joint_indices('pelvis', 'lshoulder', 'rshoulder', 'neck')
    found, found_score = errors._derive_midline(image.copy(), score.copy())
    assert found[:, :, neck] == pytest.approx((image[:, :, left] + image[:, :, right]) / 2, abs=1e-6)
    np.testing.assert_array_equal(found_score[:, :, neck], np.minimum(score[:, :, left], score[:, :, right]))
    assert not found_score[:, :, pelvis].any(), 'a hip is not seen'
    assert not found_score[:, :, BODY26.index('nose')].any(), 'the detector gives no face'


def test_a_head_is_derived_from_the_ears_as_for_detectors(
    errors: DetectorErrors, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = (*LIMBS, 'nose', 'leye', 'reye', 'lear', 'rear')
    monkeypatch.setattr(detector_errors, 'GIVEN_JOINTS', ((given, 1.0),))
    image = np.random.default_rng(6).standard_normal((EXAMPLES, SLOTS, JOINT_COUNT, 2)).astype(np.float32)
    found, score = errors._derive_midline(image.copy(), np.ones(image.shape[:3], np.float32))
    sources = image[:, :, joint_indices(*given)].astype(float)
    expected, expected_score = build_joint_map(given, BODY26).apply(sources, np.ones(sources.shape[:3]))
    head = BODY26.index('head')
    assert found[:, :, head] == pytest.approx(expected[:, :, head], abs=1e-5)
    assert score == pytest.approx(expected_score, abs=1e-6)


def test_points_of_the_face_behind_the_head_may_be_hidden(errors: DetectorErrors) -> None:
    depth = np.zeros((EXAMPLES, JOINT_COUNT), np.float32)
    lear, rear, wrist = joint_indices('lear', 'rear', 'lwrist')
    depth[:, lear], depth[:, wrist] = 0.15, 0.5
    hidden = errors._hide_behind_head(depth)
    assert 0.25 < hidden[:, lear].mean() < 0.45
    assert not hidden[:, [rear, wrist]].any()
