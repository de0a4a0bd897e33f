# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Save a reconstructed sequence as arrays, a table, a bag, or a file for animation or biomechanics."""

from __future__ import annotations

import csv
import math
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from mocap_ros.bags.recorder import RECOVERY_HINT, Recorder
from mocap_ros.config import RecorderConfig
from mocap_ros.errors import InputError, RecordingError
from mocap_ros.formats.bvh import save_bvh
from mocap_ros.formats.detections import MAX_FRAME_RATE_HZ, Detections
from mocap_ros.formats.export.armature import build_armature
from mocap_ros.formats.export.joint_angles import COORDINATES, POSITIONS, compute_joint_angles
from mocap_ros.formats.export.trc import save_trc
from mocap_ros.formats.sequence_file import KeypointSequence
from mocap_ros.geometry.differences import central_velocity
from mocap_ros.geometry.level import average_vertical, rotation_to_level
from mocap_ros.geometry.rotations import multiply_quaternions, quaternion_from_rotation
from mocap_ros.messages.camera_info import CAMERA_INFO, CameraInfo, encode_camera_info
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from mocap_ros.npz_file import write_npz
from mocap_ros.offline.whole_sequence import SequenceResult
from mocap_ros.people import CameraVertical, Motion, MotionKind, Person3D
from mocap_ros.runtime.outputs import LATCHED_OUTPUTS, OutputEncoder, build_skeleton_definition
from mocap_ros.runtime.sequence_messages import DEFAULT_FRAME_ID
from mocap_ros.skeleton import CORE_COUNT

Array = NDArray[np.float64]

ONE_FILE = RecorderConfig(min_free_mb=0, split_seconds=0.0)  # of a bag that is written as a single file
DEFAULT_PERSON_ID = 'person_1'  # id in the messages of a bag, if the sequence does not name its person
MAX_RESAMPLED_FRAMES = 1_000_000  # frames; guards the memory against two frames that are years apart
RATE_TOLERANCE = 0.01  # 1; seconds since 1970 as doubles are rounded to 0.2 us
HALF_TURN = np.array([1.0, 0.0, 0.0, 0.0])  # quaternion x, y, z, w of `CAMERA_TO_Y_UP`, half a turn about x
SMALLEST_NORM = 1e-9  # 1; guards the normalisation of mixed quaternions
CAMERA_TO_Y_UP = np.array([1.0, -1.0, -1.0])  # factors of x, y, z: optical frame (y down, z forward) to y up


@dataclass(frozen=True, eq=False)
class ReconstructedSequence:
    """A keypoint sequence and its reconstruction.

    Attributes:
        sequence: The keypoints.
        result: The reconstruction, with joints (F, J, 3) in m in the camera's optical frame.
    """

    sequence: KeypointSequence
    result: SequenceResult


def save(path: Path, reconstruction: ReconstructedSequence) -> None:
    """Write a reconstruction; the suffix of `path`, one of `SUFFIXES`, selects the format.

    Raises:
        InputError: The frames are too far apart in time, or too close, for a format with a constant frame rate.
        RecordingError: A bag cannot be written.
        OSError: A file of another format, or a temporary folder beside the bag, cannot be written.
    """
    WRITERS[find_suffix(path)](path, reconstruction)


def find_suffix(path: Path) -> str:
    """Return the suffix in `SUFFIXES` that a path has, the longest if it has several; empty if it has none."""
    return max((suffix for suffix in SUFFIXES if path.name.endswith(suffix)), key=len, default='')


def _save_npz(path: Path, reconstruction: ReconstructedSequence) -> None:
    result = reconstruction.result
    cameras, translation = result.cameras_in_real_image()
    arrays: dict[str, NDArray[np.generic]] = {
        'joints3d': result.joints.astype('f4'),
        'joint_names': np.array(result.skeleton.joints),
        'parents': np.array(result.skeleton.parents),
        'timestamps': reconstruction.sequence.timestamps,
        'seen': result.seen,
        'scale': cameras.scale,
        'rotation': cameras.rotation,
        'translation': translation,
        'scale_known': np.array(result.virtual_camera.intrinsics.is_focal_known),
        'residual_px': result.solution.residual,
        'theta': result.solution.theta,
        'vertical': result.vertical,
        'vertical_std': result.vertical_std,
    }
    if result.orientation is not None and result.turn_inferred is not None:
        arrays |= {'orientation': result.orientation.astype('f4'), 'turn_inferred': result.turn_inferred}
    write_npz(path, arrays)


def _save_csv(path: Path, reconstruction: ReconstructedSequence) -> None:
    timestamps, result = reconstruction.sequence.timestamps, reconstruction.result
    with path.open('w', newline='', encoding='utf-8') as file:
        writer = csv.writer(file)
        names = result.skeleton.joints
        writer.writerow(['time_s', *(f'{n}_{axis}_m' for n in names for axis in 'xyz')])
        for time, joints in zip(timestamps, result.joints, strict=True):
            writer.writerow([f'{time:.6f}', *(f'{v:.6f}' for v in joints.ravel())])


