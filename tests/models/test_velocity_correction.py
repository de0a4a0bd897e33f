# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The correction of velocities: what it must not depend on, where it does nothing, and what ships."""

from __future__ import annotations

import io

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mocap_ros.errors import ModelError
from mocap_ros.models.model_file import list_shipped_base_poses
from mocap_ros.models.velocity_correction import (
    LEAST_PAST_S,
    MAX_CORRECTION,
    SPANS_S,
    VelocityPast,
    build_inputs,
    decode_velocity_correction,
    load_velocity_correction,
)
from mocap_ros.people import HIPS
from mocap_ros.skeleton import CMU15
from tests.support.swinging_body import STANDING

SPANS = np.array(SPANS_S)
MIRROR = list(CMU15.mirror)


def make_past(seed: int, tremble: float = 0.02) -> VelocityPast:
    """Return somebody upright in an optical frame, 4 m away, whose places tremble by so many m."""
    rng = np.random.default_rng(seed)
    joints = STANDING + [0.5, 0.0, 4.0]
    velocity = rng.normal(0, 1, 3) + rng.normal(0, 0.3, (15, 3))
    earlier = joints - SPANS[:, None, None] * velocity + rng.normal(0, tremble, (len(SPANS), 15, 3))
    axes = Rotation.random(random_state=rng).as_matrix()
    return VelocityPast(velocity, rng.uniform(0.1, 0.8, 15), joints, earlier, axes)


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


@given(st.integers(0, 2**31))
@settings(max_examples=30)
def test_the_mirror_image_has_the_mirrored_correction(seed: int) -> None:
    past, flip = make_past(seed), np.array([-1.0, 1.0, 1.0])
    axes = past.axes * flip[:, None] * [1.0, -1.0, 1.0]
    mirrored = VelocityPast(
        past.velocity[MIRROR] * flip,
        past.std[MIRROR],
        past.joints[MIRROR] * flip,
        np.ascontiguousarray(past.earlier[:, MIRROR] * flip),
        axes,
    )
    np.testing.assert_allclose(build_inputs(past), build_inputs(mirrored)[::-1], atol=1e-12)
    one, other = (load_velocity_correction().correct(p) for p in (past, mirrored))
    np.testing.assert_allclose(one[MIRROR] * flip, other, atol=1e-4)


def test_without_a_past_nothing_is_corrected() -> None:
    past, network = make_past(0), load_velocity_correction()
    assert network.correct(past).any()
    for n, span in enumerate(SPANS):
        earlier = past.earlier.copy()
        earlier[n:] = np.nan
        correction = network.correct(past._replace(earlier=earlier))
        assert np.isfinite(correction).all()
        assert bool(correction.any()) == (span > LEAST_PAST_S)
    unknown = np.full((15, 3), np.nan)
    assert not network.correct(past._replace(velocity=unknown, std=unknown[:, 0].copy())).any()


@pytest.mark.parametrize('tremble', [0.0, 0.05, 10.0, 1e30])
def test_a_correction_is_limited_by_what_the_filter_does_not_know(tremble: float) -> None:
    for seed in range(20):
        past = make_past(seed, tremble)
        correction = np.linalg.norm(load_velocity_correction().correct(past), axis=1)
        assert (correction <= MAX_CORRECTION * past.std * (1 + 1e-9)).all()


def test_what_trembles_in_depth_is_corrected_in_depth() -> None:
    """As of somebody far away, whose image tells the velocity across the line of sight."""
    for seed in range(20):
        past = make_past(seed, 0.0)
        sight = past.joints[list(HIPS)].sum(axis=0)
        sight /= np.linalg.norm(sight)
        depth = np.random.default_rng(seed).normal(0, 0.2, (len(SPANS), 15, 1))
        correction = load_velocity_correction().correct(past._replace(earlier=past.earlier + depth * sight))
        assert np.abs(correction @ sight).max() > 0.01
        np.testing.assert_allclose(correction - (correction @ sight)[:, None] * sight, 0, atol=1e-9)


@pytest.mark.parametrize('speed', [0.0, 0.5, 1.3])
def test_who_stands_or_is_moved_without_moving_keeps_the_velocity(speed: float) -> None:
    past = make_past(0)
    velocity = np.tile([speed, 0.0, speed], (15, 1))
    earlier = past.joints - SPANS[:, None, None] * velocity
    correction = load_velocity_correction().correct(past._replace(velocity=velocity, earlier=earlier))
    np.testing.assert_allclose(correction, 0, atol=1e-9)


def test_the_shipped_network_is_no_base_pose_model_and_a_damaged_one_is_refused() -> None:
    assert 'velocity' not in list_shipped_base_poses()
    network = load_velocity_correction()
    arrays = {name: getattr(network, name) for name in network.__dataclass_fields__}
    for name, broken in (
        ('bias_0', np.full_like(network.bias_0, np.nan)),
        ('weight_1', network.weight_1[:, 1:]),
        ('centre', np.zeros((2, 2))),
    ):
        file = io.BytesIO()
        np.savez(file, **{**arrays, name: broken})
        with pytest.raises(ModelError, match=f'velocity: no correction of velocities.*{name}'):
            decode_velocity_correction(file.getvalue())
    for data in (b'', b'PK\x03\x04 cut off'):
        with pytest.raises(ModelError, match='velocity: no correction of velocities'):
            decode_velocity_correction(data)
