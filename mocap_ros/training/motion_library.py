# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Motion capture trials in one array, from which training examples are drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros.skeleton import BODY26

Array = NDArray[np.float32]
Array64 = NDArray[np.float64]

FPS = 30  # frames per second of the trials and of the library

# Share of the examples by speed relative to the recording; negative speeds play a trial backwards. Other speeds
# than those of the trials make the lifter robust to slower and faster people.
SPEED_SHARES = {1.0: 0.5, -1.0: 0.15, 0.75: 0.15, 1.35: 0.2}

TIME_TOLERANCE_FRAMES = 1e-9  # frames; includes the last frame of a trial despite rounding


@dataclass(frozen=True, eq=False)
class MotionLibrary:
    """All training motion: N frames of trials at several speeds, one trial after the other.

    Attributes:
        bone_vectors: (N, J, 3) m, vector from each joint's parent to the joint; zero for the root, and for face,
            feet and hands of trials without them.
        has_extremities: (N,) whether the trial of each frame has face, feet and hands.
        first_frame: (N,) index of the first frame of the trial that each frame belongs to.
        cumulative_probability: (N,) cumulative probability of each frame to be the newest frame of an example.
    """

    bone_vectors: Array
    has_extremities: NDArray[np.bool_]
    first_frame: NDArray[np.intp]
    cumulative_probability: Array64

    @staticmethod
    def from_trials(trials: Sequence[Array64], shares: Array64) -> MotionLibrary:
        """Build the library.

        Args:
            trials: arrays (F, J, 3) or, without face, feet and hands, (F, J_c, 3) in m, z up, at `FPS`.
            shares: (N,) probability of each trial, as from `balance.balance_trials`.
        """
        parents = np.array([max(p, 0) for p in BODY26.parents])
        root = BODY26.parents.index(-1)
        parents[root] = root
        vectors, is_complete, first_frame, probability, count = [], [], [], [], 0
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
