"""Some frames of a track as the input of a solver: the image points, and the solution so far as initial values.

A new frame at time t_n starts from a prediction by the last two solved frames:

    a       = EXTRAPOLATION_SHARE min((t_n - t_(n-1)) / (t_(n-1) - t_(n-2)), MAX_EXTRAPOLATION_STEPS)
    theta_n = theta_(n-1) + a (theta_(n-1) - theta_(n-2))                 weights of the base poses
    root_n  = root_(n-1) + a (root_(n-1) - root_(n-2))                    position of the body's origin
    R_n     = exp(a log(R_(n-1) R_(n-2)^T)) R_(n-1)                       rotation from body to camera

With a lifter, theta_n instead approximates the pose P_(n-1) + L_n - L_(n-1), the last pose P moved as the lifted
pose L has moved.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import (
    FLOAT,
    FLOATS_1D,
    FLOATS_2D,
    FLOATS_3D,
    INPUT_1D,
    INPUT_2D,
    INPUT_3D,
    INT,
    kernel,
)
from mocap_ros.geometry.rotations import MIN_SINE, write_rotation_from_vector
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers.window import EarlierFrames, Window
from mocap_ros.tracking.seen_frames import SeenFrames
from mocap_ros.tracking.solution import TrackSolution, average_rows

Array = NDArray[np.float64]

EXTRAPOLATION_SHARE = 0.7  # no unit; share of the last step that is repeated; less than 1 to amplify less noise
MAX_EXTRAPOLATION_STEPS = 2.0  # steps; limits the extrapolation after missing frames
NO_POSES = np.empty((0, 0, 3))  # lifted poses where there is no lifter


def build_solver_window(seen: SeenFrames, solution: TrackSolution, frames: NDArray[np.intp]) -> Window:
    """Return some solved frames of a track as the input of a solver.

    Args:
        seen: the F frames of the window.
        solution: their solution.
        frames: (n,) indices of the frames, increasing.
    """
    observed = seen.observed.select_frames(frames)
    states = solution.theta[frames], solution.rotation[frames], solution.roots[frames]
    return observed.build_solver_window(observed.convert_to_initial_values(*states), solution.noise)


def build_refinement_window(
    seen: SeenFrames, solution: TrackSolution, model: BasePoses, first: int, fixed_frames: int
) -> Window:
    """Return the newest frames of a track, the last of which is not solved yet, as the input of a solver.

    Args:
        seen: the F frames of the window.
        solution: solution of the first F - 1 frames.
        model: base poses of the solution.
        first: index of the first frame of the solver's window.
        fixed_frames: number of frames at its beginning that the solver must not change.
    """
    observed = seen.observed.select_frames(slice(first, None))
    start = observed.convert_to_initial_values(*append_prediction(seen, solution, model, first))
    earlier_frames = None
    if fixed_frames and first > 0:
        earlier_frames = EarlierFrames(first, average_rows(solution.bone_lengths[:first]))
    return observed.build_solver_window(start, solution.noise, fixed_frames, earlier_frames)


def append_prediction(
    seen: SeenFrames, solution: TrackSolution, model: BasePoses, first: int
) -> tuple[Array, Array, Array]:
    """Return the states of the newest n frames, that of the last one predicted from the last solved ones.

    Args:
        seen: the F frames of the window.
        solution: solution of the first F - 1 frames.
        model: base poses of the solution.
        first: index of the first of the n frames, at most F - 1.

    Returns:
        theta (n, K) m, rotations (n, 3, 3) from the body to the real camera, and roots (n, 3) m in its frame.
    """
    stamps_ns, last, share = seen.stamps_ns, len(solution.theta) - 1, 0.0
    if last > 0:
        last_step_ns = max(stamps_ns[last] - stamps_ns[last - 1], 1)
        steps = min((stamps_ns[-1] - stamps_ns[last]) / last_step_ns, MAX_EXTRAPOLATION_STEPS)
        share = EXTRAPOLATION_SHARE * steps
    lifted = seen.observed.lifted
    lifted_joints = NO_POSES if lifted is None else lifted.joints[last:]
    states = solution.theta, solution.rotation, solution.roots
    return _append_prediction(*states, first, share, lifted_joints, model.mean, model.components)


@kernel(types.Tuple((FLOATS_1D, FLOATS_2D, FLOATS_1D))(FLOAT, INPUT_2D, INPUT_3D, INPUT_2D))
def _extrapolate_state(share: float, theta: Array, rotation: Array, roots: Array) -> tuple[Array, Array, Array]:
    """Return theta_n, R_n and root_n of the module's formulas without a lifter.

    Args:
        share: a.
        theta: (2, K) m, weights in the last two solved frames, or (1, K) if only one is solved.
        rotation: (2, 3, 3) or (1, 3, 3), rotations likewise.
        roots: (2, 3) m or (1, 3) m, positions likewise.
    """
    turn, vector = np.empty((3, 3)), np.empty(3)
    last, before = rotation[-1], rotation[0]
    for i in range(3):
        for j in range(3):
            turn[i, j] = last[i, 0] * before[j, 0] + last[i, 1] * before[j, 1] + last[i, 2] * before[j, 2]
    vector[0], vector[1] = (turn[2, 1] - turn[1, 2]) / 2, (turn[0, 2] - turn[2, 0]) / 2
    vector[2] = (turn[1, 0] - turn[0, 1]) / 2
    sine = math.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    angle = math.atan2(sine, (turn[0, 0] + turn[1, 1] + turn[2, 2] - 1) / 2)
    vector *= share * max(angle, MIN_SINE) / max(sine, MIN_SINE)
    write_rotation_from_vector(vector, turn)
    new_rotation = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                new_rotation[i, j] += turn[i, k] * last[k, j]
    new_theta, new_root = theta[-1] + share * (theta[-1] - theta[0]), roots[-1] + share * (roots[-1] - roots[0])
    return new_theta, new_rotation, new_root


@kernel(FLOATS_1D(INPUT_1D, INPUT_2D, INPUT_2D, INPUT_2D, FLOAT, INPUT_2D, INPUT_2D, INPUT_3D))
def _follow_lifted_pose(
    theta: Array,
    rotation: Array,
    lifted: Array,
    next_lifted: Array,
    depth: float,
    next_rotation: Array,
    mean: Array,
    components: Array,
) -> Array:
    """Return theta_n (K,) m of the module's formula with a lifter; NaN where a lifted pose is not known.

    Args:
        theta: (K,) m, weights of the last solved frame.
        rotation: (3, 3), its rotation from the body to the camera.
        lifted: (J, 3) its lifted pose, in the units of rays.
        next_lifted: (J, 3) lifted pose of the new frame.
        depth: m, depth of the body's origin in the new frame, which converts these poses to m.
        next_rotation: (3, 3) rotation R_n of the new frame.
        mean: (J, 3) m, mean pose.
        components: (K, J, 3) base poses.
    """
    joints, change, basis = mean.copy(), np.empty(3), components.reshape(len(components), mean.size)
    pose = joints.ravel()
    for k in range(len(theta)):
        for i in range(len(pose)):
            pose[i] += theta[k] * basis[k, i]
    for j in range(len(joints)):
        for axis in range(3):
            change[axis] = depth * (next_lifted[j, axis] - lifted[j, axis])
            for i in range(3):
                change[axis] += rotation[axis, i] * joints[j, i]
        for axis in range(3):
            joints[j, axis] = -mean[j, axis]
            for i in range(3):
                joints[j, axis] += change[i] * next_rotation[i, axis]
    out = np.zeros(len(theta))
    for k in range(len(theta)):
        for i in range(len(pose)):
            out[k] += basis[k, i] * pose[i]
    return out


@kernel(
    types.Tuple((FLOATS_2D, FLOATS_3D, FLOATS_2D))(
        *(INPUT_2D, INPUT_3D, INPUT_2D, INT, FLOAT, INPUT_3D, INPUT_2D, INPUT_3D)
    )
)
def _append_prediction(
    theta: Array,
    rotation: Array,
    roots: Array,
    first: int,
    share: float,
    lifted: Array,
    mean: Array,
    components: Array,
) -> tuple[Array, Array, Array]:
    """Compute `append_prediction`.

    Args:
        theta: (S, K) m, weights of the solved frames.
        rotation: (S, 3, 3), their rotations.
        roots: (S, 3) m, their positions.
        first: index of the first frame to return.
        share: a.
        lifted: lifted poses, that of the last solved frame first and that of the new frame last; empty without a
            lifter.
        mean: (J, 3) m, mean pose.
        components: (K, J, 3) base poses.
    """
    last, count = len(theta) - 1, len(theta) - first
    new_theta, new_rotation = np.empty((count + 1, theta.shape[1])), np.empty((count + 1, 3, 3))
    new_roots = np.empty((count + 1, 3))
    new_theta[:count], new_rotation[:count], new_roots[:count] = theta[first:], rotation[first:], roots[first:]
    recent = slice(max(last - 1, 0), None)
    next_theta, next_rotation, next_root = _extrapolate_state(
        share, theta[recent], rotation[recent], roots[recent]
    )
    if len(lifted) > 0:
        newest = (theta[last], rotation[last], lifted[0], lifted[-1])
        followed = _follow_lifted_pose(*newest, next_root[2], next_rotation, mean, components)
        if math.isfinite(followed[0]):
            next_theta = followed
    new_theta[count], new_rotation[count], new_roots[count] = next_theta, next_rotation, next_root
    return new_theta, new_rotation, new_roots
