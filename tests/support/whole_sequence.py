# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""One person over a whole sequence, on the floor."""

from collections.abc import Mapping

from mocap_ros.config import Config
from mocap_ros.keypoints.keypoint_sequence import KeypointSequence
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.offline.floor import share_floor
from mocap_ros.offline.whole_sequence import solve_sequence
from mocap_ros.people import PoseSequence


def reconstruct_sequence(
    sequence: KeypointSequence, model: PoseModel | Mapping[str, PoseModel], config: Config
) -> PoseSequence:
    """Reconstruct a sequence with base poses, or several by name."""
    models = {model.name: model} if isinstance(model, PoseModel) else model
    (person,), _ = share_floor([solve_sequence(sequence, models, config)], config.tracker)
    return person
