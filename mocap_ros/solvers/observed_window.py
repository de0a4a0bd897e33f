# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""One person's keypoints over some frames, as every reconstruction sees them and gives them to a solver.

    r_tj               ray of joint j in the real camera: lens distortion undone, left and right put right
    q_tj = pi(V_t (r_tj, 1))          ray in the virtual camera, pi(x, y, z) = (x / z, y / z)
    x_tj = f q_tj                     image point of the solvers' `Window`, px

V_t is the rotation of the virtual camera and f its focal length. Points and lifted poses are in the units of rays;
only `ObservedWindow.build_solver_window` makes them px.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.config import TrackerConfig
from mocap_ros.engine import lifter as engine
from mocap_ros.errors import InputError
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.virtual_camera import VirtualCamera, solver_focal
from mocap_ros.keypoints.association import measure_sizes, show_people
from mocap_ros.keypoints.keypoint_sequence import KeypointSequence
from mocap_ros.keypoints.left_right import BodySides, exchange_sides, find_swapped_parts
from mocap_ros.keypoints.rays import Extremities, convert_to_rays, join_body, select_core_depth
from mocap_ros.models.lifter import LiftedPoses
from mocap_ros.models.lifter_input import JOINT_COUNT, SLOTS
from mocap_ros.skeleton import CMU15, Skeleton
from mocap_ros.solvers.window import (
    MIN_JOINTS_FOR_CAMERA,
    InitialValues,
    Window,
    require_camera_frame,
)

# s; the virtual cameras' directions are averaged over it, so that they follow a walk, but not the joints that come
# and go in single frames
VIEW_SMOOTHING_S = 3.0
RAY_FOCAL = 1.0  # rays; focal length of a camera whose image points are rays
MAX_SPAN_S = (
    1e6  # s (11 days); a longer recording is one with a stamp that was not set, and would need GB of memory
)
# Splits a sequence, by its rays (F, J, 2), weights (F, J) and times (F,) s, into shots between cuts.
ShotFinder = Callable[[Array, Array, Array], list[slice]]


