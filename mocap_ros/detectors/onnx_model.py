# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A network in an ONNX file, which onnxruntime runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap_ros.detectors.detector import Image
from mocap_ros.errors import ModelError, tell_installation

Outputs = list[NDArray[np.float32]]

DEFAULT_INPUT_SIDE = 256  # px, of the input of a network that takes any size; MoveNet's multi-pose model wants it
ERRORS_ONLY = 3  # level of onnxruntime's log: its warnings about graphics cards are no concern of the user
THREADS = 1  # of a network; more would wait in a busy loop for each other, and leave the node and others no core
CHANNELS = 3  # red, green, blue
NUMBER_TYPES = {
    'tensor(float)': np.float32,
    'tensor(float16)': np.float16,
    'tensor(int32)': np.int32,
    'tensor(uint8)': np.uint8,
}


class OnnxModel:
    """A network whose only input is one RGB image.

    Images have (width, height) `input_size` in px, or with `takes_any_size` also another; the input is (1, 3, H,
    W) with `is_channels_first`, else (1, H, W, 3). `output_shapes` are those of the outputs for one image.
    """

    def __init__(self, path: Path) -> None:
        try:
            import onnxruntime
        except ImportError:
            raise ModelError(f'{path}: needs onnxruntime: {tell_installation("video")}') from None
        self.path = path
        options = onnxruntime.SessionOptions()
        options.log_severity_level = ERRORS_ONLY
        options.intra_op_num_threads = THREADS
        options.add_session_config_entry('session.intra_op.allow_spinning', '0')
        try:
            self._session = onnxruntime.InferenceSession(
                str(path), options, providers=onnxruntime.get_available_providers()
            )
        except Exception as error:  # onnxruntime raises many types, all of its own
            raise ModelError(f'{path}: no ONNX model ({_shorten(error)})') from None
        inputs = self._session.get_inputs()
        form = [(i.type, i.shape) for i in inputs]
        if len(inputs) != 1 or len(inputs[0].shape) != len('NHWC') or inputs[0].type not in NUMBER_TYPES:
            raise ModelError(f'{path}: takes {form}, expected one image')
        self._input_name = inputs[0].name
        self._number_type = NUMBER_TYPES[inputs[0].type]
        self.is_channels_first = inputs[0].shape[1] == CHANNELS
        height, width = inputs[0].shape[2:] if self.is_channels_first else inputs[0].shape[1:3]
        self.takes_any_size = not (isinstance(width, int) and isinstance(height, int))
        self.input_size = (
            (DEFAULT_INPUT_SIDE, DEFAULT_INPUT_SIDE) if self.takes_any_size else (int(width), int(height))
        )
        try:
            blank = np.zeros((self.input_size[1], self.input_size[0], CHANNELS), np.uint8)
            self.output_shapes = tuple(output.shape for output in self.run(blank))
        except ModelError as error:
            raise ModelError(f'{path}: {error}') from None

    def run(self, image: Image | NDArray[np.float32]) -> Outputs:
        """Run the network on an image (H, W, 3) of `input_size`, of the numbers that the network expects."""
        batch = image[None].astype(self._number_type)
        if self.is_channels_first:
            batch = np.ascontiguousarray(batch.transpose(0, 3, 1, 2))
        try:
            return list(self._session.run(None, {self._input_name: batch}))
        except Exception as error:  # see above
            raise ModelError(f'the network failed ({_shorten(error)})') from None


def _shorten(error: Exception) -> str:
    return str(error).rpartition(' : ')[2].split('\n')[0].strip().rstrip('.') or type(error).__name__
