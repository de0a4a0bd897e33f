# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Linear maps from a detector's keypoints to the joints of the reconstruction's skeleton.

y_t = sum_s W_ts x_s, with sum_s W_ts = 1: target joint t as a weighted sum of source keypoints s, in 2D or 3D. A
joint that the detector lacks has a list of derivations, the most precise first; the first one that has all of its
keypoints is used. MediaPipe's joints are moved to where motion capture has them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.engine import rays as engine
from mocap_ros.errors import SkeletonError
from mocap_ros.skeleton import BODY26, CMU15, Skeleton, canonical_joint_names

MIN_TARGET_JOINTS = 4  # joints; the 2x4 camera matrix M has 8 unknowns, and each image point gives 2 equations
MAX_NAMES_IN_ERROR = 5  # joint names; keeps the error message on one line for layouts with many keypoints
MAX_CACHED_MAPS = 64  # maps; bounds the memory when messages name ever new joints, far above detectors in use


# Joints that do not count among those that determine the camera.
_EXTREMITIES = frozenset(BODY26.joints) - frozenset(CMU15.joints)


class _Derivation(NamedTuple):
    """Weights of keypoints by name, and a factor on their least score, below 1 if the derivation is imprecise."""

    weights: dict[str, float]
    score_factor: float


_SHOULDERS = {'lshoulder': 0.5, 'rshoulder': 0.5}  # weights of the point midway between the shoulders
_HIPS = {'lhip': 0.5, 'rhip': 0.5}  # weights of the point midway between the hips


_MIDWAY = {'neck': tuple(_SHOULDERS), 'pelvis': tuple(_HIPS)}  # joints that some programs put between two others


def _extrapolate_from_shoulders(end: dict[str, float], fraction: float) -> dict[str, float]:
    towards = {j: fraction * w for j, w in end.items()}
    return towards | {j: (1 - fraction) * w for j, w in _SHOULDERS.items()}


_TOES = ('bigtoe', 'foot_index')  # keypoints that are a toe, without the side
_HANDS = ({'index': 0.5, 'pinky': 0.5}, {'index': 1.0})  # weights of the knuckles that stand for a hand

# How to derive joints, the most precise way first. The model's head joint is the tip of the CMU head bone, about a
# hand's breadth above the ears. The fractions of the way from the shoulders to a keypoint of the head were read
# off CMU motion capture and anthropometric tables and are good to about 3 cm. The score factors were chosen by
# judgement, not measured: the less certain a derivation is, the less it counts.
_DERIVATIONS: dict[str, tuple[_Derivation, ...]] = {
    'neck': (_Derivation(_SHOULDERS, 1.0), _Derivation({'upperneck': 1.0}, 0.25)),
    'pelvis': (_Derivation(_HIPS, 1.0),),
    'head': (
        _Derivation(_extrapolate_from_shoulders({'headtop': 1.0}, 0.8), 0.5),
        _Derivation(_extrapolate_from_shoulders({'lear': 0.5, 'rear': 0.5}, 1.3), 0.5),
        _Derivation(_extrapolate_from_shoulders({'leye': 0.5, 'reye': 0.5}, 1.2), 0.2),
        _Derivation(_extrapolate_from_shoulders({'nose': 1.0}, 1.3), 0.1),
    ),
    **{f'{side}toe': tuple(_Derivation({side + toe: 1.0}, 1.0) for toe in _TOES) for side in 'lr'},
    **{
        f'{side}hand': tuple(_Derivation({side + k: w for k, w in hand.items()}, 1.0) for hand in _HANDS)
        for side in 'lr'
    },
}


# Where MediaPipe sees joints, relative to where motion capture has them: outwards, in widths of the shoulders, and
# up the trunk, in distances between the middle of the hips and that of the shoulders. These are medians over 53
# recordings with markers, of 6 to 24 mm. It sees shoulders 26 mm too far back and elbows 11 mm as well, which no
# linear map can undo.
_MEDIAPIPE_JOINTS = frozenset({'lfoot_index', 'rfoot_index'})  # names that only its layout has
_MEDIAPIPE_OFFSETS = {
    'shoulder': (0.0, 0.016),
    'elbow': (-0.039, 0.027),
    'knee': (0.0, 0.045),
    'ankle': (0.018, 0.047),
}


def _correct_mediapipe() -> dict[str, _Derivation]:
    """Return how joints of motion capture follow from MediaPipe's, which are the same keypoints a little moved."""
    out = {}
    for side, other in (('l', 'r'), ('r', 'l')):
        for name, (outwards, up) in _MEDIAPIPE_OFFSETS.items():
            weights = dict.fromkeys((f'{side}hip', f'{other}hip'), up / 2)
            weights |= {f'{side}shoulder': -up / 2 - outwards, f'{other}shoulder': -up / 2 + outwards}
            weights[side + name] = 1 + weights.get(side + name, 0.0)
            out[side + name] = _Derivation(weights, 1.0)
    return out


