# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Save a reconstructed sequence as arrays, a table, a bag, or for animation or biomechanics."""

from __future__ import annotations

import csv
import math
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.bags.recorder import ONE_FILE, RECOVERY_HINT, Recorder
from mocap_ros.errors import InputError, RecordingError
from mocap_ros.formats.bvh import BvhMotion, save_bvh
from mocap_ros.formats.detections import MAX_FRAME_RATE_HZ, Detections
from mocap_ros.formats.export.armature import build_armature
from mocap_ros.formats.export.joint_angles import COORDINATES, POSITIONS, compute_joint_angles
from mocap_ros.formats.export.trc import save_trc
from mocap_ros.formats.result_file import save_result_file
from mocap_ros.formats.sequence_file import find_longest_gap
from mocap_ros.geometry.interpolation import central_velocity, interpolate_linearly
from mocap_ros.geometry.rotations import multiply_quaternions, quaternion_from_rotation
from mocap_ros.messages.camera_info import CAMERA_INFO, CameraInfo, encode_camera_info
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from mocap_ros.offline.whole_sequence import MAX_GAP_S
from mocap_ros.people import SHARED_COLUMNS, CameraVertical, Motion, MotionKind, People, PoseSequence
from mocap_ros.recordings.playback import DEFAULT_FRAME_ID
from mocap_ros.runtime.outputs import LATCHED_OUTPUTS, OutputEncoder, build_skeleton_definition

DEFAULT_PERSON_ID = 'person_1'  # id in the messages of a bag, if the sequence does not name its person
MAX_RESAMPLED_FRAMES = 1_000_000  # frames; guards the memory against two frames that are years apart
MAX_EMPTY_S = 60.0  # s without a skeleton that a file of a constant frame rate may hold as empty frames
MAX_BVH_GAP_S = 10.0  # s without a skeleton over which BVH, which has no empty frames, is interpolated
RATE_TOLERANCE = 0.01  # 1; seconds since 1970 as doubles are rounded to 0.2 us
SMALLEST_NORM = 1e-9  # 1; guards the normalisation of mixed quaternions

# Axes in the world, in rows: of animation (x left, y up, z ahead) and of biomechanics (x ahead, y up, z right).
WORLD_TO_ANIMATION = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
WORLD_TO_GROUND = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def save(path: Path, poses: PoseSequence) -> None:
    """Write a reconstruction; the suffix of `path`, one of `SUFFIXES`, selects the format.

    InputError where the frames are too far apart in time, or too close, for a format with a constant frame rate.
    """
    WRITERS[find_suffix(path)](path, poses)


def find_suffix(path: Path) -> str:
    """Return the suffix in `SUFFIXES` that a path has, the longest if it has several; empty if it has none."""
    return max((suffix for suffix in SUFFIXES if path.name.endswith(suffix)), key=len, default='')


def _save_csv(path: Path, poses: PoseSequence) -> None:
    columns = [f'{name}_{axis}_m' for name in poses.joint_names for axis in 'xyz']
    _write_table(path, columns, poses.times, poses.joints.reshape(len(poses), -1))


def _count_times(poses: PoseSequence) -> Array:
    """Return the times (F,) in s since the first image of the recording, the same for all of its people."""
    first, start = float(poses.times[0]), None
    if poses.sequence is not None:
        start = poses.sequence.recording_start
    return poses.times - (first if start is None else min(start, first))


def _save_angles(path: Path, poses: PoseSequence) -> None:
    times, joints, known = _count_times(poses), stand_on_floor(poses, WORLD_TO_GROUND), poses.in_sight
    angles = np.full((len(times), len(COORDINATES)), np.nan)
    fps = 1 / float(np.median(np.diff(times))) if len(times) > 1 else 1.0
    angles[known] = compute_joint_angles(joints[known], fps)
    columns = [f'{name}_{"m" if name in POSITIONS else "deg"}' for name in COORDINATES]
    _write_table(path, columns, times, angles)


