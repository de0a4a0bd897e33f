"""Synthetic errors of a 2D keypoint detector, for training examples.

Image points are in metres at the person's distance. Shapes: N examples, T slots of the history (newest first),
J joints of `skeleton.CMU15`.

The errors are of the kinds that OpenPose and MediaPipe make. Their magnitudes are estimates, wide enough for
many detectors. The mixture as a whole was chosen on CMU subjects 02, 16 and 49, with lifters that had seen neither
these nor the test subjects (docs/lifter.md, "Training"). Shares are shares of the examples unless noted.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap_ros.models.lifter_input import (
    HISTORY_SLOTS_S,
    JOINT_COUNT,
    MAX_INTERPOLATION_GAP_S,
    MIRROR_PERMUTATION,
)
from mocap_ros.training.body_parts import joint_indices, limb_indices
from mocap_ros.training.random_arrays import Array, RandomArrays

# Confidence scores.
CONSTANT_SCORE_SHARE = 0.35  # share; scores that are all 1, from detectors whose scores carry no information
MEAN_SCORE_RANGE = (0.4, 0.95)  # 1, mean score of an example; detectors differ in their scale
JOINT_SCORE_STD = 0.15  # 1, standard deviation of the score between joints of an example
FRAME_SCORE_STD = 0.08  # 1, standard deviation of the score of a joint between frames
MIN_SCORE = 0.05  # 1; joints that are seen have no lower score

# Lapses: a joint is detected badly for a few frames.
LAPSE_SHARE = 0.2  # share of the examples with lapses
LAPSE_JOINT_SHARE = 0.2  # share of the joints in these examples
LAPSE_SCORE_FACTOR = 0.35  # 1; detectors mostly notice a lapse and lower the score
MISPLACED_LAPSE_SHARE = 0.5  # share of the examples in which lapses also displace the joint

# Position noise, from white and slowly varying parts.
NOISELESS_SHARE = 0.4  # share; keeps the lifter accurate for precise keypoints
NOISE_RANGE_M = (0.003, 0.03)  # m, standard deviation at score 1, log-uniform; 0.2 to 2 % of the stature
JOINT_NOISE_LOG_STD = 0.4  # 1, standard deviation of the noise level's logarithm between joints; makes heavy tails
MAX_SCORE_EXPONENT = 1.5  # 1; noise grows as score^-e with e between 0 and this, as detectors' scores differ
WHITE_NOISE_SHARE = 0.75  # 1, amplitude of the part that is independent between frames
SLOW_NOISE_SHARE = 0.5  # 1, amplitude of the part that drifts
DRIFT_TIME_S = 0.4  # s in which the drift reaches the size of the constant part of the slow noise

# Gross errors: a joint is detected somewhere else.
GROSS_ERROR_POINT_SHARE = 0.01  # share of all points
DISPLACEMENT_M = 0.12  # m, standard deviation of the displacement of a joint, the same in all frames
GROSS_ERROR_JITTER = 0.15  # 1, amplitude of additional noise on gross errors
LAPSE_JITTER = 0.03  # 1, amplitude of additional noise on misplaced lapses, which stay in one place

# Swaps of left and right for a few frames.
SWAP_SHARE = 0.2  # share of the examples with a swap
MIN_SPAN_START = -4  # slots; spans may begin before the newest frame, so that the newest frame is often within one
MAX_SPAN_SLOTS = 8  # slots; longest lapse or swap

# Joints that are not seen.
COMPLETE_SHARE = 0.6  # share of the examples in which no single points are missing
MAX_MISSING_POINT_SHARE = 0.25  # share of the points in the others, uniform from 0
HIDDEN_LIMBS_SHARE = 0.12  # share of the examples with limbs hidden by the body or an object
MISSING_MIDLINE_JOINT_SHARE = 0.2  # share, for each of head, neck and pelvis, which many detectors lack
MISSING_MIDLINE_SHARE = 0.12  # share in which head, neck and pelvis are all missing
BORDER_SHARE = 0.1  # share of the examples in which the image's border cuts the person off
BORDER_RANGE_M = (0.0, 0.8)  # m from the centroid to the border
MIN_SEEN_JOINTS = 5  # joints; examples with fewer in the newest frame teach little

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
_HIDDEN_LIMBS = ('larm', 'rarm', 'lleg', 'rleg', 'legs', 'arms')


class DetectorErrors:
    """Errors of many different detectors.

    Attributes:
        random: source of all random numbers.
        gap_patterns: (G, T, T) interpolation matrices, as from `make_gap_patterns`.
    """

    def __init__(self, random: RandomArrays) -> None:
        self.random = random
        self.gap_patterns = make_gap_patterns(random.rng, GAP_PATTERN_COUNT)

    def detect(self, image: Array, is_recorded: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Return what detectors would detect: the true image points with random errors and gaps.

        Args:
            image: (N, T, J, 2) m at the person's distance, true image points.
            is_recorded: (N, T) True for slots of the history at which the motion has a frame.

        Returns:
            (N, T, J, 2) m, detected image points, arbitrary where the score is 0, and (N, T, J) confidence scores
            in [0, 1], 0 for joints that were not seen.
        """
        image, score = self._add_noise(image)
        image, score = self._swap_sides(image, score)
        score = np.where(self._hide(image, is_recorded), 0, score)
        return self._interpolate_gaps(image, score)

    def _add_noise(self, image: Array) -> tuple[Array, Array]:
        """Return noisy points (N, T, J, 2) and their confidence scores (N, T, J)."""
        random, rng = self.random, self.random.rng
        count, slots = image.shape[:2]
        is_constant = random.chance(count, CONSTANT_SCORE_SHARE, axes=2)
        mean_score = random.uniform(*MEAN_SCORE_RANGE, count, 1, 1)
        score = (
            mean_score
            + JOINT_SCORE_STD * random.normal(count, 1, JOINT_COUNT)
            + FRAME_SCORE_STD * random.normal(count, slots, JOINT_COUNT)
        )
        lapse = (
            self._draw_spans(count, slots)
            & random.chance(count, LAPSE_SHARE, axes=2)
            & (rng.random((count, 1, JOINT_COUNT)) < LAPSE_JOINT_SHARE)
        )
        score = np.where(lapse, np.float32(LAPSE_SCORE_FACTOR) * score, score)
        score = np.clip(score, np.float32(MIN_SCORE), np.float32(1))
        exponent = random.uniform(0, MAX_SCORE_EXPONENT, count, 1, 1)
        level = np.exp(random.uniform(*np.log(NOISE_RANGE_M), count, 1, 1))
        level = level * random.choose(count, NOISELESS_SHARE, 0, 1, axes=2)
        level = level * np.exp(JOINT_NOISE_LOG_STD * random.normal(count, 1, JOINT_COUNT))
        level = level * np.exp(-exponent * np.log(score))
        slow = random.normal(count, 1, JOINT_COUNT, 2)
        drift = random.normal(count, 1, JOINT_COUNT, 2)
        slow = slow + HISTORY_SLOTS_S.astype(np.float32)[:, None, None] / DRIFT_TIME_S * drift
        white = random.normal(count, slots, JOINT_COUNT, 2)
        noise = WHITE_NOISE_SHARE * white + SLOW_NOISE_SHARE * slow
        gross = rng.random((count, slots, JOINT_COUNT), dtype=np.float32) < GROSS_ERROR_POINT_SHARE
        misplaced = gross | (lapse & random.chance(count, MISPLACED_LAPSE_SHARE, axes=2))
        image = image + level[..., None] * noise
        at = np.nonzero(misplaced)
        displacement = random.normal(count, JOINT_COUNT, 2)[at[0], at[2]]
        jitter = np.where(gross[at], np.float32(GROSS_ERROR_JITTER), np.float32(LAPSE_JITTER))[:, None]
        image[at] += DISPLACEMENT_M * displacement + jitter * noise[at]
        return image, np.where(is_constant, np.float32(1), score)

    def _draw_spans(self, count: int, slots: int) -> NDArray[np.bool_]:
        """Return (N, T, 1) whether each slot lies within a random span of slots, one span for each example."""
        first = self.random.rng.integers(MIN_SPAN_START, slots, (count, 1))
        length = self.random.rng.integers(1, MAX_SPAN_SLOTS + 1, (count, 1))
        slot = np.arange(slots)
        return ((slot >= first) & (slot < first + length))[..., None]

    def _swap_sides(self, image: Array, score: Array) -> tuple[Array, Array]:
        """Exchange left and right in a span of slots, for all joints, the legs or the arms."""
        count, slots = score.shape[:2]
        parts = np.zeros((3, JOINT_COUNT), bool)
        parts[0] = True
        parts[1, [*limb_indices('legs'), *joint_indices('lhip', 'rhip')]] = True
        parts[2, [*limb_indices('arms'), *joint_indices('lshoulder', 'rshoulder')]] = True
        part = parts[np.minimum(self.random.rng.integers(0, 5, count), 2)]  # one in five all, one in five the legs
        swapped = self._draw_spans(count, slots) & self.random.chance(count, SWAP_SHARE, axes=2) & part[:, None]
        image = np.where(swapped[..., None], image[:, :, MIRROR_PERMUTATION], image)
        return image, np.where(swapped, score[:, :, MIRROR_PERMUTATION], score)

    def _hide(self, image: Array, is_recorded: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return (N, T, J) whether a joint is not seen.

        Single points are missing, limbs are hidden, detectors lack midline joints, or the image's border cuts the
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
        midline = joint_indices('head', 'neck', 'pelvis')
        lacking = np.zeros((count, JOINT_COUNT), bool)
        lacking[:, midline] = rng.random((count, len(midline))) < MISSING_MIDLINE_JOINT_SHARE
        lacking[:, midline] |= random.chance(count, MISSING_MIDLINE_SHARE, axes=1)
        hidden |= lacking[:, None]
        hidden |= self._is_beyond_border(image)
        hidden[:, 0] &= ((~hidden[:, 0]).sum(axis=1) >= MIN_SEEN_JOINTS)[:, None] | ~is_recorded[:, :1]
        return np.asarray(hidden)

    def _is_beyond_border(self, image: Array) -> NDArray[np.bool_]:
        """Return (N, T, J) whether a point is below, right or left of a border at a random distance."""
        count = len(image)
        direction = self.random.rng.integers(0, 3, count)
        normal = np.array([[0, 1], [1, 0], [-1, 0]], np.float32)[direction]
        border = self.random.uniform(*BORDER_RANGE_M, count, 1, 1)
        centroid = image[:, :1].mean(axis=2, keepdims=True)
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
        has_frame = _draw_frames(rng, slots)
        if i < SINGLE_FRAME_PATTERNS:
            has_frame = np.arange(slots) < 1
        has_frame[0] = True
        frames = np.flatnonzero(has_frame)
        for slot in range(slots):
            newer, older = frames[frames <= slot][-1], frames[frames >= slot][:1]
            if has_frame[slot]:
                pattern[slot, slot] = 1
            elif len(older) and HISTORY_SLOTS_S[older[0]] - HISTORY_SLOTS_S[newer] <= MAX_INTERPOLATION_GAP_S:
                gap = HISTORY_SLOTS_S[older[0]] - HISTORY_SLOTS_S[newer]
                share = (HISTORY_SLOTS_S[slot] - HISTORY_SLOTS_S[newer]) / gap
                pattern[slot, newer], pattern[slot, older[0]] = 1 - share, share
    return out


def _draw_frames(rng: np.random.Generator, slots: int) -> NDArray[np.bool_]:
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
