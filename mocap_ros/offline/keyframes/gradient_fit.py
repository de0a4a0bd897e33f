"""A motion fitted to its image (Loy et al. 2004, section 6.2, figure 9).

Step 1 brings each pose to its image points by translation, rotation and scale. Then gradient descent on the
squared reprojection error (eq. 6), each step followed by the return to what a skeleton can do: limb lengths
reset, those of left and right the same, the joints' trajectories low-passed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.errors import InputError
from mocap_ros.geometry.rotations import cross_matrix, small_rotation
from mocap_ros.geometry.weak_perspective import centred_on_seen
from mocap_ros.offline.keyframes.filters import low_pass, median
from mocap_ros.offline.keyframes.interpolation import limb_directions, pose_of
from mocap_ros.skeleton import Skeleton

Array = NDArray[np.float64]

ROBUST = 0.06
PLACING_STEPS = 8
TURN_SPREAD = np.radians(3.0)
POINT_SPREAD = 0.03
SCALE_TIME = 0.6
NEAREST = 0.2
SMALLEST = 1e-9


@dataclass(frozen=True, eq=False)
class Placed:
    """A motion in front of a camera.

    Attributes:
        joints: (F, J, 3) m, camera's axes, about a point near their mean.
        scale: (F,) px/m at that point.
        translation: (F, 2) px, its image.
    """

    joints: Array
    scale: Array
    translation: Array

    def depth(self, focal: float) -> Array:
        """(F, J) of each joint, of that of the body's point; 1 where the focal length is infinite."""
        return np.maximum(1 + self.scale[:, None] * self.joints[..., 2] / focal, NEAREST)

    def lifted(self, points: Array, focal: float) -> Array:
        """(F, J, 2) m: x and y of the points, px, moved to the depth of their joints."""
        away = points * self.depth(focal)[..., None] - self.translation[:, None]
        return np.asarray(away / self.scale[:, None, None])

    def image(self, focal: float) -> Array:
        """(F, J, 2) px."""
        flat = self.scale[:, None, None] * self.joints[..., :2] + self.translation[:, None]
        return np.asarray(flat / self.depth(focal)[..., None])


def placed(motion: Array, points: Array, weight: Array, times: Array, focal: float) -> Placed:
    """Step 1: each pose translated, rotated and scaled to its image points, robustly.

    Rotations are held near none, since key poses are in the camera's frame already; scales are low-passed, and
    both scale and place are interpolated where too little is seen.

    Args:
        motion: (F, J, 3) m, camera's axes.
        points: (F, J, 2) px, anything where the weight is 0.
        weight: (F, J).
        times: (F,) s, increasing.
        focal: px, or infinite.
    """
    joints = motion - motion.mean(axis=1, keepdims=True)
    good = np.flatnonzero((weight > 0).sum(axis=1) >= 3)
    if not len(good):
        raise InputError('no frame has three joints that can be believed')
    body, image, trust = joints[good], points[good], weight[good]
    a, _ = centred_on_seen(body[..., :2], trust)
    b, _ = centred_on_seen(image, trust)
    radius = [np.sqrt((trust[..., None] * v**2).sum(axis=(1, 2))) for v in (a, b)]
    log_scale = np.log(np.maximum(radius[1], SMALLEST) / np.maximum(radius[0], SMALLEST))
    here = Placed(body, np.exp(log_scale), np.zeros((len(good), 2)))
    for _ in range(PLACING_STEPS):
        target = here.lifted(image, focal)
        error = here.joints[..., :2] - target
        middle = _middle(error, trust)
        error = error - middle[:, None]
        robust = trust / (1 + (error**2).sum(axis=-1) / ROBUST**2)
        error, mean = centred_on_seen(error, robust)
        turned, _ = centred_on_seen(here.joints, robust)
        jac = np.concatenate([-cross_matrix(turned)[..., :2, :], turned[..., :2, None]], axis=-1)
        w = robust[..., None, None] / POINT_SPREAD**2
        normal = (np.swapaxes(jac, -1, -2) @ (w * jac)).sum(axis=1)
        gradient = (np.swapaxes(jac, -1, -2) @ (w * error[..., None])).sum(axis=1)[..., 0]
        normal += np.diag([*[TURN_SPREAD**-2] * 3, 1.0])
        step = np.clip(-np.linalg.solve(normal, gradient[..., None])[..., 0], -0.5, 0.5)
        turned = here.joints @ np.swapaxes(small_rotation(step[:, :3]), -1, -2)
        shift = here.scale[:, None] * (middle + mean)
        here = Placed(turned, here.scale * np.exp(step[:, 3]), here.translation - shift)
    low = low_pass(times[good], SCALE_TIME)
    scale = np.exp(low @ np.log(here.scale))
    every = np.empty_like(joints)
    every[:] = joints
    every[good] = here.joints
    knots = times[good]
    translation = np.stack([np.interp(times, knots, here.translation[:, d]) for d in (0, 1)], axis=-1)
    return Placed(every, np.exp(np.interp(times, knots, np.log(scale))), translation)


