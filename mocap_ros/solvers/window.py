# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The input and output of every solver, and the initial values that all solvers share.

A solver receives a `Window` of image points x_tj with scores w_tj and estimates, for every frame t, the weights
theta_t of the base poses (TPAMI 2016, eq. 1) and a weak-perspective camera (scale s_t, rotation R_t, translation
t_t):

    P_tj = Q_0j + sum_l theta_tl Q_lj                    pose in the body frame, m
    x_tj ~ s_t R_t[:2] P_tj + t_t                        image point, px (eq. 8 and 14)

The result is a `Reconstruction`. The solvers start from the mean pose, theta = 0, seen by closed-form cameras
(section 3.5, eq. 10 and 11), unless the window says otherwise.

Sizes in this package: F frames, J joints, B bones, K base poses.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.engine import joint as engine
from mocap_ros.errors import InputError
from mocap_ros.geometry.interpolation import find_nearest, interpolate_linearly
from mocap_ros.geometry.weak_perspective import WeakPerspectiveCameras, fit_cameras_closed_form
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.models.lifter import LiftedPoses

# Four points in general position determine an affine camera: 8 unknowns, 2 equations a point.
MIN_JOINTS_FOR_CAMERA = 4
# Reflection of the camera frame that reverses depth (z).
DEPTH_REFLECTION = np.diag([1.0, 1.0, -1.0])
# Reflection of the body frame that exchanges front and back (x).
BODY_REFLECTION = np.diag([-1.0, 1.0, 1.0])


@dataclass(frozen=True, eq=False)
class InitialValues:
    """Values of the unknowns from which a solver starts."""

    theta: Array  # (F, K) m, weights of the base poses
    # scale (F,) in px/m and rotation (F, 3, 3) from the body frame to the camera frame
    cameras: WeakPerspectiveCameras


@dataclass(frozen=True, eq=False)
class Window:
    """Image points of one person over consecutive frames, with what is known about them in advance.

    Raises:
        InputError: the shapes do not match, or no frame has `MIN_JOINTS_FOR_CAMERA` seen joints.
    """

    # (F, J, 2) px, joints in the order of the model's skeleton. All values are finite; the value of a point of
    # weight 0 is ignored
    points: Array
    weight: Array  # (F, J) confidence scores of the detector, 0 for joints that were not seen
    times: Array  # (F,) s, increasing
    start: InitialValues | None = None  # initial values; None selects the mean pose and closed-form cameras
    # px/m, the constant s0 that converts image errors to metres at the body; None selects the median scale of the
    # initial cameras. Objectives of one window are comparable only under the same unit
    unit: float | None = None
    # m, standard deviation of a coordinate of a point of weight 1; None to estimate it from the residual
    noise: float | None = None
    # px, focal length of a virtual camera that faces the person; `points` are relative to its optical axis.
    # Infinity selects weak perspective
    focal: float = math.inf
    # 3D poses of the frames as estimated by the lifter, in px, used as a prior; None uses the prior of the base
    # poses alone
    lifted: LiftedPoses | None = None

    def __post_init__(self) -> None:
        frames, joints = self.weight.shape
        if self.points.shape != (frames, joints, 2) or self.times.shape != (frames,):
            raise InputError(
                f'points {self.points.shape}, weight {self.weight.shape} and times '
                f'{self.times.shape} do not fit each other'
            )
        if self.lifted is not None and self.lifted.joints.shape != (frames, joints, 3):
            raise InputError(f'lifted poses {self.lifted.joints.shape} do not fit points {self.points.shape}')
        require_camera_frame(self.weight)


def require_camera_frame(weight: Array) -> None:
    """Raise an `InputError` unless some frame of weights (F, J) has `MIN_JOINTS_FOR_CAMERA` seen joints."""
    if not any(np.count_nonzero(frame > 0) >= MIN_JOINTS_FOR_CAMERA for frame in weight[::-1]):
        raise InputError('no frame has four seen joints: nothing to reconstruct')


class SolverStatus(IntEnum):
    """Why a solver stopped. As in `scipy.optimize`, positive values are successes."""

    SINGULAR = engine.Ending.SINGULAR
    MAX_ITERATIONS = engine.Ending.MAX_ITERATIONS
    CONVERGED = engine.Ending.CONVERGED
    NO_LOWER_STEP = engine.Ending.NO_LOWER_STEP

    @property
    def message(self) -> str:
        """The reason as a sentence."""
        return STATUS_MESSAGES[self]


