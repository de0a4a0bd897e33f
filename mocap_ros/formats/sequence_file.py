"""Sequence files (.npz): one person's keypoints in the images of one camera, and the truth where it is known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap_ros.bags.reader import is_bag
from mocap_ros.errors import InputError, SkeletonError, reader_reason
from mocap_ros.geometry.distortion import Distortion
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.person import Person2D
from mocap_ros.keypoints.validation import first_fault, looks_normalised, tidied
from mocap_ros.npz_file import open_npz
from mocap_ros.skeleton import joint_map, own_names

Array = NDArray[np.float64]

NS = 1_000_000_000
LARGEST_FILE = 1 << 30
LONGEST_SECONDS = 2.0**31
LARGEST_IMAGE = 100_000
FARTHEST_JOINT = 1e6
MOST_OF_PLUMB_BOB = 5


@dataclass(frozen=True, eq=False)
class Truth:
    """Measured or generated 3D joints.

    Attributes:
        joints: (F, J3, 3) m in the camera's optical frame; NaN where unknown.
        joint_names: (J3,).
    """

    joints: Array
    joint_names: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Sequence:
    """Keypoints of one person over time.

    Attributes:
        keypoints: (F, J, 3) x right and y down in px, score in [0, 1]; NaN points and score 0 where not seen.
        joint_names: (J,).
        timestamps: (F,) s, strictly increasing.
        image_size: (width, height) px.
        camera_matrix: (3, 3) px, or None where the camera is unknown.
        distortion: coefficients as OpenCV orders them, or None.
        truth: 3D joints of the same frames, or None.
        person_id: who it is, or empty.
        frame_id: the camera's optical frame, or empty.
        recorded_ns: (F,) the timestamps in ns, where they are known more exactly than in s.
        calibration: of the camera, where it came otherwise than as matrix and distortion.
    """

    keypoints: Array
    joint_names: tuple[str, ...]
    timestamps: Array
    image_size: tuple[int, int]
    camera_matrix: Array | None = None
    distortion: Array | None = None
    truth: Truth | None = None
    person_id: str = ''
    frame_id: str = ''
    recorded_ns: tuple[int, ...] = ()
    calibration: Intrinsics | None = None

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.timestamps)

    @property
    def stamps_ns(self) -> list[int]:
        """(F,) timestamps in ns."""
        return list(self.recorded_ns) or [round(float(t) * NS) for t in self.timestamps]

    def person(self, frame: int, person_id: str = '') -> Person2D:
        """The person in one frame, under this name."""
        keypoints = self.keypoints[frame]
        return Person2D(person_id, self.joint_names, keypoints[:, :2], keypoints[:, 2])

    def intrinsics(self, focal_in_widths: float) -> Intrinsics:
        """The camera's, or nominal ones of this focal length (image widths) where it is unknown."""
        if self.calibration is not None:
            return self.calibration
        if self.camera_matrix is not None:
            return Intrinsics.from_matrix(self.camera_matrix, _lens(self.distortion))
        return Intrinsics.nominal(*self.image_size, focal_in_widths)


def save_sequence(path: str | Path, sequence: Sequence) -> None:
    """Write a sequence file."""
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


def load_sequence(path: str | Path) -> Sequence:
    """Read a sequence file; keys it does not know are left alone.

    Raises:
        InputError: the file is none, or what it holds cannot be used; names file, key and frame.
    """
    if is_bag(Path(path)):
        raise InputError(f'{path}: is a bag, expected a sequence file (.npz)')
    try:
        return _checked(_Arrays(_read(Path(path))))
    except InputError as error:
        raise InputError(f'{path}: {error}') from None


KEYS = (
    'keypoints',
    'joint_names',
    'timestamps',
    'image_size',
    'camera_matrix',
    'distortion',
    'joints3d',
    'joints3d_names',
)
RESULT_KEYS = {'joints3d', 'theta', 'residual_px'}


def _read(path: Path) -> dict[str, NDArray[np.generic]]:
    arrays = {}
    key = ''
    try:
        with open_npz(path, LARGEST_FILE) as archive:
            if set(archive.files) >= RESULT_KEYS:
                raise InputError('a result of reconstruct; give the sequence file it was made from')
            for key in (k for k in KEYS if k in archive.files):
                arrays[key] = archive[key]
    except InputError as error:
        raise InputError(f'not a sequence file: {error}') from None
    except OSError as error:
        raise InputError(error.strerror or str(error)) from None
    except Exception as error:  # the zip and array readers raise almost anything on garbage
        where = f'{key}: ' if key else 'not a sequence file: '
        raise InputError(f'{where}{reader_reason(error)}') from None
    return arrays


