# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Save a reconstructed sequence as arrays, a table, a bag, or for animation or biomechanics; and keyframes."""

from __future__ import annotations

import csv
import math
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
import yaml
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.bags.recorder import RECOVERY_HINT, Recorder
from mocap_ros.config import RecorderConfig
from mocap_ros.errors import InputError, RecordingError
from mocap_ros.formats.bvh import save_bvh
from mocap_ros.formats.detections import MAX_FRAME_RATE_HZ, Detections
from mocap_ros.formats.export.armature import build_armature
from mocap_ros.formats.export.joint_angles import COORDINATES, POSITIONS, compute_joint_angles
from mocap_ros.formats.export.trc import save_trc
from mocap_ros.formats.sequence_file import KeypointSequence, find_longest_gap, make_camera_arrays
from mocap_ros.geometry.interpolation import central_velocity
from mocap_ros.geometry.rotations import multiply_quaternions, quaternion_from_rotation
from mocap_ros.messages.camera_info import CAMERA_INFO, CameraInfo, encode_camera_info
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from mocap_ros.npz_file import write_npz
from mocap_ros.offline.keyframes.keyframe_set import KeyframeSet
from mocap_ros.offline.whole_sequence import MAX_GAP_S, SequenceResult
from mocap_ros.people import CameraVertical, Motion, MotionKind, Person3D
from mocap_ros.recordings.playback import DEFAULT_FRAME_ID
from mocap_ros.runtime.outputs import LATCHED_OUTPUTS, OutputEncoder, build_skeleton_definition
from mocap_ros.skeleton import CORE_COUNT
from mocap_ros.solvers.observed_window import ObservedWindow
from mocap_ros.verdict.summary import Summary

ONE_FILE = RecorderConfig(min_free_mb=0, split_seconds=0.0)  # of a bag that is written as a single file
DEFAULT_PERSON_ID = 'person_1'  # id in the messages of a bag, if the sequence does not name its person
MAX_RESAMPLED_FRAMES = 1_000_000  # frames; guards the memory against two frames that are years apart
MAX_EMPTY_S = 60.0  # s without a skeleton that a file of a constant frame rate may hold as empty frames
MAX_BVH_GAP_S = 10.0  # s without a skeleton over which BVH, which has no empty frames, is interpolated
RATE_TOLERANCE = 0.01  # 1; seconds since 1970 as doubles are rounded to 0.2 us
SMALLEST_NORM = 1e-9  # 1; guards the normalisation of mixed quaternions

# Axes in the world, in rows: of animation (x left, y up, z ahead) and of biomechanics (x ahead, y up, z right).
WORLD_TO_ANIMATION = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
WORLD_TO_GROUND = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])

# The comment above the keyframes in the YAML file.
KEYFRAMES_HEADER = """\
# Keyframes of {name}. start_ns: stamp of the first frame of the person, ns; time: s from then on; represents:
# number of frames that the keyframe represents; spans: first and last time of every run of these frames, s.
# To compute the 3D pose of a keyframe by Taylor's method, add to it the outer joints of the limbs that point
# towards the camera (the other limbs point away), and optionally the scale in px per m, for example:
#     forward: [lelbow, lwrist]
#     scale: 250
# Then run: mocap-ros reconstruct --method keyframes --choices THIS_FILE
"""


@dataclass(frozen=True, eq=False)
class ReconstructedSequence:
    """A keypoint sequence and its reconstruction."""

    sequence: KeypointSequence  # the keypoints
    result: SequenceResult  # the reconstruction, with joints (F, J, 3) in m in the camera's optical frame
    summary: Summary | None = None  # what it rests on


def save(path: Path, reconstruction: ReconstructedSequence) -> None:
    """Write a reconstruction; the suffix of `path`, one of `SUFFIXES`, selects the format.

    InputError where the frames are too far apart in time, or too close, for a format with a constant frame rate.
    """
    WRITERS[find_suffix(path)](path, reconstruction)


def find_suffix(path: Path) -> str:
    """Return the suffix in `SUFFIXES` that a path has, the longest if it has several; empty if it has none."""
    return max((suffix for suffix in SUFFIXES if path.name.endswith(suffix)), key=len, default='')


