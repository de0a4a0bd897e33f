# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""MediaPipe's pose landmarker (BlazePose; Bazarevsky et al., CVPR workshops 2020): 33 keypoints of each person.

The score of a keypoint is MediaPipe's visibility.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.detectors.detector import Image
from mocap_ros.errors import ModelError, tell_installation

KEYPOINTS = 33  # of BlazePose
MS_PER_S = 1000.0  # the Tasks API takes whole milliseconds
STDERR = 2  # the file descriptor


def _import_mediapipe(place: str) -> Any:
    """Import MediaPipe without its log about its start-up; a ModelError begins with `place`."""
    os.environ.setdefault('GLOG_minloglevel', '2')  # errors only
    os.environ.setdefault('TF_CPP_MIN_LOG_LEVEL', '3')  # likewise
    warnings.filterwarnings('ignore', 'SymbolDatabase.GetPrototype', UserWarning)  # of 0.10.14
    try:
        import mediapipe
    except ImportError as error:
        missing = isinstance(error, ModuleNotFoundError) and error.name == 'mediapipe'
        raise ModelError(
            f'{place}needs MediaPipe: {tell_installation("mediapipe")}' + ('' if missing else f' ({error})')
        ) from None
    return mediapipe


@contextmanager
def _without_log() -> Iterator[None]:
    """Silence what MediaPipe's libraries write on stderr, which is no concern of the user and has no setting."""
    kept, nowhere = os.dup(STDERR), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, STDERR)
    try:
        yield
    finally:
        os.dup2(kept, STDERR)
        os.close(kept)
        os.close(nowhere)


def _convert(people: Iterable[Iterable[Any]], image: Image) -> Array:
    """Return MediaPipe's landmarks, in shares of the image, as keypoints (P, 33, 3) in px and with scores."""
    size = image.shape[1], image.shape[0]
    rows = [[(p.x * size[0], p.y * size[1], p.visibility) for p in person] for person in people]
    return np.array(rows, float).reshape(-1, KEYPOINTS, 3)


class MediaPipe:
    """The Tasks API with a model bundle (`.task`)."""

    def __init__(self, model: Path, max_people: int) -> None:
        mediapipe = _import_mediapipe(f'{model}: ')
        vision, tasks = mediapipe.tasks.vision, mediapipe.tasks
        self.name = f'MediaPipe ({model.name})'
        options = vision.PoseLandmarkerOptions(
            base_options=tasks.BaseOptions(model_asset_path=str(model)),
            running_mode=vision.RunningMode.VIDEO,
            num_poses=max_people,
        )
        try:
            with _without_log():
                self._landmarker = vision.PoseLandmarker.create_from_options(options)
        except (RuntimeError, ValueError) as error:
            reason = ' '.join(str(error).split('\n')[0].split())
            raise ModelError(f'{model}: no model of the pose landmarker ({reason})') from None
        self._mediapipe = mediapipe
        self._last_ms = -1
        self._has_seen = False

    def detect(self, image: Image, time_s: float) -> Array:
        """Find the people; see `Detector`."""
        self._last_ms = max(round(time_s * MS_PER_S), self._last_ms + 1)
        picture = self._mediapipe.Image(
            image_format=self._mediapipe.ImageFormat.SRGB, data=np.ascontiguousarray(image)
        )
        with nullcontext() if self._has_seen else _without_log():
            people = self._landmarker.detect_for_video(picture, self._last_ms).pose_landmarks
        self._has_seen = True
        return _convert(people, image)

    def close(self) -> None:
        """Release the model."""
        with _without_log():
            self._landmarker.close()
