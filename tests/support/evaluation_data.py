# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Access to the evaluation data, which is not part of the repository."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.support.paths import ROOT

SHARED = Path(os.environ.get('MOCAP_ROS_SHARED', ROOT.parent / 'shared'))


def shared(relative: str) -> Path:
    """Return the path of a file of the evaluation data; skip the test if the file is missing."""
    path = SHARED / relative
    if not path.exists():
        pytest.skip(f'evaluation data is missing: shared/{relative}')
    return path
