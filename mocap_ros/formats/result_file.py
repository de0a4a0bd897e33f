# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Result files (.npz) of `reconstruct`, read again to be drawn or to be compared with the truth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap_ros.errors import InputError, naming
from mocap_ros.formats.npz_arrays import ArrayReader, list_keys, read_arrays
from mocap_ros.formats.sequence_file import RESULT_KEYS
from mocap_ros.skeleton import Skeleton, skeleton_from_joints
from mocap_ros.units import NS_PER_S

Array = NDArray[np.float64]

READ_KEYS = ('joints3d', 'joint_names', 'timestamps', 'seen', 'residual_px')  # the keys that are read again


@dataclass(frozen=True, eq=False)
class StoredResult:
    """One person's reconstruction as a file holds it.

    Attributes:
        times: (F,) s, increasing.
        joints: (F, J, 3) m in the camera's optical frame; NaN in frames without a skeleton.
        seen: (F, J) True where the joint was seen in the image, False where it was inferred.
        residual: (F,) px, RMS reprojection error over the seen joints; NaN where there is none.
        skeleton: skeleton of the joints.
        recorded_ns: (F,) times in ns, where they are known more exactly than in s, or empty.
        std: (F, J) m, standard deviation of each joint in the body, or None where they are not stored.
        root_covariance: (F, 3, 3) m^2, covariance of the place between the hips, likewise.
    """

    times: Array
    joints: Array
    seen: NDArray[np.bool_]
    residual: Array
    skeleton: Skeleton
    recorded_ns: tuple[int, ...] = ()
    std: Array | None = None
    root_covariance: Array | None = None

    @property
    def stamps_ns(self) -> list[int]:
        """Times (F,) in ns."""
        return list(self.recorded_ns) or [round(float(t) * NS_PER_S) for t in self.times]


def is_result_file(path: Path) -> bool:
    """Return whether a file is an .npz file with the keys of a result."""
    return list_keys(path) >= RESULT_KEYS


def load_result_file(path: Path) -> StoredResult:
    """Read and validate a result file.

    Raises:
        InputError: the file is not a result, or its content is not valid; the error names the file and the key.
    """
    with naming(path):
        arrays = ArrayReader(read_arrays(path, READ_KEYS, 'a result of reconstruct'))
        times = arrays.read_numbers('timestamps', (None,))
        if not len(times) or not (np.isfinite(times).all() and (np.diff(times) > 0).all()):
            raise InputError('timestamps: expected increasing times in s')
        names = arrays.read_joint_names('joint_names')
        skeleton = skeleton_from_joints(names)
        if not skeleton.name:
            raise InputError(f'joint_names: {", ".join(names)}: not those of a known skeleton')
        shape = (len(times), len(names))
        joints = arrays.read_numbers('joints3d', (*shape, 3))
        if np.isinf(joints).any():
            raise InputError('joints3d: not finite')
        seen, residual = arrays.read_flags('seen', shape), arrays.read_numbers('residual_px', shape[:1])
        return StoredResult(times, joints, seen, residual, skeleton)
