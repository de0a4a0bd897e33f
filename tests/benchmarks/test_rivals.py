# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The rivals reconstruct without error what their models can represent."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rivals import bregler, gotardo, ramakrishna, zhou
from rivals.factorisation import reflect_in_depth, turn_to_camera

from mocap_ros.geometry.rotations import nearest_rotation, rotation_from_vector
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.skeleton import CMU15

Array = NDArray[np.float64]

FRAMES = 60
JOINTS = 15


def make_orbit(frames: int = FRAMES) -> Array:
    """Cameras (F, 3, 3) that turn about the body and nod."""
    t = np.linspace(0, 1, frames)
    about_y = rotation_from_vector(np.stack([0 * t, 5 * t, 0 * t], axis=1))
    nod = rotation_from_vector(np.stack([0.5 * np.sin(7 * t), 0 * t, 0.3 * np.cos(5 * t)], axis=1))
    return nod @ about_y


def make_shapes(coefficients: Array) -> Array:
    """Shapes (F, J, 3) m: a rigid one plus deformations with these coefficients (F, K - 1)."""
    basis = np.random.default_rng(0).standard_normal((1 + coefficients.shape[1], JOINTS, 3)) * 0.3
    basis -= basis.mean(axis=1, keepdims=True)
    return np.asarray(basis[0] + 0.4 * np.einsum('fk,kjc->fjc', coefficients, basis[1:]))


def compute_error(found: Array, truth: Array) -> float:
    """Return the mean distance of the joints in m, of the poses or of their mirror images in depth."""
    return min(float(np.linalg.norm(p - truth, axis=-1).mean()) for p in (found, reflect_in_depth(found)))


def make_linear_motion(shapes: int) -> Array:
    return turn_to_camera(make_shapes(gotardo.cosine_basis(FRAMES, 4)[:, 1:shapes]), make_orbit())


def test_both_forms_of_bregler_reconstruct_a_rigid_body() -> None:
    truth = make_linear_motion(1)
    for reconstruct in (bregler.reconstruct_as_printed, bregler.reconstruct_with_full_upgrade):
        assert compute_error(reconstruct(truth[..., :2], 1), truth) < 1e-9  # m


def test_the_full_upgrade_reconstructs_a_deforming_body_and_the_printed_one_does_not() -> None:
    truth = make_linear_motion(2)
    assert compute_error(bregler.reconstruct_with_full_upgrade(truth[..., :2], 2), truth) < 1e-6  # m
    assert compute_error(bregler.reconstruct_as_printed(truth[..., :2], 2), truth) > 0.05  # m


@pytest.mark.parametrize('functions', [6, 12])
def test_smooth_trajectories_reconstruct_a_smoothly_deforming_body(functions: int) -> None:
    truth = make_linear_motion(2)
    cameras = gotardo.find_cameras(truth[..., :2], 2)
    model = gotardo.LinearCoefficients(gotardo.cosine_basis(FRAMES, functions), 2)
    assert compute_error(gotardo.reconstruct(truth[..., :2], cameras, model), truth) < 1e-6  # m


def test_smooth_trajectories_reconstruct_mixed_frequencies_with_known_cameras() -> None:
    basis = gotardo.cosine_basis(FRAMES, 6)
    mixed = basis @ np.random.default_rng(3).standard_normal((6, 2))
    truth = turn_to_camera(make_shapes(mixed), make_orbit())
    found = gotardo.reconstruct(truth[..., :2], make_orbit(), gotardo.LinearCoefficients(basis, 3))
    assert compute_error(found, truth) < 1e-9  # m


def test_kernel_trajectories_reconstruct_a_body_on_a_curve_in_shape_space() -> None:
    model = gotardo.KernelCoefficients(gotardo.cosine_basis(FRAMES, 5), 4, 2, 1.0)
    start = model.initialise()
    coefficients, _ = model.evaluate(start + 0.3 * np.random.default_rng(1).standard_normal(len(start)))
    truth = turn_to_camera(make_shapes(4 * coefficients[:, 1:]), make_orbit())
    assert compute_error(gotardo.reconstruct(truth[..., :2], make_orbit(), model), truth) < 1e-6  # m


def test_the_derivatives_of_the_coefficients_are_those_of_finite_differences() -> None:
    basis, step = gotardo.cosine_basis(20, 5), 1e-6
    for model in (gotardo.LinearCoefficients(basis, 3), gotardo.KernelCoefficients(basis, 4, 2, 1.0)):
        x = model.initialise() + 0.3 * np.random.default_rng(0).standard_normal(len(model.initialise()))
        moves = step * np.eye(len(x))
        numeric = [(model.evaluate(x + m)[0] - model.evaluate(x - m)[0]) / (2 * step) for m in moves]
        np.testing.assert_allclose(model.evaluate(x)[1], numeric, atol=1e-8)


@settings(max_examples=20)
@given(seed=st.integers(0, 1000), size=st.floats(0.1, 10))
def test_the_image_kernel_knows_no_rotation_in_the_image_no_scale_and_no_place(seed: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    points = make_linear_motion(2)[::6, :, :2]
    angle = rng.uniform(0, 2 * np.pi, len(points))
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]).transpose(2, 0, 1)
    moved = size * points @ turn + rng.standard_normal((len(points), 1, 2))
    first, second = (gotardo.image_kernel_basis(p, 4, 1.0) for p in (points, moved))
    np.testing.assert_allclose(first @ first.T, second @ second.T, atol=1e-6)


