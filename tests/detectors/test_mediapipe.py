# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""MediaPipe's own model finds a real person, by both of its interfaces."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mocap_ros.detectors.load import load_detector
from mocap_ros.errors import ModelError
from mocap_ros.skeleton import keypoint_layout
from tests.support.mediapipe_models import load_portrait, require_mediapipe, save_task

LAYOUT = keypoint_layout('mediapipe33')
# px, read off the portrait by eye; left and right are those of the person
LANDMARKS = {
    'nose': (270, 225),
    'leye': (305, 190),
    'reye': (230, 196),
    'lshoulder': (455, 428),
    'rshoulder': (96, 423),
}


@pytest.mark.parametrize('interface', ['bundled', 'tasks'])
def test_a_real_person_is_found(tmp_path: Path, interface: str) -> None:
    require_mediapipe()
    detector = load_detector(None if interface == 'bundled' else save_task(tmp_path / 'pose.task'))
    image = load_portrait()
    try:
        assert len(detector.detect(np.zeros_like(image), 0.0)) == 0
        for time_s in (1.0, 1.0001, 1.0002):  # less than the millisecond that the Tasks API counts by
            (person,) = detector.detect(image, time_s)
    finally:
        detector.close()
    for name, point in LANDMARKS.items():
        found = person[LAYOUT.index(name)]
        assert found[:2] == pytest.approx(point, abs=12), name
        assert found[2] > 0.9
    assert person[LAYOUT.index('lankle'), 2] < 0.5  # below the picture


def test_a_file_that_is_no_bundle_is_refused_in_one_line(tmp_path: Path) -> None:
    require_mediapipe()
    (tmp_path / 'pose.task').write_bytes(b'no model')
    with pytest.raises(ModelError, match=r'pose\.task: no model of the pose landmarker \(.+\)$'):
        load_detector(tmp_path / 'pose.task')
