# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Training of base poses from motion capture (TPAMI 2016, section 4.1).

    P_i R_i^T - Q_0 = sum_l theta_il Q_l,   Q_l: eigenvectors of the covariance of the aligned poses (PCA)

The poses P_i are aligned to their mean Q_0 by rotations R_i before the principal component analysis (generalised
Procrustes analysis). The paper does not align them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.errors import ModelError
from mocap_ros.geometry.rotations import centre_poses, fit_heading_rotation, fit_rotation
from mocap_ros.models.base_poses import PoseModel, mirror_poses
from mocap_ros.models.model_file import STATURE_RANGE_M
from mocap_ros.skeleton import CMU15, Skeleton, estimate_stature

MAX_ALIGNMENT_PASSES = 50  # passes over the poses in `align_to_mean`; CMU motions need 8 to 16
ALIGNMENT_TOLERANCE_M = 1e-7  # m; the alignment ends when every coordinate of the mean changes by less
BODY_SPREAD = 0.05  # share; standard deviation of bone lengths among random bodies, about that among adults
BODY_SEED = 0  # of these factors; any fixed number, so that training can be repeated
MIN_WEIGHT_STD_M = 1e-4  # m; base poses that vary less are numerical noise, and solvers divide by their variance


def align_to_mean(poses: Array, shares: Array, align: Callable[[Array, Array], Array]) -> tuple[Array, Array]:
    """Align centred poses (N, J, 3) in m to their own mean by rotations, `fit_rotation` or `fit_heading_rotation`.

    The first pose is the first estimate of the mean, and so determines the orientation of the result. The shares
    (N,) of the poses in the mean have the sum 1. Returns the mean (J, 3) and the aligned poses (N, J, 3).
    """
    mean = poses[0]
    for _ in range(MAX_ALIGNMENT_PASSES):
        aligned = poses @ np.swapaxes(align(poses, mean), -1, -2)
        updated_mean = np.tensordot(shares, aligned, axes=1)
        change = np.abs(updated_mean - mean).max()
        mean = updated_mean
        if change < ALIGNMENT_TOLERANCE_M:
            break
    return mean, aligned


def rotation_to_face_forward(mean: Array, skeleton: Skeleton) -> Array:
    """Return the rotation (3, 3) about z after which the pose `mean` (J, 3) faces +x and its left is +y."""
    left, right = zip(*skeleton.left_right_pairs, strict=True)
    across = (mean[list(left)] - mean[list(right)]).sum(axis=0)
    angle = np.pi / 2 - np.arctan2(across[1], across[0])
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def scale_bones(poses: Array, skeleton: Skeleton, factor: Array) -> Array:
    """Scale the bones of poses (..., J, 3) by factors (B,), ordered as `skeleton.bones`; keep their directions."""
    by_child = {child: f for (_, child), f in zip(skeleton.bones, factor, strict=True)}
    out = poses.copy()
    for parent, child in skeleton.outward_bones():
        out[..., child, :] = out[..., parent, :] + by_child[child] * (poses[..., child, :] - poses[..., parent, :])
    return out


def _transfer_to_random_bodies(
    poses: Array, skeleton: Skeleton, count: int, rng: np.random.Generator
) -> list[Array]:
    """Return `count` copies of a motion (F, J, 3) with random bone lengths, the same left and right."""
    names = [min(skeleton.joints[c], skeleton.joints[skeleton.mirror[c]]) for _, c in skeleton.bones]
    out = []
    for _ in range(count):
        by_name = {n: 1 + BODY_SPREAD * rng.standard_normal() for n in sorted(set(names))}
        out.append(scale_bones(poses, skeleton, np.array([by_name[n] for n in names])))
    return out


def _check_trial(trial: Array, skeleton: Skeleton, label: object) -> None:
    """Raise `ModelError` unless a trial holds finite poses of a person in metres."""
    if trial.ndim != 3 or trial.shape[1:] != (len(skeleton.joints), 3):
        raise ModelError(f'trial {label} has shape {trial.shape}, expected (frames, {len(skeleton.joints)}, 3)')
    if not np.isfinite(trial).all():
        raise ModelError(f'trial {label} holds numbers that are not finite')
    if not len(trial):
        return
    low, high = STATURE_RANGE_M
    if np.abs(trial - trial[:, :1]).max() > 2 * high:
        raise ModelError(f'trial {label}: joints more than {2 * high:g} m apart; m expected')
    stature = estimate_stature(trial, skeleton)
    if not low <= stature <= high:
        raise ModelError(f'trial {label}: a body {stature:.3g} m tall, expected {low} to {high} m')


