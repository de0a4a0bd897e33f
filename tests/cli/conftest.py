# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Recordings that the tests of the commands share."""

from dataclasses import replace
from pathlib import Path

import pytest

from mocap_ros.demo.scene import make_recording
from mocap_ros.formats.sequence_file import load_sequence, save_sequence
from mocap_ros.keypoints.keypoint_sequence import GroundTruth


@pytest.fixture(scope='session')
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp('cli') / 'demo.npz'
    save_sequence(path, make_recording().sequence())
    return path


@pytest.fixture
def short_recording(recording: Path, tmp_path: Path) -> Path:
    """Twenty frames of the demo recording, in a file whose name matplotlib could take for a formula."""
    whole = load_sequence(recording)
    assert whole.truth is not None
    truth = GroundTruth(whole.truth.joints[:20], whole.truth.joint_names)
    path, keypoints = tmp_path / '$x^{_$.npz', whole.keypoints[:20]
    save_sequence(path, replace(whole, keypoints=keypoints, timestamps=whole.timestamps[:20], truth=truth))
    return path