def _write_table(path: Path, columns: Iterable[str], times: Array, rows: Array) -> None:
    with path.open('w', newline='', encoding='utf-8') as file:
        writer = csv.writer(file)
        writer.writerow(['time_s', *columns])
        for time, row in zip(times, rows, strict=True):
            writer.writerow([f'{time:.6f}', *(f'{v:.6f}' for v in row)])


def save_detections(path: Path, detections: Detections) -> None:
    """Write the keypoints of all people as a bag of `/keypoints`, in a single .mcap file."""
    with _record_file(path) as recorder:
        for stamp, people in zip(detections.stamps_ns, detections.people, strict=True):
            header = Header(stamp, detections.frame_id or DEFAULT_FRAME_ID)
            raw = encode_keypoints(header, detections.image_size, people)
            recorder.write('/keypoints', KEYPOINTS, raw, stamp, stamp)


@contextmanager
def _record_file(path: Path) -> Iterator[Recorder]:
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


def _save_bag(path: Path, poses: PoseSequence) -> None:
    """Write the inputs and the outputs in the same way as `replay`, but into a single .mcap file."""
    sequence, encoder = poses.sequence, OutputEncoder()
    if sequence is None:
        raise InputError('the result is without its keypoints')
    intrinsics, person_id = poses.intrinsics, poses.id or DEFAULT_PERSON_ID
    frames = zip(sequence.stamps_ns, _iterate_people(poses), poses.vertical, strict=True)
    with _record_file(path) as recorder:

        def write(topic: str, msgtype: str, raw: bytes) -> None:
            recorder.write('/' + topic, msgtype, raw, stamp, stamp)

        for topic, msgtype in LATCHED_OUTPUTS.items():
            recorder.declare_topic('/' + topic, msgtype, latched=True)
        for frame, (stamp, people, upward) in enumerate(frames):
            if not frame:
                definition = build_skeleton_definition(poses.skeleton.name)
                write(definition.topic, definition.type, definition.data)
            header = Header(stamp, sequence.frame_id or DEFAULT_FRAME_ID)
            if intrinsics.is_focal_known:
                camera = CameraInfo(sequence.image_size, intrinsics)
                write('camera_info', CAMERA_INFO, encode_camera_info(header, camera))
            keypoints = encode_keypoints(header, sequence.image_size, [sequence.person(frame, person_id)])
            write('keypoints', KEYPOINTS, keypoints)
            std = float(poses.vertical_std[frame])
            vertical = None if math.isnan(std) else CameraVertical(upward, std)
            for output in encoder.encode(header, people, vertical=vertical):
                write(output.topic, output.type, output.data)


def _iterate_people(poses: PoseSequence) -> Iterator[People]:
    """Yield who is shown in each frame: the person, or nobody."""
    velocity, scale, translation = central_velocity(poses.times, poses.joints), poses.scale, poses.translation
    motion = Motion(MotionKind.UNKNOWN, poses.base_poses, math.nan, math.nan)
    first = last_seen = math.nan
    for frame, is_in_sight in enumerate(poses.in_sight.tolist()):
        time, now = poses.times[frame], slice(frame, frame + 1)
        if not poses.predicted[frame]:
            first, last_seen = time if math.isnan(first) else first, time
        if not is_in_sight:
            yield People.none(poses.skeleton)
            continue
        yield People(
            ids=(poses.id or DEFAULT_PERSON_ID,),
            skeleton=poses.skeleton,
            scale=scale[now],
            translation=translation[now],
            motion=(motion,),
            is_scale_known=poses.is_scale_known,
            joint_velocity=velocity[now],
            age=np.array([time - first]),
            unseen_for=np.array([time - last_seen]),
            **{name: getattr(poses, name)[now] for name in SHARED_COLUMNS},
        )


def stand_on_floor(poses: PoseSequence, axes: Array) -> Array:
    """Return the joints (F, J, 3) in m in the person's world, in axes whose rows (3, 3) are along those of it."""
    world = axes @ poses.world_from_camera[:3]
    return np.asarray(poses.joints @ world[:, :3].T + world[:, 3])


def _save_bvh(path: Path, poses: PoseSequence) -> None:
    save_bvh(path, animate(poses))


