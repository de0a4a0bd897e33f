"""What an observed window and the solved core tell of face, feet and hands."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import types
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import FLOATS_1D, FLOATS_2D, INPUT_1D, INPUT_2D, kernel
from mocap_ros.keypoints.extremities import Extremities, join_body
from mocap_ros.skeleton import BODY26, CORE_COUNT, EXTREMITY_COUNT
from mocap_ros.solvers.observed_window import ObservedWindow

Array = NDArray[np.float64]

_NOT_LIFTED = np.full((len(BODY26.joints), 3), np.nan)  # m, joints of a person who was not lifted
# rays and scores of a person of whom neither face nor feet nor hands were seen
_NOT_SEEN = Extremities(np.zeros((EXTREMITY_COUNT, 2)), np.zeros(EXTREMITY_COUNT))


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
        """Return that nothing but the core (15, 3) m is known."""
        joints = CORE_COUNT + EXTREMITY_COUNT
        unknown = np.full((joints, 3), np.nan)
        return ExtremityEvidence(core, unknown, unknown, np.zeros((joints, 2)), np.zeros(joints), 0.0)


def collect_evidence(core: Array, observed: ObservedWindow, noise: float) -> ExtremityEvidence:
    """Return what the frames of a window tell of the extremities.

    Args:
        core: (F, 15, 3) m, solved core joints of these frames in the real camera's frame.
        observed: the window, lifted if there is a lifter.
        noise: m, image noise at the body.
    """
    lifted, seen = observed.lifted, observed.extremities
    if lifted is None:
        joints = std = np.full((*core.shape[:-2], len(BODY26.joints), 3), np.nan)
    else:
        depth = core[..., 2].mean(axis=-1)[..., None, None]  # lifted poses are in the units of rays
        joints, std = lifted.joints * depth, lifted.std * depth
    return ExtremityEvidence(core, joints, std, *join_body(observed.rays, observed.weight, seen), noise)


def collect_frame_evidence(core: Array, observed: ObservedWindow, noise: float, frame: int) -> ExtremityEvidence:
    """Return what a frame of a window tells of the extremities, as `collect_evidence` does.

    Args:
        core: (15, 3) m, solved core joints of the frame.
        observed: as for `collect_evidence`.
        noise: as for `collect_evidence`.
        frame: index of the frame.
    """
    lifted, seen = observed.lifted, observed.extremities
    joints, std = (_NOT_LIFTED,) * 2 if lifted is None else (lifted.joints[frame], lifted.std[frame])
    others = _NOT_SEEN if seen is None else seen.select_frames(frame)
    parts = _join_evidence(core, joints, std, observed.rays[frame], observed.weight[frame], *others)
    return ExtremityEvidence(core, *parts, noise)


@kernel(
    types.Tuple((FLOATS_2D, FLOATS_2D, FLOATS_2D, FLOATS_1D))(
        INPUT_2D, INPUT_2D, INPUT_2D, INPUT_2D, INPUT_1D, INPUT_2D, INPUT_1D
    )
)
def _join_evidence(
    core: Array, lifted: Array, lifted_std: Array, rays: Array, weight: Array, others: Array, others_weight: Array
) -> tuple[Array, Array, Array, Array]:
    """Return lifted joints and their deviations in m, rays and scores of all joints.

    Args:
        core: (15, 3) m.
        lifted: (26, 3) in the units of rays.
        lifted_std: (26, 3) likewise.
        rays: (15, 2) of the core.
        weight: (15,) of the core.
        others: (11, 2) rays of the extremities.
        others_weight: (11,) of the extremities.
    """
    joints = len(lifted)
    depth = 0.0
    for j in range(CORE_COUNT):
        depth += core[j, 2] / CORE_COUNT
    all_rays, all_weight = np.empty((joints, 2)), np.empty(joints)
    for j in range(joints):
        if j < CORE_COUNT:
            all_rays[j, 0], all_rays[j, 1], all_weight[j] = rays[j, 0], rays[j, 1], weight[j]
        else:
            e = j - CORE_COUNT
            all_rays[j, 0], all_rays[j, 1], all_weight[j] = others[e, 0], others[e, 1], others_weight[e]
    return lifted * depth, lifted_std * depth, all_rays, all_weight
