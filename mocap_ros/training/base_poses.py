"""Learning base poses from motion capture (TPAMI 2016, section 4.1)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from mocap_ros.errors import ModelError
from mocap_ros.geometry.rotations import centred, heading_to, rotation_to
from mocap_ros.models.base_poses import BasePoses, mirrored
from mocap_ros.models.model_file import STATURES
from mocap_ros.skeleton import CMU15, Skeleton, stature

Array = NDArray[np.float64]

NEGLIGIBLE_STD = 1e-4


def procrustes_mean(
    poses: Array, align: Callable[[Array, Array], Array], rounds: int = 50, tolerance: float = 1e-7
) -> tuple[Array, Array]:
    """Generalised Procrustes: all poses aligned to their own mean.

    Args:
        poses: (N, J, 3) centred poses.
        align: `rotation_to` or `heading_to`.
        rounds: at most so many passes.
        tolerance: m, change of the mean that ends it.

    Returns:
        (J, 3) mean, and the (N, J, 3) aligned poses.
    """
    mean = poses[0]
    for _ in range(rounds):
        aligned = poses @ np.swapaxes(align(poses, mean), -1, -2)
        new = aligned.mean(axis=0)
        moved = np.abs(new - mean).max()
        mean = new
        if moved < tolerance:
            break
    return mean, aligned


def facing_forward(mean: Array, skeleton: Skeleton) -> Array:
    """(3, 3) rotation about z after which left joints of `mean` lie towards +y and the body faces +x."""
    left, right = zip(*skeleton.pairs, strict=True)
    across = (mean[list(left)] - mean[list(right)]).sum(axis=0)
    angle = np.pi / 2 - np.arctan2(across[1], across[0])
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def with_bone_lengths(poses: Array, skeleton: Skeleton, factor: Array) -> Array:
    """Poses (..., J, 3) with every bone stretched, directions kept; `factor` (bones,) as `skeleton.bones`."""
    by_child = {child: f for (_, child), f in zip(skeleton.bones, factor, strict=True)}
    out = poses.copy()
    for parent, child in skeleton.outward():
        out[..., child, :] = out[..., parent, :] + by_child[child] * (poses[..., child, :] - poses[..., parent, :])
    return out


def _random_bodies(
    poses: Array, skeleton: Skeleton, spread: float, count: int, rng: np.random.Generator
) -> list[Array]:
    """The same (F, J, 3) motion on `count` other bodies, left and right limbs alike."""
    names = [skeleton.joints[c] for _, c in skeleton.bones]
    twins = [min(n, skeleton.joints[skeleton.mirror[skeleton.index(n)]]) for n in names]
    out = []
    for _ in range(count):
        by_name = {n: 1 + spread * rng.standard_normal() for n in sorted(set(twins))}
        factor = np.array([by_name[t] for t in twins])
        out.append(with_bone_lengths(poses, skeleton, factor))
    return out


def _check_trial(trial: Array, skeleton: Skeleton, label: object) -> None:
    if trial.ndim != 3 or trial.shape[1:] != (len(skeleton.joints), 3):
        raise ModelError(f'trial {label} has shape {trial.shape}, expected (frames, {len(skeleton.joints)}, 3)')
    if not np.isfinite(trial).all():
        raise ModelError(f'trial {label} holds numbers that are not finite')
    low, high = STATURES
    if len(trial) and np.abs(trial - trial[:, :1]).max() > 2 * high:
        raise ModelError(f'trial {label}: joints more than {2 * high:g} m apart; m expected')
    if len(trial) and not low <= stature(trial, skeleton) <= high:
        raise ModelError(
            f'trial {label}: a body {stature(trial, skeleton):.3g} m tall, expected {low} to {high} m'
        )


def fit_base_poses(
    trials: Sequence[Array],
    *,
    name: str = 'all',
    skeleton: Skeleton = CMU15,
    components: int = 45,
    alignment: str = 'rotation',
    mirror: bool = False,
    bodies: int = 0,
    body_spread: float = 0.05,
    seed: int = 0,
    provenance: Mapping[str, object] | None = None,
    labels: Sequence[str] = (),
) -> BasePoses:
    """Learn base poses from motion capture (TPAMI 2016, section 4.1, with poses aligned first).

    Args:
        trials: (F_i, J, 3) arrays, metres, z up.
        name: motion category.
        skeleton: names and tree of the J joints.
        components: base poses kept at most; those of negligible variance never are.
        alignment: `rotation` (generalised Procrustes) or `heading` (rotation about the vertical only).
        mirror: add the mirror image of every pose.
        bodies: how many bodies with randomly scaled bones to add to each trial.
        body_spread: standard deviation of their bone scale factors.
        seed: of those factors.
        provenance: recorded in the model.
        labels: names of the trials, for errors; numbers by default.

    Raises:
        ModelError: no trials, wrong shapes, numbers that are not finite, poses that are no people in m, or that
            do not vary.
    """
    align = {'rotation': rotation_to, 'heading': heading_to}.get(alignment)
    if align is None:
        raise ModelError(f'alignment {alignment!r}: expected rotation or heading')
    if not trials or sum(map(len, trials)) < 2:
        raise ModelError('training needs at least two poses')
    for i, trial in enumerate(trials):
        _check_trial(trial, skeleton, labels[i] if labels else i)
    rng = np.random.default_rng(seed)
    stacked = [np.asarray(t, float) for t in trials]
    stacked += [b for t in stacked for b in _random_bodies(t, skeleton, body_spread, bodies, rng)]
    poses = centred(np.concatenate(stacked))
    if mirror:
        poses = np.concatenate([poses, mirrored(poses, skeleton)])
    mean, aligned = procrustes_mean(poses, align)
    turn = facing_forward(mean, skeleton)
    mean, aligned = mean @ turn.T, aligned @ turn.T

    flat = (aligned - mean).reshape(len(aligned), -1)
    variance, vectors = np.linalg.eigh(flat.T @ flat / len(flat))
    order = np.argsort(variance)[::-1][:components]
    order = order[variance[order] > NEGLIGIBLE_STD**2]
    if not len(order):
        raise ModelError('the poses do not vary: nothing to learn')
    basis = vectors[:, order].T
    largest = np.take_along_axis(basis, np.abs(basis).argmax(axis=1)[:, None], axis=1)
    return BasePoses(
        name=name,
        skeleton=skeleton,
        mean=mean,
        components=(basis * np.sign(largest)).reshape(-1, *mean.shape),
        std=np.sqrt(variance[order]),
        explained=np.cumsum(variance[order]) / variance.sum(),
        stature=stature(np.concatenate(stacked), skeleton),
        provenance={
            'alignment': alignment,
            'mirror': mirror,
            'bodies': bodies,
            'body_spread': body_spread if bodies else 0.0,
            'seed': seed,
            'poses': int(sum(map(len, trials))),
            **(provenance or {}),
        },
    )