_MEDIAPIPE_CORRECTIONS = _correct_mediapipe()


@dataclass(frozen=True)
class JointMap:
    """Linear maps from source keypoints to target joints: alternatives, tried in order until one can be used."""

    source: tuple[str, ...]  # (Js,) canonical names of the source keypoints
    target: Skeleton  # skeleton that is mapped to, with Jt joints
    # (A, Jt, Js) weights of the A alternatives. A row sums to one, or is zero if the joint has fewer alternatives
    weights: Array
    score_factor: Array  # (A, Jt) factor on the confidence score, 0 if the joint has fewer alternatives
    shows: NDArray[np.uint8]  # (Jt,) whether a joint is not derived from others of the body alone
    midway: NDArray[np.int64]  # (M, 3) joints that some programs put midway between two others, and these

    def apply(self, points: Array, score: Array) -> tuple[Array, Array]:
        """Map keypoints (..., Js, D) with scores (..., Js) to the target skeleton; NaN or score 0: not seen.

        Returns points (..., Jt, D), NaN where no alternative can be used, and the least scores of their keypoints
        times the factor.
        """
        leading, (sources, dimensions) = points.shape[:-2], points.shape[-2:]
        flat_points = np.ascontiguousarray(points, float).reshape(-1, sources, dimensions)
        flat_score = np.ascontiguousarray(score, float).reshape(-1, sources)
        out, out_score = engine.map_joints(flat_points, flat_score, self.weights, self.score_factor)
        return out.reshape(*leading, -1, dimensions), out_score.reshape(*leading, -1)


@lru_cache(maxsize=MAX_CACHED_MAPS)
def build_joint_map(source: tuple[str, ...], target: Skeleton = CMU15) -> JointMap:
    """Build the map from keypoints, in any spelling, to a skeleton: the joint itself, then its derivations.

    Raises:
        SkeletonError: A name repeats, or fewer than `MIN_TARGET_JOINTS` joints of `target` can be mapped, those of
            face, feet and hands not counted; the message then lists the names that can be used.
    """
    source = canonical_joint_names(source)
    if len(set(source)) != len(source):
        repeated = max(source, key=source.count)
        raise SkeletonError(f'joint names repeat: {repeated}')
    source_names = set(source)
    corrections = _MEDIAPIPE_CORRECTIONS if source_names & _MEDIAPIPE_JOINTS else {}
    alternatives = [
        [
            derivation
            for derivation in (
                *((corrections[joint],) if joint in corrections else ()),
                _Derivation({joint: 1.0}, 1.0),
                *_DERIVATIONS.get(joint, ()),
            )
            if source_names.issuperset(derivation.weights)
        ]
        for joint in target.joints
    ]
    if (
        sum(bool(a) for a, j in zip(alternatives, target.joints, strict=True) if j not in _EXTREMITIES)
        < MIN_TARGET_JOINTS
    ):
        shown = ', '.join(source[:MAX_NAMES_IN_ERROR]) + (', ...' if len(source) > MAX_NAMES_IN_ERROR else '')
        raise SkeletonError(
            f'{shown or "no names"}: fewer than four joints of the body; '
            f'known: {", ".join(_list_usable_names(target))}'
        )
    count = max(map(len, alternatives))
    weights = np.zeros((count, len(target.joints), len(source)))
    score_factor = np.zeros(weights.shape[:2])
    for t, derivations in enumerate(alternatives):
        for a, derivation in enumerate(derivations):
            score_factor[a, t] = derivation.score_factor
            for joint, weight in derivation.weights.items():
                weights[a, t, source.index(joint)] = weight
    body = frozenset(CMU15.joints)
    shows = np.array([any(d.weights.keys() - body for d in a) for a in alternatives])
    shows |= np.isin(target.joints, source)
    midway = [[joint, *ends] for joint, ends in _MIDWAY.items() if joint in target.joints]
    indices = np.array([[*map(target.index, joints)] for joints in midway], np.int64).reshape(-1, 3)
    return JointMap(source, target, weights, score_factor, shows.astype(np.uint8), indices)


def _list_usable_names(target: Skeleton) -> list[str]:
    core = [joint for joint in target.joints if joint not in _EXTREMITIES]
    derived = [j for joint in core for d in _DERIVATIONS.get(joint, ()) for j in d.weights]
    return list(dict.fromkeys([*core, *derived]))
