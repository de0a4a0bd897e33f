# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Where the camera and the floor are in `node.output_frame`, which way is up, and the world of the people."""

from __future__ import annotations

import math

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.config import Config, NodeConfig, parse_numbers
from mocap_ros.errors import ConfigError, InputError
from mocap_ros.geometry.gravity import Gravity
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.level import MAX_CERTAIN_STD, Floor, build_world, is_level
from mocap_ros.geometry.rigid_transform import OPTICAL_TO_BODY, RigidTransform, parse_camera_pose
from mocap_ros.geometry.rotations import quaternion_from_rotation
from mocap_ros.messages.camera_placement import CameraPlacement
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.imu import decode_acceleration
from mocap_ros.messages.transform_tree import TransformTree
from mocap_ros.people import CameraVertical, People
from mocap_ros.skeleton import CORE_COUNT
from mocap_ros.solvers.floor import ANKLE_M, HEEL_M, MAX_STEP_S
from mocap_ros.solvers.vertical import AUTO as AUTO_VERTICAL
from mocap_ros.units import NS_PER_S

CAMERA_MOTION_S = 0.1  # s; over which the motion of the camera is found: as long as velocities are smoothed over
FIRST_S = 0.5  # s; for which the first person shows heading and floor of the world
SETTLING_S = 5.0  # s; time constant with which the world follows the vertical and a floor of known height
SETTLED_S = 60.0  # s; the same of a floor that feet show, once people have stood so long
LEDGE_M = 0.3  # m; feet higher than that over others, or over the floor so far, may be on something


