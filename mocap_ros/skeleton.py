# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Keypoint layouts, the skeleton of the reconstruction, and the canonical spelling of joint names.

Canonical names are lower case with the side as first letter, for example `lshoulder`. `CMU15` is the skeleton of
the solvers, `BODY26` adds face, feet and hands; maps from one layout to another are in `keypoints.joint_map`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.errors import SkeletonError, suggest

# 1; stature = this factor * (legs + trunk + neck and head), 1.131 to 1.139 over the subjects of the CMU database
STATURE_PER_BONE_LENGTH = 1.135


@dataclass(frozen=True)
class Skeleton:
    """A keypoint layout: named joints in a fixed order, and the bones between them."""

    name: str  # as in messages and files
    joints: tuple[str, ...]  # names in the order of the data
    parents: tuple[int, ...]  # index of each joint's parent, -1 for a root, of which there may be several

    def __hash__(self) -> int:  # that of all fields would take longer than what is looked up with it
        return hash(self.name)

    @cached_property
    def bones(self) -> tuple[tuple[int, int], ...]:
        """Return (parent, child) joint indices of every bone, ordered by child."""
        return tuple((p, c) for c, p in enumerate(self.parents) if p >= 0)

    @cached_property
    def bone_ends(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return the (B,) indices of the parent and of the child of every bone, in the order of `bones`."""
        parents, children = zip(*self.bones, strict=True)
        return np.array(parents), np.array(children)

    def bone_lengths(self, poses: Array) -> Array:
        """Return the (..., B) bone lengths of poses (..., J, 3) in their unit, in the order of `bones`."""
        parents, children = self.bone_ends
        bones = np.take(poses, children, axis=-2) - np.take(poses, parents, axis=-2)
        return np.asarray(np.linalg.norm(bones, axis=-1))

    @cached_property
    def stature_per_bone(self) -> Array:
        """Return the (B,) stature per length of each bone: stature = sum_b (stature per bone b) (length of b).

        Raises:
            SkeletonError: The skeleton lacks a bone of legs, trunk or neck.
        """
        out = np.zeros(len(self.bones))
        for parent, child, share in _STATURE_BONES:
            bone = self.index(parent), self.index(child)
            if bone not in self.bones:
                raise SkeletonError(f'layout {self.name!r} has no bone from {parent} to {child}')
            out[self.bones.index(bone)] = STATURE_PER_BONE_LENGTH * share
        return out

    @cached_property
    def mirror(self) -> tuple[int, ...]:
        """Return the permutation of joint indices that exchanges left and right joints."""
        return tuple(self.joints.index(_find_twin(j, self.joints)) for j in self.joints)

    @cached_property
    def left_right_pairs(self) -> tuple[tuple[int, int], ...]:
        """Return (left, right) joint indices of every joint that exists on both sides."""
        return tuple((i, m) for i, m in enumerate(self.mirror) if i != m and _is_left(self.joints[i], self.joints))

    def index(self, joint: str) -> int:
        """Return the index of a joint.

        Raises:
            SkeletonError: The layout has no joint of this name; the message lists its joints.
        """
        try:
            return self.joints.index(joint)
        except ValueError:
            raise SkeletonError(
                f'layout {self.name!r} has no joint {joint!r}; it has {", ".join(self.joints)}'
            ) from None

    def outward_bones(self) -> tuple[tuple[int, int], ...]:
        """Return the bones as (parent, child), ordered so that every bone comes after the bone of its parent."""
        reached = [i for i, p in enumerate(self.parents) if p < 0]
        order: list[tuple[int, int]] = []
        for joint in reached:
            children = [c for c, p in enumerate(self.parents) if p == joint]
            order += [(joint, c) for c in children]
            reached += children
        return tuple(order)


def _find_twin(joint: str, joints: Sequence[str]) -> str:
    for side, opposite in (('l', 'r'), ('r', 'l')):
        if joint.startswith(side) and opposite + joint[1:] in joints:
            return opposite + joint[1:]
        if joint.endswith('_' + side) and joint[:-1] + opposite in joints:
            return joint[:-1] + opposite
    return joint


def _is_left(joint: str, joints: Sequence[str]) -> bool:
    twin = _find_twin(joint, joints)
    return joint.endswith('_l') if joint[1:] != twin[1:] else joint.startswith('l')


def _parse_layout(name: str, tree: str) -> Skeleton:
    """Parse a layout from `joint<parent` words in data order; a word without `<` is a root."""
    words = [w.partition('<') for w in tree.split()]
    joints = tuple(w[0] for w in words)
    parents = tuple(joints.index(w[2]) if w[2] else -1 for w in words)
    return Skeleton(name, joints, parents)


# Parts that several layouts share; `{}` stands for the parent of the first joint of the part.
_FACE = 'nose{} leye<nose reye<nose lear<leye rear<reye '
_COCO_BODY = (
    'lshoulder{0} rshoulder{0} lelbow<lshoulder relbow<rshoulder lwrist<lelbow rwrist<relbow '
    'lhip{1} rhip{1} lknee<lhip rknee<rhip lankle<lknee rankle<rknee '
)
_OPENPOSE_BODY = (
    'nose<neck neck rshoulder<neck relbow<rshoulder rwrist<relbow lshoulder<neck lelbow<lshoulder lwrist<lelbow '
)
_OPENPOSE_LEGS = 'rhip<{0} rknee<rhip rankle<rknee lhip<{0} lknee<lhip lankle<lknee '
_OPENPOSE_FACE = 'reye<nose leye<nose rear<reye lear<leye '
_FEET = 'lbigtoe<lankle lsmalltoe<lbigtoe lheel<lankle rbigtoe<rankle rsmalltoe<rbigtoe rheel<rankle'
_CMU_BODY = (
    'head<neck neck<pelvis lshoulder<neck lelbow<lshoulder lwrist<lelbow rshoulder<neck relbow<rshoulder '
    'rwrist<relbow pelvis lhip<pelvis lknee<lhip lankle<lknee rhip<pelvis rknee<rhip rankle<rknee '
)

_TREES = {
    # the skeleton of this package: the CMU motion capture joints that detectors see, without hands and feet
    'cmu15': _CMU_BODY,
    # the joints of `cmu15`, then what detectors see of feet, hands and face
    'body26': _CMU_BODY + 'ltoe<lankle rtoe<rankle lheel<lankle rheel<rankle lhand<lwrist rhand<rwrist nose<head '
    'leye<nose reye<nose lear<leye rear<reye',
    # COCO person keypoints; most detectors of today
    'coco17': _FACE.format('') + 'lshoulder<rshoulder rshoulder lelbow<lshoulder relbow<rshoulder lwrist<lelbow '
    'rwrist<relbow lhip<lshoulder rhip<rshoulder lknee<lhip rknee<rhip lankle<lknee rankle<rknee',
    # OpenPose's COCO model, and body format 18 of the ZED SDK
    'coco18': _OPENPOSE_BODY + _OPENPOSE_LEGS.format('neck') + _OPENPOSE_FACE,
    # hri_msgs/Skeleton2D of ROS4HRI: as coco18, but left eye and ear before the right ones
    'hri18': _OPENPOSE_BODY + _OPENPOSE_LEGS.format('neck') + 'leye<nose reye<nose lear<leye rear<reye',
    # OpenPose BODY_25
    'body25': _OPENPOSE_BODY + 'pelvis<neck ' + _OPENPOSE_LEGS.format('pelvis') + _OPENPOSE_FACE + _FEET,
    # OpenPose BODY_25B
    'body25b': _FACE.format('<upperneck') + _COCO_BODY.format('<upperneck', '<upperneck') + 'upperneck '
    'headtop<upperneck ' + _FEET,
    # Halpe-FullBody without face and hands, used by AlphaPose and RTMPose
    'halpe26': _FACE.format('<neck') + _COCO_BODY.format('<neck', '<pelvis') + 'headtop<neck neck<pelvis pelvis '
    'lbigtoe<lankle rbigtoe<rankle lsmalltoe<lbigtoe rsmalltoe<rbigtoe lheel<lankle rheel<rankle',
    # MediaPipe Pose (BlazePose)
    'mediapipe33': 'nose leye_inner<nose leye<leye_inner leye_outer<leye reye_inner<nose reye<reye_inner '
    'reye_outer<reye lear<leye_outer rear<reye_outer mouth_l<nose mouth_r<nose lshoulder<rshoulder rshoulder '
    'lelbow<lshoulder relbow<rshoulder lwrist<lelbow rwrist<relbow lpinky<lwrist rpinky<rwrist lindex<lwrist '
    'rindex<rwrist lthumb<lwrist rthumb<rwrist lhip<lshoulder rhip<rshoulder lknee<lhip rknee<rhip lankle<lknee '
    'rankle<rknee lheel<lankle rheel<rankle lfoot_index<lankle rfoot_index<rankle',
    # Human3.6M, as 3D benchmarks reduce it to 17 joints
    'h36m17': 'pelvis rhip<pelvis rknee<rhip rankle<rknee lhip<pelvis lknee<lhip lankle<lknee spine<pelvis '
    'neck<spine nose<neck headtop<nose lshoulder<neck lelbow<lshoulder lwrist<lelbow rshoulder<neck '
    'relbow<rshoulder rwrist<relbow',
}

KEYPOINT_LAYOUTS = {name: _parse_layout(name, tree) for name, tree in _TREES.items()}  # by name
KNOWN_JOINTS = frozenset(j for layout in KEYPOINT_LAYOUTS.values() for j in layout.joints)
LAYOUT_NAMES = tuple(KEYPOINT_LAYOUTS)  # names of the known layouts, for messages, files and --layout
CMU15 = KEYPOINT_LAYOUTS['cmu15']  # skeleton of the base poses and the solvers
BODY26 = KEYPOINT_LAYOUTS['body26']  # skeleton of the lifter: that of the solvers, then face, feet and hands
CORE_COUNT = len(CMU15.joints)  # joints; the first of `BODY26` are those of `CMU15`
HIPS = CMU15.index('lhip'), CMU15.index('rhip')  # joints between which the root is
EXTREMITY_COUNT = len(BODY26.joints) - CORE_COUNT  # joints; the others, of face, feet and hands

# Words that name a side, and the letter of the side in canonical joint names.
_SIDES = {'l': 'l', 'left': 'l', 'r': 'r', 'right': 'r'}

# Names that detectors use for a joint, and the canonical name of the joint.
_SYNONYMS = {'midhip': 'pelvis', 'tophead': 'headtop', 'headbottom': 'upperneck'}
# Names that stand for a joint where no other name does: those of Human3.6M, Halpe, CMU Panoptic and their like.
_WEAK_SYNONYMS = {
    'root': 'pelvis', 'hip': 'pelvis', 'hips': 'pelvis', 'hipcenter': 'pelvis', 'centerhip': 'pelvis',
    'bodycenter': 'pelvis', 'thorax': 'neck', 'necktop': 'upperneck',
}  # fmt: skip
MIN_LIKENESS = 0.8  # 1; share of the names in the order of a layout from which on a list of names is that layout


def find_roots(joints: Array) -> Array:
    """Return the points (..., 3) midway between the hips, or their velocities, of joints (..., J, 3)."""
    return np.asarray((joints[..., HIPS[0], :] + joints[..., HIPS[1], :]) / 2)


def _split_joint_name(name: str) -> tuple[str, str]:
    """Return the side (`l`, `r` or empty) and the rest of a joint name, without case and separators."""
    words = re.sub(r'([a-z0-9])([A-Z])|([A-Z])([A-Z][a-z])', r'\1\3_\2\4', name).lower()
    parts = [part for part in re.split(r'[^a-z0-9]+', words) if part]
    side = next((part for part in parts if part in _SIDES), '')
    if side:
        parts.remove(side)
    return _SIDES.get(side, ''), ''.join(parts)


def _build_spelling_table() -> dict[tuple[str, str], str]:
    """Return the canonical joint name for each result of `_split_joint_name` that names a joint of a layout."""
    table = {('', synonym): joint for synonym, joint in _SYNONYMS.items()}
    for skeleton in KEYPOINT_LAYOUTS.values():
        for joint, twin in zip(skeleton.joints, skeleton.mirror, strict=True):
            side, spelling = _split_joint_name(joint)
            table[side, spelling] = joint
            if not side and joint != skeleton.joints[twin]:
                table[joint[0], spelling[1:]] = joint
                table |= {
                    ('', word + spelling[1:]): joint for word, letter in _SIDES.items() if letter == joint[0]
                }
    return table


_CANONICAL_NAMES = _build_spelling_table()  # canonical joint names by side and rest of a name


def canonical_joint_names(names: Sequence[str]) -> tuple[str, ...]:
    """Convert joint names to the canonical spelling: `left_shoulder`, `LShoulder` and `l-shoulder` to `lshoulder`.

    Names that stand for a joint only where no other does, such as `root` and `left_foot` of Human3.6M, are
    converted then. Names of joints that no layout has are returned unchanged.
    """
    split = [_split_joint_name(name) for name in names]
    out = [_CANONICAL_NAMES.get(key, name) for key, name in zip(split, names, strict=True)]
    for i, (side, rest) in enumerate(split):
        joint = f'{side}ankle' if side and rest == 'foot' else '' if side else _WEAK_SYNONYMS.get(rest, '')
        if joint and split[i] not in _CANONICAL_NAMES and joint not in out:
            out[i] = joint
    return tuple(out)


def detector_joint_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return the canonical names of a detector's joints.

    If most of them are a known layout's, in its order, and the others are no joints of it, all are that layout's:
    Human3.6M and Halpe call the top of the head `head`, which is another joint in motion capture.
    """
    out = canonical_joint_names(names)
    for layout in KEYPOINT_LAYOUTS.values():
        if len(layout.joints) == len(out):
            others = [name for name, joint in zip(out, layout.joints, strict=True) if name != joint]
            if len(others) <= (1 - MIN_LIKENESS) * len(out) and not set(others) & set(layout.joints):
                return layout.joints
    return out


def keypoint_layout(name: str) -> Skeleton:
    """Return the keypoint layout of this name.

    Raises:
        SkeletonError: No layout has this name; the message lists the known names.
    """
    try:
        return KEYPOINT_LAYOUTS[name]
    except KeyError:
        raise SkeletonError(f'unknown keypoint layout {name!r}; {suggest(name, LAYOUT_NAMES)}') from None


def skeleton_from_joints(joints: tuple[str, ...]) -> Skeleton:
    """Return the known layout with exactly these joints, or an unnamed skeleton without bones."""
    matches = [s for s in KEYPOINT_LAYOUTS.values() if s.joints == joints]
    return matches[0] if matches else Skeleton('', joints, (-1,) * len(joints))


# (parent, child, share) of the bones whose lengths add up to the stature, legs as the mean of both.
_STATURE_BONES = (
    ('lhip', 'lknee', 0.5),
    ('lknee', 'lankle', 0.5),
    ('rhip', 'rknee', 0.5),
    ('rknee', 'rankle', 0.5),
    ('pelvis', 'neck', 1.0),
    ('neck', 'head', 1.0),
)


def estimate_stature(poses: Array, skeleton: Skeleton) -> float:
    """Return the mean stature in m of poses (..., J, 3) in m: 1.135 (mean leg + trunk + neck length).

    SkeletonError if the skeleton lacks one of these joints.
    """
    parents = [skeleton.index(parent) for parent, _, _ in _STATURE_BONES]
    children = [skeleton.index(child) for _, child, _ in _STATURE_BONES]
    lengths = np.linalg.norm(poses[..., children, :] - poses[..., parents, :], axis=-1)
    mean = lengths.reshape(-1, len(parents)).mean(axis=0)
    return float(STATURE_PER_BONE_LENGTH * (mean @ [share for _, _, share in _STATURE_BONES]))
