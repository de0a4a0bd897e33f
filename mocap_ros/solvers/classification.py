# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Classification of a motion: its category by evidence, and whether it is periodic (TPAMI 2016, section 4.9).

The category is that of the base poses with the highest evidence, by Laplace's method and up to a constant,

    -2 log p(x | model) = min E / n0^2 + F sum_l log(1 + 2/3 sigma_l^2 / noise^2)

with E the objective of the joint solver (m^2) under the common image noise, n0 = 10 mm, F frames, and sigma_l the
standard deviation of the weight of base pose l, two thirds of which the image shows. The second term is Occam's.

A window is periodic if, for the periodic model of a walk or a run (section 3.3), the RMS 2D residual is below a
threshold, and amplitude and cadence are above theirs. Most of the residual of real detectors is their error,
whatever the motion. So where poses were found without periodicity, the periodic motion x must explain how their
image y moves, but not its jitter w, most of which lasts for some frames (hence the 3):

    excess residual = (mean_tj |d_tj - median_t d_tj|^2 - 3 w^2)^(1/2)
    d_tj = x_tj - y_tj, each about its mean over j
    w^2 = median_t mean_j |third difference of y_tj|^2 / 20
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from mocap_ros.arrays import Array, copy_with
from mocap_ros.config import ClassifierConfig, SolverConfig
from mocap_ros.engine import periodic as engine
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.solvers import joint, periodic
from mocap_ros.solvers.joint.objective import NOISE_REFERENCE
from mocap_ros.solvers.joint.solver import JointReconstruction
from mocap_ros.solvers.levenberg_marquardt import Stepwise, run_to_end
from mocap_ros.solvers.periodic import (
    MAX_CADENCE_HZ,
    MIN_CADENCE_HZ,
    MIN_CYCLES,
    EstimatedPoses,
    PeriodicReconstruction,
)
from mocap_ros.solvers.window import InitialValues, Window

# Names of the models whose motion can be periodic.
PERIODIC_CATEGORIES = ('walk', 'run')
OBSERVED_FRACTION = 2 / 3  # the image shows two of three coordinates
# m; smallest noise under which models are compared: base poses represent an unseen person no better than that.
MIN_COMPARISON_NOISE = 0.01
JITTER_SHARE = 3.0  # 1; of w^2, chosen on walks with MoveNet's points, of which 0.62 instead of 0.44 are found
JITTER_STEP_S = 1 / 30  # s; time between the frames of which the differences are taken
MIN_JITTER_FRAMES = 15  # frames; of fewer the median says too little
THIRD_DIFFERENCE_SQUARES = 20.0  # sum of the squared coefficients of a third difference: 1, -3, 3, -1
MAX_JITTER_STEP_S = 0.05  # s; in slower streams the third differences are those of the motion
REPEATED_S, MAX_STRETCH = engine.REPETITION  # explained there
EPSILON = 1e-9  # of the longest cycle that is known; keeps rounding from making it longer
# of the longest cycle that may be fitted; motion that is known for less than that may repeat itself later
MIN_SHARE_OF_CYCLE = 0.75
PERIODIC_FIT_TOLERANCE = 1e-3  # relative decrease of the objective; a residual needs no closer minimum


def choose_category(
    window: Window, models: Mapping[str, PoseModel], config: SolverConfig
) -> tuple[str, JointReconstruction]:
    """Fit every model; return the name and the fit of the highest evidence, all under the same image noise."""
    fits = {}
    for name, model in models.items():
        (fits[name],) = joint.solve_hypotheses([window], model, config)
    noise = max(MIN_COMPARISON_NOISE, min(fit.noise for fit in fits.values()))
    evidence = {}
    for name, fit in fits.items():
        fitted = copy_with(window, start=InitialValues(fit.theta, fit.cameras))
        evidence[name], _ = run_to_end(minus_twice_log_evidence_stepwise(fitted, models[name], noise, config))
    best = min(evidence, key=lambda name: evidence[name])
    return best, fits[best]


def minus_twice_log_evidence_stepwise(
    window: Window, model: PoseModel, noise: float, config: SolverConfig
) -> Stepwise[tuple[float, JointReconstruction]]:
    """Return -2 log p(x | model) (formula of the module) and the reconstruction, at a noise in m."""
    noise = max(noise, MIN_COMPARISON_NOISE)
    model = model.truncate(config.components)
    adaptive = replace(config, adapt_noise=True)
    (fit,) = yield from joint.solve_stepwise([copy_with(window, noise=noise)], model, adaptive)
    return measure_evidence(fit, model, noise), fit


def measure_evidence(fit: JointReconstruction, model: PoseModel, noise: float) -> float:
    """Return -2 log p(x | model) up to a constant, of the minimum under an image noise in m."""
    occam = len(fit.theta) * np.log1p(OBSERVED_FRACTION * (model.std / noise) ** 2).sum()
    return fit.cost / NOISE_REFERENCE**2 + float(occam)


