# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Keypoints as rays: the compiled conversion is the plain formula, for any keypoints and lenses."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mocap_ros.geometry.distortion import Distortion
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.joint_map import JointMap, build_joint_map
from mocap_ros.keypoints.rays import convert_to_rays
from mocap_ros.skeleton import keypoint_layout

Array = NDArray[np.float64]

NAMES = keypoint_layout('coco17').joints
MIN_SCORE = 0.3
MAX_POINT_PX = 1e7  # coordinates beyond it count as not seen
LENSES = [
    Distortion(),
    Distortion('plumb_bob', (-0.28, 0.07, 0.0002, 0.00002)),
    Distortion('equidistant', (-0.01, 0.02, -0.02, 0.005)),
]


def make_keypoints(rng: np.random.Generator, frames: tuple[int, ...]) -> tuple[Array, Array]:
    """Return points (..., 17, 2) px and scores (..., 17); some are missing, not numbers or far out of range."""
    points, score = rng.uniform(0, 640, (*frames, 17, 2)), rng.uniform(0, 1.5, (*frames, 17))
    for array, value in ((points, np.nan), (points, 2 * MAX_POINT_PX), (score, np.nan), (score, 0.0)):
        array[rng.random(array.shape) < 0.05] = value
    return points, score


def map_plainly(joint_map: JointMap, points: Array, score: Array) -> tuple[Array, Array]:
    """Return points (Jt, D), NaN where no alternative can be used, and scores (Jt,) of one frame."""
    out, out_score = np.full((len(joint_map.target.joints), points.shape[-1]), np.nan), np.zeros(15)
    seen = (score > 0) & np.isfinite(points).all(axis=-1)
    for joint in range(len(out)):
        for weights, factor in zip(joint_map.weights[:, joint], joint_map.score_factor[:, joint], strict=True):
            used = weights != 0
            if factor > 0 and seen[used].all():
                out[joint], out_score[joint] = weights[used] @ points[used], factor * score[used].min()
                break
    return out, out_score


@pytest.mark.parametrize('dimensions', [2, 3])
def test_joints_are_mapped_as_the_formula_says(dimensions: int, rng: np.random.Generator) -> None:
    joint_map = build_joint_map(NAMES)
    points, score = rng.normal(size=(4, 25, 17, dimensions)), rng.random((4, 25, 17))
    score[rng.random(score.shape) < 0.2] = 0
    points[rng.random(points.shape) < 0.05] = np.nan
    found, found_score = joint_map.apply(points, score)
    assert (found.shape, found_score.shape) == ((4, 25, 15, dimensions), (4, 25, 15))
    for index in np.ndindex(4, 25):
        expected, expected_score = map_plainly(joint_map, points[index], score[index])
        np.testing.assert_allclose(found[index], expected, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(found_score[index], expected_score, rtol=1e-12)
    assert 0.1 < np.isnan(found).mean() < 0.6, 'some joints are seen and some are not'


@pytest.mark.parametrize('lens', LENSES, ids=['pinhole', 'plumb_bob', 'equidistant'])
def test_rays_are_those_of_the_formula(lens: Distortion, rng: np.random.Generator) -> None:
    camera = Intrinsics(640.0, (310.0, 250.0), True, 1.1, lens)
    points, score = make_keypoints(rng, (3, 20))
    points.flags.writeable = score.flags.writeable = False
    rays, weight = convert_to_rays(points, score, NAMES, camera, MIN_SCORE)
    assert (rays.shape, weight.shape) == ((3, 20, 15, 2), (3, 20, 15))
    joint_map, seen_count = build_joint_map(NAMES), 0
    for index in np.ndindex(3, 20):
        with np.errstate(invalid='ignore'):
            is_used = (np.abs(points[index]) < MAX_POINT_PX).all(axis=-1) & (score[index] >= MIN_SCORE)
        expected, expected_weight = map_plainly(
            joint_map, points[index], np.where(is_used, np.minimum(score[index], 1), 0)
        )
        seen = expected_weight > 0
        seen_count += int(seen.sum())
        assert weight[index] == pytest.approx(expected_weight)
        assert (rays[index][~seen] == 0).all()
        assert rays[index][seen] == pytest.approx(camera.pixels_to_rays(expected[seen]), abs=1e-12)
    assert 200 < seen_count < 800, 'some joints are seen and some are not'
