# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The layout of a batch: sequences of any number of people and hypotheses, one after the other in the same arrays.

Throughout the joint solver N is the number of frames of the whole batch, P the number of its sequences, J of
joints, B of bones, K of base poses, and n = K + 4 the number of unknowns of a frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

VELOCITY_CHANGE_FRAMES = 3  # frames; a change of velocity compares so many
MIN_TIME_STEP = 1e-4  # s; guards the division by time steps, far below that of any camera


@dataclass(frozen=True, eq=False)
class Batch:
    """Which frames belong to which sequence.

    Attributes:
        times: (N,) s, increasing within each sequence.
        starts: (P,) index of the first frame of each sequence.
        counts: (P,) number of frames of each sequence.
    """

    times: Array
    starts: NDArray[np.intp]
    counts: NDArray[np.intp]

    @staticmethod
    def of_times(times: Sequence[Array]) -> Batch:
        """Return the batch of sequences with these times, (F_p,) s each."""
        counts = np.array([len(t) for t in times])
        return Batch(np.concatenate(times), np.cumsum(counts) - counts, counts)

    @cached_property
    def sequence(self) -> NDArray[np.intp]:
        """(N,) index of the sequence of each frame."""
        return np.repeat(np.arange(len(self.starts)), self.counts)

    @cached_property
    def inverse_time_steps(self) -> Array:
        """(N - 1,) 1/s, reciprocal of the time from each frame to the next; 0 between two sequences."""
        inverse = 1 / np.maximum(np.diff(self.times), MIN_TIME_STEP)
        inverse[self.starts[1:] - 1] = 0.0
        return inverse

    @cached_property
    def velocity_change(self) -> Array:
        """(N, 3) factors c_t of the values x of frames t, t + 1 and t + 2 that give the change of their velocity.

            c_t0 x_t + c_t1 x_(t+1) + c_t2 x_(t+2) = (v_(t+1) - v_t) / sqrt(h_t)
            v_t = (x_(t+1) - x_t) / dt_t,    h_t = (dt_t + dt_(t+1)) / 2

        dt_t is the time from frame t to the next. Where the three are not of one sequence, the factors are 0.
        """
        factors = np.zeros((len(self.times), VELOCITY_CHANGE_FRAMES))
        first, second = self.inverse_time_steps[:-1], self.inverse_time_steps[1:]
        together = np.flatnonzero(first * second)
        a, b = first[together], second[together]
        root = np.sqrt(2 / (1 / a + 1 / b))
        factors[together] = np.stack([a * root, -(a + b) * root, b * root], axis=-1)
        return factors

    def sum_per_sequence(self, per_frame: Array) -> Array:
        """Sum values of frames (N, ...) over each sequence, which gives (P, ...)."""
        return np.asarray(np.add.reduceat(per_frame, self.starts, axis=0))

    def repeat_per_frame(self, per_sequence: NDArray[Any]) -> NDArray[Any]:
        """Repeat the value of each sequence (P, ...) for all its frames, which gives (N, ...)."""
        return np.asarray(np.repeat(per_sequence, self.counts, axis=0))

    def subsample(self, step: float, weight: Array) -> Subsample:
        """Keep the best-seen frame of every `step` s.

        The terms between neighbours get weights that keep their balance with the image: a pair of kept frames
        takes the weight of one old pair, times the share of frames that are kept, times the ratio of the time
        steps.

        Args:
            step: s.
            weight: (N,) how well each frame is seen.
        """
        sequence = self.sequence
        part = np.floor((self.times - self.times[self.starts][sequence]) / step + 1e-6)
        order = np.lexsort((-weight, part, sequence))
        is_best = np.diff(part[order], prepend=-1) != 0
        is_best[self.starts] = True
        kept = np.sort(order[is_best])
        counts = np.bincount(sequence[kept], minlength=len(self.starts))
        before, after = kept[:-1], kept[1:]
        old_step = np.maximum(self.times[before + 1] - self.times[before], MIN_TIME_STEP)
        new_step = np.maximum(self.times[after] - self.times[before], MIN_TIME_STEP)
        share = (counts / self.counts)[sequence[before]]
        factor = np.where(sequence[before] == sequence[after], share * old_step / new_step, 0.0)
        batch = Batch(self.times[kept], np.cumsum(counts) - counts, counts)
        return Subsample(batch, kept, before, factor)


class Subsample(NamedTuple):
    """Some frames of a batch, and how strongly neighbours among them are coupled.

    Attributes:
        batch: layout of the kept frames.
        frames: (M,) indices of the frames that are kept.
        pairs: (M - 1,) index of the old pair whose weight each new pair of neighbours takes.
        pair_factor: (M - 1,) factor on that weight, 0 between two sequences.
    """

    batch: Batch
    frames: NDArray[np.intp]
    pairs: NDArray[np.intp]
    pair_factor: Array