def _save_npz(path: Path, reconstruction: ReconstructedSequence) -> None:
    result, sequence = reconstruction.result, reconstruction.sequence
    cameras, translation = result.cameras_in_real_image()
    intrinsics = result.virtual_camera.intrinsics
    camera = make_camera_arrays(replace(sequence, calibration=replace(intrinsics, is_focal_known=True)))
    arrays: dict[str, NDArray[np.generic]] = {
        'joints3d': result.joints.astype('f4'),
        'joint_names': np.array(result.skeleton.joints),
        'parents': np.array(result.skeleton.parents),
        'timestamps': sequence.timestamps,
        'keypoints': sequence.keypoints.astype('f4'),
        'keypoint_names': np.array(sequence.joint_names),
        'image_size': np.array(sequence.image_size),
        'seen': result.seen,
        'scale': cameras.scale,
        'rotation': cameras.rotation,
        'translation': translation,
        'scale_known': np.array(intrinsics.is_focal_known),
        'residual_px': result.solution.residual,
        'theta': result.solution.theta,
        'vertical': result.vertical,
        'vertical_std': result.vertical_std,
        'contact': result.foot_contact.astype('f4'),
        'world_from_camera': result.world_from_camera,
        'floor_std': np.array(result.floor_std),
    }
    arrays |= {key: a for key, a in zip(('camera_matrix', 'distortion'), camera, strict=True) if a is not None}
    if (summary := reconstruction.summary) is not None:
        arrays |= {'grade': np.array(summary.grade), 'summary': np.array(str(summary))}
    if result.orientation is not None and result.turn_inferred is not None:
        arrays |= {'orientation': result.orientation.astype('f4'), 'orientation_order': np.array('xyzw')}
        arrays['turn_inferred'] = result.turn_inferred
    write_npz(path, arrays)


def _save_csv(path: Path, reconstruction: ReconstructedSequence) -> None:
    result = reconstruction.result
    columns = [f'{name}_{axis}_m' for name in result.skeleton.joints for axis in 'xyz']
    _write_table(path, columns, reconstruction.sequence.timestamps, result.joints.reshape(len(result.joints), -1))


def _count_times(sequence: KeypointSequence) -> Array:
    """Return the times (F,) in s since the first image of the recording, the same for all of its people."""
    first = float(sequence.timestamps[0])
    start = first if sequence.recording_start is None else sequence.recording_start
    return sequence.timestamps - min(start, first)


def _save_angles(path: Path, reconstruction: ReconstructedSequence) -> None:
    times, joints = _count_times(reconstruction.sequence), stand_on_floor(reconstruction.result, WORLD_TO_GROUND)
    known = np.isfinite(joints).all(axis=(1, 2))
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


def _save_bag(path: Path, reconstruction: ReconstructedSequence) -> None:
    """Write the inputs and the outputs in the same way as `replay`, but into a single .mcap file."""
    sequence, result, encoder = reconstruction.sequence, reconstruction.result, OutputEncoder()
    intrinsics, person_id = result.virtual_camera.intrinsics, sequence.person_id or DEFAULT_PERSON_ID
    frames = zip(sequence.stamps_ns, _iterate_people(reconstruction), result.vertical, strict=True)
    with _record_file(path) as recorder:

        def write(topic: str, msgtype: str, raw: bytes) -> None:
            recorder.write('/' + topic, msgtype, raw, stamp, stamp)

        for topic, msgtype in LATCHED_OUTPUTS.items():
            recorder.declare_topic('/' + topic, msgtype, latched=True)
        for frame, (stamp, person, upward) in enumerate(frames):
            if not frame:
                definition = build_skeleton_definition(result.skeleton.name)
                write(definition.topic, definition.type, definition.data)
            header = Header(stamp, sequence.frame_id or DEFAULT_FRAME_ID)
            if intrinsics.is_focal_known:
                camera = CameraInfo(sequence.image_size, intrinsics)
                write('camera_info', CAMERA_INFO, encode_camera_info(header, camera))
            keypoints = encode_keypoints(header, sequence.image_size, [sequence.person(frame, person_id)])
            write('keypoints', KEYPOINTS, keypoints)
            std = float(result.vertical_std[frame])
            vertical = None if math.isnan(std) else CameraVertical(upward, std)
            for output in encoder.encode(header, [person] if person else [], vertical=vertical):
                write(output.topic, output.type, output.data)


def _iterate_people(reconstruction: ReconstructedSequence) -> Iterator[Person3D | None]:
    result, nan = reconstruction.result, float('nan')
    cameras, translation = result.cameras_in_real_image()
    contact = result.foot_contact
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
            contact=contact[frame],
        )
        if result.orientation is not None and result.turn_inferred is not None:
            turns = result.orientation[frame], result.turn_inferred[frame]
            person = replace(person, orientation=turns[0], turn_inferred=turns[1])
        yield person


def stand_on_floor(result: SequenceResult, axes: Array) -> Array:
    """Return the joints (F, J, 3) in m in the person's world, in axes whose rows (3, 3) are along those of it."""
    world = axes @ result.world_from_camera[:3]
    return np.asarray(result.joints @ world[:, :3].T + world[:, 3])


