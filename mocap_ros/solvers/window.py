"""What every solver is given and gives back, and where they all begin."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros.errors import InputError
from mocap_ros.geometry.rotations import small_rotation
from mocap_ros.geometry.weak_perspective import Cameras, closed_form
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.lifter import Lifted

Array = NDArray[np.float64]

ENOUGH_FOR_A_CAMERA = 4
REVERSED_DEPTH = np.diag([1.0, 1.0, -1.0])
REVERSED_BODY = np.diag([-1.0, 1.0, 1.0])
RING = (45.0, 90.0, 135.0, 180.0)


@dataclass(frozen=True, eq=False)
class Start:
    """Start values: weights (F, K) and cameras, scale in px/m."""

    theta: Array
    cameras: Cameras


@dataclass(frozen=True, eq=False)
class Older:
    """What is known of the frames before a window: how many, and their mean bone lengths (B,) m."""

    frames: int
    bone_lengths: Array


@dataclass(frozen=True, eq=False)
class Window:
    """One person's image points over some frames.

    Attributes:
        points: (F, J, 2) px in the order of the model's skeleton; finite, anything where the weight is 0.
        weight: (F, J) detector scores, 0 where not seen.
        times: (F,) s, increasing.
        start: where to begin; None for the mean pose and closed-form cameras.
        unit: px/m, the constant that makes image errors metres; None for the median start scale. Objectives
            of one window from several starts compare only under one unit.
        noise: m, standard deviation of a coordinate of a fully trusted point; None to find it.
        focal: px, of a camera that looks at the person, points relative to its axis; infinite: weak perspective.
        held: so many frames at the beginning keep their start, which `start` must give.
        older: frames before these, or None.
        lifted: 3D poses of the frames in px, as a prior; None for that of the base poses alone.
    """

    points: Array
    weight: Array
    times: Array
    start: Start | None = None
    unit: float | None = None
    noise: float | None = None
    focal: float = math.inf
    held: int = 0
    older: Older | None = None
    lifted: Lifted | None = None

    def __post_init__(self) -> None:
        frames, joints = self.weight.shape
        if self.points.shape != (frames, joints, 2) or self.times.shape != (frames,):
            raise InputError(
                f'points {self.points.shape}, weight {self.weight.shape} and times '
                f'{self.times.shape} do not fit each other'
            )
        if self.lifted is not None and self.lifted.joints.shape != (frames, joints, 3):
            raise InputError(f'lifted poses {self.lifted.joints.shape} do not fit points {self.points.shape}')
        if not ((self.weight > 0).sum(axis=1) >= ENOUGH_FOR_A_CAMERA).any():
            raise InputError('no frame has four seen joints: nothing to reconstruct')


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """3D poses and cameras of a sequence.

    Attributes:
        joints: (F, J, 3) m, camera optical frame's orientation, each pose centred on the mean of its joints.
        theta: (F, K) m, weights of the base poses.
        cameras: scale in px/m, rotation body to camera.
        translation: (F, 2) px, image of the body's origin.
        residual: (F,) px, RMS reprojection error over the seen joints; NaN where none is.
        objective: its value at the start and after every step, never rising; m^2.
        iterations: steps made.
        converged: False where `max_iterations` ended it.
        noise: m, standard deviation of a coordinate of a fully trusted point, found from the residual; NaN where
            not looked for.
        spread: (J,) m, posterior standard deviation (root of the trace of the covariance) of each joint of the
            last frame about the body's origin; NaN where not computed.
    """

    joints: Array
    theta: Array
    cameras: Cameras
    translation: Array
    residual: Array
    objective: tuple[float, ...]
    iterations: int
    converged: bool
    noise: float
    spread: Array


def begin(window: Window, model: BasePoses, share: float) -> tuple[Start, float]:
    """The window's start and unit, or the default ones; `share` s as in `camera.closed_form`."""
    start = window.start or mean_pose_start(window, model, share)
    k = len(model.std)
    return Start(start.theta[:, :k], start.cameras), window.unit or float(np.median(start.cameras.scale))


def camera_hypotheses(start: Start, count: int) -> list[Start]:
    """The start, its Necker reversal, and a ring of headings: `count` starts in all.

    A nearly planar body looks the same with its depth reversed, which for a body seen from the front is a turn by
    half; the ring covers wrong headings of other kinds.
    """
    cameras = start.cameras
    turns = [REVERSED_BODY, *(_turn(sign * step) for step in RING for sign in (1, -1))]
    rotations = [cameras.rotation] + [
        REVERSED_DEPTH @ cameras.rotation @ REVERSED_BODY if turn is REVERSED_BODY else cameras.rotation @ turn
        for turn in turns
    ]
    return [Start(start.theta, Cameras(cameras.scale, rotation)) for rotation in rotations[:count]]


def _turn(degrees: float) -> Array:
    """(3, 3) rotation of the body about its vertical."""
    return small_rotation(np.radians([0.0, 0.0, degrees]))


def mean_pose_start(window: Window, model: BasePoses, share: float) -> Start:
    """The mean pose in every frame, seen by closed-form cameras (TPAMI 2016, section 3.5).

    Frames without enough joints for a camera take the nearest frame's that has them; `share` s as in
    `camera.closed_form`.
    """
    theta = np.zeros((len(window.times), len(model.std)))
    cameras = closed_form(model.poses(theta), window.points, window.weight, window.times, share)
    good = np.flatnonzero((window.weight > 0).sum(axis=1) >= ENOUGH_FOR_A_CAMERA)
    nearest = good[np.abs(window.times[:, None] - window.times[good]).argmin(axis=1)]
    return Start(theta, Cameras(cameras.scale[nearest], cameras.rotation[nearest]))
