# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Coverage: right covariances hold as many errors as they should, wrong ones do not, unknown ones are left out."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_ros.evaluation.coverage import compute_coverage
from mocap_ros.skeleton import CMU15

FRAMES = 4000
STD_M = 0.05
ROOT_COVARIANCE = np.diag([0.01, 0.0004, 0.04]) + 0.005
TRUTH = np.random.default_rng(1).normal(size=(15, 3)) + [0, 0, 4]


def draw(rng: np.random.Generator) -> np.ndarray:
    """Return joints (F, 15, 3) with errors of the covariances above; those of the hips are the root's alone."""
    root = rng.multivariate_normal(np.zeros(3), ROOT_COVARIANCE, FRAMES)
    sight = TRUTH.mean(axis=0) / np.linalg.norm(TRUTH.mean(axis=0))
    own = rng.normal(scale=STD_M / np.sqrt(6), size=(FRAMES, 15, 3))
    own += (own @ sight)[..., None] * sight  # twice as much along the line of sight
    own[:, [CMU15.index('lhip'), CMU15.index('rhip')]] = 0
    return np.asarray(TRUTH + root[:, None] + own)


def measure(factor: float, joints: np.ndarray, names: tuple[str, ...] = CMU15.joints) -> dict[str, float]:
    std = np.full((FRAMES, 15), STD_M * factor)
    std[:, [CMU15.index('lhip'), CMU15.index('rhip')]] = 0
    covariance = np.tile(ROOT_COVARIANCE * factor**2, (FRAMES, 1, 1))
    return compute_coverage(joints, std, covariance, CMU15, np.tile(TRUTH, (FRAMES, 1, 1)), names)


def test_right_covariances_hold_as_many_errors_as_they_should(rng: np.random.Generator) -> None:
    found = measure(1.0, draw(rng))
    assert found == pytest.approx({'joints68': 0.68, 'joints95': 0.95, 'roots68': 0.68, 'roots95': 0.95}, abs=0.02)


@pytest.mark.parametrize(('factor', 'least', 'most'), [(0.5, 0.2, 0.6), (2.0, 0.995, 1.0)])
def test_wrong_covariances_hold_too_few_or_too_many(
    rng: np.random.Generator, factor: float, least: float, most: float
) -> None:
    found = measure(factor, draw(rng))
    assert least < found['joints95'] <= most
    assert least < found['roots95'] <= most


def test_what_is_unknown_is_left_out(rng: np.random.Generator) -> None:
    joints = draw(rng)
    known = measure(1.0, joints)
    half = joints.copy()
    half[::2] = np.nan
    assert measure(1.0, half) == pytest.approx(known, abs=0.03)
    assert measure(1.0, np.full_like(joints, np.nan)) == {}
    without_hips = tuple(f'x{name}' if name.endswith('hip') else name for name in CMU15.joints)
    assert set(measure(1.0, joints, without_hips)) == {'joints68', 'joints95'}
    assert measure(1.0, joints, tuple(f'x{name}' for name in CMU15.joints)) == {}