def _middle(error: Array, weight: Array) -> Array:
    """(F, 2) median error of the seen joints."""
    return np.nan_to_num(median(np.where(weight[..., None] > 0, error, np.nan), axis=1))


def symmetric(lengths: Array, skeleton: Skeleton) -> Array:
    """(B,) limb lengths with those of left and right made the same."""
    child = [c for _, c in skeleton.bones]
    twin = [child.index(skeleton.mirror[c]) for c in child]
    return np.asarray((lengths + lengths[twin]) / 2)


def with_lengths(joints: Array, lengths: Array, skeleton: Skeleton) -> Array:
    """Poses (F, J, 3) with limb lengths (B,) and their own limb directions, centred."""
    return pose_of(limb_directions(joints, skeleton.bones), lengths, skeleton)


@dataclass(frozen=True, eq=False)
class Descent:
    """A fitted motion, and the mean squared reprojection error, m^2, before each step and at the end."""

    placed: Placed
    error: tuple[float, ...]


def fitted(
    start: Placed,
    points: Array,
    weight: Array,
    times: Array,
    lengths: Array,
    skeleton: Skeleton,
    *,
    focal: float,
    step: float,
    smoothing: float,
    iterations: int,
    tolerance: float = 1e-3,
    progress: Callable[[], None] = lambda: None,
) -> Descent:
    """Projected gradient descent on the reprojection error (figure 9).

    Args:
        start: step 1's motion.
        points: (F, J, 2) px, anything where the weight is 0.
        weight: (F, J) in [0, 1].
        times: (F,) s, increasing.
        lengths: (B,) m, of the limbs, left and right the same.
        skeleton: of the joints.
        focal: px, or infinite.
        step: lambda, of the gradient of the squared error in m.
        smoothing: s, standard deviation of the low-pass filter.
        iterations: at most.
        tolerance: relative change of the error that ends it.
        progress: told of every step.
    """
    low = low_pass(times, smoothing) if smoothing > 0 else None
    here = replace(start, joints=with_lengths(start.joints, lengths, skeleton))
    here, gradient, error = _gradient(here, points, weight, focal)
    errors = [error]
    for _ in range(iterations):
        joints = here.joints.copy()
        joints[..., :2] -= step * gradient
        joints = with_lengths(joints, lengths, skeleton)
        if low is not None:
            joints = np.asarray(low @ joints.reshape(len(joints), -1)).reshape(joints.shape)
        here, gradient, error = _gradient(replace(here, joints=joints), points, weight, focal)
        errors.append(error)
        progress()
        if abs(errors[-2] - error) <= tolerance * errors[-2]:
            break
    joints = with_lengths(here.joints, lengths, skeleton)
    return Descent(replace(here, joints=joints), tuple(errors))


def _gradient(here: Placed, points: Array, weight: Array, focal: float) -> tuple[Placed, Array, float]:
    """The motion moved to the best translation, the gradient (F, J, 2) m of its error, and that error, m^2."""
    error = here.joints[..., :2] - here.lifted(points, focal)
    total = weight.sum(axis=1)
    mean = (weight[..., None] * error).sum(axis=1) / np.maximum(total, SMALLEST)[:, None]
    here = replace(here, translation=here.translation - here.scale[:, None] * mean)
    error = (error - mean[:, None]) * weight[..., None]
    squared = float((error**2).sum() / max(weight.sum(), SMALLEST))
    return here, 2 * error, squared
