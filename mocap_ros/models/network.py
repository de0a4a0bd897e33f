# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The lifter's network, evaluated with weights that are rounded to integers.

    h_0 = relu(W_0 x + b_0),   h_(i+1) = h_i + relu(W'_i relu(W_i h_i + b_i) + b'_i),   y = W h + b

Most of the time goes into fetching and converting the 3.2 million weights. Those of the hidden layers are
therefore rounded to 8 bits, those of the first and of the last layer, to whose errors the outputs are more
sensitive, to 16:

    W_oi ~ s_i c_oi,   s_i = max_o |W_oi| / c_max,   c_max = 127 or 32767

Such a pose differs by 1.3 mm from that of the exact network, and its error by less than 0.01 mm. Weights are
fetched only where the input that they belong to is not 0, which does not change the result; relu makes half of the
inputs 0.

The kernels evaluate two rows of inputs at a time, a pose and its mirror image, which use nearly the same weights.
The outputs of a row depend on that row alone, to the last bit: each is a sum over the inputs in their order.

Shapes: P pairs, I features, W hidden units, H hidden layers, O outputs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import float32, int8, int16, types, void
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import INT, INTS_1D, kernel
from mocap_ros.compiled.multiply_add import multiply_add

Array32 = NDArray[np.float32]
Codes = NDArray[np.signedinteger[Any]]

ZERO = np.float32(0)  # of single precision

_FLOATS32_2D, _FLOATS32_3D = (types.Array(float32, n, 'C') for n in (2, 3))  # types of kernels' arguments
# types of kernels' arguments that they only read
_INPUT32_1D, _INPUT32_2D, _INPUT32_3D = (types.Array(float32, n, 'C', readonly=True) for n in (1, 2, 3))
_CODES_16 = types.Array(int16, 2, 'C', readonly=True)  # of weights of a layer
_CODES_8, _CODES_8_3D = (types.Array(int8, n, 'C', readonly=True) for n in (2, 3))  # of one or several layers


@dataclass(frozen=True, eq=False)
class RoundedNetwork:
    """A network whose weights are rounded to integers, the codes c, times the scales s of its inputs.

    Attributes:
        first: (I, W) codes of the first layer.
        first_scales: (I,) its scales.
        hidden: (H, W, W) codes of the layers of the residual blocks, two for each block.
        hidden_scales: (H, W) their scales.
        last: (W, O) codes of the last layer.
        last_scales: (W,) its scales.
        biases: (1 + H, W) biases of all layers but the last.
        last_bias: (O,) biases of the last layer.
    """

    first: Codes
    first_scales: Array32
    hidden: Codes
    hidden_scales: Array32
    last: Codes
    last_scales: Array32
    biases: Array32
    last_bias: Array32

    @staticmethod
    def from_layers(layers: Sequence[tuple[Array32, Array32]]) -> RoundedNetwork:
        """Round the weights (in, out), with biases (out,), of the first layer, the blocks of two, and the last."""
        (first, _), *blocks, (last, last_bias) = layers
        width = first.shape[1]
        rounded = [_round_weights(weights, np.int8) for weights, _ in blocks]
        return RoundedNetwork(
            *_round_weights(first, np.int16),
            np.array([codes for codes, _ in rounded], np.int8).reshape(-1, width, width),
            np.array([scales for _, scales in rounded], np.float32).reshape(-1, width),
            *_round_weights(last, np.int16),
            np.array([bias for _, bias in layers[:-1]]),
            np.ascontiguousarray(last_bias),
        )

    def evaluate(self, features: Array32) -> Array32:
        """Return the outputs (P, 2, O) of features (P, 2, I); not finite if they overflow."""
        out = np.empty((*features.shape[:2], len(self.last_bias)), np.float32)
        _evaluate(
            features,
            self.first,
            self.first_scales,
            self.hidden,
            self.hidden_scales,
            self.last,
            self.last_scales,
            self.biases,
            self.last_bias,
            out,
        )
        return out


def _round_weights(weights: Array32, kind: type[np.signedinteger[Any]]) -> tuple[Codes, Array32]:
    """Return the codes (in, out) of weights (in, out) as integers of a kind, and the scales (in,)."""
    scales = np.abs(weights).max(axis=1) / np.float32(np.iinfo(kind).max)
    codes = np.rint(weights / np.where(scales > 0, scales, 1)[:, None])
    return codes.astype(kind), scales