@dataclass(frozen=True, eq=False)
class _Arrays:
    """Arrays of a file by key, with the checks that all of them need."""

    by_key: Mapping[str, NDArray[np.generic]]

    def __contains__(self, key: str) -> bool:
        return key in self.by_key

    def numbers(self, key: str, shape: tuple[int | None, ...]) -> Array:
        """The array as float64; None stands for any length."""
        array = self._get(key)
        if array.dtype.kind not in 'fiu':
            raise InputError(f'{key}: holds {array.dtype}, expected numbers')
        unfit = [w for w, h in zip(shape, array.shape, strict=False) if w is not None and w != h]
        if unfit or len(shape) != array.ndim:
            wanted = ', '.join('n' if n is None else str(n) for n in shape)
            raise InputError(f'{key}: shape {array.shape}, expected ({wanted})')
        return array.astype(np.float64)

    def names(self, key: str) -> tuple[str, ...]:
        """Names of joints, as this package spells them."""
        array = self._get(key)
        if array.dtype.kind != 'U' or array.ndim != 1:
            raise InputError(f'{key}: holds {array.dtype} of shape {array.shape}, expected names')
        return own_names([str(n) for n in array])

    def _get(self, key: str) -> NDArray[np.generic]:
        if key not in self.by_key:
            raise InputError(f'{key}: missing; the file has {", ".join(self.by_key) or "no known key"}')
        return self.by_key[key]


def _checked(arrays: _Arrays) -> Sequence:
    timestamps = arrays.numbers('timestamps', (None,))
    frames = len(timestamps)
    if not frames:
        raise InputError('timestamps: no frames')
    _check_timestamps(timestamps)

    joint_names = arrays.names('joint_names')
    try:
        joint_map(joint_names)
    except SkeletonError as error:
        raise InputError(f'joint_names: {error}') from None
    raw = arrays.numbers('keypoints', (frames, len(joint_names), 3))
    fault = first_fault(raw[..., :2], raw[..., 2])
    if fault:
        frame, joint = fault.index
        raise InputError(f'keypoints: frame {frame}: {fault.field} of {joint_names[joint]} is {fault.what}')
    points, score = tidied(raw[..., :2], raw[..., 2])
    image_size = _image_size(arrays)
    if looks_normalised(points, score, image_size[0]):
        raise InputError('keypoints: looks normalised; px expected')

    camera_matrix = None
    if 'camera_matrix' in arrays:
        camera_matrix = arrays.numbers('camera_matrix', (3, 3))
        try:
            Intrinsics.from_matrix(camera_matrix)
        except InputError as error:
            raise InputError(f'camera_matrix: {error}') from None
    return Sequence(
        keypoints=np.concatenate([points, score[..., None]], axis=-1),
        joint_names=joint_names,
        timestamps=timestamps,
        image_size=image_size,
        camera_matrix=camera_matrix,
        distortion=_distortion(arrays) if 'distortion' in arrays else None,
        truth=_truth(arrays, frames) if 'joints3d' in arrays else None,
    )


def _check_timestamps(timestamps: Array) -> None:
    wrong = ~(np.abs(timestamps) < LONGEST_SECONDS) | (timestamps < 0)
    if wrong.any():
        frame = int(wrong.argmax())
        raise InputError(f'timestamps: frame {frame}: {timestamps[frame]:g} s')
    back = np.diff(timestamps) < 1 / NS
    if back.any():
        frame = int(back.argmax()) + 1
        what = 'repeats' if timestamps[frame] == timestamps[frame - 1] else 'is not later than'
        raise InputError(f'timestamps: frame {frame}: {timestamps[frame]:.9g} s {what} frame {frame - 1}')


def _image_size(arrays: _Arrays) -> tuple[int, int]:
    size = arrays.numbers('image_size', (2,))
    if not ((size >= 1) & (size <= LARGEST_IMAGE)).all():
        raise InputError(f'image_size: {size[0]:g} x {size[1]:g} px')
    return int(size[0]), int(size[1])


def _distortion(arrays: _Arrays) -> Array:
    values = arrays.numbers('distortion', (None,))
    _lens(values)
    return values


def _lens(distortion: Array | None) -> Distortion:
    """From coefficients as OpenCV orders them: k1 k2 p1 p2, and k3, and k4 k5 k6."""
    coefficients = () if distortion is None else tuple(distortion.tolist())
    model = 'plumb_bob' if len(coefficients) <= MOST_OF_PLUMB_BOB else 'rational_polynomial'
    return Distortion.named(model, coefficients)


def _truth(arrays: _Arrays, frames: int) -> Truth:
    names = arrays.names('joints3d_names')
    joints = arrays.numbers('joints3d', (frames, len(names), 3))
    beyond = np.abs(joints) > FARTHEST_JOINT
    if beyond.any():
        frame, joint, _ = np.argwhere(beyond)[0]
        raise InputError(f'joints3d: frame {frame}: {names[joint]} is more than {FARTHEST_JOINT:g} m away')
    return Truth(joints, names)
