"""Where the evaluation data lies; users do not have it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.support.paths import ROOT

SHARED = Path(os.environ.get('MOCAP_ROS_SHARED', ROOT.parent / 'shared'))


def shared(relative: str) -> Path:
    """A file of the evaluation data; where it is not here the test is skipped, and the report says so."""
    path = SHARED / relative
    if not path.exists():
        pytest.skip(f'evaluation data not here: shared/{relative}')
    return path
