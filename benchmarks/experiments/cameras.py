# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The flip regulariser (figure 4), its difference scheme (section 3.5), and moving cameras."""

from __future__ import annotations

import time
from typing import Any

import common
import numpy as np
from numpy.typing import NDArray
from panels import JUMP, RUN, WALK, draw_curves, label_axes, make_panels
from report import Report
from scipy.optimize import least_squares
from scipy.sparse import lil_array

from experiments.methods import ALGORITHM_1, JOINT, choose_few_headings, choose_headings
from mocap_ros.geometry.rotations import centre_poses, fit_rotation, rotation_from_vector
from mocap_ros.geometry.weak_perspective import fit_cameras_closed_form, subtract_weighted_centroid
from mocap_ros.solvers.window import Reconstruction

Array = NDArray[np.float64]

# Trials of the experiments, with their categories.
CASES = (('35_02', 'walk'), ('35_17', 'run'), ('13_11', 'jump'))
FLIP_NOISE = 0.05  # option `noise` of the protocol
MIN_FLIP_ANGLE_DEG = 30.0  # degrees between two frames; no real camera of the test turns as fast
# Options of the protocol for each camera motion.
CAMERAS = {
    'fixed': {},
    'orbiting at 30 degrees/s': {'orbit': 30.0},
    'shaken by 5 degrees': {'shake': 5.0},
    'orbiting and shaken': {'orbit': 30.0, 'shake': 5.0},
}
# Trials that are seen by moving cameras.
MOVING_TRIALS = (('35_02', 'walk'), ('07_01', 'walk'), ('16_15', 'walk'), ('35_17', 'run'), ('09_01', 'run'))


def count_flips(result: Reconstruction) -> int:
    """Count the frames to which the camera turns by more than `MIN_FLIP_ANGLE_DEG`."""
    r = result.cameras.rotation
    cosine = (np.einsum('fij,fij->f', r[1:], r[:-1]) - 1) / 2
    return int((np.degrees(np.arccos(np.clip(cosine, -1, 1))) > MIN_FLIP_ANGLE_DEG).sum())


def measure_flip_regulariser(report: Report, quick: bool) -> dict[str, Any]:
    """Flip regulariser (figure 4)."""
    gammas = (0.0, 1e-2) if quick else (0.0, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0)
    slow, plain = {'tolerance': 1e-3}, {'heading_flip_factor': 1.0, 'start_window': 0.0}
    columns: dict[str, Any] = {
        'Algorithm 1, clean': (ALGORITHM_1, 0.0, slow),
        'Algorithm 1, 5 % noise': (ALGORITHM_1, FLIP_NOISE, slow),
        'joint, 5 % noise': (JOINT, FLIP_NOISE, plain),
    }
    errors: dict[str, list[float]] = {c: [] for c in columns}
    counts: dict[str, list[int]] = {c: [] for c in columns}
    for gamma in common.show_progress(gammas, 'gamma'):
        for column, (method, noise, values) in columns.items():
            scores, total = [], 0
            for trial, category in CASES[:2]:
                tests = common.make_views(trial, choose_few_headings(quick), noise=noise)
                found = method.solve(tests, category, trial, flip_weight=gamma, **values)
                scores += common.compute_all_errors(tests, found)
                total += sum(map(count_flips, found))
            errors[column].append(common.mean_error(scores))
            counts[column].append(total)
    rows = [
        [f'{g:g}', *(cell for c in columns for cell in (f'{errors[c][i]:.1f}', counts[c][i]))]
        for i, g in enumerate(gammas)
    ]
    report.table(['gamma', *(f'{c}: {what}' for c in columns for what in ('MPJPE, mm', 'flips'))], rows)
    axis = [max(g, gammas[1] / 10) for g in gammas]
    figure, axes = make_panels(2)
    draw_curves(axes[0], axis, errors, (WALK, JUMP, RUN))
    draw_curves(axes[1], axis, counts, (WALK, JUMP, RUN))
    for ax, what in zip(axes, ('MPJPE, mm', 'camera flips'), strict=True):
        ax.set_xscale('log')
        ax.set_ylim(bottom=0)
        label_axes(ax, 'gamma, m² s (leftmost: 0)', what)
    figure.legend(*axes[0].get_legend_handles_labels(), loc='outside lower center', ncols=3)
    report.paper_figure('fig04_flips', figure, '3D error and camera flips against the flip regulariser')
    return {'gamma': list(gammas), 'mpjpe_mm': errors, 'flips': counts}


