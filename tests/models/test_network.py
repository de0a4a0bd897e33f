"""The network in half precision: agreement with the formula, and rows that do not depend on each other."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from mocap_ros.models.network import EXPONENT_BIAS_DIFFERENCE, HalfPrecisionNetwork, _decode
from tests.support import plain_lifter

Array32 = NDArray[np.float32]
Layers = list[tuple[Array32, Array32]]


def make_layers(rng: np.random.Generator, sizes: list[int], scale: float = 1.0) -> Layers:
    """Return layers of these sizes, the first being that of the inputs, with weights of half precision."""

    def draw(*shape: int) -> Array32:
        return (scale * rng.normal(size=shape) / np.sqrt(shape[0])).astype(np.float16).astype(np.float32)

    return [(draw(inputs, outputs), draw(outputs)) for inputs, outputs in pairwise(sizes)]


def make_features(rng: np.random.Generator, pairs: int, size: int) -> Array32:
    """Return features of which a third are 0, as those of joints that were not seen are."""
    return (rng.normal(size=(pairs, 2, size)) * (rng.random((pairs, 2, size)) > 1 / 3)).astype(np.float32)


@pytest.mark.parametrize('blocks', [0, 1, 3])
@pytest.mark.parametrize('scale', [1e-3, 1.0, 10.0])
def test_it_agrees_with_the_formula(rng: np.random.Generator, blocks: int, scale: float) -> None:
    layers = make_layers(rng, [37, *[26] * (1 + 2 * blocks), 11], scale)
    features = make_features(rng, 5, 37)
    expected = plain_lifter.evaluate(layers, features)
    found = HalfPrecisionNetwork.from_layers(layers).evaluate(features)
    assert found == pytest.approx(expected, abs=2e-6 * np.abs(expected).max())


def test_a_row_does_not_depend_on_the_others(rng: np.random.Generator) -> None:
    network = HalfPrecisionNetwork.from_layers(make_layers(rng, [37, 26, 26, 26, 11]))
    features = make_features(rng, 6, 37)
    together = network.evaluate(features)
    for pair in range(len(features)):
        assert (network.evaluate(features[pair : pair + 1]) == together[pair]).all()
        assert (network.evaluate(features[pair : pair + 1, ::-1].copy()) == together[pair, ::-1]).all()
        with_another = np.stack([features[pair, 0], features[pair - 1, 1]])[None]
        assert (network.evaluate(with_another)[0, 0] == together[pair, 0]).all()


def test_every_number_of_half_precision_is_decoded_exactly() -> None:
    codes = np.arange(-(1 << 15), 1 << 15).astype(np.int16)
    numbers = codes.view(np.float16).astype(np.float64)
    for code, number in zip(codes[::7], numbers[::7], strict=True):
        if np.isfinite(number):
            assert _decode(code) * 2.0**EXPONENT_BIAS_DIFFERENCE == number


def test_weights_are_rounded_to_half_precision(rng: np.random.Generator) -> None:
    weights = rng.normal(size=(1, 500)).astype(np.float32)
    layers = [(np.ones((1, 1), np.float32), np.zeros(1, np.float32)), (weights, np.zeros(500, np.float32))]
    found = HalfPrecisionNetwork.from_layers(layers).evaluate(np.ones((1, 2, 1), np.float32))
    error = np.abs(found[0, 0] / weights[0] - 1)
    assert 2.0**-12 < error.max() <= 2.0**-11
