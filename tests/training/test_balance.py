# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Shares of trials in the training: many repetitions of one motion and many trials of one person gain little."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_ros.training.motion_library import balance_trials


def test_shares_follow_the_formula() -> None:
    shares = balance_trials(['golf', 'golf', 'golf', 'dance'], ['a', 'a', 'b', 'a'], [100, 300, 900, 2500])
    expected = np.array([20 / 4, 20 * 3 / 4, 30, 50])
    assert shares == pytest.approx(expected / expected.sum())
