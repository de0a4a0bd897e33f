# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""People in 3D from one uncalibrated camera and a 2D keypoint detector.

This module exports the public Python API, which docs/python.md explains:

    sequence = mocap_ros.read('walk.npz')
    result = mocap_ros.reconstruct(sequence)
    mocap_ros.write('walk.bvh', result)

A name is imported when it is first used, so `import mocap_ros` alone imports neither NumPy nor SciPy.

Of the folders, `geometry`, `keypoints`, `models`, `solvers`, `tracking` and `offline` hold the mathematics and
know no messages, bags or file formats. `messages`, `bags` and `formats` read and write them. `runtime` joins the
two sides, `ros` is the only folder that imports rclpy, `api` holds the public functions, and `cli` has the
commands. docs/architecture.md explains the folders.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mocap_ros.api.base_poses import BasePoses
    from mocap_ros.api.evaluate import evaluate
    from mocap_ros.api.files import read, write
    from mocap_ros.api.merge import merge
    from mocap_ros.api.reconstruct import reconstruct
    from mocap_ros.api.tracker import Tracker
    from mocap_ros.config import Config
    from mocap_ros.errors import (
        ConfigError,
        FrameDropped,
        InputError,
        MocapError,
        ModelError,
        RecordingError,
        SkeletonError,
    )
    from mocap_ros.keypoints.keypoint_sequence import GroundTruth, KeypointSequence
    from mocap_ros.people import Motion, MotionKind, Person3D, PoseSequence, Posture
    from mocap_ros.verdict.accuracy import Evaluation

__all__ = [
    'BasePoses',
    'Config',
    'ConfigError',
    'Evaluation',
    'FrameDropped',
    'GroundTruth',
    'InputError',
    'KeypointSequence',
    'MocapError',
    'ModelError',
    'Motion',
    'MotionKind',
    'Person3D',
    'PoseSequence',
    'Posture',
    'RecordingError',
    'SkeletonError',
    'Tracker',
    'evaluate',
    'merge',
    'read',
    'reconstruct',
    'write',
]

# The module that defines each public name.
_MODULES = {
    'mocap_ros.api.base_poses': ('BasePoses',),
    'mocap_ros.api.evaluate': ('evaluate',),
    'mocap_ros.api.files': ('read', 'write'),
    'mocap_ros.api.merge': ('merge',),
    'mocap_ros.api.reconstruct': ('reconstruct',),
    'mocap_ros.api.tracker': ('Tracker',),
    'mocap_ros.config': ('Config',),
    'mocap_ros.errors': (
        'ConfigError',
        'FrameDropped',
        'InputError',
        'MocapError',
        'ModelError',
        'RecordingError',
        'SkeletonError',
    ),
    'mocap_ros.verdict.accuracy': ('Evaluation',),
    'mocap_ros.keypoints.keypoint_sequence': ('GroundTruth', 'KeypointSequence'),
    'mocap_ros.people': ('Motion', 'MotionKind', 'Person3D', 'PoseSequence', 'Posture'),
}

if not TYPE_CHECKING:  # type checkers know the names from above, and so report names that do not exist

    def __getattr__(name: str) -> object:
        """Import a public name when it is first used."""
        for module, names in _MODULES.items():
            if name in names:
                value = globals()[name] = getattr(import_module(module), name)
                return value
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')


def __dir__() -> list[str]:
    """Return the public names and those of the module itself."""
    return sorted({*globals(), *__all__})
