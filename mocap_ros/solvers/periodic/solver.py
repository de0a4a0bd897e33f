"""The periodic model: base-pose weights as harmonic functions of time (TPAMI 2016, section 3.3).

A weight is a Fourier series with a constant term and `harmonics` harmonics of one fundamental that all base poses
share,

    theta_l(t) = c_l0 + sum_h a_lh cos(h omega t) + b_lh sin(h omega t),

or, with `paper_sines`, the paper's form (eq. 17): one sine a base pose, each with its own omega, no constant.

Base poses know no heading, but a body turns with every stride. That turn is periodic too and has a series of its
own, psi: the rotation of a frame is C_t Rz(psi(t)), with C_t the camera's, which no stride moves and which may be
held the more firmly. To reprojection and bone lengths as in `nonperiodic` the objective adds

    lambda sum_lp c_lp^2 / var_lp          Gaussian prior of the coefficients, once a window
  + gamma  int |dM / dt|^2 dt              velocity of the camera, M = s C[:2]
  + kappa  int |d^2 M / dt^2|^2 dt         its acceleration
  + nu     mean_t |tilt_t|^2               upright models only: cameras are held level, more or less

Where the image is noisy, another cadence and a camera that hardly moves are tried too, and the likeliest stays.
In each Levenberg-Marquardt step the cameras, a banded system of 4 unknowns a frame, are eliminated, which leaves a
dense one of (2 H + 1) (K + 1) + 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError

from mocap_ros.config import SolverConfig
from mocap_ros.errors import InputError
from mocap_ros.geometry.rotations import rotation_to
from mocap_ros.geometry.weak_perspective import Cameras
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers import joint
from mocap_ros.solvers.joint.objective import NOISE_REFERENCE, initial_state
from mocap_ros.solvers.joint.solver import ACCEPTED, LEAST_DAMPING, MOST_DAMPING, REJECTED, WARM_DAMPING
from mocap_ros.solvers.joint.solver import result as joint_result
from mocap_ros.solvers.joint.state import State
from mocap_ros.solvers.periodic.fourier import Series, first_series
from mocap_ros.solvers.periodic.normal_equations import Reduced
from mocap_ros.solvers.periodic.objective import Objective, about_vertical
from mocap_ros.solvers.window import Reconstruction, Start, Window

Array = NDArray[np.float64]

FIRST_ITERATIONS = 12
NOISE_ROUNDS = 2
NOISE_ROUND_TOLERANCE = 0.05
RIVALS_FROM, RIVAL_TOLERANCE = 0.03, 2e-3


@dataclass(frozen=True, eq=False)
class PeriodicReconstruction(Reconstruction):
    """A reconstruction under the periodic model.

    Attributes:
        cadence: Hz, full cycles (two steps of a walk).
        series: coefficients and frequencies.
    """

    cadence: float
    series: Series


def solve(
    windows: Sequence[Window],
    model: BasePoses,
    config: SolverConfig,
    begun: Sequence[Reconstruction | None] | None = None,
    series: Sequence[Series | None] | None = None,
) -> tuple[PeriodicReconstruction, ...]:
    """Reconstruct sequences under the periodic model.

    Args:
        windows: the sequences; each should hold a cycle or more. Times may be irregular. Lifted poses are for
            motion that is not periodic.
        model: base poses of a periodic motion.
        config: weights of the terms, `harmonics`, `paper_sines`. `max_iterations` bounds all steps together, taken
            or not.
        begun: a reconstruction of each window to start from, under any model of this skeleton; None makes one.
        series: where each motion was before, its `origin` on the window's clock; None scans the cadences. One of
            another shape is passed over.

    Raises:
        InputError: a window without four seen joints in any frame, or with numbers beyond all measure.
    """
    model = model.truncated(config.components)
    count = len(windows)
    before = begun or [None] * count
    known = series or [None] * count
    with np.errstate(all='ignore'):
        return tuple(
            _solve_one(replace(window, lifted=None), start, last, model, config)
            for window, start, last in zip(windows, before, known, strict=True)
        )


def _solve_one(
    window: Window, begun: Reconstruction | None, last: Series | None, model: BasePoses, config: SolverConfig
) -> PeriodicReconstruction:
    exponent = _exponent(window)
    own = _times_two_to(window, -exponent)
    try:
        start, noise = _start(own, begun, exponent, model, config)
        unit = own.unit or float(np.median(start.cameras.scale))
        fit = _fit(own, start, noise, unit, last, model, config)
    except LinAlgError as error:
        raise InputError(f'no periodic motion can be fitted: {error}') from None
    cameras = Cameras(np.ldexp(fit.cameras.scale, exponent), fit.cameras.rotation)
    result = replace(
        fit,
        cameras=cameras,
        translation=np.ldexp(fit.translation, exponent),
        residual=np.ldexp(fit.residual, exponent),
    )
    numbers = (result.joints, cameras.scale, result.translation, result.series.coefficients, result.objective)
    if not all(np.isfinite(n).all() for n in numbers):
        raise InputError('no periodic motion can be fitted: image points or weights beyond all measure')
    return result


def _exponent(window: Window) -> int:
    """Power of two by which the seen points are spread, so that no square of theirs overflows."""
    seen = window.points[window.weight > 0]
    return int(np.frexp(np.ptp(seen / 2, axis=0).max())[1]) + 1


def _times_two_to(window: Window, exponent: int) -> Window:
    """The window in other units than px, and free from its first frame on."""
    start = window.start
    return replace(
        window,
        points=np.ldexp(np.where(window.weight[..., None] > 0, window.points, 0.0), exponent),
        focal=float(np.ldexp(window.focal, exponent)),
        held=0,
        older=None,
        unit=None if window.unit is None else float(np.ldexp(window.unit, exponent)),
        start=start
        and Start(start.theta, Cameras(np.ldexp(start.cameras.scale, exponent), start.cameras.rotation)),
    )


def _start(
    window: Window, begun: Reconstruction | None, exponent: int, model: BasePoses, config: SolverConfig
) -> tuple[Start, float]:
    """Weights and cameras of the given reconstruction in terms of this model, or of a short one; and its noise."""
    if begun is None:
        short = replace(config, max_iterations=min(FIRST_ITERATIONS, config.max_iterations))
        (own,) = joint.solve([window], model, short)
        return Start(own.theta, own.cameras), own.noise
    to_body = rotation_to(begun.joints, model.mean)
    theta = model.weights(begun.joints @ np.swapaxes(to_body, -1, -2))
    scale = np.ldexp(begun.cameras.scale, -exponent)
    return Start(theta, Cameras(scale, np.swapaxes(to_body, -1, -2))), begun.noise


def _fit(
    window: Window,
    start: Start,
    noise: float,
    unit: float,
    last: Series | None,
    model: BasePoses,
    config: SolverConfig,
) -> PeriodicReconstruction:
    noise = float(np.fmax(window.noise or noise, config.noise_floor))
    objective = Objective.build(window, unit, model, config)
    if config.adapt_noise:
        objective = objective.under_noise(noise)
    searches = []
    for series in _first_guesses(start.theta, window.times, last, noise, config):
        cameras = initial_state(objective.problem, [start], np.array([unit]))
        cameras = replace(cameras, rotation=cameras.rotation @ about_vertical(-series.heading(window.times)))
        for _ in range(2):
            cameras = objective.best_translation(series, cameras)
        searches.append(_Search(objective, series, cameras, config.max_iterations))
    search = _likeliest(searches)
    if noise >= RIVALS_FROM:
        still = _Search(objective.of_still_camera(config), search.series, search.cameras, search.tries)
        search = _likeliest([search, still])
    rough = max(NOISE_ROUND_TOLERANCE, config.tolerance)
    if config.adapt_noise and window.noise is None:
        for _ in range(NOISE_ROUNDS):
            search.run(rough)
            noise = max(search.noise(), config.noise_floor)
            search.take(search.objective.under_noise(noise))
    converged = search.run(config.tolerance)
    problem, series = search.objective.problem, search.series
    fit = problem.fit(search.objective.body(series, search.cameras))
    result = joint_result(problem, 0, window, unit, fit, search.history, converged, float(noise))
    plain = {f.name: getattr(result, f.name) for f in fields(Reconstruction)}
    moving = (series.coefficients[:, :-1] ** 2).sum(axis=0) if series.sines else None
    cadence = float(np.average(series.omega[:-1], weights=moving) / (2 * np.pi))
    return PeriodicReconstruction(**plain, cadence=cadence, series=series)


def _first_guesses(
    theta: Array, times: Array, last: Series | None, noise: float, config: SolverConfig
) -> list[Series]:
    """The last series if it fits the configuration, else that of the likeliest cadence; under much noise two."""
    first = first_series(theta, times, config)
    if last is not None and last.sines == first.sines and last.coefficients.shape == first.coefficients.shape:
        return [last]
    if noise < RIVALS_FROM or config.paper_sines:
        return [first]
    return [first, first_series(theta, times, config, unlike=float(first.omega[0]))]


class _Search:
    """Levenberg-Marquardt over series and cameras, with so many tries in all its runs together."""

    def __init__(self, objective: Objective, series: Series, cameras: State, tries: int) -> None:
        self.series, self.cameras, self.tries = series, cameras, tries
        self.damping = WARM_DAMPING
        self.equations = Reduced.build(objective, series, cameras)
        self.take(objective)
        self.behind = False

    def take(self, objective: Objective) -> None:
        """Go on under another objective."""
        self.objective = objective
        self.history = [objective.cost(self.series, self.cameras)]
        self.behind = True

    def noise(self) -> float:
        """m, of the image; what the unknowns absorb is counted a step ago."""
        return self.objective.noise(self.series, self.cameras, self.equations.absorbed())

    def evidence(self) -> float:
        """Minus twice the log evidence, cameras integrated over (Laplace, a step ago), up to a constant."""
        return self.history[-1] / NOISE_REFERENCE**2 + self.equations.volume()

    def run(self, tolerance: float) -> bool:
        """Descend until a step gains less than this share of the cost; whether it came to that."""
        while self.tries > 0:
            self.tries -= 1
            cost = self.history[-1]
            if self._step():
                self.damping = max(self.damping * ACCEPTED, LEAST_DAMPING)
                if cost - self.history[-1] <= tolerance * cost:
                    return True
            else:
                self.damping *= REJECTED
                if self.damping > MOST_DAMPING:
                    return True
        return False

    def _step(self) -> bool:
        if self.behind:
            self.equations = Reduced.build(self.objective, self.series, self.cameras)
            self.behind = False
        step = self.equations.step(self.damping)
        if step is None:
            return False
        series = self.series.moved(step[0])
        cameras = self.cameras.moved(np.concatenate([np.zeros_like(self.cameras.theta), step[1]], axis=1))
        cameras = self.objective.best_translation(series, cameras)
        cost = self.objective.cost(series, cameras)
        if not cost < self.history[-1]:
            return False
        self.series, self.cameras, self.behind = series, cameras, True
        self.history.append(cost)
        return True


def _likeliest(rivals: Sequence[_Search]) -> _Search:
    """The one of the highest evidence once all have come near their ends, on the tries of one together."""
    if len(rivals) == 1:
        return rivals[0]
    left = rivals[0].tries
    for rival in rivals:
        rival.tries = left
        rival.run(RIVAL_TOLERANCE)
        left = rival.tries
    best = min(rivals, key=_Search.evidence)
    best.tries = left
    return best
