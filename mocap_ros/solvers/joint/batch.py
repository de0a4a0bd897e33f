# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What the joint solver is given: sequences of any number of people and hypotheses, one after the other.

Throughout the joint solver N is the number of frames of the whole batch, P the number of its sequences, J of
joints, B of bones, K of base poses, and n = K + 4 the number of unknowns of a frame. Image lengths are divided by
the sequence's unit in px/m, so that they are metres at the body.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.engine import batch as engine
from mocap_ros.errors import InputError
from mocap_ros.geometry.rotations import rotation_from_vector, vector_from_rotation
from mocap_ros.solvers.window import InitialValues, Window


class State(NamedTuple):
    """The unknowns of all frames."""

    theta: Array  # (N, K) m, base-pose weights
    rotation: Array  # (N, 3, 3) body frame to camera frame
    # (N,) logarithm of the scale, which is measured in the sequence's unit (1 at its median start)
    log_scale: Array
    translation: Array  # (N, 2) m, image of the body's origin in the sequence's unit

    def select(self, frames: NDArray[np.intp]) -> State:
        """Return the state of some frames."""
        return State(*(values[frames] for values in self))


class Batch(engine.Batch):
    """The measurements of all frames, which of them belong to which sequence, and the state to start from."""

    @staticmethod
    def build(windows: Sequence[Window], units: Array, starts: Sequence[InitialValues]) -> Batch:
        """Return the batch of these windows, of which all frames are free, with their units (P,) px/m.

        Raises:
            InputError: only some of the windows have lifted poses.
        """
        has_lifted = [w.lifted is not None for w in windows]
        if any(has_lifted) and not all(has_lifted):
            raise InputError('some windows of the batch have lifted poses and some have not')
        batch = Batch([len(w.times) for w in windows], starts[0].theta.shape[1], all(has_lifted))
        for p, (window, unit) in enumerate(zip(windows, units.tolist(), strict=True)):
            batch.measure_window(p, window, unit)
        batch.measure_least_noise()
        batch.theta[:] = np.concatenate([s.theta for s in starts])
        batch.rotation[:] = np.concatenate([s.cameras.rotation for s in starts])
        scale = np.concatenate([s.cameras.scale for s in starts])
        batch.log_scale[:] = np.log(scale / batch.repeat_per_frame(units))
        return batch

    @property
    def start(self) -> State:
        """The state to start from, translations being the weighted centroids of the points."""
        return State(self.theta, self.rotation, self.log_scale, self.frames['centroid'])

    @property
    def times(self) -> Array:
        """Times (N,) s, increasing within each sequence."""
        return np.asarray(self.frames['time'])

    @property
    def slices(self) -> list[slice]:
        """The frames of each sequence."""
        starts, counts = self.sequences['start'].tolist(), self.sequences['count'].tolist()
        return [slice(s, s + c) for s, c in zip(starts, counts, strict=True)]

    def repeat_per_frame(self, per_sequence: NDArray[Any]) -> NDArray[Any]:
        """Repeat the value of each sequence (P, ...) for all its frames, which gives (N, ...)."""
        return np.asarray(np.repeat(per_sequence, self.sequences['count'], axis=0))

    def select(self, frames: NDArray[np.intp]) -> Batch:
        """Return the batch of some frames (M,), increasing, at least one of each sequence; changes count less."""
        counts = np.diff(np.searchsorted(frames, np.append(self.sequences['start'], len(self.frames))))
        batch = Batch(counts, self.theta.shape[1], self.has_lifted)
        batch.frames[:] = self.frames[frames]
        for name in ('unit', 'noise_ratio', 'earlier_frames', 'earlier_lengths'):
            batch.sequences[name] = self.sequences[name]
        batch.sequences['motion_share'] = self.sequences['motion_share'] * counts / self.sequences['count']
        batch.measure_least_noise()
        return batch

    def find_best_seen(self, step_s: float) -> NDArray[np.intp]:
        """Return the best-seen frame (M,) of every `step_s` of each sequence."""
        starts = self.sequences['start']
        sequence = self.repeat_per_frame(np.arange(len(starts)))
        part = np.floor((self.times - self.times[starts][sequence]) / step_s + 1e-6)
        order = np.lexsort((-self.frames['score'].sum(axis=1), part, sequence))
        is_best = np.diff(part[order], prepend=-1) != 0
        is_best[starts] = True
        return np.sort(order[is_best])

    def interpolate(self, state: State, frames: NDArray[np.intp]) -> State:
        """Interpolate the state of some frames (M,) in time to all frames, rotations at constant angular velocity.

        Frames outside those given have that of the nearest one of their sequence.
        """
        before, after = np.empty(len(self.times), np.intp), np.empty(len(self.times), np.intp)
        for own in self.slices:
            first, end = np.searchsorted(frames, (own.start, own.stop))
            every = np.arange(own.start, own.stop)
            after[own] = np.clip(np.searchsorted(frames, every), first, end - 1)
            before[own] = np.clip(np.searchsorted(frames, every, side='right') - 1, first, end - 1)
        t, t0, t1 = self.times, self.times[frames[before]], self.times[frames[after]]
        share = np.clip((t - t0) / np.maximum(t1 - t0, engine.MIN_TIME_STEP_S), 0.0, 1.0)
        a, b = state.select(before), state.select(after)
        turn = vector_from_rotation(b.rotation @ np.swapaxes(a.rotation, -1, -2))
        return State(
            a.theta + share[:, None] * (b.theta - a.theta),
            rotation_from_vector(share[:, None] * turn) @ a.rotation,
            a.log_scale + share * (b.log_scale - a.log_scale),
            a.translation + share[:, None] * (b.translation - a.translation),
        )
