# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The taking over of a solution that was found for a track as it was some frames ago.

The frames that both windows have take the states that were found. A newer frame i goes on from the last of
these, o, as the person has moved since then:

    P_i = P_o + M_i - M_o                      joints about the body's origin, in the axes of the real camera
    R_i = T_i T_o^T R_o                        rotation from body to camera
    r_i = r_o + (t_i - t_o) z(r_o) / z(t_o)    position of the body's origin

with T and t the rotations and positions of the solution so far, and M its poses.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping

import numpy as np

from mocap_ros.models.base_poses import BasePoses
from mocap_ros.tracking.seen_frames import SeenFrames
from mocap_ros.tracking.solution import TrackSolution
from mocap_ros.tracking.track import Track


def is_outdated(then: SeenFrames, now: SeenFrames) -> bool:
    """Return whether what was seen then counts for nothing now.

    So it is if the camera has changed, if left and right of an earlier frame have been exchanged since, or if none
    of the frames is left in the window.

    Args:
        then: the frames of a person as they were.
        now: the frames of the same person now.
    """
    kept = then.swap_filter.is_swapped[bisect_left(then.stamps_ns, now.stamps_ns[0]) :]
    is_relabelled = not np.array_equal(now.swap_filter.is_swapped[: len(kept)], kept)
    return is_relabelled or not len(kept) or then.intrinsics != now.intrinsics


def take_over(found: TrackSolution, then: Track, now: Track, models: Mapping[str, BasePoses]) -> TrackSolution:
    """Return the solution of a track that follows from the solution of the same track some frames ago.

    Args:
        found: solution of all frames of the track as it was.
        then: the track as it was; not outdated.
        now: the track with its own solution of all its frames.
        models: base-pose models by name.
    """
    kept = found.drop_oldest(bisect_left(then.seen.stamps_ns, now.seen.stamps_ns[0]))
    if kept is None:
        raise ValueError(f'track {now.id}: none of the frames is left')
    own, model, last = now.solved, models[found.model_name], len(kept.theta) - 1
    newer = slice(last + 1, None)
    if last + 1 == len(own.theta):
        return kept
    frames = np.arange(last, len(own.theta))
    rotation = own.rotation[newer] @ own.rotation[last].T @ kept.rotation[-1]
    roots = kept.roots[-1] + (own.roots[newer] - own.roots[last]) * (kept.roots[-1, 2] / own.roots[last, 2])
    joints = own.compute_joints(models[own.model_name], frames)
    joints = kept.compute_joints(model, np.array([last])) + joints[1:] - joints[0]
    return kept.append_states(model.weights(joints @ rotation), rotation, roots, model)
