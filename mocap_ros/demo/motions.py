# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Motions as curves of base-pose weights: a gait is a Fourier series, a single action is a cosine series.

    gait:    y(t) = a_0 + sum_h (a_h cos(2 pi h t / T) + b_h sin(2 pi h t / T)),    h = 1 .. H, cycle T
    action:  y(t) = sum_n c_n cos(pi n t / T),    n = 0 .. N - 1, length T

Here y(t) holds the base-pose weights, the height of the body's centre and its speed. The motions are learned from
motion capture, shipped with the package, and used by `mocap_ros.demo.scene`.
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
from scipy.fft import dct

from mocap_ros.arrays import Array
from mocap_ros.geometry.rotations import centre_poses, fit_heading_rotation
from mocap_ros.models import model_file
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.npz_file import write_npz

FRAME_RATE_HZ = 30.0  # Hz, of the motion capture and of the demo recording
GAIT_HARMONICS = 6  # harmonics of a learned gait; the sixth is at 5 to 10 Hz, where a gait has hardly any movement
PERIOD_SEARCH_HARMONICS = 2  # harmonics in the search for the cycle; with many, twice the cycle would fit as well
ACTION_TERMS = 40  # cosine terms of a learned action, which smooth it
ANKLES = ('lankle', 'rankle')  # joints whose lowest position defines the ground
# s, candidates for the cycle of a gait, from a fast run to a slow walk in steps of 5 ms
CANDIDATE_PERIODS_S = np.linspace(0.55, 1.35, 161)


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion as a series."""

    # (terms, K + 2) coefficients of the series, a column for each base-pose weight (m), the height of the body's
    # centre above the ground (m) and its horizontal speed along the heading (m/s)
    table: Array
    period: float  # s, cycle of a gait, or length of an action
    cyclic: bool  # whether the motion is a gait (a Fourier series) and not an action (a cosine series)

    def sample(self, times_s: Array) -> Array:
        """Return the columns of the table (N, K + 2) at times (N,) in s; an action holds its last pose."""
        phase, n = times_s / self.period, len(self.table)
        if self.cyclic:
            terms = fourier_terms(phase, (n - 1) // 2)
        else:
            terms = np.cos(np.pi * np.clip(phase, 0, 1)[:, None] * np.arange(n))
        return np.asarray(terms @ self.table)


def fourier_terms(phase: Array, harmonics: int) -> Array:
    """Return the terms (N, 2 H + 1) 1, cos, sin, cos 2, sin 2, ... of the phases (N,) in cycles."""
    angle = 2 * np.pi * phase[:, None] * np.arange(1, harmonics + 1)
    pairs = np.stack([np.cos(angle), np.sin(angle)], axis=-1).reshape(len(phase), -1)
    return np.concatenate([np.ones((len(phase), 1)), pairs], axis=1)


def learn_gait(poses: Array, model: PoseModel) -> Motion:
    """Learn the cycle of a gait from a few strides (F, 15, 3) in m, z up, at `FRAME_RATE_HZ`."""
    samples = _tabulate_motion(poses, model)
    times_s = np.arange(len(poses)) / FRAME_RATE_HZ

    def fit(period: float, harmonics: int) -> tuple[float, Array]:
        """Return the sum of squared residuals and the coefficients of the least-squares fit."""
        terms = fourier_terms(times_s / period, harmonics)
        coefficients, *_ = np.linalg.lstsq(terms, samples, rcond=1e-3)
        return float(((terms @ coefficients - samples) ** 2).sum()), np.asarray(coefficients, float)

    period = min(CANDIDATE_PERIODS_S, key=lambda candidate: fit(candidate, PERIOD_SEARCH_HARMONICS)[0])
    return Motion(fit(period, GAIT_HARMONICS)[1], float(period), cyclic=True)


def learn_action(poses: Array, model: PoseModel) -> Motion:
    """Learn a single action, smoothed to `ACTION_TERMS` cosine terms; the arguments are those of `learn_gait`."""
    samples = _tabulate_motion(poses, model)
    coefficients = dct(samples, type=1, axis=0)[:ACTION_TERMS] / (len(samples) - 1)
    coefficients[0] /= 2
    return Motion(coefficients, (len(samples) - 1) / FRAME_RATE_HZ, cyclic=False)


def _tabulate_motion(poses: Array, model: PoseModel) -> Array:
    """Return base-pose weights, height and speed (F, K + 2) of the poses (F, 15, 3)."""
    body = centre_poses(poses)
    body = body @ np.swapaxes(fit_heading_rotation(body, model.mean), -1, -2)
    centre = poses.mean(axis=1)
    ankle_heights = poses[:, [model.skeleton.index(ankle) for ankle in ANKLES], 2]
    speed = np.linalg.norm(np.gradient(centre[:, :2], axis=0), axis=1) * FRAME_RATE_HZ
    height = centre[:, 2] - ankle_heights.min()
    return np.column_stack([model.weights(body), height, speed])


def save_motions(model: PoseModel, motions: Mapping[str, Motion], path: Path) -> None:
    """Write base poses and the motions of their weights, by name, into one .npz."""
    meta = {
        'periods': {name: motion.period for name, motion in motions.items()},
        'cyclic': {name: motion.cyclic for name, motion in motions.items()},
    }
    buffer = io.BytesIO()
    model_file.save_base_poses(model, buffer)
    arrays: dict[str, Any] = {f'motion_{name}': motion.table.astype('f4') for name, motion in motions.items()}
    arrays['model'] = np.frombuffer(buffer.getvalue(), dtype=np.uint8)
    arrays['meta'] = np.array(json.dumps(meta, sort_keys=True))
    write_npz(path, arrays)


def load_motions() -> tuple[PoseModel, dict[str, Motion]]:
    """Load the shipped base poses and motions: walk, run and jump."""
    data = (files('mocap_ros') / 'demo' / 'demo_motion.npz').read_bytes()
    with np.load(io.BytesIO(data), allow_pickle=False) as z:
        meta = json.loads(str(z['meta']))
        model = model_file.decode_base_poses(z['model'].tobytes(), 'demo_motion.npz')
        motions = {
            name: Motion(np.asarray(z[f'motion_{name}'], float), meta['periods'][name], meta['cyclic'][name])
            for name in meta['periods']
        }
    return model, motions