@dataclass(eq=False)
class ObservedWindow:
    """One person's joints in some frames, and the virtual cameras that face the person."""

    times: Array  # (F,) s, increasing
    # (F, J, 2) x / z and y / z of the joints in the real camera, lens distortion undone, left and right put right;
    # finite, and ignored where the weight is 0
    rays: Array
    weight: Array  # (F, J) confidence scores; 0 for a joint that was not seen
    # virtual cameras, one for each frame or one for all, with the real camera's intrinsics
    virtual_camera: VirtualCamera
    focal: float  # px, focal length that the solvers assume; infinite for weak perspective (`solver_focal`)
    # poses of the frames as the lifter estimated them, in the units of rays: the joints along the axes of the real
    # camera, the standard deviations along those of the virtual cameras; None without a lifter
    lifted: LiftedPoses | None = None
    # face, feet and hands, for the lifter, as rays in the real camera, left and right put right; None if none were
    # seen
    extremities: Extremities | None = None
    # (F, J) as of `rays.convert_to_rays`; None if every joint that was seen counts
    is_evidence: NDArray[np.bool_] | None = None
    # (F, J) m, depths along the optical axis of the surfaces that are seen at joints, left and right put right;
    # NaN where unknown, None if all are
    depth: Array | None = None

    @staticmethod
    def facing_person(
        times: Array,
        rays: Array,
        weight: Array,
        intrinsics: Intrinsics,
        focal: float,
        extremities: Extremities | None = None,
        is_evidence: NDArray[np.bool_] | None = None,
        depth: Array | None = None,
    ) -> ObservedWindow:
        """Return a window whose virtual cameras, one for each frame, follow the person."""
        camera = VirtualCamera.look_at_person(rays, weight, times, VIEW_SMOOTHING_S, intrinsics)
        return ObservedWindow(times, rays, weight, camera, focal, None, extremities, is_evidence, depth)

    @property
    def lifted_frames(self) -> int:
        """Number of the first frames, those that have lifted poses."""
        return 0 if self.lifted is None else len(self.lifted.joints)

    @property
    def evidence(self) -> Array:
        """Scores (F, J) of the joints as the solvers see them: 0 for those that were derived from others."""
        return self.weight if self.is_evidence is None else self.weight * self.is_evidence

    @cached_property
    def points(self) -> Array:
        """Image points (F, J, 2) px of the virtual cameras, relative to their axes; 0 where the weight is 0."""
        return self.virtual_camera.view_rays(self.rays, self.weight, self.virtual_camera.intrinsics.focal)

    def select_frames(self, frames: NDArray[np.intp] | slice) -> ObservedWindow:
        """Return the window of some frames, increasing indices or a slice, seen by the same virtual cameras."""
        return replace(
            self,
            times=self.times[frames],
            rays=self.rays[frames],
            weight=self.weight[frames],
            virtual_camera=self.virtual_camera.select_frames(frames),
            lifted=None if self.lifted is None else self.lifted.select_frames(frames),
            extremities=None if self.extremities is None else self.extremities.select_frames(frames),
            is_evidence=None if self.is_evidence is None else self.is_evidence[frames],
            depth=None if self.depth is None else self.depth[frames],
        )

    def exclude_points(self, excluded: NDArray[np.bool_]) -> ObservedWindow:
        """Return the window with the points of a mask (F, J) set to not seen."""
        return replace(self, weight=np.where(excluded, 0.0, self.weight))

    def view_body(self, frames: slice, focal: float) -> tuple[Array, Array]:
        """Return points (F, J, 2) of `skeleton.BODY26` in the virtual cameras, and scores."""
        extremities = None if self.extremities is None else self.extremities.select_frames(frames)
        rays, weight = join_body(self.rays[frames], self.weight[frames], extremities)
        return self.virtual_camera.select_frames(frames).view_rays(rays, weight, focal), weight

    def convert_to_initial_values(self, theta: Array, rotation: Array, roots: Array) -> InitialValues:
        """Return theta (F, K) m, rotations (F, 3, 3) and roots (F, 3) m in the real camera as initial values."""
        return InitialValues(theta, self.virtual_camera.weak_perspective_cameras(rotation, roots))

    def build_solver_window(
        self,
        start: InitialValues | None = None,
        noise: float | None = None,
    ) -> Window:
        """Return the window as a solver gets it, in px of the virtual cameras.

        Its unit is the median scale of `start`; `noise` is in m.

        Raises:
            InputError: No frame has four seen joints.
        """
        lifted = None if self.lifted is None else self.lifted.select_core()
        if lifted is not None:
            focal = self.virtual_camera.intrinsics.focal
            lifted = LiftedPoses(focal * self.virtual_camera.to_virtual_camera(lifted.joints), focal * lifted.std)
        return Window(
            self.points,
            self.evidence,
            self.times,
            start=start,
            unit=None if start is None else statistics.median(start.cameras.scale.tolist()),
            noise=noise,
            focal=self.focal,
            lifted=lifted,
        )


def sample_unlifted_histories(
    windows: Sequence[ObservedWindow], roll: float = 0.0, frames: slice = slice(None)
) -> tuple[Array, Array, Array]:
    """Return rays (N, T, J, 2) and scores (N, T, J) of the frames not lifted yet, for `Lifter.lift`.

    `frames` selects some of these frames of each window. The frames of all windows are one after the other. Their
    virtual cameras are turned about their axes, so that images turn clockwise by `roll` rad; the rotations
    (N, 3, 3) from the real camera to these are returned too.
    """
    people = []
    turn = np.array([
        [math.cos(roll), -math.sin(roll), 0.0], [math.sin(roll), math.cos(roll), 0.0], [0.0, 0.0, 1.0]
    ])  # fmt: skip
    for window in windows:
        groups = [(window.rays, window.weight)]
        if window.extremities is not None:
            groups.append(window.extremities)
        rotation = window.virtual_camera.rotation.reshape(-1, 3, 3)
        rotation = turn @ rotation if roll else rotation
        people.append((window.times, range(window.lifted_frames, len(window.times))[frames], rotation, groups))
    return engine.sample_histories(people, JOINT_COUNT, *SLOTS)