def animate(poses: PoseSequence) -> BvhMotion:
    """Return the armature of a result at a constant rate, y up."""
    resampled = _resample_at_constant_rate(poses, MAX_BVH_GAP_S, WORLD_TO_ANIMATION, is_from_start=True)
    orientation = resampled.orientation
    if orientation is not None:
        orientation /= np.maximum(np.linalg.norm(orientation, axis=-1, keepdims=True), SMALLEST_NORM)
        turn = WORLD_TO_ANIMATION @ poses.world_from_camera[:3, :3]
        orientation = multiply_quaternions(np.array(quaternion_from_rotation(turn)), orientation)
    return build_armature(resampled.joints, resampled.fps, orientation)


def _save_trc(path: Path, poses: PoseSequence) -> None:
    resampled = _resample_at_constant_rate(poses, MAX_EMPTY_S, WORLD_TO_GROUND)
    resampled.joints[~resampled.in_sight] = np.nan
    save_trc(path, poses.joint_names, resampled.joints, resampled.fps, resampled.first)


class _Resampled(NamedTuple):
    fps: float  # frames per second
    joints: Array  # (F, J, 3) m; before the first and after the last skeleton of the result the nearest pose
    orientation: Array | None  # (F, J, 4) quaternions in the optical frame, not of length 1; None if unknown
    in_sight: NDArray[np.bool_]  # (F,) whether the frame is between skeletons at most `MAX_GAP_S` apart
    first: int  # number of the first frame, which is 0 at the first image of the recording


def _resample_at_constant_rate(
    poses: PoseSequence, max_gap_s: float, axes: Array, *, is_from_start: bool = False
) -> _Resampled:
    """Interpolate a result linearly, at about the median frame rate of the sequence; InputError at longer gaps.

    The frames begin with those of the sequence, or at the start of the recording, with the first pose.
    """
    times, joints, known = _count_times(poses), stand_on_floor(poses, axes), poses.in_sight
    step = float(np.median(np.diff(times))) if len(times) > 1 else 1.0
    if step * MAX_FRAME_RATE_HZ < 1.0 - RATE_TOLERANCE:
        raise InputError(
            f'timestamps: {step:.3g} s from frame to frame; at most {MAX_FRAME_RATE_HZ:g} Hz fit the format'
        )
    frame_count = round(float(times[-1]) / step) + 1
    known_times = times[known]
    gap, start = find_longest_gap(known_times)
    if gap > max_gap_s:
        raise InputError(
            f'timestamps: a gap of {gap:.1f} s after {start:.1f} s, without images or by a clock that was set, '
            'does not fit a format with a constant frame rate; write .npz or .csv, or cut the recording there'
        )
    step = float(times[-1]) / (frame_count - 1) if frame_count > 1 else step
    first = 0 if is_from_start else round(float(times[0]) / step)
    if frame_count - first > MAX_RESAMPLED_FRAMES:
        raise InputError(f'timestamps: {times[-1]:.0f} s would be {frame_count} frames at a constant rate')
    grid = step * np.arange(first, frame_count, dtype=np.float64)

    in_sight = (grid > known_times[0] - step / 2) & (grid < known_times[-1] + step / 2)
    for before, after in pairwise(known_times):
        if after - before > MAX_GAP_S:
            in_sight &= (grid < before + step / 2) | (grid > after - step / 2)
    orientation = None
    if np.isfinite(poses.joint_orientation).any():
        orientation = interpolate_linearly(grid, known_times, poses.joint_orientation[known])
    joints = interpolate_linearly(grid, known_times, joints[known])
    return _Resampled(1 / step, joints, orientation, in_sight, first)


# The function that writes each format, by file suffix.
WRITERS: dict[str, Callable[[Path, PoseSequence], None]] = {
    '.npz': save_result_file,
    '.csv': _save_csv,
    '.mcap': _save_bag,
    '.bvh': _save_bvh,
    '.trc': _save_trc,
    '.angles.csv': _save_angles,
}
SUFFIXES = tuple(WRITERS)  # the file suffixes that `save` accepts
