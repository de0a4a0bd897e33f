# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The network with rounded weights: agreement with the formula, and rows that do not depend on each other."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from mocap_ros.models.network import RoundedNetwork
from tests.support import plain_lifter

Array32 = NDArray[np.float32]
Layers = list[tuple[Array32, Array32]]


def make_layers(rng: np.random.Generator, sizes: list[int], scale: float = 1.0) -> Layers:
    """Return layers of these sizes, the first being that of the inputs."""

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
