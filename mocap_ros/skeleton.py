"""Keypoint layouts, the model's skeleton, and the linear maps from one to the other.

Joint names are lower case, `l` or `r` first: `lshoulder`; `own_names` turns the spellings of others into these.
The reconstruction's own skeleton is `cmu15`; a detector's keypoints reach it through `joint_map`, which also
derives joints the detector lacks.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from mocap_ros.errors import SkeletonError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Skeleton:
    """A named joint layout.

    Attributes:
        name: name of the layout, as used in messages.
        joints: joint names, in the order of the data.
        parents: index of each joint's parent, -1 for a root (a layout may have several parts).
    """

    name: str
    joints: tuple[str, ...]
    parents: tuple[int, ...]

    @cached_property
    def bones(self) -> tuple[tuple[int, int], ...]:
        """(parent, child) of every bone, in joint order."""
        return tuple((p, c) for c, p in enumerate(self.parents) if p >= 0)

    def bone_lengths(self, poses: Array) -> Array:
        """(..., J, 3) -> (..., B) in the same unit, in the order of `bones`."""
        parents, children = (list(side) for side in zip(*self.bones, strict=True))
        return np.asarray(np.linalg.norm(poses[..., children, :] - poses[..., parents, :], axis=-1))

    @cached_property
    def mirror(self) -> tuple[int, ...]:
        """Permutation that exchanges left and right joints."""
        return tuple(self.joints.index(_other_side(j, self.joints)) for j in self.joints)

    @cached_property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """(left, right) indices of every joint that has a twin."""
        return tuple((i, m) for i, m in enumerate(self.mirror) if i != m and _is_left(self.joints[i], self.joints))

    def index(self, joint: str) -> int:
        """Index of a joint by name."""
        try:
            return self.joints.index(joint)
        except ValueError:
            raise SkeletonError(
                f'layout {self.name!r} has no joint {joint!r}; it has {", ".join(self.joints)}'
            ) from None

    def outward(self) -> tuple[tuple[int, int], ...]:
        """Bones ordered so that every parent comes before its children."""
        done = [i for i, p in enumerate(self.parents) if p < 0]
        order: list[tuple[int, int]] = []
        for joint in done:
            children = [c for c, p in enumerate(self.parents) if p == joint]
            order += [(joint, c) for c in children]
            done += children
        return tuple(order)


def _other_side(joint: str, joints: Sequence[str]) -> str:
    for here, there in (('l', 'r'), ('r', 'l')):
        if joint.startswith(here) and there + joint[1:] in joints:
            return there + joint[1:]
        if joint.endswith('_' + here) and joint[:-1] + there in joints:
            return joint[:-1] + there
    return joint


def _is_left(joint: str, joints: Sequence[str]) -> bool:
    other = _other_side(joint, joints)
    return joint.endswith('_l') if joint[1:] != other[1:] else joint.startswith('l')


def _layout(name: str, tree: str) -> Skeleton:
    """A layout from `joint<parent` words in data order; a word without `<` is a root."""
    words = [w.partition('<') for w in tree.split()]
    joints = tuple(w[0] for w in words)
    parents = tuple(joints.index(w[2]) if w[2] else -1 for w in words)
    return Skeleton(name, joints, parents)


_FACE = 'nose{} leye<nose reye<nose lear<leye rear<reye '


_COCO_BODY = (
    'lshoulder{0} rshoulder{0} lelbow<lshoulder relbow<rshoulder lwrist<lelbow rwrist<relbow '
    'lhip{1} rhip{1} lknee<lhip rknee<rhip lankle<lknee rankle<rknee '
)


_OPENPOSE_BODY = 'rshoulder<neck relbow<rshoulder rwrist<relbow lshoulder<neck lelbow<lshoulder lwrist<lelbow '


_FEET = 'lbigtoe<lankle lsmalltoe<lbigtoe lheel<lankle rbigtoe<rankle rsmalltoe<rbigtoe rheel<rankle'


_LAYOUTS = {
    s.name: s
    for s in (
        _layout(
            'cmu15',
            'head<neck neck<pelvis lshoulder<neck lelbow<lshoulder lwrist<lelbow rshoulder<neck '
            'relbow<rshoulder rwrist<relbow pelvis lhip<pelvis lknee<lhip lankle<lknee '
            'rhip<pelvis rknee<rhip rankle<rknee',
        ),
        _layout(
            'coco17',
            _FACE.format('') + 'lshoulder<rshoulder rshoulder lelbow<lshoulder '
            'relbow<rshoulder lwrist<lelbow rwrist<relbow lhip<lshoulder rhip<rshoulder '
            'lknee<lhip rknee<rhip lankle<lknee rankle<rknee',
        ),
        _layout(
            'coco18',
            'nose<neck neck ' + _OPENPOSE_BODY + 'rhip<neck rknee<rhip rankle<rknee '
            'lhip<neck lknee<lhip lankle<lknee reye<nose leye<nose rear<reye lear<leye',
        ),
        _layout(
            'hri18',
            'nose<neck neck ' + _OPENPOSE_BODY + 'rhip<neck rknee<rhip rankle<rknee '
            'lhip<neck lknee<lhip lankle<lknee leye<nose reye<nose lear<leye rear<reye',
        ),
        _layout(
            'body25',
            'nose<neck neck ' + _OPENPOSE_BODY + 'pelvis<neck rhip<pelvis rknee<rhip '
            'rankle<rknee lhip<pelvis lknee<lhip lankle<lknee reye<nose leye<nose rear<reye '
            'lear<leye ' + _FEET,
        ),
        _layout(
            'body25b',
            _FACE.format('<upperneck')
            + _COCO_BODY.format('<upperneck', '<upperneck')
            + 'upperneck headtop<upperneck '
            + _FEET,
        ),
        _layout(
            'halpe26',
            _FACE.format('<neck') + _COCO_BODY.format('<neck', '<pelvis') + 'headtop<neck '
            'neck<pelvis pelvis lbigtoe<lankle rbigtoe<rankle lsmalltoe<lbigtoe '
            'rsmalltoe<rbigtoe lheel<lankle rheel<rankle',
        ),
        _layout(
            'mediapipe33',
            'nose leye_inner<nose leye<leye_inner leye_outer<leye reye_inner<nose '
            'reye<reye_inner reye_outer<reye lear<leye_outer rear<reye_outer mouth_l<nose '
            'mouth_r<nose lshoulder<rshoulder rshoulder lelbow<lshoulder relbow<rshoulder '
            'lwrist<lelbow rwrist<relbow lpinky<lwrist rpinky<rwrist lindex<lwrist '
            'rindex<rwrist lthumb<lwrist rthumb<rwrist lhip<lshoulder rhip<rshoulder lknee<lhip '
            'rknee<rhip lankle<lknee rankle<rknee lheel<lankle rheel<rankle '
            'lfoot_index<lankle rfoot_index<rankle',
        ),
        _layout(
            'h36m17',
            'pelvis rhip<pelvis rknee<rhip rankle<rknee lhip<pelvis lknee<lhip lankle<lknee '
            'spine<pelvis neck<spine nose<neck headtop<nose lshoulder<neck lelbow<lshoulder '
            'lwrist<lelbow rshoulder<neck relbow<rshoulder rwrist<relbow',
        ),
    )
}


LAYOUT_NAMES = tuple(_LAYOUTS)


CMU15 = _LAYOUTS['cmu15']


NAMES_SHOWN = 5


_SIDES = {'l': 'l', 'left': 'l', 'r': 'r', 'right': 'r'}


_SYNONYMS = {'midhip': 'pelvis'}


def _spelt(name: str) -> tuple[str, str]:
    """Side (`l`, `r` or empty) and the rest of a joint name, whatever its case and separators."""
    words = re.sub(r'([a-z0-9])([A-Z])|([A-Z])([A-Z][a-z])', r'\1\3_\2\4', name).lower()
    parts = [part for part in re.split(r'[^a-z0-9]+', words) if part]
    side = next((part for part in parts if part in _SIDES), '')
    if side:
        parts.remove(side)
    return _SIDES.get(side, ''), ''.join(parts)


def _own_spellings() -> dict[tuple[str, str], str]:
    """Every joint name of the layouts by what `_spelt` makes of its spellings."""
    own = {('', other): joint for other, joint in _SYNONYMS.items()}
    for skeleton in _LAYOUTS.values():
        for joint, twin in zip(skeleton.joints, skeleton.mirror, strict=True):
            side, spelling = _spelt(joint)
            own[side, spelling] = joint
            if not side and joint != skeleton.joints[twin]:
                own[joint[0], spelling[1:]] = joint
                own |= {('', word + spelling[1:]): joint for word, letter in _SIDES.items() if letter == joint[0]}
    return own


_OWN_SPELLINGS = _own_spellings()


def own_names(names: Sequence[str]) -> tuple[str, ...]:
    """Joint names as this package spells them: `left_shoulder`, `LShoulder` or `l-shoulder` is `lshoulder`.

    Names that are not known stay as they are.
    """
    return tuple(_OWN_SPELLINGS.get(_spelt(name), name) for name in names)


def layout(name: str) -> Skeleton:
    """The layout of that name.

    Raises:
        SkeletonError: the name is not known; the message lists those that are.
    """
    try:
        return _LAYOUTS[name]
    except KeyError:
        raise SkeletonError(f'unknown keypoint layout {name!r}; known: {", ".join(LAYOUT_NAMES)}') from None


def skeleton_of(joints: tuple[str, ...]) -> Skeleton:
    """The known layout with exactly these joints, or these joints without any bones."""
    same = [s for s in _LAYOUTS.values() if s.joints == joints]
    return same[0] if same else Skeleton('', joints, (-1,) * len(joints))


@dataclass(frozen=True)
class _Recipe:
    """One way to derive a joint: weighted sum of others, and how far to trust it."""

    weights: dict[str, float]
    trust: float


_SHOULDERS = {'lshoulder': 0.5, 'rshoulder': 0.5}


_HIPS = {'lhip': 0.5, 'rhip': 0.5}


def _along_neck(top: dict[str, float], share: float) -> dict[str, float]:
    """The point at `share` of the way from between the shoulders to `top`."""
    towards = {j: share * w for j, w in top.items()}
    return towards | {j: (1 - share) * w for j, w in _SHOULDERS.items()}


# The model's head joint is the tip of the CMU head bone, a hand's breadth above the ears; its share of the
# way from the shoulders to what a detector sees was read off CMU and anthropometric tables (+-3 cm).
_DERIVED: dict[str, tuple[_Recipe, ...]] = {
    'neck': (_Recipe(_SHOULDERS, 1.0), _Recipe({'upperneck': 1.0}, 0.25)),
    'pelvis': (_Recipe(_HIPS, 1.0),),
    'head': (
        _Recipe(_along_neck({'headtop': 1.0}, 0.8), 0.5),
        _Recipe(_along_neck({'lear': 0.5, 'rear': 0.5}, 1.3), 0.5),
        _Recipe(_along_neck({'leye': 0.5, 'reye': 0.5}, 1.2), 0.2),
        _Recipe(_along_neck({'nose': 1.0}, 1.3), 0.1),
    ),
}


@dataclass(frozen=True)
class JointMap:
    """Linear maps from source joints to target joints, tried in order until one is fully seen.

    Attributes:
        source: (Js,) source joint names.
        target: the skeleton mapped to.
        weights: (A, Jt, Js) alternatives; rows sum to one, or are zero where an alternative does not exist.
        trust: (A, Jt) factor on the score, 0 where the alternative does not exist.
    """

    source: tuple[str, ...]
    target: Skeleton
    weights: Array
    trust: Array

    def apply(self, points: Array, score: Array) -> tuple[Array, Array]:
        """Keypoints of the target skeleton.

        Args:
            points: (..., Js, D) coordinates, any unit; NaN where not seen.
            score: (..., Js) in [0, 1]; 0 where not seen.

        Returns:
            (..., Jt, D) points, NaN where no alternative is fully seen, and (..., Jt) scores (the least
            score that went in, times the alternative's trust).
        """
        seen = (score > 0) & np.isfinite(points).all(-1)
        clean = np.where(seen[..., None], points, 0.0)
        lead = points.shape[:-2]
        out = np.full((*lead, len(self.target.joints), points.shape[-1]), np.nan)
        out_score = np.zeros(out.shape[:-1])
        for weights, trust in zip(self.weights, self.trust, strict=True):
            used = weights != 0
            usable = ~(used & ~seen[..., None, :]).any(-1) & (trust > 0)
            take = usable & (out_score == 0)
            least = np.where(used, score[..., None, :], np.inf).min(-1)
            out = np.where(take[..., None], weights @ clean, out)
            out_score = np.where(take, np.where(take, least, 0.0) * trust, out_score)
        return out, out_score


def _useful(target: Skeleton) -> list[str]:
    """Names of the joints that a map to `target` can use."""
    derived = [j for joint in target.joints for recipe in _DERIVED.get(joint, ()) for j in recipe.weights]
    return list(dict.fromkeys([*target.joints, *derived]))


def model_joints(
    points: Array, score: Array, names: tuple[str, ...], min_score: float, target: Skeleton = CMU15
) -> tuple[Array, Array]:
    """A detector's keypoints as the solvers want them.

    Args:
        points: (..., Js, 2), any unit; NaN where not seen.
        score: (..., Js); below `min_score` counts as not seen.
        names: (Js,) of the joints, in any spelling.
        min_score: the least score of a joint that is seen.
        target: the model's joints.

    Returns:
        (..., Jt, 2) points and (..., Jt) scores of `target`; both 0 where not seen.

    Raises:
        SkeletonError: as `joint_map`.
    """
    score = np.where(score >= min_score, score, 0.0)
    points, weight = joint_map(names, target).apply(points, score)
    return np.where(weight[..., None] > 0, points, 0.0), weight


@lru_cache(maxsize=64)
def joint_map(source: tuple[str, ...], target: Skeleton = CMU15) -> JointMap:
    """The map from joints of these names, in any spelling, to `target`: the joint itself, else derived ones.

    Raises:
        SkeletonError: fewer than four of the target's joints can be had; lists the names that are of use.
    """
    source = own_names(source)
    if len(set(source)) != len(source):
        twice = max(source, key=source.count)
        raise SkeletonError(f'joint names repeat: {twice}')
    recipes = [
        [r for r in (_Recipe({joint: 1.0}, 1.0), *_DERIVED.get(joint, ())) if all(j in source for j in r.weights)]
        for joint in target.joints
    ]
    if sum(bool(r) for r in recipes) < 4:
        few = ', '.join(source[:NAMES_SHOWN]) + (', ...' if len(source) > NAMES_SHOWN else '')
        raise SkeletonError(
            f'{few or "no names"}: fewer than four joints of the body; known: {", ".join(_useful(target))}'
        )
    alternatives = max(map(len, recipes))
    weights = np.zeros((alternatives, len(target.joints), len(source)))
    trust = np.zeros(weights.shape[:2])
    for t, ways in enumerate(recipes):
        for a, recipe in enumerate(ways):
            trust[a, t] = recipe.trust
            for joint, weight in recipe.weights.items():
                weights[a, t, source.index(joint)] = weight
    return JointMap(source, target, weights, trust)


STATURE_OVER_BONES = 1.135


_SPINE = (('pelvis', 'neck'), ('neck', 'head'))


_LEGS = (('lhip', 'lknee'), ('lknee', 'lankle'), ('rhip', 'rknee'), ('rknee', 'rankle'))


def stature(poses: Array, skeleton: Skeleton) -> float:
    """m, mean stature of the owners of poses (..., J, 3), from the lengths of legs, trunk and neck.

    The factor between the two is 1.131 to 1.139 over the subjects of the CMU database.
    """
    parents, children = zip(*[(skeleton.index(a), skeleton.index(b)) for a, b in (*_LEGS, *_SPINE)], strict=True)
    lengths = np.linalg.norm(poses[..., children, :] - poses[..., parents, :], axis=-1)
    mean = lengths.reshape(-1, len(parents)).mean(axis=0)
    return float(STATURE_OVER_BONES * (mean[: len(_LEGS)].sum() / 2 + mean[len(_LEGS) :].sum()))
