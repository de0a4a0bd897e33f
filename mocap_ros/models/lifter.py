# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The lifter: a small network that estimates a 3D pose from 2D joints, as start value and prior of the solvers.

    (p, l) = network(features),   (p', l') = network(features of the mirror image)
    pose = u V^T centre((p + M p') / 2 + x),   std = u exp((l + M l') / 2)

M negates x and exchanges left and right joints; `centre` puts the mean of the core, the joints of
`skeleton.CMU15`, into the origin. The newest image points x, the unit u, the rotation V to the virtual camera and
the features come from `lifter_input.py`. The network is that of Martinez et al. ("A simple yet effective baseline
for 3D human pose estimation", ICCV 2017), extended by a history of 0.8 s and by standard deviations; it gives the
difference of the pose from the newest image points. Poses are in the unit of the image points.

Shapes: N histories, T slots, J joints of `skeleton.BODY26`, J_c of its core `skeleton.CMU15`, F frames.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.engine import lifter as engine
from mocap_ros.models.lifter_input import JOINT_COUNT, MIRROR_PERMUTATION, sample_histories, weigh_vertical
from mocap_ros.models.network import Layers, RoundedNetwork
from mocap_ros.skeleton import CORE_COUNT

LOG_STD_RANGE = -7.0, 1.0  # log of the output unit; bounds standard deviations to 0.001 and 2.7 mean distances

OUTPUT_COUNT = 5 * JOINT_COUNT  # x, y and z of each joint; log standard deviations of x and y together, and of z


@dataclass(eq=False)
class LiftedPoses:
    """3D poses of N frames along the axes of the camera's optical frame (x right, y down, z forward)."""

    # (N, J, 3) joint positions relative to the mean of each pose's core, in the unit of the image points; NaN for
    # frames with too few seen joints
    joints: Array
    # (N, J, 3) standard deviations in the same unit, across the axis of the virtual camera that faces the person
    # (x and y, one value) and along it (z); they are not turned into the camera's axes
    std: Array

    def select_frames(self, frames: NDArray[np.intp] | slice) -> LiftedPoses:
        """Return the poses of the given frames."""
        return LiftedPoses(self.joints[frames], self.std[frames])

    def select_core(self) -> LiftedPoses:
        """Return the poses without face, feet and hands, (N, J_c, 3)."""
        return LiftedPoses(
            np.ascontiguousarray(self.joints[:, :CORE_COUNT]), np.ascontiguousarray(self.std[:, :CORE_COUNT])
        )


@dataclass(frozen=True, eq=False)
class Lifter:
    """The trained network, with its batch normalisation folded into the layers."""

    # weights and biases of each layer: the first layer, then the two layers of each residual block, then the last;
    # in half precision, as in a file, or more
    layers: Layers
    provenance: Mapping[str, object]
    network: RoundedNetwork = field(init=False, repr=False)  # the layers, with the weights rounded to integers

    def __post_init__(self) -> None:
        object.__setattr__(self, 'network', RoundedNetwork.from_layers(self.layers))

    def lift(
        self,
        points: Array,
        weight: Array,
        focal: float = math.inf,
        vertical: Array | None = None,
        vertical_std: Array | None = None,
    ) -> LiftedPoses:
        """Estimate the pose of the newest frame of each of N independent histories.

        Points (N, T, J, 2) at `HISTORY_SLOTS_S` before the newest frame are in any unit, relative to the optical
        axis if `focal`, in their unit, is finite; weights (N, T, J) are 0 where not seen. `vertical` (N, 3) are
        unit vectors upwards in the camera's axes, NaN or None where unknown, with standard deviations (N,) in rad.
        """
        upward = np.zeros((len(weight), 3))
        if vertical is not None and vertical_std is not None:
            upward = weigh_vertical(vertical, vertical_std)
        joints, std = engine.lift(
            np.ascontiguousarray(points, float),
            np.ascontiguousarray(weight, float),
            np.full(len(weight), focal),
            upward,
            self.network,
            MIRROR_PERMUTATION,
            CORE_COUNT,
            *LOG_STD_RANGE,
        )
        return LiftedPoses(joints, std)

    def lift_sequence(self, points: Array, weight: Array, times: Array, focal: float = math.inf) -> LiftedPoses:
        """Estimate the pose of each of F frames from points (F, J, 2), weights and times (F,) s up to it."""
        return self.lift(*sample_histories(points, weight, times, np.arange(len(times))), focal)
