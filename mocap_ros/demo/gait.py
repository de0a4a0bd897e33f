"""Motions as curves of base-pose weights: gait cycles as Fourier series, single actions as cosine series.

Learned once from motion capture (`learn`), shipped with the package, and played by `demo.scene`.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct

from mocap_ros.geometry.rotations import centred, heading_to
from mocap_ros.models import model_file
from mocap_ros.models.base_poses import BasePoses

Array = NDArray[np.float64]

RATE = 30.0
HARMONICS = 6
ACTION_TERMS = 40
ANKLES = ('lankle', 'rankle')


@dataclass(frozen=True, eq=False)
class Curves:
    """What a moving body does over time: base-pose weights (m), height of its centre (m), distance gone (m).

    Attributes:
        theta: (N, K).
        height: (N,) above the ground.
        advance: (N,) m/s along the heading.
    """

    theta: Array
    height: Array
    advance: Array


@dataclass(frozen=True, eq=False)
class Motion:
    """One motion: `table` (terms, K + 2) holds weights, height and speed, one column each.

    Attributes:
        table: coefficients of the series.
        period: s, of a gait's cycle, or the length of an action.
        cyclic: Fourier series with period `period`, else a cosine series over it.
    """

    table: Array
    period: float
    cyclic: bool

    def at(self, seconds: Array) -> Curves:
        """The curves at these times (N,) s; an action holds its last pose afterwards."""
        values = self._series(seconds / self.period) @ self.table
        return Curves(values[:, :-2], values[:, -2], values[:, -1])

    def _series(self, phase: Array) -> Array:
        n = len(self.table)
        if self.cyclic:
            return fourier_terms(phase, (n - 1) // 2)
        clipped = np.clip(phase, 0, 1)
        return np.cos(np.pi * clipped[:, None] * np.arange(n))


def fourier_terms(phase: Array, harmonics: int) -> Array:
    """(N,) cycles -> (N, 2 H + 1): 1, cos, sin, cos 2, sin 2, ..."""
    angle = 2 * np.pi * phase[:, None] * np.arange(1, harmonics + 1)
    pairs = np.stack([np.cos(angle), np.sin(angle)], axis=-1).reshape(len(phase), -1)
    return np.concatenate([np.ones((len(phase), 1)), pairs], axis=1)


def learn_gait(poses: Array, model: BasePoses) -> Motion:
    """A cycle from a few strides; `poses` (F, 15, 3) m, z up, 30 Hz."""
    table = _samples(poses, model)
    seconds = np.arange(len(poses)) / RATE

    def fitted(period: float, harmonics: int) -> tuple[float, Array]:
        terms = fourier_terms(seconds / period, harmonics)
        coefficients, *_ = np.linalg.lstsq(terms, table, rcond=1e-3)
        return float(((terms @ coefficients - table) ** 2).sum()), np.asarray(coefficients, float)

    # few harmonics, or twice the period would fit just as well
    period = min(np.linspace(0.55, 1.35, 161), key=lambda p: fitted(p, 2)[0])
    return Motion(fitted(period, HARMONICS)[1], float(period), cyclic=True)


def learn_action(poses: Array, model: BasePoses) -> Motion:
    """One action, smoothed to `ACTION_TERMS` cosine terms."""
    table = _samples(poses, model)
    coefficients = dct(table, type=1, axis=0)[:ACTION_TERMS] / (len(table) - 1)
    coefficients[0] /= 2
    return Motion(coefficients, (len(table) - 1) / RATE, cyclic=False)


def _samples(poses: Array, model: BasePoses) -> Array:
    body = centred(poses)
    body = body @ np.swapaxes(heading_to(body, model.mean), -1, -2)
    centre = poses.mean(axis=1)
    feet = poses[:, [model.skeleton.index(a) for a in ANKLES], 2]
    speed = np.linalg.norm(np.gradient(centre[:, :2], axis=0), axis=1) * RATE
    height = centre[:, 2] - feet.min()
    return np.column_stack([model.weights(body), height, speed])


def save(model: BasePoses, motions: Mapping[str, Motion], path: Path) -> None:
    """Write a basis and its motions as one .npz."""
    meta = {
        'periods': {n: m.period for n, m in motions.items()},
        'cyclic': {n: m.cyclic for n, m in motions.items()},
    }
    buffer = io.BytesIO()
    model_file.save_base_poses(model, buffer)
    arrays: dict[str, Any] = {f'motion_{name}': m.table.astype('f4') for name, m in motions.items()}
    arrays['model'] = np.frombuffer(buffer.getvalue(), dtype=np.uint8)
    arrays['meta'] = np.array(json.dumps(meta, sort_keys=True))
    np.savez_compressed(path, **arrays)


def load() -> tuple[BasePoses, dict[str, Motion]]:
    """The shipped basis and motions: walk, run and jump."""
    data = (files('mocap_ros') / 'demo' / 'demo_motion.npz').read_bytes()
    with np.load(io.BytesIO(data), allow_pickle=False) as z:
        meta = json.loads(str(z['meta']))
        model = model_file.base_poses_from_bytes(z['model'].tobytes(), 'demo_motion.npz')
        motions = {
            n: Motion(np.asarray(z[f'motion_{n}'], float), meta['periods'][n], meta['cyclic'][n])
            for n in meta['periods']
        }
    return model, motions