STATUS_MESSAGES = {
    SolverStatus.SINGULAR: 'Not converged: the equations for the next step have no finite solution.',
    SolverStatus.MAX_ITERATIONS: 'Not converged: the largest number of iterations was reached.',
    SolverStatus.CONVERGED: 'Converged: the last iteration changed the objective by less than the tolerance.',
    SolverStatus.NO_LOWER_STEP: 'Converged: no step lowers the objective any further.',
}


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """3D poses and cameras of the frames of a window, and how the solver ended.

    The names of the latter are those of `scipy.optimize.OptimizeResult` where it has them. Every field holds what
    was computed; what only some solvers compute is in subclasses.
    """

    # (F, J, 3) m, poses along the axes of the camera optical frame (x right, y down, z forward), each centred on
    # the mean of its joints
    joints: Array
    theta: Array  # (F, K) m, weights of the base poses
    # scale (F,) in px/m and rotation (F, 3, 3) from the body frame to the camera frame
    cameras: WeakPerspectiveCameras
    # (F, 2) px, image of the origin of the body frame; interpolated in frames without a seen joint
    translation: Array
    residual: Array  # (F,) px, RMS reprojection error over the seen joints; NaN for a frame without any
    status: SolverStatus
    # m^2, values of the objective at the initial values and after the steps. A solver that estimates the image
    # noise in rounds gives those of its last round, since objectives under different noise are not comparable
    history: tuple[float, ...]
    iterations: int  # number of steps that were tried, in all rounds together

    @property
    def cost(self) -> float:
        """Final value of the objective, m^2."""
        return self.history[-1]

    @property
    def success(self) -> bool:
        """Whether the solver converged."""
        return self.status > 0

    @property
    def message(self) -> str:
        """Why the solver stopped, as a sentence."""
        return self.status.message


def choose_initial_values(window: Window, model: PoseModel, camera_window_s: float) -> tuple[InitialValues, float]:
    """Return the window's initial values and unit (px/m), each replaced by its default if it is None."""
    start = window.start or initialise_from_mean_pose(window, model, camera_window_s)
    k = len(model.std)
    unit = window.unit or float(np.median(start.cameras.scale))
    return InitialValues(start.theta[:, :k], start.cameras), unit


def reverse_depth(start: InitialValues) -> InitialValues:
    """Return the initial values with the Necker reversal R -> diag(1, 1, -1) R diag(-1, 1, 1) of the cameras.

    The projection of a body seen from the front hardly changes under it; there it is half a turn about the
    vertical.
    """
    rotation = DEPTH_REFLECTION @ start.cameras.rotation @ BODY_REFLECTION
    return InitialValues(start.theta, WeakPerspectiveCameras(start.cameras.scale, rotation))


def interpolate_unseen(translation: Array, window: Window) -> Array:
    """Return translations (F, 2) px, those of frames without a seen joint interpolated in time from the others."""
    seen = np.asarray((window.weight > 0).any(axis=1))
    if seen.all():
        return translation
    interpolated = interpolate_linearly(window.times, window.times[seen], translation[seen])
    return np.where(seen[:, None], translation, interpolated)


def initialise_from_mean_pose(window: Window, model: PoseModel, camera_window_s: float) -> InitialValues:
    """Return the mean pose for every frame, seen by closed-form cameras (TPAMI 2016, section 3.5).

    Frames within `camera_window_s` s share one, 0 fits each alone; one of fewer than `MIN_JOINTS_FOR_CAMERA` seen
    joints has that of the nearest frame.
    """
    theta = np.zeros((len(window.times), len(model.std)))
    cameras = fit_cameras_closed_form(
        model.poses(theta), window.points, window.weight, window.times, camera_window_s
    )
    has_camera = np.flatnonzero((window.weight > 0).sum(axis=1) >= MIN_JOINTS_FOR_CAMERA)
    nearest = has_camera[find_nearest(window.times, window.times[has_camera])]
    return InitialValues(theta, WeakPerspectiveCameras(cameras.scale[nearest], cameras.rotation[nearest]))