def save_detections(path: Path, detections: Detections) -> None:
    """Write the keypoints of all people as a bag of `/keypoints`, in a single .mcap file.

    Raises:
        RecordingError: The bag cannot be written.
    """
    with _record_file(path) as recorder:
        for stamp, people in zip(detections.stamps_ns, detections.people, strict=True):
            header = Header(stamp, detections.frame_id or DEFAULT_FRAME_ID)
            raw = encode_keypoints(header, detections.image_size, people)
            recorder.write('/keypoints', KEYPOINTS, raw, stamp, stamp)


def _save_bag(path: Path, reconstruction: ReconstructedSequence) -> None:
    """Write the inputs and the outputs in the same way as `replay`, but into a single .mcap file."""
    with _record_file(path) as recorder:
        _record(recorder, reconstruction)


@contextmanager
def _record_file(path: Path) -> Iterator[Recorder]:
    """Write a bag into a single .mcap file, which is there when it is complete.

    Raises:
        RecordingError: The bag cannot be written.
    """
    with TemporaryDirectory(dir=path.parent, prefix='.mocap_ros_') as folder:
        bag = Path(folder) / 'bag'
        try:
            with Recorder(bag, ONE_FILE, name=path.stem) as recorder:
                yield recorder
        except RecordingError as error:
            reason = str(error).rpartition(': ')[2].partition(RECOVERY_HINT)[0]  # the folder does not remain
            raise RecordingError(f'{path}: {reason}') from None
        (file,) = bag.glob('*.mcap')
        if path.exists():  # a device
            shutil.copyfile(file, path)
        else:
            file.replace(path)


def _record(recorder: Recorder, reconstruction: ReconstructedSequence) -> None:
    sequence = reconstruction.sequence
    encoder = OutputEncoder()
    stamps = sequence.stamps_ns
    for topic, msgtype in LATCHED_OUTPUTS.items():
        recorder.declare_topic('/' + topic, msgtype, latched=True)
    definition = build_skeleton_definition(reconstruction.result.skeleton.name)
    recorder.write('/' + definition.topic, definition.type, definition.data, stamps[0], stamps[0])
    person_id = sequence.person_id or DEFAULT_PERSON_ID
    result = reconstruction.result
    intrinsics = result.virtual_camera.intrinsics
    for frame, (stamp, person) in enumerate(zip(stamps, _iterate_people(reconstruction), strict=True)):
        vertical = CameraVertical(result.vertical[frame], float(result.vertical_std[frame]))
        header = Header(stamp, sequence.frame_id or DEFAULT_FRAME_ID)
        keypoints = [sequence.person(frame, person_id)]
        if intrinsics.is_focal_known:
            camera = encode_camera_info(header, CameraInfo(sequence.image_size, intrinsics))
            recorder.write('/camera_info', CAMERA_INFO, camera, stamp, stamp)
        recorder.write(
            '/keypoints',
            KEYPOINTS,
            encode_keypoints(header, sequence.image_size, keypoints),
            stamp,
            stamp,
        )
        known = None if math.isnan(vertical.std) else vertical
        people = [person] if person else []
        for output in encoder.encode(header, people, vertical=known):
            recorder.write('/' + output.topic, output.type, output.data, stamp, stamp)


def _iterate_people(reconstruction: ReconstructedSequence) -> Iterator[Person3D | None]:
    """Yield the person of each frame, or None where the result has no skeleton."""
    result, nan = reconstruction.result, float('nan')
    cameras, translation = result.cameras_in_real_image()
    times = np.asarray(reconstruction.sequence.timestamps)
    velocity = central_velocity(times, result.joints)
    first = last_seen = math.nan
    for frame, seen in enumerate(result.seen):
        if seen[:CORE_COUNT].any():
            first, last_seen = times[frame] if math.isnan(first) else first, times[frame]
        if np.isnan(result.joints[frame]).any():
            yield None
            continue
        person = Person3D(
            id=reconstruction.sequence.person_id or DEFAULT_PERSON_ID,
            joints=result.joints[frame],
            std=np.full(len(seen), nan),
            inferred=~seen,
            scale=float(cameras.scale[frame]),
            rotation=cameras.rotation[frame],
            translation=translation[frame],
            motion=Motion(MotionKind.UNKNOWN, result.category, nan, nan),
            residual=float(result.solution.residual[frame]),
            scale_known=result.virtual_camera.intrinsics.is_focal_known,
            predicted=not seen[:CORE_COUNT].any(),
            velocity=velocity[frame],
            velocity_std=np.full(len(seen), nan),
            age=float(times[frame] - first),
            unseen_for=float(times[frame] - last_seen),
            skeleton=result.skeleton,
        )
        if result.orientation is not None and result.turn_inferred is not None:
            turns = result.orientation[frame], result.turn_inferred[frame]
            person = replace(person, orientation=turns[0], turn_inferred=turns[1])
        yield person


