"""The keyframes of a sequence, whatever its length (Loy et al. 2004, section 4).

Up to `largest` frames the distance matrix is whole and the choice is the paper's. A longer sequence is taken
section by section: keyframes found so far come first, by their distances to the section's frames, and the section
then adds what it needs. Memory is bounded by the section; what is lost is that a later keyframe cannot replace
earlier ones, and that a matrix is de-noised within its section alone, a keyframe from before by the mean pose of
the frames near it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import KeyframesConfig
from mocap_ros.offline.keyframes.body_halves import Half, HalfPoses
from mocap_ros.offline.keyframes.distance import averaging, denoised, distances
from mocap_ros.offline.keyframes.selection import interpolatable, select

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Keyframes:
    """The keyframes of one half of the body.

    Attributes:
        half: of the body.
        frames: (K,) of the sequence, in the order in which they were chosen.
        nearest: (F,) index into `frames` of the keyframe nearest to each frame; -1 where too little is seen.
        distance: (F,) torso lengths, to that keyframe; infinite where there is none.
        well: (F,) frames that it represents well.
        covered: (F,) well represented or interpolatable.
        seen: (F,) frames with a pose of this half.
        matrix: (N, N) the distance matrix of the first `largest` frames that have a pose, torso lengths.
        matrix_frames: (N,) those frames.
    """

    half: Half
    frames: Indices
    nearest: Indices
    distance: Array
    well: Mask
    covered: Mask
    seen: Mask
    matrix: Array32
    matrix_frames: Indices

    @property
    def coverage(self) -> float:
        """Share of the frames with a pose that are covered (eq. 1)."""
        return float(self.covered.sum() / max(self.seen.sum(), 1))

    @property
    def by_time(self) -> Indices:
        """(K,) which keyframe comes first in the sequence, which next, and so on."""
        return np.argsort(self.frames, kind='stable')

    def spans(self, key: int) -> list[tuple[int, int]]:
        """First and last frame of every run of frames that a keyframe represents well."""
        at = np.flatnonzero(self.assigned == key)
        runs = np.split(at, np.flatnonzero(np.diff(at) > 1) + 1) if len(at) else []
        return [(int(run[0]), int(run[-1])) for run in runs]

    @property
    def assigned(self) -> Indices:
        """(F,) the keyframe that represents each frame well, -1 where none does."""
        return np.where(self.well, self.nearest, -1)


def summarised(
    poses: HalfPoses,
    half: Half,
    frames: int,
    rules: KeyframesConfig,
    progress: Callable[[int], None] = lambda _: None,
) -> Keyframes:
    """The keyframes of one half.

    Args:
        poses: of the frames in which it is seen.
        half: of the body.
        frames: of the sequence.
        rules: `beta`, `alpha`, `gap` and `largest` apply.
        progress: told how many more frames are done.
    """
    if not len(poses):
        return _none(half, frames)
    parts = np.array_split(np.arange(len(poses)), max(-(-len(poses) // rules.max_matrix_frames), 1))
    chosen: list[Indices] = []
    means: HalfPoses | None = None
    nearest, distance = np.full(len(poses), -1), np.full(len(poses), np.inf, np.float32)
    first = np.zeros((0, 0), np.float32)
    largest: float | None = None
    for part in parts:
        own = poses.take(part)
        c, most = distances(own, own, largest)
        largest = most if largest is None else largest
        near = averaging(c, rules.beta)
        matrix = denoised(c, near)
        np.fill_diagonal(matrix, 0.0)
        rows = matrix[:0]
        if means is not None and len(means):
            rows = denoised(distances(means, own, largest)[0], near)
        well = np.asarray((rows < rules.beta).any(axis=0))
        selection = select(matrix < rules.beta, own.times, rules.alpha, rules.gap, well)
        keys = selection.keyframes
        chosen.append(part[keys])
        rows = np.concatenate([rows, matrix[keys]])
        if len(rows):
            nearest[part] = rows.argmin(axis=0)
            distance[part] = rows.min(axis=0)
        means = joined(means, averaged(own, near[keys], keys))
        first = first if len(first) else matrix
        progress(len(part))
    keyframes = np.concatenate(chosen)
    well = distance < rules.beta
    covered = well | interpolatable(well, poses.times, rules.gap)
    at = poses.frames

    everywhere = np.full(frames, -1)
    everywhere[at] = nearest
    far = np.full(frames, np.inf)
    far[at] = distance

    def among(chosen: Mask) -> Mask:
        out = np.zeros(frames, bool)
        out[at] = chosen
        return out

    return Keyframes(
        half=half,
        frames=at[keyframes],
        nearest=everywhere,
        distance=far,
        well=among(well),
        covered=among(covered),
        seen=among(np.ones(len(poses), bool)),
        matrix=first,
        matrix_frames=at[: len(first)],
    )


def _none(half: Half, frames: int) -> Keyframes:
    """Of a half that is never seen."""
    no, nowhere = np.zeros(frames, bool), np.full(frames, np.inf)
    empty = np.zeros(0, int)
    return Keyframes(half, empty, np.full(frames, -1), nowhere, no, no, no, np.zeros((0, 0), np.float32), empty)


def averaged(poses: HalfPoses, near: Array32, keys: Indices) -> HalfPoses:
    """The mean pose of the frames near each of some keyframes; near (K, N) rows of `averaging`.

    Joints that the keyframe does not have stay unknown.
    """
    weight = near[..., None] * poses.seen
    seen = poses.seen.astype(np.float32)
    middle = (seen[..., None] * poses.points).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)[:, None]
    centred = poses.points - middle[:, None]
    total = np.maximum(weight.sum(axis=1), 1e-9)
    mean = np.einsum('knj,njd->kjd', weight, centred) / total[..., None]
    return HalfPoses(poses.frames[keys], poses.times[keys], mean.astype(np.float32), poses.seen[keys])


def joined(before: HalfPoses | None, after: HalfPoses) -> HalfPoses:
    """Both sets of poses, one after the other."""
    if before is None:
        return after
    return HalfPoses(
        *(np.concatenate([getattr(p, k) for p in (before, after)]) for k in ('frames', 'times', 'points', 'seen'))
    )
