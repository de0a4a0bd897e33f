"""Which motion is it: its category by evidence, and whether it is periodic (TPAMI 2016, section 4.9).

The category is that of the base poses under which the image is likeliest. Judged by the residual alone the
all-motions model would nearly always win, for it fits anything; the evidence also counts how much each model could
have fitted (Occam's factor of its Gaussian prior).

A window is periodic where the periodic model of a walk or a run explains the image to within a threshold, as in
the paper, and does it with a movement of some size and a cadence that legs can have.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from mocap_ros.config import ClassifierConfig, SolverConfig
from mocap_ros.errors import InputError
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers import joint, periodic
from mocap_ros.solvers.joint.objective import NOISE_REFERENCE
from mocap_ros.solvers.periodic.fourier import Series
from mocap_ros.solvers.periodic.solver import PeriodicReconstruction
from mocap_ros.solvers.window import Reconstruction, Start, Window

PERIODIC_CATEGORIES = ('walk', 'run')
SEEN_OF_A_POSE = 2 / 3
LEAST_NOISE = 0.01
MOST_NOISE = 0.03
RESIDUAL_TOLERANCE = 1e-3


@dataclass(frozen=True, eq=False)
class Choice:
    """The chosen category.

    Attributes:
        category: name of the model with the highest evidence.
        reconstruction: under that model.
        evidence: minus twice the log evidence of every model, up to a constant; the least is chosen.
    """

    category: str
    reconstruction: Reconstruction
    evidence: Mapping[str, float]


def choose_category(window: Window, models: Mapping[str, BasePoses], config: SolverConfig) -> Choice:
    """Fit every model and choose by evidence, all judged under the same image noise.

    Args:
        window: what was seen.
        models: by name; at least one.
        config: of the solver.
    """
    fits = {name: joint.solve_hypotheses([window], model, config)[0] for name, model in models.items()}
    noise = max(LEAST_NOISE, min(fit.noise for fit in fits.values()))
    evidence = {
        name: log_evidence(replace(window, start=Start(fit.theta, fit.cameras)), models[name], noise, config)[0]
        for name, fit in fits.items()
    }
    best = min(evidence, key=lambda name: evidence[name])
    return Choice(best, fits[best], evidence)


def log_evidence(
    window: Window, model: BasePoses, noise: float, config: SolverConfig
) -> tuple[float, Reconstruction]:
    """Minus twice the log evidence of a model, up to a constant, and the reconstruction it is that of.

    Args:
        window: what was seen; its start is where to begin.
        model: base poses.
        noise: m, of the image points, the same for all models that are compared; at least `LEAST_NOISE` counts.
        config: of the solver.
    """
    noise = max(noise, LEAST_NOISE)
    model = model.truncated(config.components)
    (judged,) = joint.solve([replace(window, noise=noise)], model, replace(config, adapt_noise=True))
    occam = len(window.times) * np.log1p(SEEN_OF_A_POSE * (model.std / noise) ** 2).sum()
    return judged.objective[-1] / NOISE_REFERENCE**2 + float(occam), judged


@dataclass(frozen=True, eq=False)
class PeriodicFit:
    """How well a periodic motion explains a window.

    Attributes:
        category: `walk` or `run`, the one that explains more.
        residual: RMS 2D residual as a fraction of stature.
        excess: what of it the image noise does not explain, where that is known.
        amplitude: RMS movement of a joint about its mean as a fraction of stature.
        reconstruction: under the periodic model; holds the cadence.
    """

    category: str
    residual: float
    excess: float
    amplitude: float
    reconstruction: PeriodicReconstruction


def fit_periodic(
    window: Window,
    models: Mapping[str, BasePoses],
    config: SolverConfig,
    begun: Reconstruction | None = None,
    series: Mapping[str, Series] | None = None,
) -> PeriodicFit:
    """The best periodic explanation of a window.

    Args:
        window: a cycle or more of what was seen.
        models: by name; those of `PERIODIC_CATEGORIES` are used.
        config: of the solver.
        begun: the window's reconstruction under any model, to start from; None makes one for each model.
        series: by name, where the motion was before, as in `periodic.solve`.

    Raises:
        InputError: none of `models` is periodic, or the window is not what it should be.
    """
    known = series or {}
    config = replace(config, tolerance=max(config.tolerance, RESIDUAL_TOLERANCE))
    fits = []
    for name in PERIODIC_CATEGORIES:
        if name in models:
            model = models[name]
            (result,) = periodic.solve([window], model, config, [begun], [known.get(name)])
            movement = result.theta - result.theta.mean(axis=0)
            amplitude = np.sqrt((movement**2).sum(axis=1).mean() / len(model.mean))
            residual = np.sqrt(np.nanmean((result.residual / result.cameras.scale) ** 2))
            size = model.stature
            noise = 0.0 if begun is None or np.isnan(begun.noise) else min(begun.noise, MOST_NOISE)
            excess = np.sqrt(max(residual**2 - 2 * noise**2, 0.0))
            fits.append(
                PeriodicFit(name, float(residual) / size, float(excess) / size, float(amplitude) / size, result)
            )
    if not fits:
        raise InputError(f'no model of {" or ".join(PERIODIC_CATEGORIES)} to fit')
    return min(fits, key=lambda fit: fit.residual)


def is_periodic(fit: PeriodicFit, config: ClassifierConfig, slack: float = 1.0) -> bool:
    """Whether a fit is good enough; `slack` above 1 loosens every threshold, below 1 tightens it."""
    walk = fit.category == 'walk'
    residual = config.walk_residual if walk else config.run_residual
    cadence = config.walk_cadence if walk else config.run_cadence
    return (
        fit.excess <= residual * slack
        and fit.amplitude >= config.amplitude / slack
        and fit.reconstruction.cadence >= cadence / slack
    )


@dataclass
class PeriodicSwitch:
    """Periodic or not over time, with hysteresis so that the answer does not chatter.

    Attributes:
        config: thresholds, and how much better or worse than them a fit must be to change the answer.
        periodic: the answer; not periodic at first.
    """

    config: ClassifierConfig
    periodic: bool = False

    def update(self, fit: PeriodicFit) -> bool:
        """Take the fit of the newest window; returns the answer."""
        slack = self.config.hysteresis if self.periodic else 1 / self.config.hysteresis
        self.periodic = is_periodic(fit, self.config, slack)
        return self.periodic
