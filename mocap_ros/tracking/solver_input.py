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

import numpy as np
from numpy.typing import NDArray

from mocap_ros.geometry.rotations import rotation_from_vector, vector_from_rotation
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers.window import EarlierFrames, Window
from mocap_ros.tracking.seen_frames import SeenFrames
from mocap_ros.tracking.solution import TrackSolution

Array = NDArray[np.float64]

EXTRAPOLATION_SHARE = 0.7  # no unit; share of the last step that is repeated; less than 1 to amplify less noise
MAX_EXTRAPOLATION_STEPS = 2.0  # steps; limits the extrapolation after missing frames


def build_solver_window(
    seen: SeenFrames,
    solution: TrackSolution,
    model: BasePoses,
    frames: NDArray[np.intp],
    fixed_frames: int = 0,
) -> Window:
    """Return some frames of a solved track as the input of a solver.

    Args:
        seen: the F frames of the window.
        solution: solution of the first frames, at least F - 1.
        model: base poses of the solution.
        frames: (n,) indices of the frames, increasing.
        fixed_frames: number of frames at the beginning that the solver must not change.
    """
    observed = seen.observed.select_frames(frames)
    solved = np.minimum(frames, len(solution.theta) - 1)
    theta, rotation, roots = solution.theta[solved], solution.rotation[solved], solution.roots[solved]
    if frames[-1] == len(solution.theta):
        theta[-1], rotation[-1], roots[-1] = predict_state(seen, solution, model)
    start = observed.convert_to_initial_values(theta, rotation, roots)
    earlier_frames = None
    first = int(frames[0])
    if fixed_frames and first > 0:
        lengths = model.skeleton.bone_lengths(model.poses(solution.theta[:first]))
        earlier_frames = EarlierFrames(first, lengths.mean(axis=0))
    return observed.build_solver_window(start, solution.noise, fixed_frames, earlier_frames)


def predict_state(seen: SeenFrames, solution: TrackSolution, model: BasePoses) -> tuple[Array, Array, Array]:
    """Predict the state of the newest frame from the last solved ones.

    Args:
        seen: the F frames of the window.
        solution: solution of the first F - 1 frames.
        model: base poses of the solution.

    Returns:
        theta (K,) m, rotation (3, 3) from the body to the real camera and root (3,) m in the real camera's frame.
    """
    theta, rotation, root = solution.theta[-1], solution.rotation[-1], solution.roots[-1]
    stamps_ns, last = seen.stamps_ns, len(solution.theta) - 1
    if last > 0:
        last_step_ns = max(stamps_ns[last] - stamps_ns[last - 1], 1)
        steps = min((stamps_ns[-1] - stamps_ns[last]) / last_step_ns, MAX_EXTRAPOLATION_STEPS)
        share = EXTRAPOLATION_SHARE * steps
        theta = theta + share * (theta - solution.theta[-2])
        root = root + share * (root - solution.roots[-2])
        last_turn = vector_from_rotation(rotation @ solution.rotation[-2].T)
        rotation = rotation_from_vector(share * last_turn) @ rotation
    lifted = seen.observed.lifted
    if lifted is not None:
        movement = root[2] * (lifted.joints[-1] - lifted.joints[last])
        if np.isfinite(movement).all():
            joints = model.poses(solution.theta[-1]) @ solution.rotation[-1].T + movement
            theta = model.weights(joints @ rotation)
    return theta, rotation, root
