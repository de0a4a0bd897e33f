"""One tracked person: the sliding window of recent frames, its 3D solution, and the prediction of new frames.

The solver starts a new frame at time t_n from a prediction by the last two solved frames:

    a       = EXTRAPOLATION_SHARE min((t_n - t_(n-1)) / (t_(n-1) - t_(n-2)), MAX_EXTRAPOLATION_STEPS)
    theta_n = theta_(n-1) + a (theta_(n-1) - theta_(n-2))                 weights of the base poses
    root_n  = root_(n-1) + a (root_(n-1) - root_(n-2))                    position of the body's origin
    R_n     = exp(a log(R_(n-1) R_(n-2)^T)) R_(n-1)                       rotation from body to camera

With a lifter, theta_n instead approximates the pose P_(n-1) + L_n - L_(n-1), the last pose P moved as the lifted
pose L has moved.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.rotations import fit_rotation, rotation_from_vector, vector_from_rotation
from mocap_ros.geometry.virtual_camera import VirtualCamera, rotation_to_optical_axis
from mocap_ros.geometry.weak_perspective import WeakPerspectiveCameras
from mocap_ros.keypoints.association import ExpectedExtent, measure_extent
from mocap_ros.keypoints.left_right import SwapFilter
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.lifter import LiftedPoses, concatenate_lifted, sample_histories
from mocap_ros.people import Motion, MotionKind
from mocap_ros.skeleton import estimate_stature
from mocap_ros.solvers.window import EarlierFrames, InitialValues, Reconstruction, Window
from mocap_ros.units import NS_PER_S

Array = NDArray[np.float64]

VELOCITY_SPAN_S = 0.25  # s; velocities are averaged over this time, which evens out image noise and single steps
MIN_VELOCITY_SPAN_S = 0.05  # s; over a shorter time image noise, divided by the time, looks like a fast movement
MIN_VELOCITY_FRAMES = 3  # frames; a line through two frames does not average the noise
EXTRAPOLATION_SHARE = 0.7  # no unit; share of the last step that is repeated; less than 1 to amplify less noise
MAX_EXTRAPOLATION_STEPS = 2.0  # steps; limits the extrapolation after missing frames
INITIAL_NOISE = 0.05  # m; image noise before the first solution; the joint solver lowers it from this value, too
MIN_TOTAL_WEIGHT = 1e-12  # no unit; guards the division by the sum of the confidence scores
MIN_DEPTH_M = 1e-3  # m; guards the division by the depth of the body's origin
# Motion of a track before its window is long enough to be classified.
UNKNOWN_MOTION = Motion(MotionKind.UNKNOWN, '', float('nan'), float('nan'))


@dataclass(eq=False)
class Track:
    """A tracked person.

    Arrays run over the F frames of the window. The first S of these frames are solved, where S is F, or F - 1
    between the arrival of a frame and its solution. Arrays are always replaced and never written into, so a
    shallow copy of a track is a snapshot.

    Attributes:
        id: stable name of the person in the output.
        given_id: name that the detector gives the person; empty if it gives none.
        first_stamp_ns: ns, stamp of the person's first frame.
        swap_filter: filter that finds the frames with swapped left and right.
        stamps_ns: (F,) ns, stamps of the frames.
        rays: (F, J, 2) x / z and y / z of the joints in the real camera, with the detector's labels.
        weight: (F, J) confidence scores with the detector's labels; 0 for a joint that was not seen.
        corrected_rays: (F, J, 2) rays with swaps of left and right undone.
        corrected_weight: (F, J) confidence scores with swaps of left and right undone.
        view_rotation: (3, 3) rotation from the real camera to a virtual camera that faces the person, one for the
            whole window.
        theta: (S, K) m, weights of the base poses.
        rotation: (S, 3, 3) rotations from the body to the real camera.
        roots: (S, 3) m, positions of the body's origin in the real camera's frame, before `stature_ratio` is
            applied.
        lifted: 3D poses that the lifter estimated for the first frames, in the units of rays (image plane at
            distance 1) and the axes of the real camera; None before the first.
        model_name: name of the base-pose model of the solution; empty before the first solution.
        noise: m, standard deviation of a coordinate of a fully trusted image point, at the body.
        stature_ratio: stature of the solution divided by that of the model.
        swapped_count: number of frames that arrived with swapped left and right.
        joint_std: (J,) m, posterior standard deviations of the newest frame's joints.
        residual: RMS reprojection error of the last solved frames as a fraction of the body's RMS radius.
        frame_residual: px, RMS reprojection error of the newest frame.
        next_check_ns: ns, stamp at which the next hypothesis check is due.
        check_count: number of hypothesis checks so far.
        pending_restarts: number of re-initialisations that are still due after the image noise has risen.
        next_classification_ns: ns, stamp at which the motion is to be classified again.
        classification_count: number of classifications so far.
        periodic_model_name: name of the model of the periodic motion; empty if the motion is not periodic.
        baseline_noise: m, image noise after the last round of checks in which every model had its turn; infinite
            before the first round.
        motion: kind of motion of the window.
    """

    id: str
    given_id: str
    first_stamp_ns: int
    swap_filter: SwapFilter
    stamps_ns: list[int] = field(default_factory=list)
    rays: Array = field(default_factory=lambda: np.empty((0, 0, 2)))
    weight: Array = field(default_factory=lambda: np.empty((0, 0)))
    corrected_rays: Array = field(default_factory=lambda: np.empty((0, 0, 2)))
    corrected_weight: Array = field(default_factory=lambda: np.empty((0, 0)))
    view_rotation: Array = field(default_factory=lambda: np.eye(3))
    theta: Array = field(default_factory=lambda: np.empty((0, 0)))
    rotation: Array = field(default_factory=lambda: np.empty((0, 3, 3)))
    roots: Array = field(default_factory=lambda: np.empty((0, 3)))
    lifted: LiftedPoses | None = None
    model_name: str = ''
    noise: float = INITIAL_NOISE
    stature_ratio: float = 1.0
    swapped_count: int = 0
    joint_std: Array = field(default_factory=lambda: np.empty(0))
    residual: float = float('nan')
    frame_residual: float = float('nan')
    next_check_ns: int = 0
    check_count: int = 0
    pending_restarts: int = 0
    next_classification_ns: int = 0
    classification_count: int = 0
    periodic_model_name: str = ''
    baseline_noise: float = math.inf
    motion: Motion = UNKNOWN_MOTION

    @property
    def is_solved(self) -> bool:
        """Whether some frames of the window are solved."""
        return len(self.theta) > 0

    @property
    def has_unsolved_frame(self) -> bool:
        """Whether the newest frame of the window is not solved yet."""
        return len(self.theta) < len(self.stamps_ns)

    def add_frame(self, stamp_ns: int, rays: Array, weight: Array, window_s: float) -> None:
        """Append a frame to the window and drop the frames that are too old.

        A frame may change the decision about swaps in earlier frames. Their lifted poses are then dropped, and a
        hypothesis check becomes due.

        Args:
            stamp_ns: ns, stamp of the frame.
            rays: (J, 2) rays in the real camera, with the detector's labels.
            weight: (J,) confidence scores; 0 for a joint that was not seen.
            window_s: s, length of the window.
        """
        body_size = measure_extent(rays, weight).size
        swapped_before = self.swap_filter.is_swapped
        dropped = sum(t < stamp_ns - window_s * NS_PER_S for t in self.stamps_ns)
        time_s = (stamp_ns - self.first_stamp_ns) / NS_PER_S
        self.swap_filter = self.swap_filter.update(time_s, rays, weight, body_size).drop_oldest(dropped)
        self.stamps_ns = [*self.stamps_ns[dropped:], stamp_ns]
        self.rays = np.concatenate([self.rays[dropped:], rays[None]]) if len(self.rays) else rays[None]
        self.weight = np.concatenate([self.weight[dropped:], weight[None]]) if len(self.weight) else weight[None]
        self.theta, self.rotation, self.roots = self.theta[dropped:], self.rotation[dropped:], self.roots[dropped:]
        swapped_now = self.swap_filter.is_swapped
        self.swapped_count += int(swapped_now[-1])
        has_relabelled_frames = not np.array_equal(swapped_now[:-1], swapped_before[dropped:])
        if has_relabelled_frames:
            self.next_check_ns = stamp_ns
        if self.lifted is not None:
            self.lifted = None if has_relabelled_frames else self.lifted.select_frames(slice(dropped, None))
        self.update_view()

    def update_view(self) -> None:
        """Undo swaps of left and right, and turn the virtual camera towards the centre of the seen joints."""
        rays, weight, mirror = self.rays, self.weight, self.swap_filter.mirror
        is_swapped = self.swap_filter.is_swapped
        if is_swapped.any():
            rays = np.where(is_swapped[:, None, None], rays[:, mirror], rays)
            weight = np.where(is_swapped[:, None], weight[:, mirror], weight)
        self.corrected_rays, self.corrected_weight = rays, weight
        centre = np.einsum('fj,fjd->d', weight, rays) / max(weight.sum(), MIN_TOTAL_WEIGHT)
        self.view_rotation = rotation_to_optical_axis(centre)

    def change_camera(self, old: Intrinsics, new: Intrinsics) -> None:
        """Convert the window and its solution to other intrinsics, so that image points stay the same.

        Args:
            old: intrinsics of the window so far.
            new: intrinsics from now on.
        """
        ones = np.ones_like(self.rays[..., :1])
        self.lifted = None
        self.rays = new.pixels_to_rays(old.project(np.concatenate([self.rays, ones], axis=-1)))
        self.update_view()
        depth = self.roots[:, 2:] * new.focal / old.focal
        rays = new.pixels_to_rays(old.project(self.roots))
        self.roots = np.concatenate([rays * depth, depth], axis=-1)

    def virtual_camera(self, intrinsics: Intrinsics) -> VirtualCamera:
        """Return the virtual camera that faces the person.

        Args:
            intrinsics: intrinsics of the real camera.
        """
        return VirtualCamera(self.view_rotation, intrinsics)

    def expect_extent(self, stamp_ns: int) -> ExpectedExtent:
        """Return where the person is expected in the image, in the units of rays.

        The centre moves on with its mean velocity over the last `VELOCITY_SPAN_S`, for at most as long.

        Args:
            stamp_ns: ns, time of the image.
        """
        centre, size = measure_extent(self.rays[-1], self.weight[-1])
        age_s = (stamp_ns - self.stamps_ns[-1]) / NS_PER_S
        if len(self.stamps_ns) > 1:
            first = int(np.searchsorted(self.stamps_ns, self.stamps_ns[-1] - VELOCITY_SPAN_S * NS_PER_S))
            span_s = (self.stamps_ns[-1] - self.stamps_ns[first]) / NS_PER_S
            if span_s >= MIN_VELOCITY_SPAN_S:
                first_centre, _ = measure_extent(self.rays[first], self.weight[first])
                centre = centre + (centre - first_centre) * min(age_s, VELOCITY_SPAN_S) / span_s
        return ExpectedExtent(centre, size, age_s)

    def build_lifter_input(self, intrinsics: Intrinsics) -> tuple[Array, Array]:
        """Return the histories of the frames that are not lifted yet, for `Lifter.lift`.

        Args:
            intrinsics: intrinsics of the real camera.

        Returns:
            points: (N, T, J, 2) px, image points in the virtual camera.
            weight: (N, T, J) confidence scores.
        """
        first = 0 if self.lifted is None else len(self.lifted.joints)
        times = (np.array(self.stamps_ns) - self.stamps_ns[0]) / NS_PER_S
        points = self.virtual_camera(intrinsics).project_rays(self.corrected_rays)
        return sample_histories(points, self.corrected_weight, times, np.arange(first, len(times)))

    def append_lifted(self, lifted: LiftedPoses, intrinsics: Intrinsics) -> None:
        """Append the lifted poses of the frames of `build_lifter_input`.

        Args:
            lifted: poses as `Lifter.lift` returns them, in px and the axes of the virtual camera.
            intrinsics: intrinsics of the real camera.
        """
        joints = self.virtual_camera(intrinsics).to_real_camera(lifted.joints)
        in_rays = LiftedPoses(joints, lifted.std).scale_by(1 / intrinsics.focal)
        self.lifted = in_rays if self.lifted is None else concatenate_lifted([self.lifted, in_rays])

    def build_window(
        self, intrinsics: Intrinsics, focal: float, frames: NDArray[np.intp], fixed_frames: int, model: BasePoses
    ) -> Window:
        """Return some frames of the window as the input of a solver.

        Args:
            intrinsics: intrinsics of the real camera.
            focal: px, focal length that the solver assumes; infinite for weak perspective.
            frames: (n,) indices of the frames, increasing.
            fixed_frames: number of frames at the beginning that the solver must not change.
            model: base poses of the solution so far.
        """
        camera = self.virtual_camera(intrinsics)
        rays, weight = self.corrected_rays[frames], self.corrected_weight[frames]
        points = np.where(weight[..., None] > 0, camera.project_rays(rays), 0.0)
        times = np.array([self.stamps_ns[f] - self.stamps_ns[0] for f in frames]) / NS_PER_S
        lifted = None
        if self.lifted is not None:
            in_px = self.lifted.select_frames(frames).scale_by(intrinsics.focal)
            lifted = LiftedPoses(in_px.joints @ camera.rotation.T, in_px.std)
        if not self.is_solved:
            return Window(points, weight, times, focal=focal, lifted=lifted)
        start = self._build_start(camera, frames, model)
        earlier_frames = None
        first = int(frames[0])
        if fixed_frames and first > 0:
            lengths = model.skeleton.bone_lengths(model.poses(self.theta[:first]))
            earlier_frames = EarlierFrames(first, lengths.mean(axis=0))
        return Window(
            points,
            weight,
            times,
            start=start,
            unit=float(np.median(start.cameras.scale)),
            noise=self.noise,
            focal=focal,
            fixed_frames=fixed_frames,
            earlier_frames=earlier_frames,
            lifted=lifted,
        )

    def _build_start(self, camera: VirtualCamera, frames: NDArray[np.intp], model: BasePoses) -> InitialValues:
        """Return the solution of some frames in the virtual camera, with a prediction for the newest one."""
        solved = np.minimum(frames, len(self.theta) - 1)
        theta, rotation, roots = self.theta[solved], self.rotation[solved], self.roots[solved]
        if frames[-1] == len(self.theta):
            theta[-1], rotation[-1], roots[-1] = self._predict_state(model)
        depth = (roots @ camera.rotation.T)[:, 2]
        scale = camera.intrinsics.focal / np.maximum(depth, MIN_DEPTH_M)
        return InitialValues(theta, WeakPerspectiveCameras(scale, camera.rotation @ rotation))

    def _predict_state(self, model: BasePoses) -> tuple[Array, Array, Array]:
        """Predict weights (K,), rotation (3, 3) and root (3,) of the newest frame from the last solved ones."""
        theta, rotation, root = self.theta[-1], self.rotation[-1], self.roots[-1]
        last = len(self.theta) - 1
        if last > 0:
            last_step_ns = max(self.stamps_ns[last] - self.stamps_ns[last - 1], 1)
            steps = min((self.stamps_ns[-1] - self.stamps_ns[last]) / last_step_ns, MAX_EXTRAPOLATION_STEPS)
            share = EXTRAPOLATION_SHARE * steps
            theta = theta + share * (theta - self.theta[-2])
            root = root + share * (root - self.roots[-2])
            last_turn = vector_from_rotation(rotation @ self.rotation[-2].T)
            rotation = rotation_from_vector(share * last_turn) @ rotation
        if self.lifted is not None:
            movement = root[2] * (self.lifted.joints[-1] - self.lifted.joints[last])
            if np.isfinite(movement).all():
                joints = model.poses(self.theta[-1]) @ self.rotation[-1].T + movement
                theta = model.weights(joints @ rotation)
        return theta, rotation, root

    def store_solution(
        self, solution: Reconstruction, frames: NDArray[np.intp], fixed_frames: int, intrinsics: Intrinsics
    ) -> None:
        """Replace the states of some frames by a solution of the window that `build_window` made of them.

        After a solution of the newest frames alone, the image noise is averaged over the length of the window.

        Args:
            solution: solution of the frames, in the virtual camera.
            frames: (n,) indices of the frames, increasing.
            fixed_frames: number of frames at the beginning that keep their state.
            intrinsics: intrinsics of the real camera.
        """
        camera = self.virtual_camera(intrinsics)
        count = len(self.stamps_ns)

        def replace_states(old: Array, solved: Array) -> Array:
            if len(frames) == count and not fixed_frames:
                return solved
            out = np.empty((count, *solved.shape[1:]))
            out[: len(old)] = old
            out[frames[fixed_frames:]] = solved[fixed_frames:]
            return out

        self.theta = replace_states(self.theta, solution.theta)
        self.rotation = replace_states(self.rotation, camera.body_rotations(solution.cameras))
        self.roots = replace_states(self.roots, camera.root_positions(solution.cameras, solution.translation))
        self._store_fit_quality(solution)
        old_share = math.exp(-len(frames) / count) if fixed_frames else 0.0
        self.noise = math.sqrt(old_share * self.noise**2 + (1 - old_share) * solution.noise**2)

    def store_interpolated_solution(
        self, solution: Reconstruction, frames: NDArray[np.intp], intrinsics: Intrinsics
    ) -> None:
        """Replace the states of all frames since the first of some, interpolating between those that are solved.

        Args:
            solution: solution of the frames, in the virtual camera.
            frames: (n,) indices of the solved frames, increasing; the last is the newest of the window.
            intrinsics: intrinsics of the real camera.
        """
        camera = self.virtual_camera(intrinsics)
        theta = solution.theta
        roots = camera.root_positions(solution.cameras, solution.translation)
        rotation = camera.body_rotations(solution.cameras)
        stamps_ns = np.array(self.stamps_ns)
        times, solved_times = (stamps_ns - stamps_ns[0]) / NS_PER_S, (stamps_ns[frames] - stamps_ns[0]) / NS_PER_S
        times = times[times >= solved_times[0]]
        if len(frames) > 1:
            rotation = Slerp(solved_times, Rotation.from_matrix(rotation))(times).as_matrix()
        theta, roots = _interpolate(times, solved_times, theta), _interpolate(times, solved_times, roots)
        if first := int(frames[0]):
            theta = np.concatenate([self.theta[:first], theta])
            rotation = np.concatenate([self.rotation[:first], rotation])
            roots = np.concatenate([self.roots[:first], roots])
        self.theta, self.rotation, self.roots = theta, rotation, roots
        self.noise = solution.noise
        self._store_fit_quality(solution)

    def _store_fit_quality(self, solution: Reconstruction) -> None:
        """Store the posterior standard deviations and the residuals of a solution."""
        self.joint_std = solution.joint_std
        self.frame_residual = float(solution.residual[-1])
        body_px = np.sqrt((solution.joints[-1, :, :2] ** 2).sum(axis=-1).mean()) * solution.cameras.scale[-1]
        self.residual = float(np.sqrt(np.nanmean(solution.residual**2)) / body_px)

    def update_stature_ratio(self, model: BasePoses) -> None:
        """Measure the stature of the solution again.

        Args:
            model: base poses of the solution.
        """
        self.stature_ratio = estimate_stature(model.poses(self.theta), model.skeleton) / model.stature

    def select_frames(self, step_s: float, span_s: float) -> NDArray[np.intp]:
        """Return the indices of the frames with the highest scores, one for each step of time, increasing.

        The newest frame is always selected.

        Args:
            step_s: s, length of a step.
            span_s: s, age beyond which no frame is selected.
        """
        stamps_ns = np.array(self.stamps_ns)
        age_s = (stamps_ns[-1] - stamps_ns) / NS_PER_S
        step = (age_s / step_s + 0.5).astype(int)
        total_weight = self.weight.sum(axis=1)
        total_weight[-1] = np.inf
        order = np.lexsort((-total_weight, step))
        is_first_of_step = np.diff(step[order], prepend=-1) != 0
        selected = np.sort(order[is_first_of_step])
        return np.asarray(selected[age_s[selected] <= span_s])

    def convert_poses(
        self, model: BasePoses, target_model: BasePoses, frames: NDArray[np.intp]
    ) -> tuple[Array, Array]:
        """Approximate the 3D poses of some solved frames under another model.

        Args:
            model: base poses of the solution.
            target_model: other base poses.
            frames: (n,) indices of the frames.

        Returns:
            rotation: (n, 3, 3) rotations from the body to the real camera under the other model.
            theta: (n, K) m, weights of the other model.
        """
        joints = self.compute_joints(model, frames)
        rotation = fit_rotation(target_model.mean[None], joints)
        return rotation, target_model.weights(joints @ rotation)

    def change_model(self, model: BasePoses, target_model: BasePoses) -> None:
        """Approximate the poses of all solved frames under another model.

        Args:
            model: base poses of the solution so far.
            target_model: base poses of the solution from now on.
        """
        if target_model is not model:
            self.rotation, self.theta = self.convert_poses(model, target_model, np.arange(len(self.theta)))

    def compute_joints(self, model: BasePoses, frames: NDArray[np.intp]) -> Array:
        """Return the joints of some solved frames about the body's origin, (n, J, 3) m in the real camera's axes.

        Args:
            model: base poses of the solution.
            frames: (n,) indices of the frames.
        """
        poses = model.poses(self.theta[frames])
        return np.asarray(poses @ np.swapaxes(self.rotation[frames], -1, -2))

    def estimate_velocity(self) -> Array:
        """Return the velocity of the root, (3,) m/s: the slope of a line through the last `VELOCITY_SPAN_S`.

        The velocity is 0 if there are too few frames for a line.
        """
        stamps_ns = np.array(self.stamps_ns)
        is_recent = stamps_ns >= stamps_ns[-1] - VELOCITY_SPAN_S * NS_PER_S
        t = (stamps_ns[is_recent] - stamps_ns[-1]) / NS_PER_S
        if len(t) < MIN_VELOCITY_FRAMES or np.ptp(t) < VELOCITY_SPAN_S / 3:
            return np.zeros(3)
        t = t - t.mean()
        return np.asarray(t @ self.roots[is_recent] / (t @ t))


def _interpolate(times: Array, sample_times: Array, samples: Array) -> Array:
    """Interpolate samples (n, D) linearly at some times (N,), to (N, D)."""
    return np.stack([np.interp(times, sample_times, s) for s in samples.T], axis=-1)