def fit_base_poses(
    trials: Sequence[Array],
    *,
    shares: Sequence[float] | Array | None = None,
    name: str = 'all',
    skeleton: Skeleton = CMU15,
    components: int = 45,
    alignment: str = 'rotation',
    mirror: bool = False,
    bodies: int = 0,
    provenance: Mapping[str, object] | None = None,
    labels: Sequence[str] = (),
) -> PoseModel:
    """Train base poses on motion capture (TPAMI 2016, section 4.1, with poses aligned first).

    Args:
        trials: arrays (F_i, J, 3) in m, z up.
        shares: weight of each trial, which its poses share; by default every pose weighs the same.
        name: motion category of the model.
        skeleton: names and bones of the J joints.
        components: largest number of base poses, without those that hardly vary.
        alignment: `rotation` to align poses by any rotation, `heading` to rotate them about the vertical only.
        mirror: whether to add the mirror image of every pose.
        bodies: number of bodies with random bone lengths to which each trial is transferred in addition.
        provenance: further entries of the model's provenance, besides those of the training itself.
        labels: names of the trials for error messages; their numbers by default.

    Raises:
        ModelError: There are fewer than two poses, a trial does not hold finite poses of a person in metres, the
            alignment is unknown, or the poses do not vary.
    """
    align = {'rotation': fit_rotation, 'heading': fit_heading_rotation}.get(alignment)
    if align is None:
        raise ModelError(f'alignment {alignment!r}: expected rotation or heading')
    if not trials or sum(map(len, trials)) < 2:
        raise ModelError('training needs at least two poses')
    for i, trial in enumerate(trials):
        _check_trial(trial, skeleton, labels[i] if labels else i)
    rng = np.random.default_rng(BODY_SEED)
    motions = [np.asarray(t, float) for t in trials]
    motions += [b for t in motions for b in _transfer_to_random_bodies(t, skeleton, bodies, rng)]
    lengths = np.array([len(t) for t in trials])
    trial_shares = lengths / lengths.sum() if shares is None else np.asarray(shares) / np.sum(shares)
    copies = np.concatenate([np.arange(len(trials)), np.repeat(np.arange(len(trials)), bodies)])
    of_pose = np.repeat((trial_shares / np.maximum(lengths, 1))[copies], lengths[copies])
    poses = centre_poses(np.concatenate(motions))
    if mirror:
        poses = np.concatenate([poses, mirror_poses(poses, skeleton)])
        of_pose = np.concatenate([of_pose, of_pose])
    pose_shares = of_pose / of_pose.sum()
    mean, aligned = align_to_mean(poses, pose_shares, align)
    rotation = rotation_to_face_forward(mean, skeleton)
    mean, aligned = mean @ rotation.T, aligned @ rotation.T
    basis, variance, total_variance = _principal_components(aligned, pose_shares, mean, components)
    return PoseModel(
        name=name,
        skeleton=skeleton,
        mean=mean,
        components=basis,
        std=np.sqrt(variance),
        explained=np.cumsum(variance) / total_variance,
        stature=float(trial_shares @ [estimate_stature(t, skeleton) for t in trials]),
        provenance={
            **(provenance or {}),
            'alignment': alignment,
            'mirror': mirror,
            'bodies': bodies,
            'body_spread': BODY_SPREAD if bodies else 0.0,
            'seed': BODY_SEED,
            'poses': int(sum(map(len, trials))),
        },
    )


def _principal_components(
    poses: Array, shares: Array, mean: Array, max_components: int
) -> tuple[Array, Array, float]:
    """Return the principal components of poses (N, J, 3) with weights (N,) about their mean (J, 3).

    These are (K, J, 3), orthonormal, by decreasing variance, with the entry of largest magnitude positive; then
    come their variances (K,) and the total variance in m^2.
    """
    flat = (poses - mean).reshape(len(poses), -1)
    variance, vectors = np.linalg.eigh(flat.T @ (shares[:, None] * flat))
    order = np.argsort(variance)[::-1][:max_components]
    order = order[variance[order] > MIN_WEIGHT_STD_M**2]
    if not len(order):
        raise ModelError('the poses do not vary: nothing to learn')
    basis = vectors[:, order].T
    largest = np.take_along_axis(basis, np.abs(basis).argmax(axis=1)[:, None], axis=1)
    return (basis * np.sign(largest)).reshape(-1, *mean.shape), variance[order], variance.sum()