class OutputFrame:
    """The camera and the floor in the frame of the outputs, by the parameters, /tf, /tf_static and an IMU."""

    def __init__(self, node: NodeConfig) -> None:
        self.transforms = TransformTree()
        self._pose: RigidTransform | None = None  # that the parameters give
        self._floor_height: float | None = None  # m, likewise
        if node.output_frame.startswith('/'):
            raise ConfigError(f'node.output_frame = {node.output_frame!r}: frames begin without a slash')
        self._gravity = Gravity()
        self._imu_frame: str | None = None  # of the accelerations, if any have come
        self._imu_rotation: Array | None = None  # that the parameters give, from the IMU to the optical frame
        if node.floor_height and not node.output_frame:
            raise ConfigError('node.floor_height: needs node.output_frame, the frame in which it is given')
        if node.camera_pose:
            self._pose = parse_camera_pose(node.camera_pose, 'node.camera_pose')
        if node.imu_pose:
            from_optical = parse_camera_pose(node.imu_pose, 'node.imu_pose').rotation
            self._imu_rotation = OPTICAL_TO_BODY.T @ from_optical @ OPTICAL_TO_BODY.T
        if node.floor_height:
            numbers = parse_numbers(node.floor_height)
            if len(numbers) != 1 or not math.isfinite(numbers[0]):
                raise ConfigError(
                    f'node.floor_height = {node.floor_height!r}: expected a number of metres, such as 0'
                )
            self._floor_height = numbers[0]
            if self._pose is not None and self._pose.translation[2] <= self._floor_height:
                raise ConfigError(
                    f'node.floor_height = {self._floor_height:g}: the camera of node.camera_pose, at z = '
                    f'{self._pose.translation[2]:g} m, is not above it'
                )

    def place_camera(self, header: Header, node: NodeConfig) -> tuple[Header, CameraPlacement, str]:
        """Return the header of the outputs, the camera in its frame, and why that is not `node.output_frame`.

        The given header has the time of the outputs and the camera's optical frame.
        """
        if not node.output_frame:
            return header, CameraPlacement(header.frame_id), ''
        placed = Header(header.stamp_ns, node.output_frame)
        if self._pose is not None:
            return placed, CameraPlacement(header.frame_id, self._pose), ''
        try:
            pose = self._find_pose(header, node)
        except InputError as error:
            reason = f'{error}, so people are published in the frame of the camera'
            return header, CameraPlacement(header.frame_id), reason
        try:
            before = self._find_pose(header, node, CAMERA_MOTION_S)
        except InputError:  # the transforms begin later
            return placed, CameraPlacement(header.frame_id, pose), ''
        return placed, CameraPlacement(header.frame_id, pose, before, CAMERA_MOTION_S), ''

    def find_floor(self, header: Header, intrinsics: Intrinsics, config: Config) -> tuple[Floor | None, str]:
        """Return the floor at the time of an image, and what a parameter or an IMU does not show, if anything.

        Without `node.floor_height`, a frame whose name says that its z axis is up shows which way is up, else the
        IMU does, or `node.camera_pose` alone. With `tracker.lag`, people of an earlier image are published, so a
        camera that may move shows no more either.
        """
        height, pose, node = self._floor_height, self._pose, config.node
        if height is None and not is_level(node.output_frame):
            return self._find_upward(header, config)
        if pose is None:
            try:
                pose = self._find_pose(header, node)
            except InputError:  # `place_camera` says so
                return self._find_upward(header, config)
        source = f'node.output_frame = {node.output_frame!r}, whose z axis'
        floor, fault = Floor.find(pose, height, source), ''
        if height is None:
            return floor, ''
        if floor.camera_height is None:
            fault = f'the camera is at z = {pose.translation[2]:.2f} m, below it; people keep the assumed size'
        elif not intrinsics.is_focal_known:
            fault = 'without a CameraInfo it shows which way is up, but not how far away people are'
        elif self._pose is None and config.tracker.lag > 0:
            fault = 'with tracker.lag it needs node.camera_pose; people keep the assumed size'
            floor = floor._replace(camera_height=None)
        return floor, fault and f'node.floor_height = {height:g}: {fault}'

    def add_imu(self, raw: bytes, node: NodeConfig) -> None:
        """Add a sensor_msgs/Imu; `find_floor` says why it shows nothing."""
        header, acceleration = decode_acceleration(raw, node)
        if header.frame_id != self._imu_frame:
            self.forget_imu()
            self._imu_frame = header.frame_id
        if acceleration is not None:
            self._gravity.add(header.stamp_ns, acceleration)

    def forget_imu(self) -> None:
        """Begin without accelerations."""
        self._gravity, self._imu_frame = Gravity(), None

    def _find_upward(self, header: Header, config: Config) -> tuple[Floor | None, str]:
        """Return which way is up, and how far below the floor is by `tracker.camera_height`."""
        if config.tracker.vertical != AUTO_VERTICAL:
            return None, ''
        camera_height, fault = config.tracker.camera_height or None, ''
        if self._imu_frame is not None:
            try:
                upward, std = self._gravity.find(header.stamp_ns)
                upward = self._find_imu_rotation(header, self._imu_frame, config.node) @ upward
                return Floor(upward, camera_height, std, source='imu, whose mean acceleration'), ''
            except InputError as error:
                fault = f'imu does not show which way is up: {error}'
        if self._pose is None or config.node.output_frame:  # which may tilt with the robot
            return None, fault
        return Floor(self._pose.rotation[2], camera_height, source='node.camera_pose, whose z axis'), fault

    def _find_imu_rotation(self, header: Header, imu_frame: str, node: NodeConfig) -> Array:
        if self._imu_rotation is not None:
            return self._imu_rotation
        frames = header.frame_id, imu_frame
        return self.transforms.find(*frames, header.stamp_ns, node.transform_tolerance).rotation

    def _find_pose(self, header: Header, node: NodeConfig, earlier_s: float = 0.0) -> RigidTransform:
        frames = node.output_frame, header.frame_id
        return self.transforms.find(*frames, header.stamp_ns, node.transform_tolerance, earlier_s)


