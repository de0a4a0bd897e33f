# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]

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
) -> tuple[Array, Array]: ...
def drop_far_points(rays: Array, weight: Array, anchors: NDArray[np.int64], reach: Array) -> None: ...