def _save_bvh(path: Path, reconstruction: ReconstructedSequence) -> None:
    resampled = _resample_at_constant_rate(reconstruction, MAX_BVH_GAP_S, WORLD_TO_ANIMATION, is_from_start=True)
    orientation = resampled.orientation
    if orientation is not None:
        orientation /= np.maximum(np.linalg.norm(orientation, axis=-1, keepdims=True), SMALLEST_NORM)
        turn = WORLD_TO_ANIMATION @ reconstruction.result.world_from_camera[:3, :3]
        orientation = multiply_quaternions(np.array(quaternion_from_rotation(turn)), orientation)
    save_bvh(path, build_armature(resampled.joints, resampled.fps, orientation))


def _save_trc(path: Path, reconstruction: ReconstructedSequence) -> None:
    resampled = _resample_at_constant_rate(reconstruction, MAX_EMPTY_S, WORLD_TO_GROUND)
    resampled.joints[~resampled.in_sight] = np.nan
    save_trc(path, reconstruction.result.skeleton.joints, resampled.joints, resampled.fps, resampled.first)


class _Resampled(NamedTuple):
    fps: float  # frames per second
    joints: Array  # (F, J, 3) m; before the first and after the last skeleton of the result the nearest pose
    orientation: Array | None  # (F, J, 4) quaternions in the optical frame, not of length 1; None if unknown
    in_sight: NDArray[np.bool_]  # (F,) whether the frame is between skeletons at most `MAX_GAP_S` apart
    first: int  # number of the first frame, which is 0 at the first image of the recording


def _resample_at_constant_rate(
    reconstruction: ReconstructedSequence, max_gap_s: float, axes: Array, *, is_from_start: bool = False
) -> _Resampled:
    """Interpolate a result linearly, at about the median frame rate of the sequence; InputError at longer gaps.

    The frames begin with those of the sequence, or at the start of the recording, with the first pose.
    """
    result, joints = reconstruction.result, stand_on_floor(reconstruction.result, axes)
    times = _count_times(reconstruction.sequence)
    step = float(np.median(np.diff(times))) if len(times) > 1 else 1.0
    if step * MAX_FRAME_RATE_HZ < 1.0 - RATE_TOLERANCE:
        raise InputError(
            f'timestamps: {step:.3g} s from frame to frame; at most {MAX_FRAME_RATE_HZ:g} Hz fit the format'
        )
    frame_count = round(float(times[-1]) / step) + 1
    known_times = times[np.isfinite(joints).all(axis=(1, 2))]
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
    grid = step * np.arange(first, frame_count)

    def interpolate(values: Array) -> Array:
        known = np.isfinite(values).all(axis=(1, 2))
        columns = values[known].reshape(int(known.sum()), -1).T
        mixed = np.stack([np.interp(grid, times[known], column) for column in columns], axis=1)
        return mixed.reshape(len(grid), *values.shape[1:])

    in_sight = (grid > known_times[0] - step / 2) & (grid < known_times[-1] + step / 2)
    for before, after in pairwise(known_times):
        if after - before > MAX_GAP_S:
            in_sight &= (grid < before + step / 2) | (grid > after - step / 2)
    orientation = None if result.orientation is None else interpolate(result.orientation)
    return _Resampled(1 / step, interpolate(joints), orientation, in_sight, first)


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


def list_keyframe_entries(
    observed: ObservedWindow, keyframes: tuple[KeyframeSet, KeyframeSet]
) -> list[dict[str, Any]]:
    """Return the entry of every keyframe in the YAML file, upper body first, sorted by time.

    The keys are `half` (upper or lower), `time` (s from the beginning), `represents` (number of frames) and
    `spans` (pairs of times in s).
    """
    times = observed.times - observed.times[0]
    return [
        {
            'half': half.body_half.name,
            'time': round(float(times[half.frames[key]]), 6),
            'represents': int((half.assignment == key).sum()),
            'spans': [
                [round(float(times[first]), 3), round(float(times[last]), 3)]
                for first, last in half.find_runs(int(key))
            ],
        }
        for half in keyframes
        for key in half.chronological_order
    ]


def format_yaml(
    observed: ObservedWindow, keyframes: tuple[KeyframeSet, KeyframeSet], name: str, start_ns: int
) -> str:
    """Return the text of the YAML file of keyframes, which `reconstruct --choices` reads.

    The name of the recording is for the comment; times count from `start_ns`, the stamp of the first frame.
    """
    tree = {'start_ns': start_ns, 'keyframes': list_keyframe_entries(observed, keyframes)}
    content = yaml.safe_dump(tree, sort_keys=False, default_flow_style=None)
    return KEYFRAMES_HEADER.format(name=' '.join(name.split())) + content
