"""The lifter's network, evaluated with weights in half precision.

    h_0 = relu(W_0 x + b_0),   h_(i+1) = h_i + relu(W'_i relu(W_i h_i + b_i) + b'_i),   y = W h + b

For few inputs, the time goes into fetching the 2.8 million weights. They are therefore fetched as the 16 bits in
which a lifter's file holds them, and only where the input that they belong to is not 0; relu makes half of the
inputs 0. Neither changes the result.

A number of half precision becomes one of single precision when its exponent and its fraction move to their places
there. It is then too small by 2^112, because the biases of the two exponents differ by that. The inputs are
multiplied by a power of two instead, which is exact.

The kernels evaluate two rows of inputs at a time, a pose and its mirror image, which use nearly the same weights.
The outputs of a row depend on that row alone, to the last bit: each is a sum over the inputs in their order.

Shapes: P pairs, I features, W hidden units, H hidden layers, O outputs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import float32, int16, types, void
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import INT, INTS_1D, kernel
from mocap_ros.compiled.multiply_add import multiply_add

Array32 = NDArray[np.float32]
Codes = NDArray[np.int16]

HALF_MAX_EXPONENT = 15  # numbers of half precision reach to twice 2^15
HALF_MIN = 2.0**-24  # the least number of half precision above 0; the largest weight of a network is not smaller
EXPONENT_BIAS_DIFFERENCE = 112  # bias of the exponent in single precision, 127, less that in half precision, 15
FRACTION_SHIFT = np.int32(13)  # bits that single precision has more for the fraction, 23, than half precision, 10
ZERO = np.float32(0)  # of single precision
SIGN_AND_NUMBER = np.int32(-0x70002000)  # bits 31 and 27 to 13, which a shifted number of half precision fills

_FLOATS32_2D, _FLOATS32_3D = (types.Array(float32, n, 'C') for n in (2, 3))  # types of kernels' arguments
# types of kernels' arguments that they only read
_INPUT32_1D, _INPUT32_2D, _INPUT32_3D = (types.Array(float32, n, 'C', readonly=True) for n in (1, 2, 3))
_CODES_2D, _CODES_3D = (types.Array(int16, n, 'C', readonly=True) for n in (2, 3))  # half-precision weights


@dataclass(frozen=True, eq=False)
class HalfPrecisionNetwork:
    """A network whose weights are rounded to half precision.

    Attributes:
        first: (I, W) codes of the weights of the first layer. A code is the bits of a weight in half precision,
            times a power of two that makes the largest weight of the network use the largest exponent.
        hidden: (H, W, W) codes of the weights of the residual blocks, two layers for each block.
        last: (W, O) codes of the weights of the last layer.
        biases: (1 + H, W) biases of all layers but the last.
        last_bias: (O,) biases of the last layer.
        scale: power of two by which decoded weights are too small.
    """

    first: Codes
    hidden: Codes
    last: Codes
    biases: Array32
    last_bias: Array32
    scale: np.float32

    @staticmethod
    def from_layers(layers: Sequence[tuple[Array32, Array32]]) -> HalfPrecisionNetwork:
        """Round the weights of a network to half precision.

        Args:
            layers: (in, out) weights and (out,) biases of the first layer, of the two layers of each residual
                block, and of the last layer.
        """
        largest = max(HALF_MIN, *(float(np.abs(weights).max()) for weights, _ in layers))
        exponent = HALF_MAX_EXPONENT - math.frexp(largest)[1]
        codes = [(weights * np.float32(2.0**exponent)).astype(np.float16).view(np.int16) for weights, _ in layers]
        width = codes[0].shape[1]
        return HalfPrecisionNetwork(
            codes[0],
            np.array(codes[1:-1], np.int16).reshape(-1, width, width),
            codes[-1],
            np.array([bias for _, bias in layers[:-1]]),
            np.ascontiguousarray(layers[-1][1]),
            np.float32(2.0 ** (EXPONENT_BIAS_DIFFERENCE - exponent)),
        )

    def evaluate(self, features: Array32) -> Array32:
        """Return the outputs (P, 2, O) of features (P, 2, I); not finite if they overflow."""
        out = np.empty((*features.shape[:2], len(self.last_bias)), np.float32)
        _evaluate(features, self.first, self.hidden, self.last, self.biases, self.last_bias, self.scale, out)
        return out


@kernel(float32(int16))
def _decode(code: np.int16) -> np.float32:
    """Return the number of a code, which is too small by the scale of the network."""
    return np.int32((np.int32(code) << FRACTION_SHIFT) & SIGN_AND_NUMBER).view(np.float32)


@kernel(INT(_INPUT32_2D, float32, INTS_1D, _FLOATS32_2D))
def _collect_used(inputs: Array32, scale: np.float32, used: NDArray[np.int64], factors: Array32) -> int:
    """Collect the inputs that are not 0 in both of two rows.

    Args:
        inputs: (2, I) inputs of a layer.
        scale: scale of the network.
        used: (I + 3,) or more; its beginning is overwritten with the indices of these inputs.
        factors: (2, I + 3) or more; its beginning is overwritten with these inputs times the scale.

    Returns:
        The number of these inputs, filled up with inputs of 0 to a multiple of four.
    """
    count = 0
    for i in range(inputs.shape[1]):
        a, b = inputs[0, i], inputs[1, i]
        used[count], factors[0, count], factors[1, count] = i, a * scale, b * scale
        count += (a != 0) | (b != 0)  # without a branch, which no processor could predict
    while count % 4 > 0:
        used[count], factors[0, count], factors[1, count] = 0, ZERO, ZERO
        count += 1
    return count


@kernel(void(_INPUT32_2D, _CODES_2D, _INPUT32_1D, float32, _FLOATS32_2D))
def _apply_layer(inputs: Array32, codes: Codes, bias: Array32, scale: np.float32, out: Array32) -> None:
    """Write X W + b of two rows of inputs, four inputs at a time to fetch and store the outputs less often.

    Args:
        inputs: (2, I) X.
        codes: (I, O) codes of W.
        bias: (O,) b.
        scale: scale of the network.
        out: (2, O) is overwritten.
    """
    used, factors = np.empty(len(codes) + 3, np.int64), np.empty((2, len(codes) + 3), np.float32)
    count = _collect_used(inputs, scale, used, factors)
    y, z = out[0], out[1]
    for o in range(len(bias)):
        y[o] = z[o] = bias[o]
    for n in range(0, count, 4):
        c0, c1, c2, c3 = codes[used[n]], codes[used[n + 1]], codes[used[n + 2]], codes[used[n + 3]]
        a0, a1, a2, a3 = factors[0, n], factors[0, n + 1], factors[0, n + 2], factors[0, n + 3]
        b0, b1, b2, b3 = factors[1, n], factors[1, n + 1], factors[1, n + 2], factors[1, n + 3]
        for o in range(len(bias)):
            w0, w1, w2, w3 = _decode(c0[o]), _decode(c1[o]), _decode(c2[o]), _decode(c3[o])
            y[o] = multiply_add(a3, w3, multiply_add(a2, w2, multiply_add(a1, w1, multiply_add(a0, w0, y[o]))))
            z[o] = multiply_add(b3, w3, multiply_add(b2, w2, multiply_add(b1, w1, multiply_add(b0, w0, z[o]))))


@kernel(void(_FLOATS32_2D))
def _rectify(rows: Array32) -> None:
    """Overwrite numbers v with relu(v) = max(v, 0)."""
    for row in range(len(rows)):
        for i in range(rows.shape[1]):
            rows[row, i] = max(rows[row, i], ZERO)


@kernel(void(_INPUT32_3D, _CODES_2D, _CODES_3D, _CODES_2D, _INPUT32_2D, _INPUT32_1D, float32, _FLOATS32_3D))
def _evaluate(
    features: Array32,
    first: Codes,
    hidden: Codes,
    last: Codes,
    biases: Array32,
    last_bias: Array32,
    scale: np.float32,
    out: Array32,
) -> None:
    """Write the outputs (P, 2, O) of features (P, 2, I); the other arguments are the attributes of the network."""
    h = np.empty((2, first.shape[1]), np.float32)
    inner, added = np.empty_like(h), np.empty_like(h)
    for pair in range(len(features)):
        _apply_layer(features[pair], first, biases[0], scale, h)
        _rectify(h)
        for layer in range(0, len(hidden), 2):
            _apply_layer(h, hidden[layer], biases[1 + layer], scale, inner)
            _rectify(inner)
            _apply_layer(inner, hidden[layer + 1], biases[2 + layer], scale, added)
            _rectify(added)
            h += added
        _apply_layer(h, last, last_bias, scale, out[pair])
