# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Shares of trials in the training, so that no kind of motion drowns the others.

    share of trial i ~ f_c sqrt(N_cs) N_i / N_cs

N_i are the frames of the trial and N_cs those of its subject in its category c. Motion capture holds hundreds of
repetitions of a few exercises and only minutes of what people mostly do. The square root gives thin subjects more
weight than their length would, and single trials less than equal weight would; many people count more than many
repetitions.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Factors f_c of the categories, 1 for all others: people in front of a robot mostly walk, and categories that are
# repetitions of one exercise hold few different poses each.
CATEGORY_FACTORS = {
    'walk': 3.0,
    'run': 3.0,
    **dict.fromkeys(('arm_raise', 'arm_rotation', 'leg_raise', 'lunge', 'sit_stand', 'squat', 'step_over'), 0.25),
}


def balance_trials(categories: Sequence[str], subjects: Sequence[str], lengths: Sequence[int]) -> Array:
    """Return the share of each trial in the training, (N,) with the sum 1.

    Args:
        categories: (N,) category of motion of each trial; empty if unknown.
        subjects: (N,) person who moves in each trial.
        lengths: (N,) number of frames of each trial, positive.
    """
    groups = list(zip(categories, subjects, strict=True))
    of_group: Counter[tuple[str, str]] = Counter()
    for group, length in zip(groups, lengths, strict=True):
        of_group[group] += length
    weights = [
        CATEGORY_FACTORS.get(group[0], 1.0) * length / np.sqrt(of_group[group])
        for group, length in zip(groups, lengths, strict=True)
    ]
    return np.asarray(weights) / np.sum(weights)