@dataclass(frozen=True, eq=False)
class PeriodicFit:
    """Measures of how well a periodic motion explains a window."""

    category: str  # `walk` or `run`
    residual: float  # RMS 2D residual as a fraction of the stature
    # what the periodic motion leaves unexplained of the movement found without periodicity, as a fraction of the
    # stature (formula of the module); equals `residual` if no such movement is known
    excess_residual: float
    amplitude: float  # RMS movement of a joint about its mean as a fraction of the stature
    reconstruction: PeriodicReconstruction  # result under the periodic model, with the cadence


def fit_periodic_stepwise(
    window: Window,
    category: str,
    model: PoseModel,
    config: SolverConfig,
    initial: EstimatedPoses | None = None,
) -> Stepwise[PeriodicFit]:
    """Fit the periodic model of a category to a window.

    `initial` are poses to start from, which also give the image noise; without, they are computed.

    Raises:
        InputError: the periodic solver rejects the window.
    """
    config = replace(config, tolerance=max(config.tolerance, PERIODIC_FIT_TOLERANCE))
    result = yield from periodic.solve_stepwise(window, model, config, initial)
    movement = result.theta - result.theta.mean(axis=0)
    amplitude = np.sqrt((movement**2).sum(axis=1).mean() / len(model.mean))
    residual = np.sqrt(np.nanmean((result.residual / result.cameras.scale) ** 2))
    excess = residual if initial is None else _compare_movements(result, initial)
    yield
    stature = model.stature
    return PeriodicFit(
        category, float(residual) / stature, float(excess) / stature, float(amplitude) / stature, result
    )


def _compare_movements(result: PeriodicReconstruction, estimated: EstimatedPoses) -> float:
    """Return the RMS difference in m between the images of two motions, without what is constant in each joint."""
    images = [
        joints[..., :2] * (scale / estimated.scale)[:, None, None]
        for joints, scale in ((result.joints, result.cameras.scale), (estimated.joints, estimated.scale))
    ]
    periodic, free = (image - image.mean(axis=1, keepdims=True) for image in images)
    difference = periodic - free
    difference -= np.median(difference, axis=0)
    excess = (difference**2).sum(axis=-1).mean() - JITTER_SHARE * estimated.jitter**2
    return float(np.sqrt(max(excess, 0.0)))


def measure_jitter(times: Array, images: Array) -> float:
    """Return how much joints jitter in the image (w of the module), in m; 0 if frames are too few or too sparse.

    `times` (F,) s, increasing; `images` (F, J, 2) m, images of the joints.
    """
    step_s = float(np.median(np.diff(times))) if len(times) > 1 else math.inf
    stride = max(round(JITTER_STEP_S / step_s), 1)
    centred = (images - images.mean(axis=1, keepdims=True))[::-stride]
    if step_s > MAX_JITTER_STEP_S or len(centred) < MIN_JITTER_FRAMES:
        return 0.0
    squares = (np.diff(centred, n=3, axis=0) ** 2).sum(axis=-1).mean(axis=1)
    return math.sqrt(float(np.median(squares)) / THIRD_DIFFERENCE_SQUARES)


def measure_best_repetition(times: Array, theta: Array) -> float:
    """Return the largest repetition of a motion over all cadences; NaN if it is known for too short a time.

    A small one says cheaply that the motion cannot be periodic.

    `times` (F,) s, increasing; `theta` (F, K) m, base-pose weights at these times.
    """
    span_s = float(times[-1] - times[0])
    longest_s = span_s - REPEATED_S
    if longest_s < MIN_SHARE_OF_CYCLE / max(MIN_CADENCE_HZ, MIN_CYCLES / max(span_s, REPEATED_S)):
        return math.nan
    # the lengths of cycles that `measure_repetition` tries for one cadence end where those of the next begin
    step = (1 + MAX_STRETCH) / (1 - MAX_STRETCH)
    count = math.ceil(math.log(longest_s * MAX_CADENCE_HZ, step))
    cycles_s = [*(step**i / MAX_CADENCE_HZ for i in range(count)), longest_s * (1 - EPSILON)]
    found = [engine.measure_repetition(times, theta, 1 / cycle_s) for cycle_s in cycles_s]
    return max((r for r in found if not math.isnan(r)), default=math.nan)


def is_periodic(fit: PeriodicFit, config: ClassifierConfig, *, was_periodic: bool) -> bool:
    """Return whether a fit passes all thresholds, which `config.hysteresis` loosens if the motion was periodic.

    Else it tightens them.
    """
    is_walk = fit.category == 'walk'
    max_residual = config.walk_residual if is_walk else config.run_residual
    min_cadence = config.walk_cadence if is_walk else config.run_cadence
    factor = config.hysteresis if was_periodic else 1 / config.hysteresis
    return (
        fit.excess_residual <= max_residual * factor
        and fit.amplitude >= config.amplitude / factor
        and fit.reconstruction.cadence >= min_cadence / factor
    )