def compare_differences(report: Report, quick: bool) -> dict[str, Any]:
    """Forward and central differences (section 3.5)."""
    gamma, px_per_m = 1e-2, common.load_protocol().PX_PER_M
    rows = []
    for trial, category in CASES[1:2] if quick else CASES:
        (view,) = common.make_views(trial, [45], noise=0.02)
        window, model = view.window, ALGORITHM_1.train(category, trial).truncate(6)
        poses = model.poses(np.zeros((view.frames, 6)))
        body, _ = subtract_weighted_centroid(poses, window.weight)
        image, _ = subtract_weighted_centroid(window.points / px_per_m, window.weight)
        start = fit_cameras_closed_form(poses, window.points, window.weight, window.times, 0.0)
        truth = fit_rotation(poses, centre_poses(view.true_poses))
        cells = []
        for scheme in (_fit_forward, _fit_central, _fit_central_dense):
            begun = time.perf_counter()
            rotations = scheme(body, image, start.rotation, start.scale / px_per_m, gamma)
            cells.append((time.perf_counter() - begun, _mean_angle_degrees(rotations, truth)))
        times = [f'{seconds * 1e3:.0f}' for seconds, _ in cells]
        rows.append([trial, *times, f'{cells[2][0] / cells[0][0]:.1f}', *(f'{e:.2f}' for _, e in cells[:2])])
    header = ['forward, ms', 'central, sparse, ms', 'central, dense, ms', 'dense / forward']
    report.table(['trial', *header, 'forward: error, degrees', 'central: error, degrees'], rows)
    return {'rows': rows}


def _make_camera_matrices(x: Array, rotation: Array) -> Array:
    """Return the camera matrices (F, 2, 3) of unknowns (F, 4): rotation vector from `rotation`, log scale."""
    turned = rotation_from_vector(x[:, :3]) @ rotation
    return np.exp(x[:, 3])[:, None, None] * turned[:, :2]


def _fit_forward(body: Array, image: Array, rotation: Array, scale: Array, gamma: float) -> Array:
    """Fit one frame after the other, each tied to the frame before."""
    out = []
    before = None
    for t in range(len(body)):

        def residual(x: Array, t: int = t, before: Array | None = before) -> Array:
            m = _make_camera_matrices(x[None], rotation[t : t + 1])[0]
            data = (body[t] @ m.T - image[t]).ravel()
            return data if before is None else np.concatenate([data, np.sqrt(gamma) * (m - before).ravel()])

        found = least_squares(residual, [0, 0, 0, np.log(scale[t])], method='lm').x
        before = _make_camera_matrices(found[None], rotation[t : t + 1])[0]
        out.append(rotation_from_vector(found[:3]) @ rotation[t])
    return np.array(out)


def _fit_central(
    body: Array, image: Array, rotation: Array, scale: Array, gamma: float, *, sparse: bool = True
) -> Array:
    """Fit all frames at once, each tied to both neighbours."""
    frames, joints = body.shape[:2]

    def residual(x: Array) -> Array:
        m = _make_camera_matrices(x.reshape(frames, 4), rotation)
        data = body @ np.swapaxes(m, -1, -2) - image
        return np.concatenate([data.ravel(), np.sqrt(gamma) / 2 * (m[2:] - m[:-2]).ravel()])

    pattern = lil_array((frames * joints * 2 + (frames - 2) * 6, frames * 4), dtype=int)
    for t in range(frames):
        pattern[t * joints * 2 : (t + 1) * joints * 2, 4 * t : 4 * t + 4] = 1
    for t in range(frames - 2):
        rows = slice(frames * joints * 2 + 6 * t, frames * joints * 2 + 6 * t + 6)
        pattern[rows, 4 * t : 4 * t + 4] = 1
        pattern[rows, 4 * t + 8 : 4 * t + 12] = 1
    x0 = np.concatenate([np.zeros((frames, 3)), np.log(scale)[:, None]], axis=1).ravel()
    how = {'jac_sparsity': pattern.tocsr(), 'method': 'trf'} if sparse else {'method': 'lm'}
    x = least_squares(residual, x0, **how).x.reshape(frames, 4)
    return rotation_from_vector(x[:, :3]) @ rotation


def _fit_central_dense(body: Array, image: Array, rotation: Array, scale: Array, gamma: float) -> Array:
    return _fit_central(body, image, rotation, scale, gamma, sparse=False)


def _mean_angle_degrees(rotations: Array, truth: Array) -> float:
    cosine = (np.einsum('fij,fij->f', rotations, truth) - 1) / 2
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean())


def measure_moving_cameras(report: Report, quick: bool) -> dict[str, Any]:
    """Fixed, orbiting and shaken cameras: the paper's main claim."""
    trials = MOVING_TRIALS[::3] if quick else MOVING_TRIALS
    rows, data = [], {}
    for name, options in list(CAMERAS.items())[:: 3 if quick else 1]:
        means, worst, periodic = [], [], []
        for trial, category in trials:
            tests = common.make_views(trial, choose_headings(quick), **options)
            some, model = tests[::4], common.train_base_poses(category, without_subjects=(trial[:2],))
            records = common.compute_all_errors(tests, common.solve_jointly(tests, model))
            means.append(common.mean_error(records))
            worst.append(common.worst_error(records))
            records = common.compute_all_errors(some, common.solve_periodically(some, model))
            periodic.append(common.mean_error(records))
        rows.append([name, *(f'{m:.1f}' for m in means), *(f'{np.mean(v):.1f}' for v in (means, worst, periodic))])
        data[name] = {'mean': means, 'worst': worst, 'periodic': periodic}
    header = ['mean', 'worst heading, mean over the trials', 'periodic model']
    report.table(['camera', *(t for t, _ in trials), *header], rows)
    return data