def stand_upright(result: SequenceResult) -> Array:
    """Return the joints (F, J, 3) in m in the axes of animation and biomechanics: y up, x right, z to the camera.

    The origin stays in the camera, and the camera's heading is kept. Up is the mean of the verticals that the
    result has; where it has none, the camera is taken as level.
    """
    return np.asarray(result.joints @ rotation_to_level(average_vertical(result.vertical)).T * CAMERA_TO_Y_UP)


def _save_bvh(path: Path, reconstruction: ReconstructedSequence) -> None:
    fps, joints, _ = _resample_at_constant_rate(reconstruction)
    save_bvh(path, build_armature(joints, fps, _resample_orientation(reconstruction, len(joints))))


def _save_trc(path: Path, reconstruction: ReconstructedSequence) -> None:
    fps, joints, in_sight = _resample_at_constant_rate(reconstruction)
    joints[~in_sight] = np.nan
    save_trc(path, reconstruction.result.skeleton.joints, joints, fps)


def _save_angles(path: Path, reconstruction: ReconstructedSequence) -> None:
    times, joints = reconstruction.sequence.timestamps, stand_upright(reconstruction.result)
    known = np.isfinite(joints).all(axis=(1, 2))
    values = np.full((len(times), len(COORDINATES)), np.nan)
    fps = 1 / float(np.median(np.diff(times))) if len(times) > 1 else 1.0
    values[known] = compute_joint_angles(joints[known], fps)
    units = ['m' if name in POSITIONS else 'deg' for name in COORDINATES]
    with path.open('w', newline='', encoding='utf-8') as file:
        writer = csv.writer(file)
        writer.writerow(['time_s', *(f'{name}_{unit}' for name, unit in zip(COORDINATES, units, strict=True))])
        for time, row in zip(times, values, strict=True):
            writer.writerow([f'{time:.6f}', *(f'{v:.6f}' for v in row)])


def _resample_at_constant_rate(reconstruction: ReconstructedSequence) -> tuple[float, Array, NDArray[np.bool_]]:
    """Interpolate the joints linearly at a constant frame rate, about the median rate of the sequence.

    Returns:
        Frames per second; joints (F, J, 3) in m, y up, which keep the nearest pose before the first and after the
        last skeleton of the result; and (F,) True for the frames from the first to the last skeleton.
    """
    result = reconstruction.result
    times = reconstruction.sequence.timestamps - reconstruction.sequence.timestamps[0]
    has_skeleton = np.asarray(np.isfinite(result.joints).all(axis=(1, 2)))
    if len(times) < 2:
        return 1.0, stand_upright(result), has_skeleton
    step = float(np.median(np.diff(times)))
    if step * MAX_FRAME_RATE_HZ < 1.0 - RATE_TOLERANCE:
        raise InputError(
            f'timestamps: {step:.3g} s from frame to frame; at most {MAX_FRAME_RATE_HZ:g} Hz fit the format'
        )
    frame_count = round(float(times[-1]) / step) + 1
    if frame_count > MAX_RESAMPLED_FRAMES:
        raise InputError(f'timestamps: {times[-1]:.0f} s would be {frame_count} frames at a constant rate')
    grid = np.linspace(0.0, times[-1], frame_count)
    known_times, known_joints = times[has_skeleton], stand_upright(result)[has_skeleton]
    columns = known_joints.reshape(len(known_times), -1)
    resampled = np.stack([np.interp(grid, known_times, column) for column in columns.T], axis=1)
    half_step = times[-1] / (frame_count - 1) / 2
    in_sight = (grid > known_times[0] - half_step) & (grid < known_times[-1] + half_step)
    return (frame_count - 1) / float(times[-1]), resampled.reshape(frame_count, -1, 3), in_sight


def _resample_orientation(reconstruction: ReconstructedSequence, frame_count: int) -> Array | None:
    """Return the orientations (F, J, 4) at the times of `_resample_at_constant_rate`, y up; None if unknown."""
    result, times = reconstruction.result, reconstruction.sequence.timestamps
    if result.orientation is None:
        return None
    is_known = np.isfinite(result.orientation).all(axis=(1, 2))
    grid = np.linspace(times[0], times[-1], frame_count)
    columns = result.orientation[is_known].reshape(int(is_known.sum()), -1)
    mixed = np.stack([np.interp(grid, times[is_known], column) for column in columns.T], axis=1)
    mixed = mixed.reshape(frame_count, -1, 4)
    mixed /= np.maximum(np.linalg.norm(mixed, axis=-1, keepdims=True), SMALLEST_NORM)
    level = np.array(quaternion_from_rotation(rotation_to_level(average_vertical(result.vertical))))
    return multiply_quaternions(multiply_quaternions(HALF_TURN, level), mixed)


# The function that writes each format, by file suffix.
WRITERS: dict[str, Callable[[Path, ReconstructedSequence], None]] = {
    '.npz': _save_npz,
    '.csv': _save_csv,
    '.mcap': _save_bag,
    '.bvh': _save_bvh,
    '.trc': _save_trc,
    '.angles.csv': _save_angles,
}
SUFFIXES = tuple(WRITERS)  # the file suffixes that `save` accepts
