# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What the joint solver is given: sequences of any number of people and hypotheses, one after the other.

Throughout the joint solver N is the number of frames of the whole batch, P the number of its sequences, J of
joints, B of bones, K of base poses, and n = K + 4 the number of unknowns of a frame. Image lengths are divided by
the sequence's unit in px/m, so that they are metres at the body.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.errors import InputError
from mocap_ros.geometry.rotations import rotation_from_vector, vector_from_rotation
from mocap_ros.models.base_poses import BasePoses, arrange_model
from mocap_ros.solvers.joint.differences import MIN_TIME_STEP_S
from mocap_ros.solvers.window import InitialValues, Window

MIN_STD_M = 0.01  # m; a smaller standard deviation of the lifter is not believed: its poses are no better
MIN_TOTAL_WEIGHT = 1e-12  # guards the division by the weights of a frame in which no joint is seen


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


@dataclass(frozen=True, eq=False)
class Batch:
    """The measurements of all frames, and which of them belong to which sequence."""

    times: Array  # (N,) s, increasing within each sequence
    starts: NDArray[np.int64]  # (P,) index of the first frame of each sequence
    counts: NDArray[np.int64]  # (P,) number of frames of each sequence
    image: Array  # (N, J, 2) m, image points
    score: Array  # (N, J) confidence scores
    focal: Array  # (N,) m, focal length; infinite for weak perspective
    is_free: NDArray[np.bool_]  # (N,) False for first frames of a sequence that keep their initial values
    lifted: Array  # (N, J, 3) m, lifted poses about the mean of the joints; (0, J, 3) where there are none
    precision: Array  # (N, J, 3) 1/m^2, inverse variances of these coordinates; 0 where nothing is known
    earlier_lengths: Array  # (P, B) m, mean bone lengths of the frames before each window
    earlier_frames: NDArray[np.int64]  # (P,) number of those frames

    @staticmethod
    def build(windows: Sequence[Window], units: Array, model: BasePoses) -> Batch:
        """Return the batch of these windows, of which all frames are free, with their units (P,) px/m.

        Raises:
            InputError: only some of the windows have lifted poses.
        """
        counts = np.array([len(w.times) for w in windows])
        per_frame = np.repeat(units, counts)
        poses = [w.lifted for w in windows if w.lifted is not None]
        lifted = precision = np.zeros((0, len(model.mean), 3))
        if poses:
            if len(poses) < len(windows):
                raise InputError('some windows of the batch have lifted poses and some have not')
            joints, std = (
                np.concatenate(arrays) for arrays in zip(*((p.joints, p.std) for p in poses), strict=True)
            )
            is_known = np.isfinite(joints)
            lifted = np.where(is_known, joints, 0.0) / per_frame[:, None, None]
            precision = is_known / np.maximum(std / per_frame[:, None, None], MIN_STD_M) ** 2
            precision[~is_known] = 0.0
        return Batch(
            times=np.concatenate([w.times for w in windows]),
            starts=np.cumsum(counts) - counts,
            counts=counts,
            image=np.concatenate([w.points for w in windows]) / per_frame[:, None, None],
            score=np.concatenate([w.weight for w in windows]),
            focal=np.repeat([w.focal for w in windows], counts) / per_frame,
            is_free=np.ones(counts.sum(), bool),
            lifted=lifted,
            precision=precision,
            earlier_lengths=np.tile(arrange_model(model).mean_bone_lengths, (len(windows), 1)),
            earlier_frames=np.zeros(len(windows), np.int64),
        )

    @property
    def slices(self) -> list[slice]:
        """The frames of each sequence."""
        return [slice(s, s + c) for s, c in zip(self.starts.tolist(), self.counts.tolist(), strict=True)]

    def repeat_per_frame(self, per_sequence: NDArray[Any]) -> NDArray[Any]:
        """Repeat the value of each sequence (P, ...) for all its frames, which gives (N, ...)."""
        return np.asarray(np.repeat(per_sequence, self.counts, axis=0))

    def select(self, frames: NDArray[np.intp]) -> Batch:
        """Return the batch of some frames (M,), increasing, at least one of each sequence."""
        counts = np.diff(np.searchsorted(frames, np.append(self.starts, len(self.times))))
        has_lifted = len(self.lifted) > 0
        return replace(
            self,
            times=self.times[frames],
            starts=np.cumsum(counts) - counts,
            counts=counts,
            image=self.image[frames],
            score=self.score[frames],
            focal=self.focal[frames],
            is_free=self.is_free[frames],
            lifted=self.lifted[frames] if has_lifted else self.lifted,
            precision=self.precision[frames] if has_lifted else self.precision,
        )

    def find_best_seen(self, step_s: float) -> NDArray[np.intp]:
        """Return the best-seen frame (M,) of every `step_s` of each sequence."""
        sequence = np.repeat(np.arange(len(self.starts)), self.counts)
        part = np.floor((self.times - self.times[self.starts][sequence]) / step_s + 1e-6)
        order = np.lexsort((-self.score.sum(axis=1), part, sequence))
        is_best = np.diff(part[order], prepend=-1) != 0
        is_best[self.starts] = True
        return np.sort(order[is_best])

    def initial_state(self, starts: Sequence[InitialValues], units: Array) -> State:
        """Return the state at these starts, translations being the weighted centroids of the points."""
        total = np.maximum(self.score.sum(axis=1), MIN_TOTAL_WEIGHT)[:, None]
        return State(
            np.concatenate([s.theta for s in starts]),
            np.concatenate([s.cameras.rotation for s in starts]),
            np.log(np.concatenate([s.cameras.scale for s in starts]) / self.repeat_per_frame(units)),
            (self.score[..., None] * self.image).sum(axis=1) / total,
        )

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
        share = np.clip((t - t0) / np.maximum(t1 - t0, MIN_TIME_STEP_S), 0.0, 1.0)
        a, b = state.select(before), state.select(after)
        turn = vector_from_rotation(b.rotation @ np.swapaxes(a.rotation, -1, -2))
        return State(
            a.theta + share[:, None] * (b.theta - a.theta),
            rotation_from_vector(share[:, None] * turn) @ a.rotation,
            a.log_scale + share * (b.log_scale - a.log_scale),
            a.translation + share[:, None] * (b.translation - a.translation),
        )