def append_lifted(windows: Sequence[ObservedWindow], lifted: LiftedPoses, cameras: Array) -> None:
    """Add lifted poses, in the units of rays, of the frames not lifted yet, in the axes of cameras as above."""
    joints, end = lifted.joints @ cameras, 0
    for window in windows:
        newest = slice(end, end := end + len(window.times) - window.lifted_frames)
        before, after = window.lifted, LiftedPoses(joints[newest], lifted.std[newest])
        if before is not None:
            pairs = (before.joints, after.joints), (before.std, after.std)
            after = LiftedPoses(*(np.concatenate(pair) for pair in pairs))
        window.lifted = after


def observe_sequence(
    sequence: KeypointSequence,
    config: TrackerConfig,
    skeleton: Skeleton = CMU15,
    find_shots: ShotFinder | None = None,
) -> ObservedWindow:
    """Map a sequence's keypoints to the model's joints, undo swaps of left and right, and face the person.

    A frame with all its points in one place, of four or more seen joints, counts as not seen.

    `config` parameters, `min_score`, `undo_swaps`, `perspective` and `nominal_focal_length` apply; `find_shots`
    splits the sequence into shots, whose sides are put right independently, None if the sequence has no cuts.

    Raises:
        SkeletonError: These names give too few of the model's joints.
        InputError: No frame has four seen joints, all seen points of each such frame lie in one place, or the
            times span more than `MAX_SPAN_S`.
    """
    times, keypoints = sequence.timestamps, sequence.keypoints
    intrinsics = sequence.intrinsics(config.nominal_focal_length)
    if (span_s := float(times[-1] - times[0])) > MAX_SPAN_S:
        raise InputError(
            f'the times span {span_s:.0f} s, at most {MAX_SPAN_S:.0f} s expected; is a stamp not set?'
        )
    rays, weight, is_evidence, found = convert_to_rays(
        keypoints[..., :2], keypoints[..., 2], sequence.joint_names, intrinsics, config.min_score, skeleton
    )
    extremities = found if skeleton == CMU15 else None
    require_camera_frame(weight)
    depth = None
    if skeleton == CMU15 and intrinsics.is_focal_known:
        depth = select_core_depth(sequence.depth, sequence.joint_names, weight)
    rays, weight, extremities = _exclude_frames_in_one_place(rays, weight, extremities)
    if config.undo_swaps:
        sides = BodySides.of(skeleton)
        shots = find_shots(rays, weight, times) if find_shots is not None else [slice(None)]
        swapped = np.concatenate([find_swapped_parts(times[s], rays[s], weight[s], sides) for s in shots])
        if depth is not None:
            _, depth = exchange_sides(rays, depth, swapped, sides)
        rays, weight = exchange_sides(rays, weight, swapped, sides)
        extremities = None if extremities is None else extremities.exchange_sides(swapped)
    focal = solver_focal(intrinsics, config.perspective)
    return ObservedWindow.facing_person(times, rays, weight, intrinsics, focal, extremities, is_evidence, depth)


def _exclude_frames_in_one_place(
    rays: Array, weight: Array, extremities: Extremities | None
) -> tuple[Array, Array, Extremities | None]:
    """Set all points of the frames that show all joints of the core in one place to not seen.

    Frames with fewer than `MIN_JOINTS_FOR_CAMERA` seen joints stay: so few may be in one place in the image of a
    person.

    `rays` (F, J, 2) rays, some frame has `MIN_JOINTS_FOR_CAMERA` seen joints; `weight` (F, J) confidence scores;
    `extremities` those of the same frames, if there are any. Returns the rays, the scores and the extremities, all
    0 in these frames.

    Raises:
        InputError: No other frame has `MIN_JOINTS_FOR_CAMERA` seen joints.
    """
    frames = np.flatnonzero((weight > 0).sum(axis=1) >= MIN_JOINTS_FOR_CAMERA)
    in_one_place = ~show_people(measure_sizes(rays[frames], weight[frames]))
    if in_one_place.all():
        raise InputError('all seen points lie in one place')
    excluded = np.isin(np.arange(len(weight)), frames[in_one_place])[:, None]
    if extremities is not None:
        extremities = Extremities(*_clear(*extremities, excluded))
    return *_clear(rays, weight, excluded), extremities


def _clear(rays: Array, weight: Array, excluded: NDArray[np.bool_]) -> tuple[Array, Array]:
    return np.where(excluded[..., None], 0.0, rays), np.where(excluded, 0.0, weight)
