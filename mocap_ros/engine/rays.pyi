# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]

def turn_to_axes(rays: Array) -> Array: ...
def face_points(rays: Array, weight: Array, min_total: float) -> Array: ...
def rotate_rays(rays: Array, rotation: Array) -> Array: ...
def view_rays(rays: Array, weight: Array, rotation: Array, focal: float) -> Array: ...
def distort_points(points: Array, lens: Array) -> Array: ...
def undistort_points(points: Array, lens: Array) -> Array: ...
def mark_unseen(points: Array, score: Array, max_coordinate: float) -> tuple[Array, Array, bool]: ...
def map_joints(points: Array, score: Array, weights: Array, score_factor: Array) -> tuple[Array, Array]: ...
def convert_to_rays(
    points: Array,
    score: Array,
    weights: Array,
    score_factor: Array,
    min_score: float,
    focal_lengths: Array,
    center: Array,
    lens: Array,
    shows: NDArray[np.uint8],
    midway: NDArray[np.int64],
    min_evidence: int,
    anchors: NDArray[np.int64],
    reach: Array,
) -> tuple[Array, Array, NDArray[np.bool_], Array, Array]: ...
