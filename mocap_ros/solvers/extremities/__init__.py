# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Face, feet and hands of a person: rigid parts that hang on the core joints, followed over time.

The head, the feet and the hands are rigid parts k. Each hangs on a core joint c_k (`head`, ankles, wrists) and
turns by R_k, from its own axes (x forward, y left, z up; `body_segments.py`) to the camera's optical frame.
`parts.py` has their points, `evidence.py` what a frame tells of them, `correction.py` how that corrects them,
`following.py` the live and `smoothing.py` the whole sequence.
"""

from mocap_ros.solvers.extremities.evidence import ExtremityEvidence, collect_evidence
from mocap_ros.solvers.extremities.following import ANGULAR_SPEED_STD, ExtremityState
from mocap_ros.solvers.extremities.parts import SEGMENT_OF, attach
from mocap_ros.solvers.extremities.smoothing import ExtremitySequence, smooth_extremities

__all__ = [
    'ANGULAR_SPEED_STD',
    'SEGMENT_OF',
    'ExtremityEvidence',
    'ExtremitySequence',
    'ExtremityState',
    'attach',
    'collect_evidence',
    'smooth_extremities',
]