@kernel(INT(_INPUT32_2D, _INPUT32_1D, INTS_1D, _FLOATS32_2D))
def _collect_used(inputs: Array32, scales: Array32, used: NDArray[np.int64], factors: Array32) -> int:
    """Collect the inputs (2, I) of a layer that are not 0 in at least one of two rows.

    The beginnings of `used` (I + 3 or more) and `factors` (2, I + 3 or more) are overwritten with the indices of
    these inputs, and with the inputs times the scales (I,) of the weights.

    Returns:
        The number of these inputs, filled up with inputs of 0 to a multiple of four.
    """
    count = 0
    for i in range(inputs.shape[1]):
        a, b = inputs[0, i], inputs[1, i]
        used[count], factors[0, count], factors[1, count] = i, a * scales[i], b * scales[i]
        count += (a != 0) | (b != 0)  # without a branch, which no processor could predict
    while count % 4 > 0:
        used[count], factors[0, count], factors[1, count] = 0, ZERO, ZERO
        count += 1
    return count


def _apply_layer(inputs: Array32, codes: Codes, scales: Array32, bias: Array32, out: Array32) -> None:
    """Write X W + b (2, O) of two rows of inputs, four inputs at a time to fetch and store outputs less often."""
    used, factors = np.empty(len(codes) + 3, np.int64), np.empty((2, len(codes) + 3), np.float32)
    count = _collect_used(inputs, scales, used, factors)
    y, z = out[0], out[1]
    for o in range(len(bias)):
        y[o] = z[o] = bias[o]
    for n in range(0, count, 4):
        c0, c1, c2, c3 = codes[used[n]], codes[used[n + 1]], codes[used[n + 2]], codes[used[n + 3]]
        a0, a1, a2, a3 = factors[0, n], factors[0, n + 1], factors[0, n + 2], factors[0, n + 3]
        b0, b1, b2, b3 = factors[1, n], factors[1, n + 1], factors[1, n + 2], factors[1, n + 3]
        for o in range(len(bias)):
            w0, w1, w2, w3 = np.float32(c0[o]), np.float32(c1[o]), np.float32(c2[o]), np.float32(c3[o])
            y[o] = multiply_add(a3, w3, multiply_add(a2, w2, multiply_add(a1, w1, multiply_add(a0, w0, y[o]))))
            z[o] = multiply_add(b3, w3, multiply_add(b2, w2, multiply_add(b1, w1, multiply_add(b0, w0, z[o]))))


_apply_layer_16 = kernel(void(_INPUT32_2D, _CODES_16, _INPUT32_1D, _INPUT32_1D, _FLOATS32_2D))(_apply_layer)
_apply_layer_8 = kernel(void(_INPUT32_2D, _CODES_8, _INPUT32_1D, _INPUT32_1D, _FLOATS32_2D))(_apply_layer)


@kernel(void(_FLOATS32_2D))
def _rectify(rows: Array32) -> None:
    """Overwrite numbers v with relu(v) = max(v, 0)."""
    for row in range(len(rows)):
        for i in range(rows.shape[1]):
            rows[row, i] = max(rows[row, i], ZERO)


@kernel(
    void(
        *(_INPUT32_3D, _CODES_16, _INPUT32_1D, _CODES_8_3D, _INPUT32_2D, _CODES_16, _INPUT32_1D),
        *(_INPUT32_2D, _INPUT32_1D, _FLOATS32_3D),
    )
)
def _evaluate(
    features: Array32,
    first: Codes,
    first_scales: Array32,
    hidden: Codes,
    hidden_scales: Array32,
    last: Codes,
    last_scales: Array32,
    biases: Array32,
    last_bias: Array32,
    out: Array32,
) -> None:
    """Write the outputs (P, 2, O) of features (P, 2, I); the other arguments are the attributes of the network."""
    h = np.empty((2, first.shape[1]), np.float32)
    inner, added = np.empty_like(h), np.empty_like(h)
    for pair in range(len(features)):
        _apply_layer_16(features[pair], first, first_scales, biases[0], h)
        _rectify(h)
        for layer in range(0, len(hidden), 2):
            _apply_layer_8(h, hidden[layer], hidden_scales[layer], biases[1 + layer], inner)
            _rectify(inner)
            _apply_layer_8(inner, hidden[layer + 1], hidden_scales[layer + 1], biases[2 + layer], added)
            _rectify(added)
            h += added
        _apply_layer_16(h, last, last_scales, last_bias, out[pair])
