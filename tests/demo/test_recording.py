# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The shipped recording of the demo."""

from __future__ import annotations

from pathlib import Path

import pytest

from mocap_ros.demo.scene import make_recording
from mocap_ros.formats.sequence_file import load_sequence, save_sequence
from tests.support.paths import ROOT


def test_the_shipped_recording_is_the_generated_one(tmp_path: Path) -> None:
    shipped = load_sequence(ROOT / 'mocap_ros' / 'demo' / 'demo.npz')
    save_sequence(tmp_path / 'demo.npz', make_recording().sequence())
    made = load_sequence(tmp_path / 'demo.npz')
    assert shipped.keypoints == pytest.approx(made.keypoints, abs=1e-3, nan_ok=True)
    assert shipped.truth is not None
    assert made.truth is not None
    assert shipped.truth.joints == pytest.approx(made.truth.joints, abs=1e-5)
