# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Shares of trials in the training: many repetitions of one motion and many trials of one person gain little."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_ros.training.balance import CATEGORY_FACTORS, balance_trials


def test_shares_follow_the_formula() -> None:
    shares = balance_trials(['golf', 'golf', 'golf', 'dance'], ['a', 'a', 'b', 'a'], [100, 300, 900, 2500])
    expected = np.array([20 / 4, 20 * 3 / 4, 30, 50])
    assert shares == pytest.approx(expected / expected.sum())


def test_a_trial_cut_in_two_keeps_its_share() -> None:
    whole = balance_trials(['walk', 'run'], ['a', 'a'], [500, 80])
    cut = balance_trials(['walk', 'walk', 'run'], ['a', 'a', 'a'], [200, 300, 80])
    assert cut[0] + cut[1] == pytest.approx(whole[0])
    assert cut.sum() == pytest.approx(1)


def test_a_category_with_a_factor_counts_so_much_more() -> None:
    walk, other = balance_trials(['walk', 'golf'], ['a', 'b'], [400, 400])
    assert walk / other == pytest.approx(CATEGORY_FACTORS['walk'])
