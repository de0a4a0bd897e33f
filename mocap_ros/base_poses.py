"""Base poses: the mean human pose and the directions in which poses vary (TPAMI 2016, sections 3.1, 4.1).

A pose is `P = Q0 + sum_l theta_l Q_l` (eq. 1). Body frame: metres, x forward, y left, z up, origin at the
mean of the joints. Poses are centred and aligned before the principal component analysis, since the camera
absorbs translation and rotation and a basis that had to explain them as well would waste its components.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap_ros import npz
from mocap_ros.errors import ModelError, reader_reason
from mocap_ros.skeleton import CMU15, Skeleton, layout

Array = NDArray[np.float64]

AUTO = 'auto'
ALL_MOTIONS = 'all'
LIFTER = 'lifter'

FORMAT = 'mocap_ros base poses 1'
NEGLIGIBLE_STD = 1e-4

LARGEST_MODEL = 16 << 20
LONGEST_NAME = 100
STATURES = 0.3, 3.0
FARTHEST_JOINT = 3.0
STDS = 1e-6, 10.0
ORTHONORMAL = 1e-2

STATURE_OVER_BONES = 1.135
_SPINE = (('pelvis', 'neck'), ('neck', 'head'))
_LEGS = (('lhip', 'lknee'), ('lknee', 'lankle'), ('rhip', 'rknee'), ('rknee', 'rankle'))


@dataclass(frozen=True, eq=False)
class BasePoses:
    """A trained linear pose model.

    Attributes:
        name: motion category it was trained for (`walk`, ..., or `all`).
        skeleton: joints, in the order of the arrays.
        mean: (J, 3) m, mean pose Q0.
        components: (K, J, 3) base poses Q_l, orthonormal, by falling variance, largest entry positive.
        std: (K,) m, standard deviation of each weight theta_l over the training poses.
        explained: (K,) share of the variance, cumulative.
        stature: m, mean stature of the people in the training data.
        provenance: where the training data came from and how it was used.
    """

    name: str
    skeleton: Skeleton
    mean: Array
    components: Array
    std: Array
    explained: Array
    stature: float
    provenance: Mapping[str, object]

    @property
    def upright(self) -> bool:
        """True where poses were turned about the vertical only, so that the body frame's z is up in every pose."""
        return self.provenance.get('alignment') == 'heading'

    def poses(self, theta: Array) -> Array:
        """(..., K) weights in m -> (..., J, 3) poses in m, body frame (eq. 1)."""
        k = theta.shape[-1]
        flat = theta @ self.components[:k].reshape(k, -1)
        return flat.reshape(*theta.shape[:-1], *self.mean.shape) + self.mean

    def weights(self, poses: Array) -> Array:
        """(..., J, 3) centred, aligned poses in m -> (..., K) weights in m, the least-squares ones."""
        flat = (poses - self.mean).reshape(*poses.shape[:-2], -1)
        return flat @ self.components.reshape(len(self.components), -1).T

    def truncated(self, k: int) -> BasePoses:
        """The model with its first `k` base poses, or all if it has fewer."""
        return replace(self, components=self.components[:k], std=self.std[:k], explained=self.explained[:k])

    def rescaled(self, factor: float) -> BasePoses:
        """The model of a body `factor` times as large."""
        return replace(self, mean=self.mean * factor, std=self.std * factor, stature=self.stature * factor)


def centred(poses: Array) -> Array:
    """Poses (..., J, 3) moved so that the mean of the joints is the origin."""
    return poses - poses.mean(axis=-2, keepdims=True)


def rotation_to(poses: Array, target: Array) -> Array:
    """(..., 3, 3) rotations R with `poses @ R^T` closest to `target` (orthogonal Procrustes)."""
    u, _, vt = np.linalg.svd(np.swapaxes(target, -1, -2) @ poses)
    sign = np.ones(u.shape[:-1])
    sign[..., 2] = np.sign(np.linalg.det(u @ vt))
    return np.asarray((u * sign[..., None, :]) @ vt)


def heading_to(poses: Array, target: Array) -> Array:
    """(..., 3, 3) rotations about the vertical (z) that bring `poses` closest to `target`."""
    cross = poses[..., 0] * target[..., 1] - poses[..., 1] * target[..., 0]
    dot = poses[..., 0] * target[..., 0] + poses[..., 1] * target[..., 1]
    angle = np.arctan2(cross.sum(-1), dot.sum(-1))
    c, s, o = np.cos(angle), np.sin(angle), np.zeros_like(angle)
    rows = [[c, -s, o], [s, c, o], [o, o, o + 1]]
    return np.stack([np.stack(r, -1) for r in rows], -2)


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


def mirrored(poses: Array, skeleton: Skeleton) -> Array:
    """Poses (..., J, 3) seen in a mirror: y negated, left and right joints exchanged."""
    return np.asarray(poses[..., list(skeleton.mirror), :] * [1.0, -1.0, 1.0])


def with_bone_lengths(poses: Array, skeleton: Skeleton, factor: Array) -> Array:
    """Poses (..., J, 3) with every bone stretched, directions kept; `factor` (bones,) as `skeleton.bones`."""
    by_child = {child: f for (_, child), f in zip(skeleton.bones, factor, strict=True)}
    out = poses.copy()
    for parent, child in skeleton.outward():
        out[..., child, :] = out[..., parent, :] + by_child[child] * (poses[..., child, :] - poses[..., parent, :])
    return out


