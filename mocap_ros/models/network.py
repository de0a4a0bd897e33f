# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The lifter's network, evaluated with weights that are rounded to integers.

    h_0 = relu(W_0 x + b_0),   h_(i+1) = h_i + relu(W'_i relu(W_i h_i + b_i) + b'_i),   y = W h + b
    W_oi ~ s_i c_oi,   s_i = max_o |W_oi| / c_max,   c_max = 127 (hidden) or 32767 (first and last layer)

Most of the time goes into fetching the 3.2 million weights, so only those of inputs other than 0 are fetched. Such
a pose differs by 1.3 mm from that of the exact network, and its error by less than 0.01 mm. Two inputs at a time
are evaluated, a pose and its mirror image; the outputs of each depend on it alone, to the last bit.

Shapes: P pairs, I features, W hidden units, H hidden layers, O outputs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array32

Codes = NDArray[Any]  # of 8 or 16 bits
Floats = NDArray[np.floating[Any]]
Layers = Sequence[tuple[Floats, Floats]]  # weights (in, out) and biases (out,) of layers, one after the other


class RoundedNetwork(NamedTuple):
    """A network whose weights are rounded to integers, the codes c, times the scales s of its inputs.

    Rows of codes are filled up with zeros to a multiple of sixteen.
    """

    first: Codes  # (I, W or more) codes of the first layer
    first_scales: Array32  # (I,) its scales
    hidden: Codes  # (H, W, W or more) codes of the layers of the residual blocks, two for each block
    hidden_scales: Array32  # (H, W) their scales
    last: Codes  # (W, O or more) codes of the last layer
    last_scales: Array32  # (W,) its scales
    biases: Array32  # (1 + H, W) biases of all layers but the last
    last_bias: Array32  # (O,) biases of the last layer

    @staticmethod
    def from_layers(layers: Layers) -> RoundedNetwork:
        """Round the weights (in, out), with biases (out,), of the first layer, the blocks of two, and the last."""
        (first, _), *blocks, (last, last_bias) = layers
        rounded = [_round_weights(weights, np.int8) for weights, _ in blocks]
        codes, scales = _round_weights(first, np.int16)
        width, filled = first.shape[1], codes.shape[1]
        return RoundedNetwork(
            codes,
            scales,
            np.array([codes for codes, _ in rounded], np.int8).reshape(len(blocks), width, filled),
            np.array([scales for _, scales in rounded], np.float32).reshape(len(blocks), width),
            *_round_weights(last, np.int16),
            np.array([bias for _, bias in layers[:-1]], np.float32),
            np.ascontiguousarray(last_bias, np.float32),
        )


def _round_weights(given: Floats, kind: type[np.int8 | np.int16]) -> tuple[Codes, Array32]:
    """Return the codes (in, out or more) of weights (in, out) as integers of a kind, and the scales (in,)."""
    weights = np.array(given, np.float32)
    scales = np.maximum(weights.max(axis=1), -weights.min(axis=1)) / np.float32(np.iinfo(kind).max)
    weights /= np.where(scales > 0, scales, 1)[:, None]
    codes = np.zeros((len(weights), weights.shape[1] + -weights.shape[1] % 16), kind)
    codes[:, : weights.shape[1]] = np.rint(weights, out=weights)
    return codes, scales