def test_a_body_before_a_fixed_camera_is_flat_to_a_factorisation_that_knows_the_camera() -> None:
    still = np.broadcast_to(make_orbit()[:1], (FRAMES, 3, 3))
    truth = turn_to_camera(make_shapes(gotardo.cosine_basis(FRAMES, 4)[:, 1:2]), still)
    model = gotardo.LinearCoefficients(gotardo.cosine_basis(FRAMES, 6), 2)
    found = gotardo.reconstruct(truth[..., :2], still, model)
    np.testing.assert_allclose(found[..., :2], truth[..., :2], atol=1e-6)
    np.testing.assert_allclose(found[..., 2], 0, atol=1e-6)


def make_images_of_base_poses(model: BasePoses, count: int) -> tuple[Array, Array]:
    """Poses (N, J, 3) m with `count` base poses and the bones of the mean pose, and the base poses."""
    dictionary = model.components[:count]
    first, second = map(list, zip(*CMU15.bones, strict=True))
    lengths = (dictionary[:, first] - dictionary[:, second]).reshape(count, -1)
    mean = (model.mean[first] - model.mean[second]).ravel()
    cameras = make_orbit()[::4]
    along = lengths @ mean / np.linalg.norm(lengths @ mean)
    across = 0.15 * np.random.default_rng(0).standard_normal((len(cameras), count))
    across -= np.outer(across @ along, along)
    # the smaller root t of |mean + across lengths + t along lengths| = |mean|
    bones, more = mean + across @ lengths, along @ lengths
    half = bones @ more / (more @ more)
    t = -half + np.sign(half) * np.sqrt(half**2 - ((bones**2).sum(axis=1) - mean @ mean) / (more @ more))
    poses = model.mean + np.einsum('nl,ljc->njc', across + np.outer(t, along), dictionary)
    return turn_to_camera(poses - poses.mean(axis=1, keepdims=True), cameras), dictionary


def test_matching_pursuit_reconstructs_a_pose_in_the_span_of_the_dictionary(walk_model: BasePoses) -> None:
    truth, dictionary = make_images_of_base_poses(walk_model, 3)
    found = ramakrishna.reconstruct(1.7 * truth[..., :2], walk_model.mean, dictionary, CMU15.bones, 3, 1e-9, 60)
    assert np.linalg.norm(found - 1.7 * truth, axis=-1).mean(axis=1).max() < 1e-3  # m


@settings(max_examples=50)
@given(seed=st.integers(0, 10**6), size=st.integers(1, 5), rank=st.integers(1, 5), radius=st.floats(0.01, 10))
def test_no_other_point_of_the_sphere_is_lower(seed: int, size: int, rank: int, radius: float) -> None:
    rng = np.random.default_rng(seed)
    factor = rng.standard_normal((size, rank))
    hessian, linear = factor @ factor.T, rng.standard_normal(size)
    (u,) = ramakrishna.minimise_on_sphere(hessian[None], linear[None], np.array([radius]))
    assert np.linalg.norm(u) == pytest.approx(radius)
    others = rng.standard_normal((1000, size))
    others *= radius / np.linalg.norm(others, axis=1, keepdims=True)
    values = np.einsum('ni,ij,nj->n', others, hessian, others) - 2 * others @ linear
    assert u @ hessian @ u - 2 * u @ linear <= values.min() + 1e-6 * np.abs(values).max()


def test_the_convex_relaxation_finds_a_sparse_pose() -> None:
    rng = np.random.default_rng(0)
    dictionary = rng.standard_normal((30, JOINTS, 3))
    dictionary -= dictionary.mean(axis=1, keepdims=True)
    cameras = make_orbit()[::4]
    truth = turn_to_camera(dictionary[rng.integers(30, size=len(cameras))], cameras)
    relaxation = zhou.relax(truth[..., :2], dictionary, 1e-3)
    convex, refined = relaxation.compose_poses(), relaxation.refine_poses()
    assert np.linalg.norm(convex - truth, axis=-1).mean(axis=1).max() < 5e-3  # m, of poses of 1.6 m
    assert np.linalg.norm(refined - truth, axis=-1).mean(axis=1).max() < 1e-4  # m


@settings(max_examples=50)
@given(seed=st.integers(0, 10**6), amount=st.floats(0, 5))
def test_the_spectral_norm_is_shrunk_as_by_singular_values(seed: int, amount: float) -> None:
    matrix = np.random.default_rng(seed).standard_normal((2, 3))
    u, s, vt = np.linalg.svd(matrix, full_matrices=False)
    # s less its projection on the l1 ball: lower the larger one first, then both alike
    level = max(s[0] - amount, (s.sum() - amount) / 2, 0.0) if amount < s.sum() else 0.0
    expected = u @ np.diag(np.minimum(s, level)) @ vt
    np.testing.assert_allclose(zhou.shrink_spectral_norm(matrix, amount), expected, atol=1e-9)


def test_the_first_camera_of_a_pose_is_its_own() -> None:
    cameras = make_orbit()[::10]
    poses = make_shapes(np.zeros((len(cameras), 1)))
    rotations, scales = ramakrishna.fit_first_cameras(2.5 * turn_to_camera(poses, cameras)[..., :2], poses)
    np.testing.assert_allclose(rotations, nearest_rotation(cameras[:, :2]), atol=1e-9)
    np.testing.assert_allclose(scales, 2.5)
