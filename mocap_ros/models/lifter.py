"""From 2D joints to a 3D pose by a small network: a start and a prior for the factorisation.

The network (Martinez et al., "A simple yet effective baseline for 3D human pose estimation", ICCV 2017, here with
a history and its own uncertainty) sees a person's last 0.8 s at fixed times before the newest frame (`SLOTS`), to
which frames of any rate are interpolated, and gives the newest pose in the camera's frame. Image points enter
relative to the centre of each frame and in units of the window's mean distance from it; poses leave in that unit,
so that translation and scale are the caller's. Inference is NumPy alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros.geometry.virtual_camera import facing, turned_rays
from mocap_ros.skeleton import CMU15

Array = NDArray[np.float64]


Array32 = NDArray[np.float32]


SLOTS = np.array([0, 1, 2, 3, 4, 6, 8, 10, 13, 16, 20, 24]) / 30


LONGEST_BRIDGE = 0.15


SAME_TIME = 0.004


FARTHEST = 5.0


FARTHEST_POINT = 1e12


ANGULAR_UNIT = 0.1


LOG_SPREADS = -7.0, 1.0


JOINTS = len(CMU15.joints)


MIRROR = list(CMU15.mirror)


FEATURES = 3 * JOINTS * len(SLOTS) + 1


OUTPUTS = 5 * JOINTS


FEWEST_SEEN = 3


SMALLEST_SIZE = 1e-9


SIZE_TIME = 0.25


BONES_OVER_STATURE = 2.36


@dataclass(frozen=True, eq=False)
class Lifted:
    """3D poses of frames, camera optical frame's axes (x right, y down, z forward).

    Attributes:
        joints: (N, J, 3), each pose about the mean of its joints, in the unit of the image points at that depth;
            NaN where too little was seen.
        spread: (N, J, 3) standard deviations of the coordinates, same unit; those of x and y are one.
    """

    joints: Array
    spread: Array

    def take(self, frames: NDArray[np.intp] | slice) -> Lifted:
        """Those of these frames."""
        return Lifted(self.joints[frames], self.spread[frames])

    def times(self, factor: float) -> Lifted:
        """The same in another unit."""
        return Lifted(self.joints * factor, self.spread * factor)


def joined(parts: Sequence[Lifted]) -> Lifted:
    """Frames of all parts, one after the other."""
    return Lifted(np.concatenate([p.joints for p in parts]), np.concatenate([p.spread for p in parts]))


@dataclass(frozen=True, eq=False)
class Lifter:
    """The network, its batch norms folded into its layers.

    Attributes:
        layers: (in, out) weights and (out,) biases: the first, pairs that each make a residual block, the last.
        provenance: what it was trained on and how.
    """

    layers: tuple[tuple[Array32, Array32], ...]
    provenance: Mapping[str, object]

    def lift(self, points: Array, weight: Array, focal: float = float('inf'), *, mirrored: bool = True) -> Lifted:
        """Lift the newest of each history.

        Args:
            points: (N, T, J, 2) image points at the times `SLOTS` before the newest, joints as `skeleton.CMU15`;
                any unit, anything where the weight is 0.
            weight: (N, T, J) detector scores in [0, 1], 0 where not seen.
            focal: of the camera in the same unit, which looks at the person; infinite if unknown.
            mirrored: lift the mirror image as well and take the mean, which is better and takes longer.
        """
        turn = None
        if np.isfinite(focal):
            points, turn = faced(points, weight, focal)
        features, newest, size = featured(points, weight, focal)
        known = (features[:, 2 : 3 * JOINTS : 3] > 0).sum(axis=1) >= FEWEST_SEEN
        if mirrored:
            features = np.concatenate([features, mirror_features(features)])
        out = self.forward(features)
        joints = out[:, : 3 * JOINTS].reshape(-1, JOINTS, 3).astype(float)
        log_spread = out[:, 3 * JOINTS :].reshape(-1, JOINTS, 2).astype(float)
        if mirrored:
            count = len(newest)
            joints = (joints[:count] + joints[count:, MIRROR] * [-1, 1, 1]) / 2
            log_spread = (log_spread[:count] + log_spread[count:, MIRROR]) / 2
        joints[..., :2] += newest
        joints -= joints.mean(axis=1, keepdims=True)
        if turn is not None:
            joints = joints @ turn
        spread = np.exp(np.clip(log_spread, *LOG_SPREADS))
        unit = np.where(known, size, np.nan)[:, None, None]
        return Lifted(joints * unit, spread[..., [0, 0, 1]] * unit)

    def forward(self, features: Array32) -> Array32:
        """(N, FEATURES) -> (N, OUTPUTS): pose less the newest points, and logs of the spreads."""
        (first, bias), *hidden, (last, end) = self.layers
        x = np.maximum(features @ first + bias, 0)
        for (a, b), (c, d) in zip(hidden[::2], hidden[1::2], strict=True):
            x = x + np.maximum(np.maximum(x @ a + b, 0) @ c + d, 0)
        return np.asarray(x @ last + end)

    def lift_sequence(
        self, points: Array, weight: Array, times: Array, focal: float = float('inf'), *, mirrored: bool = True
    ) -> Lifted:
        """Lift every frame of a sequence, each from itself and those before it.

        Args:
            points: (F, J, 2), anything where the weight is 0.
            weight: (F, J).
            times: (F,) s, increasing.
            focal: as in `lift`.
            mirrored: as in `lift`.
        """
        return self.lift(*histories(points, weight, times, np.arange(len(times))), focal, mirrored=mirrored)


def faced(points: Array, weight: Array, focal: float) -> tuple[Array, Array]:
    """Histories as a camera sees them that faces the newest of each, as in training, and its rotations (N, 3, 3).

    Args:
        points: (N, T, J, 2), relative to the optical axis, anything where the weight is 0.
        weight: (N, T, J).
        focal: in the same unit.
    """
    seen = (weight > 0) & (np.abs(points) < FARTHEST_POINT).all(axis=-1)
    clean = np.where(seen[..., None], points, 0.0)
    trust = np.where(seen[:, 0], weight[:, 0], 0.0)
    total = np.maximum(trust.sum(axis=-1), SMALLEST_SIZE)[:, None]
    turn = facing(np.einsum('nj,njd->nd', trust, clean[:, 0]) / total / focal)
    return np.where(seen[..., None], focal * turned_rays(clean / focal, turn[:, None]), points), turn


def metric(lifted: Lifted, times: Array, height: float) -> Lifted:
    """Poses of a sequence in m, on the assumption that the person is `height` m tall.

    The image of somebody who comes nearer grows; what does not are the bones. So each frame is scaled by the
    lengths of its bones, averaged over about `SIZE_TIME` s before and after.

    Args:
        lifted: poses of one person, in px.
        times: (N,) s.
        height: m.
    """
    bones = CMU15.bone_lengths(lifted.joints).sum(axis=1)
    known = np.isfinite(bones)
    near = np.exp(-0.5 * ((times[:, None] - times[known]) / SIZE_TIME) ** 2) + SMALLEST_SIZE
    size = np.exp(near @ np.log(np.maximum(bones[known], SMALLEST_SIZE)) / near.sum(axis=1))
    factor = (BONES_OVER_STATURE * height / size)[:, None, None]
    return Lifted(lifted.joints * factor, lifted.spread * factor)


def histories(points: Array, weight: Array, times: Array, frames: NDArray[np.intp]) -> tuple[Array, Array]:
    """Points (N, T, J, 2) and weights (N, T, J) at `SLOTS` before some frames of a sequence.

    A joint is interpolated between neighbouring frames no more than `LONGEST_BRIDGE` s apart that both have it.

    Args:
        points: (F, J, 2), anything where the weight is 0.
        weight: (F, J).
        times: (F,) s, increasing.
        frames: (N,) indices.
    """
    weight = np.where(weight > 0, weight, 0.0)
    points = np.where(weight[..., None] > 0, points, 0.0)
    wanted = times[frames][:, None] - SLOTS
    after = np.minimum(times.searchsorted(wanted - SAME_TIME), frames[:, None])
    before = np.maximum(after - 1, 0)
    late, early = times[after] - wanted, wanted - times[before]
    share = early / np.maximum(late + early, SAME_TIME)
    share[late <= SAME_TIME] = 1.0
    share[np.abs(early) <= SAME_TIME] = 0.0
    exact = (share == 0) | (share == 1)
    fine = exact | ((share > 0) & (share < 1) & (late + early <= LONGEST_BRIDGE))
    share = share[..., None]
    w0, w1 = weight[before], weight[after]
    seen = fine[..., None] & ((w0 > 0) | (share == 1)) & ((w1 > 0) | (share == 0))
    mixed = np.where(seen, (1 - share) * w0 + share * w1, 0.0)
    share = share[..., None]
    between = (1 - share) * points[before] + share * points[after]
    return np.where(seen[..., None], between, 0.0), mixed


def featured(
    points: Array | Array32, weight: Array | Array32, focal: float | Array = float('inf')
) -> tuple[Array32, Array, Array]:
    """What the network is given.

    Args:
        points: (N, T, J, 2) as in `Lifter.lift`.
        weight: (N, T, J) as there.
        focal: as there, one or (N,).

    Returns:
        (N, FEATURES) features; (N, J, 2) newest points as the network sees them, 0 where not seen; (N,) the unit
        of these, in that of the points.
    """
    weight = np.where((np.abs(points) < FARTHEST_POINT).all(axis=-1) & (weight > 0), np.minimum(weight, 1), 0)
    seen = weight > 0
    clean = np.where(seen[..., None], points, 0)
    total = np.maximum(weight.sum(axis=-1, keepdims=True), SMALLEST_SIZE)
    centre = np.einsum('ntj,ntjd->ntd', weight, clean) / total
    centred = np.where(seen[..., None], clean - centre[:, :, None], 0)
    distance = np.sqrt(np.einsum('ntjd,ntjd->ntj', centred, centred))
    size = (weight * distance).sum(axis=(1, 2)) / np.maximum(weight.sum(axis=(1, 2)), SMALLEST_SIZE)
    size = np.where(size > 0, size, 1.0)
    relative = np.clip(centred / size[:, None, None, None], -FARTHEST, FARTHEST)
    features = np.empty((len(points), FEATURES), np.float32)
    block = features[:, :-1].reshape(*weight.shape, 3)
    block[..., :2] = relative
    block[..., 2] = weight
    features[:, -1] = np.minimum(size / focal / ANGULAR_UNIT, FARTHEST)
    return features, relative[:, 0], size


def mirror_features(features: Array32) -> Array32:
    """The features of the person in a mirror."""
    out = np.empty_like(features)
    block = features[:, :-1].reshape(len(features), -1, JOINTS, 3)
    out[:, :-1] = (block[:, :, MIRROR] * np.array([-1, 1, 1], np.float32)).reshape(len(features), -1)
    out[:, -1] = features[:, -1]
    return out
