# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What the lifter learns from the solution of a whole sequence, before it is lifted and solved again.

A detector at times takes something else for a joint, for some frames on end and often at a good score. The
solver's robust loss bears that, but the lifter does not. Points that the solution does not explain are hidden from
it,

    e_tj > UNEXPLAINED_MEDIANS max(median e, MIN_MEDIAN_ERROR_M)

with e_tj the reprojection error in m at the body, and its median over all joints that were seen. In frames with
more than `MAX_UNEXPLAINED_JOINTS` such points all are believed.

The lifter sees 0.8 s of noisy points and knows nothing of constant bones and smooth motion; the solution has used
all frames. So the points are drawn to where the solution has them,

    r_tj <- SEEN_SHARE r_tj + (1 - SEEN_SHARE) r'_tj

with r the rays of the seen joints and r' those of the solution's joints, in perspective even where the solution is
in weak perspective. The solution also knows better how the body is turned. So the new lifted poses P_t are turned
as its poses Q_t are,

    P_tj <- R_t P_tj,    R_t = argmin_R sum_j |R P_tj - Q_tj|^2
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.geometry.rotations import centre_poses, fit_rotation
from mocap_ros.models.lifter import LiftedPoses
from mocap_ros.skeleton import CORE_COUNT
from mocap_ros.solvers.observed_window import ObservedWindow
from mocap_ros.solvers.window import Reconstruction, Window

Array = NDArray[np.float64]

SEEN_SHARE = 0.3  # 1; with less, unusual poses are drawn to usual ones; with more, the noise of detectors stays
MIN_DEPTH_M = 0.1  # m; guards divisions, no person is nearer to a camera
UNEXPLAINED_MEDIANS = 4.0  # median errors; 4.7 standard deviations of a coordinate, if errors are Gaussian
# m at the body; a smaller median error counts as this much, so that precise points are believed even where the
# model cannot follow them
MIN_MEDIAN_ERROR_M = 0.03
# joints of a frame; where more are unexplained, the solution is wrong rather than the detector
MAX_UNEXPLAINED_JOINTS = 2


def hide_unexplained_points(observed: ObservedWindow, window: Window, solution: Reconstruction) -> ObservedWindow:
    """Return a person's joints in F frames, seen as `window`, without those that a solution does not explain."""
    unexplained = find_unexplained_points(measure_errors(window, solution), window.weight > 0)
    return observed.exclude_points(unexplained) if unexplained.any() else observed


def draw_points(observed: ObservedWindow, solution: Reconstruction) -> ObservedWindow:
    """Return a person's joints in F frames, not lifted yet, drawn to where a solution has them."""
    camera = observed.virtual_camera
    roots = camera.root_positions(solution.cameras, solution.translation)
    places = camera.to_real_camera(solution.joints) + roots[:, None]
    rays = places[..., :2] / np.maximum(places[..., 2:], MIN_DEPTH_M)
    drawn = SEEN_SHARE * observed.rays + (1 - SEEN_SHARE) * rays
    return replace(observed, rays=np.where(observed.weight[..., None] > 0, drawn, observed.rays), lifted=None)


def turn_like(lifted: LiftedPoses, joints: Array) -> LiftedPoses:
    """Return lifted poses that are turned as the poses (F, J_c, 3) of a solution, in the same axes."""
    core = lifted.joints[:, :CORE_COUNT]
    known = np.isfinite(core).all(axis=(1, 2))
    turned = lifted.joints.copy()
    rotation = fit_rotation(centre_poses(core[known]), centre_poses(joints[known]))
    turned[known] = turned[known] @ np.swapaxes(rotation, -1, -2)
    return LiftedPoses(turned, lifted.std)


def measure_errors(window: Window, solution: Reconstruction) -> Array:
    """Return the reprojection errors (F, J) of a solution in m at the body; 0 where a joint was not seen."""
    scale = solution.cameras.scale[:, None]
    depth = 1 + scale * solution.joints[..., 2] / window.focal
    image = (scale[..., None] * solution.joints[..., :2] + solution.translation[:, None]) / depth[..., None]
    return np.where(window.weight > 0, np.linalg.norm(image - window.points, axis=-1) / scale, 0.0)


def find_unexplained_points(error: Array, seen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Find the seen points (F, J) whose errors (F, J) in m are not explained (formula of the module)."""
    median = max(float(np.median(error[seen])), MIN_MEDIAN_ERROR_M)
    unexplained = seen & (error > UNEXPLAINED_MEDIANS * median)
    return np.asarray(unexplained & (unexplained.sum(axis=1, keepdims=True) <= MAX_UNEXPLAINED_JOINTS))
