# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Synthetic errors of a 2D keypoint detector, for training examples.

    x'_tj = x_tj + k_j (s_tj / s_0)^-e (c_j + g z_tj + h n_tj) + a_tj
    z_t = r z_t-1 + sqrt(1 - r^2) n'_t,    r = exp(-dt / tau)

c_j is constant over the history (this camera, this posture), z wanders slowly, n is new at every time, k_j differs
between joints, and a_tj is large where a joint is lost for a while. s is the confidence score and s_0 the score of
a joint that is seen well. What is fixed to the body is in `synthesis.py`.

Image points are in metres at the person's distance. Shapes: N examples, T slots of the history (newest first),
J joints of `skeleton.BODY26`.

The errors are of the kinds that OpenPose, MediaPipe and MoveNet make on recordings with known 3D joints. Each
magnitude is drawn for every example from a range that is wide enough for other detectors, too. Shares are shares
of the examples unless noted.
"""

from __future__ import annotations

import numpy as np

from mocap_ros.engine import rays as engine
from mocap_ros.keypoints.joint_map import build_joint_map
from mocap_ros.models.lifter_input import HISTORY_SLOTS_S, JOINT_COUNT, MAX_INTERPOLATION_GAP_S, MIRROR_PERMUTATION
from mocap_ros.skeleton import BODY26, CMU15, CORE_COUNT
from mocap_ros.training.example_arrays import AGO, Array, Bools, RandomArrays, read_table
from mocap_ros.training.postures import FACE, FEET, HANDS, joint_indices, limb_indices

# Confidence scores.
CONSTANT_SCORE_SHARE = 0.25  # share; scores that are all 1, from detectors whose scores carry no information
GOOD_SCORE_RANGE = (0.45, 1.0)  # 1, score of a joint that is seen well; detectors differ in their scale
JOINT_SCORE_STD = 0.08  # 1, standard deviation of the score between joints of an example
MAX_FRAME_SCORE_STD = 0.1  # 1, largest standard deviation of the score of a joint between frames
MIN_SCORE = 0.03  # 1; joints that are seen have no lower score
MAX_SCORE_EXPONENT = 1.3  # 1, largest e; errors at the lowest scores are 1 to 5 times those at good ones
MAX_ERROR_FACTOR = 5.0  # 1; bounds the growth of the errors at low scores

# Dim joints: their score is low for a while, most often that of arms on the far side of the body.
MAX_DIM_SHARE = 0.6  # share of the time in which a wrist is dim, uniform from 0
DIM_TIME_RANGE_S = (0.3, 1.5)  # s, mean length of such a time, log-uniform
NEAR_SIDE_FACTOR, FAR_SIDE_FACTOR = 0.5, 1.5  # 1, on this share for the nearer and the farther of two joints

# Position errors: standard deviations at a good score, log-uniform.
CONSTANT_RANGE_M = (0.004, 0.035)  # m, of the part that is constant over the history
WANDER_RANGE_M = (0.003, 0.04)  # m, of the part that wanders
WANDER_TIME_RANGE_S = (0.08, 1.5)  # s, time constant tau of the wandering part, log-uniform
WHITE_RANGE_M = (0.002, 0.035)  # m, of the part that is new in every frame
JOINT_NOISE_LOG_STD = 0.3  # 1, standard deviation of the logarithm of k_j; makes heavy tails
# Of each joint: standard deviations in m of its offset in `synthesis`, which is fixed to the body, and factors on
# the errors, on the share of lost joints and on that of dim joints.
JOINTS = """
joint     forward  sideways  up     errors  lost  dim
head      0.05     0.01      0.05   0.9     0.25  0.1
neck      0.02     0.005     0.03   0.9     0.25  0.1
pelvis    0.03     0.005     0.03   0.9     0.25  0.1
hip       0.02     0.025     0.03   0.9     0.25  0.1
shoulder  0.02     0.02      0.02   0.9     0.25  0.1
elbow     0.018    0.018     0.018  1.1     0.6   1.0
wrist     0.018    0.018     0.018  1.3     1.0   1.0
knee      0.018    0.018     0.02   0.95    0.5   0.5
ankle     0.018    0.018     0.022  1.0     0.7   0.4
toe       0.025    0.018     0.018  1.1     0.7   0.4
heel      0.02     0.018     0.018  1.1     0.7   0.4
hand      0.022    0.022     0.022  1.5     1.0   1.0
nose      0.015    0.01      0.015  0.5     0.1   0.05
eye       0.015    0.01      0.015  0.5     0.1   0.05
ear       0.015    0.01      0.015  0.6     0.1   0.1
"""

# Lost joints: they are detected somewhere else for a while.
LOST_SHARE_RANGE = (0.003, 0.12)  # share of the time in which a wrist is lost, log-uniform
LOST_TIME_RANGE_S = (0.04, 0.4)  # s, mean length of such a time, log-uniform
MIN_LOST_M = 0.08  # m, least distance of a lost joint from its place
MEAN_LOST_M = 0.15  # m, mean of what is added to it, exponential
ON_TWIN_SHARE = 0.3  # share of the lost joints of a side that are seen where the other side's is
UNNOTICED_SHARE = 0.5  # share of the lost joints that keep their score
LOST_SCORE_RANGE = (0.2, 0.7)  # 1, factor on the score of the others

# Swaps of left and right.
SWAP_SHARE = 0.25  # share of the examples with a swap
SWAPPED_PARTS = ('all', 'legs', 'legs', 'arms', 'arms')  # equally probable
MAX_PART_SWAP_SLOTS = 2  # slots; legs or arms alone are swapped for one or two frames
MIN_SPAN_START = -4  # slots; spans may begin before the newest frame, so that the newest frame is often within one
MAX_SPAN_SLOTS = 8  # slots; longest swap of the whole body
WHOLE_LIMB_SHARE = 0.5  # share of the swaps of arms or legs with shoulders or hips

# Joints that are not seen.
COMPLETE_SHARE = 0.6  # share of the examples in which no single points are missing
MAX_MISSING_POINT_SHARE = 0.25  # share of the points in the others, uniform from 0
HIDDEN_LIMBS_SHARE = 0.12  # share of the examples with limbs hidden by the body or an object
HIDDEN_FACE_SHARE = 0.35  # share in which points of the face behind the head are not given
FACE_DEPTH_M = 0.03  # m, by which a point is behind the middle of the face's points if it is hidden
MISSING_MIDLINE_JOINT_SHARE = 0.1  # share, for each of head, neck and pelvis, in which it is missing throughout
BORDER_SHARE = 0.1  # share of the examples in which the image's border cuts the person off
BORDER_RANGE_M = (0.0, 0.8)  # m from the centroid to the border
MIN_SEEN_JOINTS = 5  # joints; examples with fewer in the newest frame teach little

# Joints that detectors give, and the share of the examples: all of motion capture, its core, OpenPose's BODY_25
# and others with feet, MediaPipe's, COCO's, and limbs alone. `joint_map.py` derives from them what they lack.
_LIMBS = tuple(name for name in CMU15.joints if name not in ('head', 'neck', 'pelvis'))
GIVEN_JOINTS = (
    (BODY26.joints, 0.14),
    (CMU15.joints, 0.12),
    ((*_LIMBS, *FACE, 'neck', 'pelvis', *FEET), 0.22),
    ((*_LIMBS, *FACE, *FEET, *HANDS), 0.20),
    ((*_LIMBS, *FACE), 0.28),
    (_LIMBS, 0.04),
)

# Frame rates and gaps.
GAP_PATTERN_COUNT = 512  # patterns; enough variety, and drawn once because they are slow to make
SINGLE_FRAME_PATTERNS = 20  # patterns of these with the newest frame alone, as when tracking begins
# Shares of the patterns: the rest, 0.55, has a frame at every slot.
DROPPED_FRAMES_ABOVE = 0.55  # to 0.7: single frames are dropped
NEW_PERSON_ABOVE = 0.7  # to 0.85: the person has come into view within the history
LOW_RATE_ABOVE = 0.85  # to 1: the frame rate is low and not that of the slots
DROPPED_FRAMES_RANGE = (0.1, 0.7)  # share of dropped frames
LOW_RATE_INTERVAL_S = (0.06, 0.2)  # s between frames; 5 to 17 frames per second
LOW_RATE_PHASE_S = 0.01  # s; frames are at most so far from multiples of the interval
MIN_INTERPOLATION_WEIGHT = 1 - 1e-4  # 1; a slot is seen if all frames that it is interpolated from are seen

# Limbs that may be hidden together.
_HIDDEN_LIMBS = ('larm', 'rarm', 'lleg', 'rleg', 'legs', 'arms', 'lfoot', 'rfoot')

_MIDLINE = joint_indices('head', 'neck', 'pelvis')
_FACE = joint_indices(*FACE)

_SLOT_INTERVALS_S = np.diff(HISTORY_SLOTS_S).astype(np.float32)  # s from each slot to the next older one
_HAS_TWIN = np.arange(JOINT_COUNT) != MIRROR_PERMUTATION
_COLUMNS = read_table(JOINTS)
JOINT_ROWS = [next(i for i, joint in enumerate(_COLUMNS['joint']) if n.endswith(joint)) for n in BODY26.joints]
_ERROR_FACTOR, _LOST_FACTOR, _DIM_FACTOR = (
    np.array(_COLUMNS[c], np.float32)[JOINT_ROWS] for c in ('errors', 'lost', 'dim')
)
OFFSET_STD_M = np.array([_COLUMNS[c] for c in ('forward', 'sideways', 'up')], np.float32).T  # (rows, 3)


def _list_swapped_joints() -> Bools:
    """Return (P, 2, J) which joints a swap of each of `SWAPPED_PARTS` exchanges, without and with their ends."""
    ends = {'legs': ('lhip', 'rhip'), 'arms': ('lshoulder', 'rshoulder')}
    out = np.ones((len(SWAPPED_PARTS), 2, JOINT_COUNT), bool)
    for i, part in enumerate(SWAPPED_PARTS):
        if part in ends:
            out[i] = False
            out[i, :, limb_indices(part)] = True
            out[i, 1, joint_indices(*ends[part])] = True
    return out


_SWAPPED_JOINTS = _list_swapped_joints()


class DetectorErrors:
    """Errors of many different detectors, from one source of random numbers."""

    def __init__(self, random: RandomArrays) -> None:
        self.random = random
        self.gap_patterns = make_gap_patterns(random.rng, GAP_PATTERN_COUNT)

    def detect(
        self,
        image: Array,
        depth: Array,
        is_recorded: Bools,
        is_known: Bools,
        is_precise: Bools,
    ) -> tuple[Array, Array]:
        """Return what detectors would detect of true image points: the same with random errors and gaps.

        Args:
            image: (N, T, J, 2) m at the person's distance.
            depth: (N, J) m, of the newest joints, by which the far side of the body is known.
            is_recorded: (N, T) whether the motion has a frame at a slot of the history.
            is_known: (N, J) whether the motion has a joint.
            is_precise: (N,) whether an example is without noise.

        Returns:
            (N, T, J, 2) m, any value where the score is 0, and (N, T, J) scores in [0, 1], 0 where not seen.
        """
        image, score = self._add_noise(image, depth, is_precise)
        image, score = self._swap_sides(image, score)
        hidden = self._hide(image, is_recorded) | self._hide_behind_head(depth)[:, None] | ~is_known[:, None]
        image, score = self._derive_midline(image, np.where(hidden, np.float32(0), score))
        return self._interpolate_gaps(image, score)

    def _add_noise(self, image: Array, depth: Array, is_precise: Bools) -> tuple[Array, Array]:
        """Return noisy points (N, T, J, 2) and their confidence scores (N, T, J)."""
        random = self.random
        count, slots = image.shape[:2]
        good = random.uniform(*GOOD_SCORE_RANGE, count, 1, 1)
        score = good + JOINT_SCORE_STD * random.normal(count, 1, JOINT_COUNT)
        frame_std = random.uniform(0, MAX_FRAME_SCORE_STD, count, 1, 1)
        score = score + frame_std * random.normal(count, slots, JOINT_COUNT)
        is_dim = self._draw_dim(depth)
        newest, oldest = random.uniform(0, 1, 2, count, 1, JOINT_COUNT) * good
        score = np.where(is_dim, newest + AGO[:, None] / AGO[-1] * (oldest - newest), score)
        score = np.clip(score, np.float32(MIN_SCORE), np.float32(1))
        exponent = random.uniform(0, MAX_SCORE_EXPONENT, count, 1, 1)
        factor = np.exp(JOINT_NOISE_LOG_STD * random.normal(count, 1, JOINT_COUNT)) * _ERROR_FACTOR
        noise_factor = factor * np.minimum((score / good) ** -exponent, np.float32(MAX_ERROR_FACTOR))
        white = random.log_uniform(WHITE_RANGE_M, count, 1, 1, 1) * random.normal(count, slots, JOINT_COUNT, 2)
        noise = random.log_uniform(WANDER_RANGE_M, count, 1, 1, 1) * self._draw_wander(count) + white
        constant = random.log_uniform(CONSTANT_RANGE_M, count, 1, 1, 1) * random.normal(count, 1, JOINT_COUNT, 2)
        error = noise_factor[..., None] * noise + factor[..., None] * constant
        noisy = image + np.where(is_precise[:, None, None, None], np.float32(0), error)
        noisy, score = self._lose_joints(noisy, score)
        return noisy, np.where(random.chance(count, CONSTANT_SCORE_SHARE, axes=2), np.float32(1), score)

    def _draw_wander(self, count: int) -> Array:
        """Return unit errors (N, T, J, 2) that wander with a time constant of their own in each example."""
        tau = self.random.log_uniform(WANDER_TIME_RANGE_S, count, 1, 1)
        out = self.random.normal(count, len(HISTORY_SLOTS_S), JOINT_COUNT, 2)
        for slot, interval in enumerate(_SLOT_INTERVALS_S, start=1):
            keep = np.exp(-interval / tau)
            out[:, slot] = keep * out[:, slot - 1] + np.sqrt(1 - keep**2) * out[:, slot]
        return out

    def _draw_times(self, share: Array, length: Array) -> Bools:
        """Return (N, T, J) whether a joint is in a state that it enters and leaves at random.

        Args:
            share: (N, J) share of the time in the state.
            length: (N, 1) s, mean length of a time in the state.
        """
        chance = self.random.rng.random((len(share), len(HISTORY_SLOTS_S), JOINT_COUNT), dtype=np.float32)
        out = chance < share[:, None]
        for slot, interval in enumerate(_SLOT_INTERVALS_S, start=1):
            keep = np.exp(-interval / (length * (1 - share)))
            out[:, slot] = chance[:, slot] < share + (out[:, slot - 1] - share) * keep
        return out

    def _draw_dim(self, depth: Array) -> Bools:
        count = len(depth)
        is_far = depth > depth[:, MIRROR_PERMUTATION]
        is_near = depth < depth[:, MIRROR_PERMUTATION]
        factor = np.where(is_far, FAR_SIDE_FACTOR, np.where(is_near, NEAR_SIDE_FACTOR, 1)).astype(np.float32)
        share = self.random.uniform(0, MAX_DIM_SHARE, count, 1) * factor * _DIM_FACTOR
        return self._draw_times(share, self.random.log_uniform(DIM_TIME_RANGE_S, count, 1))

    def _lose_joints(self, image: Array, score: Array) -> tuple[Array, Array]:
        """Return points (N, T, J, 2) and scores (N, T, J), in which some joints are somewhere else for a while."""
        random, rng = self.random, self.random.rng
        count = len(image)
        share = self.random.log_uniform(LOST_SHARE_RANGE, count, 1) * _LOST_FACTOR
        is_lost = self._draw_times(share, self.random.log_uniform(LOST_TIME_RANGE_S, count, 1))
        distance = MIN_LOST_M + MEAN_LOST_M * rng.standard_exponential((count, 1, JOINT_COUNT), dtype=np.float32)
        angle = random.uniform(0, 2 * np.pi, count, 1, JOINT_COUNT)
        away = distance[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        is_on_twin = _HAS_TWIN & (rng.random((count, 1, JOINT_COUNT)) < ON_TWIN_SHARE)
        lost = np.where(is_on_twin[..., None], image[:, :, MIRROR_PERMUTATION], image + away)
        is_noticed = is_lost & (rng.random((count, 1, JOINT_COUNT)) >= UNNOTICED_SHARE)
        lower = np.maximum(score * random.uniform(*LOST_SCORE_RANGE, count, 1, JOINT_COUNT), np.float32(MIN_SCORE))
        return np.where(is_lost[..., None], lost, image), np.where(is_noticed, lower, score)

    def _swap_sides(self, image: Array, score: Array) -> tuple[Array, Array]:
        """Exchange left and right in a span of slots, for all joints, the legs or the arms."""
        count, slots = score.shape[:2]
        number = self.random.rng.integers(0, len(SWAPPED_PARTS), count)
        has_ends = self.random.chance(count, WHOLE_LIMB_SHARE).astype(np.intp)
        part = _SWAPPED_JOINTS[number, has_ends]
        is_whole = np.array([p == 'all' for p in SWAPPED_PARTS])[number]
        length = self.random.rng.integers(1, np.where(is_whole, MAX_SPAN_SLOTS, MAX_PART_SWAP_SLOTS) + 1)[:, None]
        first = self.random.rng.integers(np.maximum(MIN_SPAN_START, 1 - length), slots, (count, 1))
        slot = np.arange(slots)
        is_within = ((slot >= first) & (slot < first + length))[..., None]
        swapped = is_within & self.random.chance(count, SWAP_SHARE, axes=2) & part[:, None]
        image = np.where(swapped[..., None], image[:, :, MIRROR_PERMUTATION], image)
        return image, np.where(swapped, score[:, :, MIRROR_PERMUTATION], score)

    def _derive_midline(self, image: Array, score: Array) -> tuple[Array, Array]:
        """Return points (N, T, J, 2) and scores (N, T, J) of the joints that a detector of `GIVEN_JOINTS` gives.

        Head, neck and pelvis are derived from the others as `joint_map.py` does where the detector lacks them.
        """
        shares = np.cumsum([share for _, share in GIVEN_JOINTS])
        kind = np.searchsorted(shares / shares[-1], self.random.rng.random(len(image)), side='right')
        given = np.zeros((len(GIVEN_JOINTS), JOINT_COUNT), bool)
        for i, (names, _) in enumerate(GIVEN_JOINTS):
            sources = joint_indices(*names)
            given[i, sources] = True
            chosen = np.flatnonzero(kind == i)
            joint_map = build_joint_map(names, BODY26)
            points, derived = engine.map_joints(
                np.ascontiguousarray(image[chosen][:, :, sources], float).reshape(-1, len(sources), 2),
                np.ascontiguousarray(score[chosen][:, :, sources], float).reshape(-1, len(sources)),
                np.ascontiguousarray(joint_map.weights[:, _MIDLINE]),
                np.ascontiguousarray(joint_map.score_factor[:, _MIDLINE]),
            )
            shape = len(chosen), score.shape[1], len(_MIDLINE)
            own = chosen[:, None], slice(None), _MIDLINE
            image[own] = np.moveaxis(np.nan_to_num(points).reshape(*shape, 2), 2, 1)
            score[own] = np.moveaxis(derived.reshape(shape), 2, 1)
        is_given = given[kind]
        is_given[:, _MIDLINE] = True
        return image, np.where(is_given[:, None], score, np.float32(0))

    def _hide_behind_head(self, depth: Array) -> Bools:
        """Return (N, J) which points of the face are hidden by the head, in some examples."""
        face = depth[:, _FACE]
        out = np.zeros(depth.shape, bool)
        is_behind = face > face.mean(axis=1, keepdims=True) + FACE_DEPTH_M
        out[:, _FACE] = is_behind & self.random.chance(len(depth), HIDDEN_FACE_SHARE, axes=1)
        return out

    def _hide(self, image: Array, is_recorded: Bools) -> Bools:
        """Return (N, T, J) whether a joint is not seen.

        Single points are missing, limbs are hidden, midline joints are lacking, or the image's border cuts the
        person off.
        """
        random, rng = self.random, self.random.rng
        count, slots = is_recorded.shape
        share = random.choose(count, COMPLETE_SHARE, 0, MAX_MISSING_POINT_SHARE, axes=2)
        share = share * random.uniform(0, 1, count, 1, 1)
        hidden = rng.random((count, slots, JOINT_COUNT), dtype=np.float32) < share
        hidden |= ~is_recorded[..., None]
        limbs = np.zeros((len(_HIDDEN_LIMBS), JOINT_COUNT), bool)
        for i, name in enumerate(_HIDDEN_LIMBS):
            limbs[i, limb_indices(name)] = True
        limb = limbs[rng.integers(0, len(limbs), count)]
        since = np.arange(slots)[None] < rng.integers(1, 2 * slots, (count, 1))
        hidden |= (limb & random.chance(count, HIDDEN_LIMBS_SHARE, axes=1))[:, None] & since[..., None]
        lacking = np.zeros((count, JOINT_COUNT), bool)
        lacking[:, _MIDLINE] = rng.random((count, len(_MIDLINE))) < MISSING_MIDLINE_JOINT_SHARE
        hidden |= lacking[:, None]
        hidden |= self._is_beyond_border(image)
        has_enough = (~hidden[:, 0, :CORE_COUNT]).sum(axis=1, keepdims=True) >= MIN_SEEN_JOINTS
        hidden[:, 0] &= has_enough | ~is_recorded[:, :1]
        return np.asarray(hidden)

    def _is_beyond_border(self, image: Array) -> Bools:
        """Return (N, T, J) whether a point is below, right or left of a border at a random distance."""
        count = len(image)
        direction = self.random.rng.integers(0, 3, count)
        normal = np.array([[0, 1], [1, 0], [-1, 0]], np.float32)[direction]
        border = self.random.uniform(*BORDER_RANGE_M, count, 1, 1)
        centroid = image[:, :1, :CORE_COUNT].mean(axis=2, keepdims=True)
        beyond = np.einsum('ntjd,nd->ntj', image - centroid, normal) > border
        return np.asarray(beyond & self.random.chance(count, BORDER_SHARE, axes=2))

    def _interpolate_gaps(self, image: Array, score: Array) -> tuple[Array, Array]:
        """Drop frames and interpolate the slots between the others, as `lifter.sample_histories` does."""
        patterns = self.gap_patterns[self.random.rng.integers(0, len(self.gap_patterns), len(image))]
        count, slots = score.shape[:2]
        seen = patterns @ (score > 0) > MIN_INTERPOLATION_WEIGHT
        mixed = patterns @ image.reshape(count, slots, -1)
        return mixed.reshape(image.shape), np.where(seen, patterns @ score, 0).astype(np.float32)


def make_gap_patterns(rng: np.random.Generator, count: int) -> Array:
    """Make matrices (count, T, T) that interpolate the slots of a history from the slots that have a frame.

    The newest slot always has a frame. A row is zero if its slot lies in a gap longer than
    `MAX_INTERPOLATION_GAP_S`.
    """
    slots = len(HISTORY_SLOTS_S)
    out = np.zeros((count, slots, slots), np.float32)
    for i, pattern in enumerate(out):
        has_frame = _draw_frames(rng, slots) & (i >= SINGLE_FRAME_PATTERNS)
        has_frame[0] = True
        times = HISTORY_SLOTS_S[has_frame]
        older = np.searchsorted(times, HISTORY_SLOTS_S)  # frame at the time of each slot, or before
        gap = np.append(np.diff(times, prepend=0), np.inf)[older]
        units = np.eye(slots)[has_frame]
        interpolated = np.transpose([np.interp(HISTORY_SLOTS_S, times, unit[has_frame]) for unit in units])
        is_seen = has_frame | (gap <= MAX_INTERPOLATION_GAP_S)
        pattern[:, has_frame] = np.where(is_seen[:, None], interpolated, 0)
    return out


def _draw_frames(rng: np.random.Generator, slots: int) -> Bools:
    """Return (T,) which slots have a frame: all, or fewer by dropped frames, a new person or a low frame rate."""
    kind = rng.random()
    has_frame = np.ones(slots, bool)
    if kind > DROPPED_FRAMES_ABOVE:
        has_frame = rng.random(slots) > rng.uniform(*DROPPED_FRAMES_RANGE)
    if kind > NEW_PERSON_ABOVE:
        has_frame = np.arange(slots) < rng.integers(1, slots)
    if kind > LOW_RATE_ABOVE:
        times = np.arange(0, 1, rng.uniform(*LOW_RATE_INTERVAL_S))
        times = times + rng.uniform(-LOW_RATE_PHASE_S, LOW_RATE_PHASE_S)
        nearest = np.abs(HISTORY_SLOTS_S[:, None] - times).argmin(axis=0)
        has_frame = np.isin(np.arange(slots), nearest)
    return has_frame
