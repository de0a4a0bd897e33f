"""What an observed window and the solved core tell of face, feet and hands."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap_ros.keypoints.extremities import join_body
from mocap_ros.skeleton import BODY26
from mocap_ros.solvers.extremities import ExtremityEvidence
from mocap_ros.solvers.observed_window import ObservedWindow

Array = NDArray[np.float64]


def collect_evidence(
    core: Array, observed: ObservedWindow, noise: float, frames: int | slice = slice(None)
) -> ExtremityEvidence:
    """Return what frames of a window tell of the extremities.

    Args:
        core: (F, 15, 3) m, solved core joints of these frames in the real camera's frame; (15, 3) of a single one.
        observed: the window, lifted if there is a lifter.
        noise: m, image noise at the body.
        frames: the frames, or the index of a single one.
    """
    lifted, seen = observed.lifted, observed.extremities
    if lifted is None:
        joints = std = np.full((*core.shape[:-2], len(BODY26.joints), 3), np.nan)
    else:
        depth = core[..., 2].mean(axis=-1)[..., None, None]  # lifted poses are in the units of rays
        joints, std = lifted.joints[frames] * depth, lifted.std[frames] * depth
    extremities = None if seen is None else seen.select_frames(frames)
    rays, weight = join_body(observed.rays[frames], observed.weight[frames], extremities)
    return ExtremityEvidence(core, joints, std, rays, weight, noise)
