"""Training examples for the lifter: motion capture, seen by random cameras and by a detector that errs.

Poses in m, z up; images in m at the body, which is the unit the errors below are in.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros.models.lifter import JOINTS, LONGEST_BRIDGE, MIRROR, SLOTS, featured
from mocap_ros.skeleton import CMU15

Array = NDArray[np.float32]
Array64 = NDArray[np.float64]

FPS = 30
SPEEDS = {1.0: 0.5, -1.0: 0.15, 0.75: 0.15, 1.35: 0.2}
BONE_SPREAD = 0.07

_BACK = np.round(SLOTS * FPS).astype(int)
_HIDDEN_AT_ONCE = ('larm', 'rarm', 'lleg', 'rleg', 'legs', 'arms')
_LIMBS = {
    'larm': ('lelbow', 'lwrist'),
    'rarm': ('relbow', 'rwrist'),
    'lleg': ('lknee', 'lankle'),
    'rleg': ('rknee', 'rankle'),
    'lforearm': ('lwrist',),
    'rforearm': ('rwrist',),
    'lshank': ('lankle',),
    'rshank': ('rankle',),
    'head': ('head',),
}
_BORROWED = {'arms': 0.25, 'larm': 0.12, 'lleg': 0.04, 'legs': 0.12}
_OFFSETS = {  # m, standard deviations forward, sideways, up, of what a detector takes for the joint
    'head': (0.05, 0.01, 0.05),
    'neck': (0.02, 0.005, 0.03),
    'pelvis': (0.03, 0.005, 0.03),
    'hip': (0.02, 0.03, 0.03),
    'shoulder': (0.02, 0.02, 0.02),
    'elbow': (0.01, 0.01, 0.015),
    'wrist': (0.015, 0.01, 0.015),
    'knee': (0.015, 0.015, 0.015),
    'ankle': (0.015, 0.015, 0.02),
}


def _joints(*names: str) -> list[int]:
    return [CMU15.index(n) for n in names]


def _limb(name: str) -> list[int]:
    if name in ('legs', 'arms'):
        return _limb('l' + name[:-1]) + _limb('r' + name[:-1])
    return _joints(*_LIMBS[name])


def _tree() -> Array:
    """(J, J) joints from the vectors that end in them."""
    out = np.eye(JOINTS, dtype=np.float32)
    for parent, child in CMU15.outward():
        out[child] += out[parent]
    return out


@dataclass(frozen=True, eq=False)
class Motions:
    """All training motion in one array.

    Attributes:
        vectors: (N, J, 3) from each joint's parent to it, the root's zero.
        first: (N,) index of the first frame of the trial of each.
        chance: (N,) cumulative probability of each to be the newest of an example.
    """

    vectors: Array
    first: NDArray[np.intp]
    chance: Array64

    @staticmethod
    def of(trials: Sequence[Array64]) -> Motions:
        """Trials (F, J, 3) in m, z up, 30 a second; played at several speeds, also backwards."""
        parents = np.array([max(p, 0) for p in CMU15.parents])
        root = CMU15.parents.index(-1)
        parents[root] = root
        vectors, first, chance, count = [], [], [], 0
        for trial in trials:
            for speed, share in SPEEDS.items():
                at = np.arange(0, len(trial) - 1 + 1e-9, abs(speed))
                low = np.minimum(at.astype(int), max(len(trial) - 2, 0))
                high = np.minimum(low + 1, len(trial) - 1)
                poses = trial[low] + (at - low)[:, None, None] * (trial[high] - trial[low])
                poses = poses[::-1] if speed < 0 else poses
                vectors.append((poses - poses[:, parents]).astype(np.float32))
                first.append(np.full(len(poses), count))
                chance.append(np.full(len(poses), share * np.sqrt(len(trial)) / len(poses)))
                count += len(poses)
        total = np.cumsum(np.concatenate(chance))
        return Motions(np.concatenate(vectors), np.concatenate(first), total / total[-1])


@dataclass(frozen=True, eq=False)
class Batch:
    """Examples.

    Attributes:
        features: (N, FEATURES); newest: (N, J, 2), as `lifter.featured` gives them.
        target: (N, J, 3) pose about the mean of its joints, in the unit of the features.
        size: (N,) m, that unit.
    """

    features: Array
    newest: Array
    target: Array
    size: Array


class Synthesis:
    """An endless stream of examples from a seed."""

    def __init__(self, motions: Motions, seed: int) -> None:
        self.motions = motions
        self.rng = np.random.Generator(np.random.SFC64(seed))
        self.tree = _tree()
        self.gaps = _gap_patterns(self.rng, 512)

    def batch(self, count: int) -> Batch:
        """So many examples."""
        vectors, known = self._motion(count)
        vectors = self._other_bodies(vectors)
        points = self.tree @ vectors  # (N, T, J, 3)
        seen_at = points + self._offsets(points)
        view = self._cameras(count)
        shown = _turned(seen_at, view)
        truth = shown[:, 0].copy()
        midline = _joints('head', 'neck', 'pelvis')
        truth[:, midline] = _turned(points[:, :1], view[:, :1])[:, 0, midline]
        image, focal = self._projected(shown)
        image, weight = self._detected(image, known)
        features, newest, size = featured(image, weight, focal)
        target = (truth - truth.mean(axis=1, keepdims=True)) / size[:, None, None]
        return Batch(features, newest.astype(np.float32), target.astype(np.float32), size.astype(np.float32))

    def _some(self, count: int, share: float, *more: int) -> NDArray[np.bool_]:
        """True for a share of the examples; (N, 1, ...) to go with `more` axes."""
        return (self.rng.random(count) < share).reshape(count, *(1,) * len(more))

    def _uniform(self, low: float, high: float, *shape: int) -> Array:
        return np.float32(low) + np.float32(high - low) * self.rng.random(shape, dtype=np.float32)

    def _either(self, count: int, share: float, value: float, other: float, *more: int) -> Array:
        """One value in a share of the examples, another in the rest."""
        return np.where(self._some(count, share, *more), np.float32(value), np.float32(other))

    def _normal(self, *shape: int) -> Array:
        return self.rng.standard_normal(shape, dtype=np.float32)

    def _motion(self, count: int) -> tuple[Array, NDArray[np.bool_]]:
        """(N, T, J, 3) vectors facing +x in the newest frame, and (N, T) whether there was a frame so long ago."""
        newest = np.searchsorted(self.motions.chance, self.rng.random(count))
        index = newest[:, None] - _BACK
        first = self.motions.first[newest][:, None]
        vectors = self.motions.vectors[np.maximum(index, first)]
        flipped = self._some(count, 0.5, 1, 1, 1)
        vectors = np.where(flipped, vectors[:, :, MIRROR] * np.array([1, -1, 1], np.float32), vectors)
        poses = self.tree @ vectors[:, 0]
        left, right = (list(side) for side in zip(*CMU15.pairs, strict=True))
        trunk = [left.index(j) for j in _joints('lhip', 'lshoulder')]
        across = (poses[:, left] - poses[:, right])[:, trunk].sum(axis=1)
        x, y = across[:, 0], across[:, 1]
        yaw = np.pi / 2 - np.arctan2(y, x)
        return _turned(vectors, _about(2, yaw)[:, None]), index >= first

    def _other_bodies(self, vectors: Array) -> Array:
        """Other bone lengths, limbs of another example, limbs held differently, and the whole tilted."""
        count = len(vectors)
        factor = 1 + np.float32(BONE_SPREAD) * np.clip(self._normal(count, 1, JOINTS, 1), -2.5, 2.5)
        twins = np.minimum(np.arange(JOINTS), MIRROR)
        vectors = vectors * factor[:, :, twins]
        other = np.roll(vectors, 1, axis=0)
        for limbs, share in _BORROWED.items():
            ends = _limb(limbs)
            lengths = np.linalg.norm(vectors[:, :1, ends], axis=-1, keepdims=True)
            theirs = other[:, :, ends] * lengths / np.linalg.norm(other[:, :1, ends], axis=-1, keepdims=True)
            vectors[:, :, ends] = np.where(self._some(count, share, 1, 1, 1), theirs, vectors[:, :, ends])
        for limb in _LIMBS:
            some = self._some(count, 0.25)
            which = np.flatnonzero(some)
            turn = _rotations(np.float32(0.25) * self._normal(len(which), 3))
            vectors[which[:, None], :, _limb(limb)] = np.moveaxis(
                _turned(vectors[which][:, :, _limb(limb)], turn[:, None]), 2, 1
            )
        tilt = self._either(count, 0.06, 0.5, 0.05, 1) * self._normal(count, 3)
        return _turned(vectors, _rotations(tilt)[:, None])

    def _offsets(self, points: Array) -> Array:
        """(N, 1, J, 3) from where motion capture has joints to where a detector does, alike on both sides."""
        count = len(points)
        out = np.zeros((count, 1, JOINTS, 3), np.float32)
        for name, spread in _OFFSETS.items():
            offset = np.array(spread, np.float32) * self._normal(count, 3)
            if name in CMU15.joints:
                out[:, 0, CMU15.index(name)] = offset
            else:
                out[:, 0, CMU15.index('l' + name)] = offset
                out[:, 0, CMU15.index('r' + name)] = offset * np.array([1, -1, 1], np.float32)
        return np.where(self._some(count, 0.6, 1, 1, 1), out, np.float32(0))

    def _cameras(self, count: int) -> Array:
        """(N, T, 3, 3) rotations from the body's frame to the camera's, some of them slowly turning."""
        ago = SLOTS.astype(np.float32)
        turning = self._either(count, 0.3, 1, 0, 1) * ago
        heading = self._uniform(-np.pi, np.pi, count, 1) + 0.4 * self._normal(count, 1) * turning
        elevation = np.radians(self._uniform(-15, 35, count, 1)) + 0.1 * self._normal(count, 1) * turning
        roll = np.radians(7) * np.broadcast_to(self._normal(count, 1), heading.shape)
        to_optical = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]], np.float32)
        return np.asarray(_about(2, roll) @ _about(0, elevation) @ to_optical @ _about(2, heading))

    def _projected(self, shown: Array) -> tuple[Array, Array64]:
        """(N, T, J, 2) image, and (N,) focal lengths as known to the lifter."""
        count = len(shown)
        relative = shown - shown[:, :1].mean(axis=2, keepdims=True)
        flat = self._some(count, 0.35, 1)
        near = self._uniform(1.6, 7.0, count, 1)
        approach = self._either(count, 0.3, 0.8, 0, 1) * self._normal(count, 1)
        distance = np.maximum(near + approach * SLOTS.astype(np.float32), np.float32(1.2))[..., None]
        aside = self._either(count, 0.3, 0.2, 0.03, 1) * near * self._normal(count, 2)
        depth = np.maximum((distance + relative[..., 2]) / near[..., None], np.float32(0.2))
        depth = np.where(flat[..., None], np.float32(1), depth)
        image = (relative[..., :2] + aside[:, None, None]) / depth[..., None]
        focal = np.where(flat[:, 0] | self._some(count, 0.4), np.inf, near[:, 0])
        return image, focal

    def _detected(self, image: Array, known: NDArray[np.bool_]) -> tuple[Array, Array]:
        """What a detector makes of it: (N, T, J, 2) points and (N, T, J) scores, 0 where not seen."""
        count, slots = image.shape[:2]
        rng = self.rng
        sure = self._some(count, 0.35, 1, 1)
        base = self._uniform(0.4, 0.95, count, 1, 1)
        doubt = base + 0.15 * self._normal(count, 1, JOINTS) + 0.08 * self._normal(count, slots, JOINTS)
        lapse = self._spans(count, slots) & self._some(count, 0.2, 1, 1) & (rng.random((count, 1, JOINTS)) < 0.2)
        doubt = np.where(lapse, np.float32(0.35) * doubt, doubt)
        score = np.clip(doubt, np.float32(0.05), np.float32(1))
        honest = self._uniform(0, 1.5, count, 1, 1)
        level = np.exp(self._uniform(np.log(0.003), np.log(0.03), count, 1, 1))
        level = level * self._either(count, 0.4, 0, 1, 1, 1) * np.exp(0.4 * self._normal(count, 1, JOINTS))
        level = level * np.exp(-honest * np.log(score))
        slow = self._normal(count, 1, JOINTS, 2)
        slow = slow + SLOTS.astype(np.float32)[:, None, None] / 0.4 * self._normal(count, 1, JOINTS, 2)
        noise = 0.75 * self._normal(count, slots, JOINTS, 2) + 0.5 * slow
        gross = rng.random((count, slots, JOINTS), dtype=np.float32) < 0.01
        wrong = gross | (lapse & self._some(count, 0.5, 1, 1))
        image = image + level[..., None] * noise
        there = np.nonzero(wrong)
        where = self._normal(count, JOINTS, 2)[there[0], there[2]]
        jitter = np.where(gross[there], np.float32(0.15), np.float32(0.03))[:, None]
        image[there] += 0.12 * where + jitter * noise[there]
        score = np.where(sure, np.float32(1), score)
        image, score = self._swapped(image, score)
        score = np.where(self._hidden(image, known), 0, score)
        return self._interpolated(image, score)

    def _spans(self, count: int, slots: int) -> NDArray[np.bool_]:
        """(N, T, 1) a stretch of frames that begins anywhere."""
        first = self.rng.integers(-4, slots, (count, 1))
        length = self.rng.integers(1, 9, (count, 1))
        slot = np.arange(slots)
        return ((slot >= first) & (slot < first + length))[..., None]

    def _swapped(self, image: Array, score: Array) -> tuple[Array, Array]:
        """Left and right exchanged for a while, everywhere or in the legs or the arms."""
        count, slots = score.shape[:2]
        parts = np.zeros((3, JOINTS), bool)
        parts[0] = True
        parts[1, [*_limb('legs'), *_joints('lhip', 'rhip')]] = True
        parts[2, [*_limb('arms'), *_joints('lshoulder', 'rshoulder')]] = True
        part = parts[np.minimum(self.rng.integers(0, 5, count) % 5, 2)]
        where = self._spans(count, slots) & self._some(count, 0.2, 1, 1) & part[:, None]
        image = np.where(where[..., None], image[:, :, MIRROR], image)
        return image, np.where(where, score[:, :, MIRROR], score)

    def _hidden(self, image: Array, known: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """(N, T, J) points not seen: here and there, limbs, the joints detectors lack, beyond a border."""
        count, slots = known.shape
        rate = self._either(count, 0.6, 0, 0.25, 1, 1) * self._uniform(0, 1, count, 1, 1)
        hidden = self.rng.random((count, slots, JOINTS), dtype=np.float32) < rate
        hidden |= ~known[..., None]
        limb = np.zeros((len(_HIDDEN_AT_ONCE), JOINTS), bool)
        for i, name in enumerate(_HIDDEN_AT_ONCE):
            limb[i, _limb(name)] = True
        which = limb[self.rng.integers(0, len(limb), count)]
        away = np.arange(slots)[None] < self.rng.integers(1, 2 * slots, (count, 1))
        hidden |= (which & self._some(count, 0.12, 1))[:, None] & away[..., None]
        lacking = np.zeros((count, JOINTS), bool)
        lacking[:, _joints('head', 'neck', 'pelvis')] = self.rng.random((count, 3)) < 0.2
        lacking[:, _joints('head', 'neck', 'pelvis')] |= self._some(count, 0.12, 1)
        hidden |= lacking[:, None]
        direction = self.rng.integers(0, 3, count)
        normal = np.array([[0, 1], [1, 0], [-1, 0]], np.float32)[direction]
        border = self._uniform(0.0, 0.8, count, 1, 1)
        middle = image[:, :1].mean(axis=2, keepdims=True)
        beyond = np.einsum('ntjd,nd->ntj', image - middle, normal) > border
        hidden |= beyond & self._some(count, 0.1, 1, 1)
        hidden[:, 0] &= ((~hidden[:, 0]).sum(axis=1) >= 5)[:, None] | ~known[:, :1]
        return np.asarray(hidden)

    def _interpolated(self, image: Array, score: Array) -> tuple[Array, Array]:
        """Frames left out, and the slots between those that are left interpolated as `lifter.histories` does."""
        gaps = self.gaps[self.rng.integers(0, len(self.gaps), len(image))]
        count, slots = score.shape[:2]
        seen = gaps @ (score > 0) > 1 - 1e-4
        mixed = gaps @ image.reshape(count, slots, -1)
        return mixed.reshape(image.shape), np.where(seen, gaps @ score, 0).astype(np.float32)


def _gap_patterns(rng: np.random.Generator, count: int) -> Array:
    """(count, T, T) maps from slots to slots when only some of them had a frame; the newest always has one."""
    slots = len(SLOTS)
    out = np.zeros((count, slots, slots), np.float32)
    for i, pattern in enumerate(out):
        kind = rng.random()
        kept = np.ones(slots, bool)
        if kind > 0.55:
            kept = rng.random(slots) > rng.uniform(0.1, 0.7)
        if kind > 0.7:
            kept = np.arange(slots) < rng.integers(1, slots)
        if kind > 0.85:
            grid = np.arange(0, 1, rng.uniform(0.06, 0.2)) + rng.uniform(-0.01, 0.01)
            kept = np.isin(np.arange(slots), np.abs(SLOTS[:, None] - grid).argmin(axis=0))
        if i < 20:
            kept = np.arange(slots) < 1
        kept[0] = True
        left = np.flatnonzero(kept)
        for slot in range(slots):
            newer, older = left[left <= slot][-1], left[left >= slot][:1]
            if kept[slot]:
                pattern[slot, slot] = 1
            elif len(older) and SLOTS[older[0]] - SLOTS[newer] <= LONGEST_BRIDGE:
                share = (SLOTS[slot] - SLOTS[newer]) / (SLOTS[older[0]] - SLOTS[newer])
                pattern[slot, newer], pattern[slot, older[0]] = 1 - share, share
    return out


def _turned(points: Array, rotation: Array) -> Array:
    """(N, T, J, 3) points turned by (N, T or 1, 3, 3)."""
    if rotation.shape[1] == 1:
        count, slots, joints, _ = points.shape
        flat = points.reshape(count, slots * joints, 3) @ np.swapaxes(rotation[:, 0], -1, -2)
        return np.asarray(flat.reshape(count, slots, joints, 3))
    return np.asarray(points @ np.swapaxes(rotation, -1, -2))


def _about(axis: int, angle: Array | Array64) -> Array:
    """(..., 3, 3) rotations about a coordinate axis."""
    c, s = np.cos(angle), np.sin(angle)
    out = np.zeros((*np.shape(angle), 3, 3), np.float32)
    a, b = (axis + 1) % 3, (axis + 2) % 3
    out[..., axis, axis] = 1
    out[..., a, a], out[..., a, b], out[..., b, a], out[..., b, b] = c, -s, s, c
    return out


def _rotations(vector: Array) -> Array:
    """(N, 3, 3) of rotation vectors (N, 3), by Rodrigues' formula."""
    angle = np.maximum(np.linalg.norm(vector, axis=-1), 1e-6)[:, None, None]
    x, y, z = (vector / angle[:, 0]).T
    o = np.zeros_like(x)
    cross = np.stack([np.stack(r, -1) for r in ((o, -z, y), (z, o, -x), (-y, x, o))], -2)
    return np.asarray(np.eye(3, dtype=np.float32) + np.sin(angle) * cross + (1 - np.cos(angle)) * (cross @ cross))
