# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What an observed window and the solved core tell of face, feet and hands."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import types
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import FLOATS_2D, FLOATS_3D, INPUT_1D, INPUT_2D, INPUT_3D, kernel
from mocap_ros.keypoints.extremities import Extremities
from mocap_ros.skeleton import BODY26, CORE_COUNT, EXTREMITY_COUNT
from mocap_ros.solvers.observed_window import ObservedWindow

Array = NDArray[np.float64]


class ExtremityEvidence(NamedTuple):
    """What tells of the extremities in one frame; all in the camera's optical frame.

    Attributes:
        core: (15, 3) m, solved core joints.
        lifted: (26, 3) m, lifted joints about any origin; NaN without a lifter.
        lifted_std: (26, 3) m, their standard deviations across (twice) and along the line of sight.
        rays: (26, 2) rays of all joints.
        weight: (26,) confidence scores of all joints; 0 where not seen.
        noise: m, image noise at the body.
    """

    core: Array
    lifted: Array
    lifted_std: Array
    rays: Array
    weight: Array
    noise: float

    def make_contiguous(self) -> ExtremityEvidence:
        """Return the same with arrays that kernels take."""
        core, lifted, lifted_std, rays, weight = (np.ascontiguousarray(a, np.float64) for a in self[:5])
        return ExtremityEvidence(core, lifted, lifted_std, rays, weight, float(self.noise))

    def reverse(self) -> ExtremityEvidence:
        """Return that of a sequence in the reverse order of time."""
        core, lifted, lifted_std, rays, weight = (np.ascontiguousarray(a[::-1]) for a in self[:5])
        return ExtremityEvidence(core, lifted, lifted_std, rays, weight, self.noise)

    def select_frame(self, frame: int) -> ExtremityEvidence:
        """Return that of one frame of a sequence."""
        core, lifted, lifted_std, rays, weight = (a[frame] for a in self[:5])
        return ExtremityEvidence(core, lifted, lifted_std, rays, weight, self.noise)

    @staticmethod
    def without_image(core: Array) -> ExtremityEvidence:
        """Return the evidence of a frame of which only the core (15, 3) m is known."""
        joints = CORE_COUNT + EXTREMITY_COUNT
        unknown = np.full((joints, 3), np.nan)
        return ExtremityEvidence(core, unknown, unknown, np.zeros((joints, 2)), np.zeros(joints), 0.0)


def collect_evidence(
    core: Array, observed: ObservedWindow, noise: float, frames: slice = slice(None)
) -> ExtremityEvidence:
    """Return what F frames of a window tell of the extremities, each array with a first dimension F.

    Args:
        core: (F, 15, 3) m, solved core joints of these frames in the real camera's frame.
        observed: the window, lifted if there is a lifter.
        noise: m, image noise at the body.
        frames: the frames.
    """
    lifted, seen = observed.lifted, observed.extremities
    if lifted is None:
        joints = std = np.full((len(core), len(BODY26.joints), 3), np.nan)
    else:
        joints, std = lifted.joints[frames], lifted.std[frames]
    if seen is None:
        others = Extremities(np.zeros((len(core), EXTREMITY_COUNT, 2)), np.zeros((len(core), EXTREMITY_COUNT)))
    else:
        others = seen.select_frames(frames)
    depth = observed.virtual_camera.select_frames(frames).measure_depth(core.mean(axis=1))
    given = depth, joints, std, observed.rays[frames], observed.weight[frames], *others
    return ExtremityEvidence(core, *_join_evidence(*map(np.ascontiguousarray, given)), noise)


@kernel(
    types.Tuple((FLOATS_3D, FLOATS_3D, FLOATS_3D, FLOATS_2D))(
        INPUT_1D, INPUT_3D, INPUT_3D, INPUT_3D, INPUT_2D, INPUT_3D, INPUT_2D
    )
)
def _join_evidence(
    depth: Array, lifted: Array, lifted_std: Array, rays: Array, weight: Array, others: Array, others_weight: Array
) -> tuple[Array, Array, Array, Array]:
    """Return lifted joints and their deviations in m, rays and scores of all joints in F frames.

    Args:
        depth: (F,) m per unit of rays: the depth of the body along the axes of the virtual cameras.
        lifted: (F, 26, 3) in the units of rays.
        lifted_std: (F, 26, 3) likewise.
        rays: (F, 15, 2) of the core.
        weight: (F, 15) of the core.
        others: (F, 11, 2) rays of the extremities.
        others_weight: (F, 11) of the extremities.
    """
    frames, joints = lifted.shape[:2]
    joints_m, std_m = np.empty(lifted.shape), np.empty(lifted.shape)
    all_rays, all_weight = np.empty((frames, joints, 2)), np.empty((frames, joints))
    for f in range(frames):
        for j in range(joints):
            for i in range(3):
                joints_m[f, j, i], std_m[f, j, i] = depth[f] * lifted[f, j, i], depth[f] * lifted_std[f, j, i]
            for i in range(2):
                all_rays[f, j, i] = rays[f, j, i] if j < CORE_COUNT else others[f, j - CORE_COUNT, i]
            all_weight[f, j] = weight[f, j] if j < CORE_COUNT else others_weight[f, j - CORE_COUNT]
    return joints_m, std_m, all_rays, all_weight
