# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The correction of velocities: what it must not depend on, where it does nothing, and what ships."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mocap_ros.models.model_file import load_velocity_correction
from mocap_ros.models.velocity_correction import LEAST_PAST_S, MAX_CORRECTION, SPANS_S, VelocityPast
from tests.support.swinging_body import STANDING

SPANS = np.array(SPANS_S)


def make_past(seed: int, jitter_m: float = 0.02) -> VelocityPast:
    """Return an upright person in an optical frame, 4 m away, whose earlier positions have this jitter."""
    rng = np.random.default_rng(seed)
    joints = STANDING + [0.5, 0.0, 4.0]
    velocity = rng.normal(0, 1, 3) + rng.normal(0, 0.3, (15, 3))
    earlier = joints - SPANS[:, None, None] * velocity + rng.normal(0, jitter_m, (len(SPANS), 15, 3))
    axes = Rotation.random(random_state=rng).as_matrix()
    past = velocity, rng.uniform(0.1, 0.8, 15), joints, earlier, axes
    return VelocityPast(*(values[None] for values in past))


@given(st.integers(0, 2**31))
@settings(max_examples=30)
def test_a_correction_turns_with_the_axes_of_the_camera(seed: int) -> None:
    past, turn = make_past(seed), Rotation.random(random_state=np.random.default_rng(seed)).as_matrix()
    turned = VelocityPast(
        past.velocity @ turn.T, past.std, past.joints @ turn.T, past.earlier @ turn.T, turn @ past.axes
    )
    one, other = (load_velocity_correction().correct(p) for p in (past, turned))
    assert np.abs(one).max() > 0
    np.testing.assert_allclose(one @ turn.T, other, atol=1e-4)


def test_without_a_past_nothing_is_corrected() -> None:
    past, network = make_past(0), load_velocity_correction()
    assert network.correct(past).any()
    for n, span in enumerate(SPANS):
        earlier = past.earlier.copy()
        earlier[:, n:] = np.nan
        correction = network.correct(past._replace(earlier=earlier))
        assert np.isfinite(correction).all()
        assert bool(correction.any()) == (span > LEAST_PAST_S)
    unknown = np.full((1, 15, 3), np.nan)
    assert not network.correct(past._replace(velocity=unknown, std=unknown[..., 0].copy())).any()


@pytest.mark.parametrize('jitter', [0.05, 1e30])
def test_a_correction_is_limited_by_what_the_filter_does_not_know(jitter: float) -> None:
    for seed in range(20):
        past = make_past(seed, jitter)
        correction = np.linalg.norm(load_velocity_correction().correct(past), axis=2)
        assert (correction <= MAX_CORRECTION * past.std * (1 + 1e-9)).all()
