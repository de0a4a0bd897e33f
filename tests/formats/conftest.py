# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Motions that the tests of the file formats share."""

import numpy as np
import pytest

from mocap_ros.formats.sequence_file import KeypointSequence
from tests.support.keypoint_files import make_walker
from tests.support.motion_files import make_poses


@pytest.fixture(scope='session')
def walker() -> KeypointSequence:
    return make_walker()


@pytest.fixture(scope='session')
def poses() -> np.ndarray:
    return make_poses()
