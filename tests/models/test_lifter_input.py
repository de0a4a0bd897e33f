# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Histories, features and the network of the lifter agree with the formulas in plain NumPy."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from mocap_ros.models.lifter_input import (
    JOINT_COUNT,
    encode_features,
    sample_histories,
)
from mocap_ros.models.network import RoundedNetwork
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


Array32 = NDArray[np.float32]
Layers = list[tuple[Array32, Array32]]


def make_layers(rng: np.random.Generator, sizes: list[int], scale: float = 1.0) -> Layers:
    def draw(*shape: int) -> Array32:
        return (scale * rng.normal(size=shape) / np.sqrt(shape[0])).astype(np.float32)

    return [(draw(inputs, outputs), draw(outputs)) for inputs, outputs in pairwise(sizes)]


def make_features(rng: np.random.Generator, pairs: int, size: int) -> Array32:
    """Return features of which a third are 0, as those of joints that were not seen are."""
    return (rng.normal(size=(pairs, 2, size)) * (rng.random((pairs, 2, size)) > 1 / 3)).astype(np.float32)


@pytest.mark.parametrize('blocks', [0, 1, 3])
@pytest.mark.parametrize('scale', [1e-3, 1.0, 10.0])
def test_it_agrees_with_the_formula(rng: np.random.Generator, blocks: int, scale: float) -> None:
    layers = make_layers(rng, [37, *[26] * (1 + 2 * blocks), 11], scale)
    features = make_features(rng, 5, 37)
    layers[0][0][3] = layers[-1][0][5] = 0  # an input without weights has no scale
    expected = plain_lifter.evaluate(plain_lifter.round_layers(layers), features)
    found = RoundedNetwork.from_layers(layers).evaluate(features)
    assert found == pytest.approx(expected, abs=2e-6 * np.abs(expected).max())


def test_a_row_does_not_depend_on_the_others(rng: np.random.Generator) -> None:
    network = RoundedNetwork.from_layers(make_layers(rng, [37, 26, 26, 26, 11]))
    features = make_features(rng, 6, 37)
    together = network.evaluate(features)
    for pair in range(len(features)):
        assert (network.evaluate(features[pair : pair + 1]) == together[pair]).all()
        assert (network.evaluate(features[pair : pair + 1, ::-1].copy()) == together[pair, ::-1]).all()
        with_another = np.stack([features[pair, 0], features[pair - 1, 1]])[None]
        assert (network.evaluate(with_another)[0, 0] == together[pair, 0]).all()
