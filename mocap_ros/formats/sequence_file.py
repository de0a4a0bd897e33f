"""Sequence files (.npz): one person's keypoints in the images of one camera, and the true 3D joints if known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap_ros.errors import InputError, SkeletonError, describe_read_error
from mocap_ros.geometry.distortion import Distortion
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.joint_map import build_joint_map
from mocap_ros.keypoints.person import Person2D
from mocap_ros.keypoints.validation import find_first_fault, looks_normalised, mark_unseen
from mocap_ros.npz_file import open_npz
from mocap_ros.skeleton import canonical_joint_names
from mocap_ros.units import NS_PER_S

Array = NDArray[np.float64]

MAX_FILE_BYTES = 1 << 30  # unpacked; guards the memory against files that unpack to much more than their size
MAX_TIMESTAMP_S = 2.0**31  # s; the seconds of a ROS stamp are an int32
MAX_IMAGE_SIDE_PX = 100_000  # px; guard against garbage, far above any real image
MAX_COORDINATE_M = 1e6  # m; guard against garbage, far above any real distance
MAX_PLUMB_BOB_COEFFICIENTS = 5  # OpenCV's k1, k2, p1, p2, k3; with more coefficients the model is rational

# All keys of a sequence file; a file may have others, which are ignored.
SEQUENCE_KEYS = (
    'keypoints',
    'joint_names',
    'timestamps',
    'image_size',
    'camera_matrix',
    'distortion',
    'joints3d',
    'joints3d_names',
)
RESULT_KEYS = {'joints3d', 'theta', 'residual_px'}  # a file with all of these keys is a result of `reconstruct`


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """Measured or generated 3D joints.

    Attributes:
        joints: (F, J3, 3) m in the camera's optical frame; NaN where unknown.
        joint_names: (J3,) names of the joints.
    """

    joints: Array
    joint_names: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class KeypointSequence:
    """Keypoints of one person over time.

    Attributes:
        keypoints: (F, J, 3) x to the right and y down in px, confidence score in [0, 1]; where a keypoint was not
            seen, x and y are NaN and the score is 0.
        joint_names: (J,) names of the joints.
        timestamps: (F,) s, strictly increasing.
        image_size: (width, height) in px.
        camera_matrix: (3, 3) px, or None where the camera is unknown.
        distortion: distortion coefficients in OpenCV's order, or None.
        truth: true 3D joints in the same frames, or None.
        person_id: id of the person, or empty.
        frame_id: name of the camera's optical frame, or empty.
        recorded_ns: (F,) timestamps in ns, where they are known more exactly than in s, or empty.
        calibration: intrinsics of the camera, where they are given in another form than `camera_matrix` and
            `distortion`, or None.
    """

    keypoints: Array
    joint_names: tuple[str, ...]
    timestamps: Array
    image_size: tuple[int, int]
    camera_matrix: Array | None = None
    distortion: Array | None = None
    truth: GroundTruth | None = None
    person_id: str = ''
    frame_id: str = ''
    recorded_ns: tuple[int, ...] = ()
    calibration: Intrinsics | None = None

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.timestamps)

    @property
    def stamps_ns(self) -> list[int]:
        """Timestamps (F,) in ns."""
        return list(self.recorded_ns) or [round(float(t) * NS_PER_S) for t in self.timestamps]

    def person(self, frame: int, person_id: str = '') -> Person2D:
        """Return the keypoints in one frame as a person with this id."""
        keypoints = self.keypoints[frame]
        return Person2D(person_id, self.joint_names, keypoints[:, :2], keypoints[:, 2])

    def intrinsics(self, focal_in_widths: float) -> Intrinsics:
        """Return the intrinsics of the camera.

        Args:
            focal_in_widths: focal length in image widths that is assumed where the camera is unknown.
        """
        if self.calibration is not None:
            return self.calibration
        if self.camera_matrix is not None:
            return Intrinsics.from_matrix(self.camera_matrix, _create_distortion(self.distortion))
        return Intrinsics.from_image_size(*self.image_size, focal_in_widths)


def save_sequence(path: str | Path, sequence: KeypointSequence) -> None:
    """Write a sequence file, without the ids and the calibration, which the format does not have."""
    arrays: dict[str, NDArray[np.generic]] = {
        'keypoints': sequence.keypoints.astype(np.float32),
        'joint_names': np.array(sequence.joint_names),
        'timestamps': np.asarray(sequence.timestamps, np.float64),
        'image_size': np.array(sequence.image_size, np.int64),
    }
    if sequence.camera_matrix is not None:
        arrays['camera_matrix'] = np.asarray(sequence.camera_matrix, np.float64)
    if sequence.distortion is not None:
        arrays['distortion'] = np.asarray(sequence.distortion, np.float64)
    if sequence.truth is not None:
        arrays['joints3d'] = sequence.truth.joints.astype(np.float32)
        arrays['joints3d_names'] = np.array(sequence.truth.joint_names)
    with Path(path).open('wb') as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


def load_sequence(path: str | Path) -> KeypointSequence:
    """Read and validate a sequence file.

    Raises:
        InputError: the file is not a sequence file, or its content is not valid; the error names the file, the key
            and the frame.
    """
    try:
        return _validate(_ArrayReader(_read_arrays(Path(path))))
    except InputError as error:
        raise InputError(f'{path}: {error}') from None


def _read_arrays(path: Path) -> dict[str, NDArray[np.generic]]:
    arrays = {}
    key = ''
    try:
        with open_npz(path, MAX_FILE_BYTES) as archive:
            if set(archive.files) >= RESULT_KEYS:
                raise InputError('a result of reconstruct; give the sequence file that it was made from')
            for key in (k for k in SEQUENCE_KEYS if k in archive.files):
                arrays[key] = archive[key]
    except InputError as error:
        raise InputError(f'not a sequence file: {error}') from None
    except OSError as error:
        raise InputError(error.strerror or str(error)) from None
    except Exception as error:  # NumPy's zip and array readers raise almost any exception on malformed bytes
        where = f'{key}: ' if key else 'not a sequence file: '
        raise InputError(f'{where}{describe_read_error(error)}') from None
    return arrays


@dataclass(frozen=True, eq=False)
class _ArrayReader:
    """The arrays of a file, with the checks that all of them need.

    Attributes:
        array_by_key: arrays of the file by key, without the keys that are not in `SEQUENCE_KEYS`.
    """

    array_by_key: Mapping[str, NDArray[np.generic]]

    def __contains__(self, key: str) -> bool:
        return key in self.array_by_key

    def read_numbers(self, key: str, shape: tuple[int | None, ...]) -> Array:
        """Return the array of a key as float64.

        Args:
            key: key of the array.
            shape: expected shape; None stands for any length.
        """
        array = self._get(key)
        if array.dtype.kind not in 'fiu':
            raise InputError(f'{key}: holds {array.dtype}, expected numbers')
        wrong = [w for w, h in zip(shape, array.shape, strict=False) if w is not None and w != h]
        if wrong or len(shape) != array.ndim:
            expected = ', '.join('n' if n is None else str(n) for n in shape)
            raise InputError(f'{key}: shape {array.shape}, expected ({expected})')
        return array.astype(np.float64)

    def read_joint_names(self, key: str) -> tuple[str, ...]:
        """Return the joint names of a key in the spelling of this package."""
        array = self._get(key)
        if array.dtype.kind != 'U' or array.ndim != 1:
            raise InputError(f'{key}: holds {array.dtype} of shape {array.shape}, expected names')
        return canonical_joint_names([str(n) for n in array])

    def _get(self, key: str) -> NDArray[np.generic]:
        if key not in self.array_by_key:
            raise InputError(f'{key}: missing; the file has {", ".join(self.array_by_key) or "no known key"}')
        return self.array_by_key[key]


def _validate(arrays: _ArrayReader) -> KeypointSequence:
    timestamps = arrays.read_numbers('timestamps', (None,))
    frames = len(timestamps)
    if not frames:
        raise InputError('timestamps: no frames')
    _check_timestamps(timestamps)

    joint_names = arrays.read_joint_names('joint_names')
    try:
        build_joint_map(joint_names)
    except SkeletonError as error:
        raise InputError(f'joint_names: {error}') from None
    raw = arrays.read_numbers('keypoints', (frames, len(joint_names), 3))
    fault = find_first_fault(raw[..., :2], raw[..., 2])
    if fault:
        frame, joint = fault.index
        raise InputError(f'keypoints: frame {frame}: {fault.field} of {joint_names[joint]} is {fault.what}')
    points, score = mark_unseen(raw[..., :2], raw[..., 2])
    image_size = _read_image_size(arrays)
    if looks_normalised(points, score, image_size[0]):
        raise InputError('keypoints: looks normalised; px expected')

    camera_matrix = None
    if 'camera_matrix' in arrays:
        camera_matrix = arrays.read_numbers('camera_matrix', (3, 3))
        try:
            Intrinsics.from_matrix(camera_matrix)
        except InputError as error:
            raise InputError(f'camera_matrix: {error}') from None
    return KeypointSequence(
        keypoints=np.concatenate([points, score[..., None]], axis=-1),
        joint_names=joint_names,
        timestamps=timestamps,
        image_size=image_size,
        camera_matrix=camera_matrix,
        distortion=_read_distortion(arrays) if 'distortion' in arrays else None,
        truth=_read_truth(arrays, frames) if 'joints3d' in arrays else None,
    )


def _check_timestamps(timestamps: Array) -> None:
    invalid = ~(np.abs(timestamps) < MAX_TIMESTAMP_S) | (timestamps < 0)
    if invalid.any():
        frame = int(invalid.argmax())
        raise InputError(f'timestamps: frame {frame}: {timestamps[frame]:g} s')
    not_increasing = np.diff(timestamps) < 1 / NS_PER_S
    if not_increasing.any():
        frame = int(not_increasing.argmax()) + 1
        relation = 'repeats' if timestamps[frame] == timestamps[frame - 1] else 'is not later than'
        raise InputError(f'timestamps: frame {frame}: {timestamps[frame]:.9g} s {relation} frame {frame - 1}')


def _read_image_size(arrays: _ArrayReader) -> tuple[int, int]:
    size = arrays.read_numbers('image_size', (2,))
    if not ((size >= 1) & (size <= MAX_IMAGE_SIDE_PX)).all():
        raise InputError(f'image_size: {size[0]:g} x {size[1]:g} px')
    return int(size[0]), int(size[1])


def _read_distortion(arrays: _ArrayReader) -> Array:
    values = arrays.read_numbers('distortion', (None,))
    _create_distortion(values)
    return values


def _create_distortion(distortion: Array | None) -> Distortion:
    """Create the distortion from coefficients in OpenCV's order: k1, k2, p1, p2, then k3, then k4, k5, k6."""
    coefficients = () if distortion is None else tuple(distortion.tolist())
    model = 'plumb_bob' if len(coefficients) <= MAX_PLUMB_BOB_COEFFICIENTS else 'rational_polynomial'
    return Distortion.from_coefficients(model, coefficients)


def _read_truth(arrays: _ArrayReader, frames: int) -> GroundTruth:
    names = arrays.read_joint_names('joints3d_names')
    joints = arrays.read_numbers('joints3d', (frames, len(names), 3))
    too_far = np.abs(joints) > MAX_COORDINATE_M
    if too_far.any():
        frame, joint, _ = np.argwhere(too_far)[0]
        raise InputError(f'joints3d: frame {frame}: {names[joint]} is more than {MAX_COORDINATE_M:g} m away')
    return GroundTruth(joints, names)
