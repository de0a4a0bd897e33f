# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Histories and features: agreement with the formulas in plain NumPy, gaps, and joints that were not seen."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mocap_ros.models.lifter_input import (
    JOINT_COUNT,
    encode_features,
    encode_histories,
    sample_histories,
)
from tests.support import plain_lifter

Array = NDArray[np.float64]
RATES_HZ = [8.0, 24.0, 30.0, 60.0, 300.0]


def make_sequence(
    rng: np.random.Generator, rate_hz: float, outlier: float = 2 * plain_lifter.MAX_COORDINATE
) -> tuple[Array, Array, Array]:
    """Return points (F, J, 2), weights (F, J) and times (F,), with gaps, outliers and joints not seen."""
    frames = 60
    times = 1e5 + np.cumsum(rng.choice([1, 1, 1, 2, 4], frames) / rate_hz)
    points = rng.normal(size=(frames, JOINT_COUNT, 2)) + [0.3, -0.1]
    weight = rng.uniform(0, 1.2, (frames, JOINT_COUNT)) * (rng.random((frames, JOINT_COUNT)) > 0.2)
    points[weight == 0] = np.nan
    points[rng.random(weight.shape) > 0.98] = outlier
    return points, weight, times


@pytest.mark.parametrize('rate_hz', RATES_HZ)
def test_histories_agree_with_the_formula(rng: np.random.Generator, rate_hz: float) -> None:
    sequence = make_sequence(rng, rate_hz)
    frames = np.array([0, 1, 7, 30, 59])
    points, weight = sample_histories(*sequence, frames)
    for n, frame in enumerate(frames):
        expected_points, expected_weight = plain_lifter.sample_history(*sequence, frame)
        assert weight[n] == pytest.approx(expected_weight, abs=1e-12)
        assert points[n] == pytest.approx(expected_points, rel=1e-12, abs=1e-9)
    assert (weight > 0).any()


@pytest.mark.parametrize('focal', [np.inf, 1.5])
def test_features_agree_with_the_formula(rng: np.random.Generator, focal: float) -> None:
    points, weight = sample_histories(*make_sequence(rng, 30.0), np.array([3, 20, 59]))
    weight[1, 0] = 0  # no person was seen in the newest frame
    vertical, std = np.array([[0.0, -1, 0], [0.6, -0.8, 0], [np.nan] * 3]), np.array([0.02, 0.3, 0.02])
    encoded = encode_histories(points, weight, focal, vertical, std)
    for n in range(len(points)):
        seen, rotation = points[n], np.eye(3)
        if np.isfinite(focal):
            seen, rotation = plain_lifter.face_newest_points(points[n], weight[n], focal)
        upward = np.nan_to_num(plain_lifter.weigh_vertical(rotation @ vertical[n], std[n]))
        features, newest, size = plain_lifter.encode_features(seen, weight[n], focal, upward)
        assert encoded.features[n, 0] == pytest.approx(features, abs=1e-6)
        assert encoded.features[n, 1] == pytest.approx(plain_lifter.mirror_features(features), abs=1e-6)
        assert encoded.newest[n] == pytest.approx(newest, abs=1e-12)
        assert encoded.size[n] == pytest.approx(size, rel=1e-12)
        assert encoded.rotation[n] == pytest.approx(rotation, abs=1e-12)


def test_features_of_examples_are_those_of_histories(rng: np.random.Generator) -> None:
    points, weight = sample_histories(*make_sequence(rng, 30.0, outlier=9.0), np.array([3, 20, 59]))
    focal = np.array([np.inf, 0.7, 40.0])
    upward = rng.normal(size=(3, 3))
    single = points.astype(np.float32), weight.astype(np.float32)
    features, newest, size = encode_features(*single, focal, upward)
    for n in range(len(points)):
        given = points[n], weight[n], focal[n], upward[n]
        expected, expected_newest, expected_size = plain_lifter.encode_features(*given)
        assert features[n] == pytest.approx(expected, abs=1e-5)
        assert newest[n] == pytest.approx(expected_newest, abs=1e-5)
        assert size[n] == pytest.approx(expected_size, rel=1e-5)