class LiveWorld:
    """The world of `geometry.level` in the frame of the outputs, once a person has been seen for `FIRST_S`.

    Its heading and its origin stay, and nothing jumps: the vertical, and the floor where its height is known, are
    followed with `SETTLING_S` about the origin. Where it is not known, the floor is the mean of where people have
    stood so far, those counting less who seem to stand over it.
    """

    def __init__(self) -> None:
        self._first: tuple[str, list[Array]] = '', []  # id, and joints (J, 3) m in the frame of the outputs
        self._first_s = 0.0  # s, for how long that person has been seen
        self._axes, self._origin = np.eye(3), np.zeros(3)  # rotation from that frame, and m in it
        self._is_known = False
        self._stamp_ns: int | None = None  # of the newest image
        self._stood_s = FIRST_S  # s, for how long people have stood on the floor, at most `SETTLED_S`

    def advance(
        self,
        stamp_ns: int,
        people: People,
        vertical: CameraVertical | None,
        camera: CameraPlacement,
        camera_height: float | None,
    ) -> RigidTransform | None:
        """Return the transform from the world to the frame of the outputs after an image; None if not known.

        People and vertical are in that frame; `camera_height` in m over the floor is None where not known.
        """
        before_ns = stamp_ns if self._stamp_ns is None else self._stamp_ns
        step_s = min(max(stamp_ns - before_ns, 0) / NS_PER_S, MAX_STEP_S)
        self._stamp_ns = stamp_ns
        is_seen = ~people.predicted & np.isfinite(people.joints).all(axis=(1, 2)) & people.is_scale_known
        people = people.select(np.flatnonzero(is_seen))
        if not self._is_known and len(people):
            self._add_first(people, step_s)
        is_certain = vertical is not None and vertical.std <= MAX_CERTAIN_STD
        if vertical is not None and is_certain and self._first_s >= FIRST_S:
            share = step_s / SETTLING_S
            if not self._is_known:
                world = build_world(np.array(self._first[1]), vertical.direction, None)
                self._axes, self._origin = world[:3, :3], -world[:3, :3].T @ world[:3, 3]
                self._is_known, share = True, 1.0
            self._turn(share, vertical.direction)
            if camera_height is not None:
                place = np.zeros(3) if camera.pose is None else camera.pose.translation
                rise = float((place - self._origin) @ self._axes[2]) - camera_height
            else:
                share, rise = self._weigh_feet(step_s, people)
            self._origin = self._origin + share * rise * self._axes[2]
        if not self._is_known:
            return None
        return RigidTransform(self._origin.copy(), quaternion_from_rotation(self._axes.T))

    def _add_first(self, people: People, step_s: float) -> None:
        row = people.ids.index(self._first[0]) if self._first[0] in people.ids else 0
        if people.ids[row] != self._first[0]:
            self._first, self._first_s, step_s = (people.ids[row], []), 0.0, 0.0
        if self._first_s < FIRST_S:
            self._first[1].append(people.joints[row])
            self._first_s += step_s

    def _turn(self, share: float, upward: Array) -> None:
        up = self._axes[2] + share * (upward - self._axes[2])
        up /= np.linalg.norm(up)
        left = np.cross(up, self._axes[0])
        left /= np.linalg.norm(left)
        self._axes = np.array([np.cross(left, up), left, up])

    def _weigh_feet(self, step_s: float, people: People) -> tuple[float, float]:
        """Return the share with which the floor follows the feet in this frame, and their height over it in m."""
        weights = 2 * np.fmax(people.contact[:, 0], people.contact[:, 1]) - 1
        stand = weights > 0
        if not stand.any():
            return 0.0, 0.0
        over_joint = HEEL_M if people.joints.shape[1] > CORE_COUNT else ANKLE_M
        heights = ((people.joints - self._origin) @ self._axes[2]).min(axis=1) - over_joint
        stand &= heights < heights[stand].min() + LEDGE_M
        rise = float(np.average(heights[stand], weights=weights[stand]))
        counted_s = step_s * float(weights[stand].max()) / (1 + (max(rise, 0.0) / LEDGE_M) ** 2)
        self._stood_s = min(self._stood_s + counted_s, SETTLED_S)
        return counted_s / self._stood_s, rise
