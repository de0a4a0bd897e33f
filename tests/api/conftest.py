# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The beginning of the demo recording, which the tests of the public functions share."""

from dataclasses import replace

import pytest

import mocap_ros
from mocap_ros.demo.scene import make_recording

FRAMES = 40


@pytest.fixture(scope='session')
def sequence() -> mocap_ros.KeypointSequence:
    """A walking person, with the truth."""
    whole = make_recording().sequence()
    assert whole.truth is not None
    return replace(
        whole,
        keypoints=whole.keypoints[:FRAMES],
        timestamps=whole.timestamps[:FRAMES],
        truth=replace(whole.truth, joints=whole.truth.joints[:FRAMES]),
    )
