# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Motion capture trials in one array, from which training examples are drawn, and their shares in the training.

    share of trial i ~ f_c sqrt(N_cs) N_i / N_cs

N_i are the frames of the trial and N_cs those of its subject in its category c. Motion capture holds hundreds of
repetitions of a few exercises and only minutes of what people mostly do. The square root gives thin subjects more
weight than their length would, and single trials less than equal weight would; many people count more than many
repetitions.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros.skeleton import BODY26
from mocap_ros.training.example_arrays import Array, Array64, Bools

FPS = 30  # frames per second of the trials and of the library

# Share of the examples by speed relative to the recording; negative speeds play a trial backwards. Other speeds
# than those of the trials make the lifter robust to slower and faster people.
SPEED_SHARES = {1.0: 0.5, -1.0: 0.15, 0.75: 0.15, 1.35: 0.2}

TIME_TOLERANCE_FRAMES = 1e-9  # frames; includes the last frame of a trial despite rounding

# Factors f_c of the categories, 1 for all others: people in front of a robot mostly walk, and categories that are
# repetitions of one exercise hold few different poses each.
CATEGORY_FACTORS = {
    'walk': 3.0,
    'run': 3.0,
    **dict.fromkeys(('arm_raise', 'arm_rotation', 'leg_raise', 'lunge', 'sit_stand', 'squat', 'step_over'), 0.25),
}


@dataclass(frozen=True, eq=False)
class MotionLibrary:
    """All training motion: N frames of trials at several speeds, one trial after the other."""

    # (N, J, 3) m, vector from each joint's parent to the joint; zero for the root, and for face, feet and hands of
    # trials without them
    bone_vectors: Array
    has_extremities: Bools  # (N,) whether the trial of each frame has face, feet and hands
    first_frame: NDArray[np.intp]  # (N,) index of the first frame of the trial that each frame belongs to
    # (N,) cumulative probability of each frame to be the newest frame of an example
    cumulative_probability: Array64

    @staticmethod
    def from_trials(trials: Sequence[Array64], shares: Array64) -> MotionLibrary:
        """Build the library of trials (F, J, 3) in m, z up, at `FPS`, of which each has its share (N,).

        Trials without face, feet and hands are (F, J_c, 3).
        """
        parents = np.array([max(p, 0) for p in BODY26.parents])
        root = BODY26.parents.index(-1)
        parents[root] = root
        vectors, is_complete, first_frame, probability = [], [], [], []
        count = 0
        for trial, trial_share in zip(trials, shares, strict=True):
            for speed, share in SPEED_SHARES.items():
                position = np.arange(0, len(trial) - 1 + TIME_TOLERANCE_FRAMES, abs(speed))
                low = np.minimum(position.astype(int), max(len(trial) - 2, 0))
                high = np.minimum(low + 1, len(trial) - 1)
                poses = trial[low] + (position - low)[:, None, None] * (trial[high] - trial[low])
                poses = poses[::-1] if speed < 0 else poses
                joints = poses.shape[1]
                own = np.zeros((len(poses), len(parents), 3), np.float32)
                own[:, :joints] = poses - poses[:, parents[:joints]]
                vectors.append(own)
                is_complete.append(np.full(len(poses), joints == len(parents)))
                first_frame.append(np.full(len(poses), count))
                probability.append(np.full(len(poses), share * trial_share / len(poses)))
                count += len(poses)
        total = np.cumsum(np.concatenate(probability))
        return MotionLibrary(
            np.concatenate(vectors), np.concatenate(is_complete), np.concatenate(first_frame), total / total[-1]
        )


def balance_trials(categories: Sequence[str], subjects: Sequence[str], lengths: Sequence[int]) -> Array64:
    """Return the share of each of N trials in the training, with the sum 1.

    Args:
        categories: category of motion of each trial; empty if unknown.
        subjects: person who moves in each trial.
        lengths: number of frames of each trial, positive.
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
