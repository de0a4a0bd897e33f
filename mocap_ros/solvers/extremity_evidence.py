"""What an observed window and the solved core tell of face, feet and hands."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap_ros.skeleton import BODY26
from mocap_ros.solvers.extremities import EXTREMITY_COUNT, ExtremityEvidence
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
    rays, weight = observed.rays[frames], observed.weight[frames]
    if seen is None:
        no_rays = np.zeros((*core.shape[:-2], EXTREMITY_COUNT, 2))
        seen_rays, seen_weight = no_rays, no_rays[..., 0]
    else:
        seen_rays, seen_weight = seen.rays[frames], seen.weight[frames]
    all_rays, all_weight = (
        np.concatenate([rays, seen_rays], axis=-2),
        np.concatenate([weight, seen_weight], axis=-1),
    )
    return ExtremityEvidence(core, joints, std, all_rays, all_weight, noise)
