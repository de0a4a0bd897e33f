# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""MediaPipe where it is installed with its model, which versions up to 0.10.21 are, and a picture of a person."""

import zipfile
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from PIL import Image

# The numbers that the networks take for the numbers c = 0 to 255 of a picture are (c - mean) / std.
NETWORKS = {
    'pose_detector.tflite': ('pose_detection/pose_detection.tflite', 127.5, 127.5),
    'pose_landmarks_detector.tflite': ('pose_landmark/pose_landmark_full.tflite', 0.0, 255.0),
}


def require_mediapipe() -> Any:
    """Return the module `mediapipe`, or skip the test where it is missing or has no model."""
    mediapipe = pytest.importorskip('mediapipe', reason="needs MediaPipe: pip install -e '.[mediapipe]'")
    if not hasattr(mediapipe, 'solutions'):
        pytest.skip(f'MediaPipe {mediapipe.__version__} has no model; needs 0.10.21')
    return mediapipe


def save_task(path: Path) -> Path:
    """Write the networks that come with MediaPipe as a model bundle of the Tasks API."""
    modules = Path(require_mediapipe().__file__).parent / 'modules'
    from mediapipe.tasks.python.metadata.metadata_writers import metadata_writer

    with zipfile.ZipFile(path, 'w') as bundle:
        for name, (source, mean, std) in NETWORKS.items():
            writer = metadata_writer.MetadataWriter.create(bytearray((modules / source).read_bytes()))
            writer.add_image_input(norm_mean=[mean], norm_std=[std])
            bundle.writestr(name, bytes(writer.populate()[0]))
    return path


def load_portrait() -> np.ndarray:
    """Return the portrait (600, 512, 3) of Grace Hopper that comes with matplotlib, seen down to the chest."""
    path = Path(mpl.get_data_path()) / 'sample_data' / 'grace_hopper.jpg'
    return np.asarray(Image.open(path).convert('RGB'))