def stature(poses: Array, skeleton: Skeleton) -> float:
    """m, mean stature of the owners of poses (..., J, 3), from the lengths of legs, trunk and neck.

    The factor between the two is 1.131 to 1.139 over the subjects of the CMU database.
    """
    parents, children = zip(*[(skeleton.index(a), skeleton.index(b)) for a, b in (*_LEGS, *_SPINE)], strict=True)
    lengths = np.linalg.norm(poses[..., children, :] - poses[..., parents, :], axis=-1)
    mean = lengths.reshape(-1, len(parents)).mean(axis=0)
    return float(STATURE_OVER_BONES * (mean[: len(_LEGS)].sum() / 2 + mean[len(_LEGS) :].sum()))


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


def fit(
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


def save(model: BasePoses, path: str | Path | io.BytesIO) -> None:
    """Write a model as .npz (no pickles); the same model gives the same bytes."""
    meta = {
        'format': FORMAT,
        'name': model.name,
        'skeleton': model.skeleton.name,
        'stature': model.stature,
        'provenance': dict(model.provenance),
    }
    arrays = {
        'mean': model.mean.astype('f4'),
        'components': model.components.astype('f4'),
        'std': model.std.astype('f4'),
        'explained': model.explained.astype('f4'),
        'meta': np.array(json.dumps(meta, sort_keys=True)),
    }
    with zipfile.ZipFile(path, 'w', zipfile.ZIP_DEFLATED) as archive:
        for key, value in arrays.items():
            buffer = io.BytesIO()
            np.lib.format.write_array(buffer, value, allow_pickle=False)
            archive.writestr(zipfile.ZipInfo(f'{key}.npy'), buffer.getvalue(), zipfile.ZIP_DEFLATED)


def shipped_models() -> tuple[str, ...]:
    """Names of the models that come with the package."""
    folder = files('mocap_ros') / 'models'
    names = (p.name.removesuffix('.npz') for p in folder.iterdir() if p.name.endswith('.npz'))
    return tuple(sorted(n for n in names if n != LIFTER))


def load_model(name_or_path: str | Path) -> BasePoses:
    """A shipped model by name, or a trained one by path.

    Raises:
        ModelError: there is none of that name, or the file is not a base-pose model.
    """
    text = str(name_or_path)
    if text in shipped_models():
        return from_bytes((files('mocap_ros') / 'models' / f'{text}.npz').read_bytes(), text)
    path = Path(name_or_path)
    if not path.is_file():
        raise ModelError(f'no base-pose model {text!r}: neither a file nor one of {", ".join(shipped_models())}')
    try:
        with path.open('rb') as file:
            return from_bytes(file.read(LARGEST_MODEL + 1), text)
    except OSError as error:
        raise ModelError(f'{text}: {error.strerror}') from None


def load_models(name: str) -> dict[str, BasePoses]:
    """The model of that name or path, or for `auto` all shipped ones, by name.

    Raises:
        ModelError: as `load_model`.
    """
    return {n: load_model(n) for n in (shipped_models() if name == AUTO else (name,))}


def from_bytes(data: bytes, source: str) -> BasePoses:
    """A model from the bytes of its file; `source` names it in errors (ModelError)."""
    try:
        if len(data) > LARGEST_MODEL:
            raise ValueError(f'larger than {LARGEST_MODEL >> 20} MiB')
        with npz.opened(io.BytesIO(data), LARGEST_MODEL) as archive:
            meta = json.loads(str(archive['meta']))
            arrays = {k: _numbers(archive[k], k) for k in ('mean', 'components', 'std', 'explained')}
        if meta['format'] != FORMAT:
            raise ValueError(f'format {meta["format"]!r}, expected {FORMAT!r}')
        model = BasePoses(
            name=meta['name'],
            skeleton=layout(meta['skeleton']),
            stature=float(meta['stature']),
            provenance=meta['provenance'],
            **arrays,
        )
        _check_model(model)
    except KeyError as error:
        raise ModelError(f'{source}: not a base-pose model (no {str(error.args[0]).split()[0]})') from None
    except Exception as error:  # any malformed byte ends up here: the file comes from a stranger
        raise ModelError(f'{source}: not a base-pose model ({reader_reason(error)})') from None
    return model


def _numbers(array: NDArray[np.generic], key: str) -> Array:
    if array.dtype.kind != 'f':
        raise ValueError(f'{key}: holds {array.dtype}, expected floating point')
    numbers = array.astype(np.float64)
    if not np.isfinite(numbers).all():
        raise ValueError(f'{key}: numbers that are not finite')
    return numbers


def _check_model(model: BasePoses) -> None:
    """Refuse what no training makes (ValueError)."""
    joints, k = len(CMU15.joints), len(model.components)
    shapes = {'mean': (joints, 3), 'components': (k, joints, 3), 'std': (k,), 'explained': (k,)}
    for key, shape in shapes.items():
        if getattr(model, key).shape != shape or not k:
            raise ValueError(f'{key}: shape {getattr(model, key).shape}, expected {shape}')
    flat = model.components.reshape(k, -1)
    low, high = STATURES
    for fine, what in (
        (model.skeleton == CMU15, f'skeleton: {model.skeleton.name}, expected {CMU15.name}'),
        (isinstance(model.name, str) and len(model.name) <= LONGEST_NAME, 'name: no short text'),
        (isinstance(model.provenance, dict), 'provenance: no mapping'),
        (low <= model.stature <= high, f'stature: {model.stature:g}, expected {low} to {high} m'),
        ((np.abs(model.mean) <= FARTHEST_JOINT).all(), f'mean: a joint beyond {FARTHEST_JOINT:g} m'),
        (((model.std >= STDS[0]) & (model.std <= STDS[1])).all(), 'std: outside {:g} to {:g} m'.format(*STDS)),
        ((np.diff(model.std) <= ORTHONORMAL * model.std[:-1]).all(), 'std: not falling'),
        (np.abs(flat @ flat.T - np.eye(k)).max() <= ORTHONORMAL, 'components: not orthonormal'),
    ):
        if not fine:
            raise ValueError(what)
