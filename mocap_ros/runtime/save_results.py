"""Save a reconstructed sequence as arrays, a table, a bag, or a file for animation or biomechanics."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from mocap_ros.bags.recorder import Recorder
from mocap_ros.config import RecorderConfig
from mocap_ros.errors import InputError, RecordingError
from mocap_ros.formats.export.armature import build_armature
from mocap_ros.formats.export.bvh import save_bvh
from mocap_ros.formats.export.trc import save_trc
from mocap_ros.formats.sequence_file import KeypointSequence
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.rotations import fit_rotation
from mocap_ros.messages.cameras import encode_cameras
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from mocap_ros.messages.markers import MarkerEncoder
from mocap_ros.messages.skeletons import encode_skeletons
from mocap_ros.offline.whole_sequence import SequenceResult
from mocap_ros.people import Motion, MotionKind, Person3D
from mocap_ros.runtime.pipeline import LATCHED_OUTPUTS, OUTPUTS, build_skeleton_definition
from mocap_ros.runtime.sequence_messages import DEFAULT_FRAME_ID

Array = NDArray[np.float64]

DEFAULT_PERSON_ID = 'person_1'  # id in the messages of a bag, if the sequence does not name its person
MARKER_LIFETIME_S = 0.5  # s; lifetime of the markers in a bag; the default of node.marker_lifetime
MAX_RESAMPLED_FRAMES = 1_000_000  # frames; guards the memory against two frames that are years apart
CAMERA_TO_Y_UP = np.array([1.0, -1.0, -1.0])  # factors of x, y, z: optical frame (y down, z forward) to y up


@dataclass(frozen=True, eq=False)
class ReconstructedSequence:
    """A keypoint sequence and its reconstruction.

    Attributes:
        sequence: The keypoints.
        result: The reconstruction, with joints (F, J, 3) in m in the camera's optical frame.
        intrinsics: The camera that the reconstruction assumed.
    """

    sequence: KeypointSequence
    result: SequenceResult
    intrinsics: Intrinsics

    def estimate_cameras(self) -> tuple[Array, Array, Array]:
        """Return the weak-perspective camera of each frame that shows the joints where the intrinsics show them.

        Returns:
            (F,) scale px/m, (F, 3, 3) rotation from the body's frame to the camera's, and (F, 2) translation px.
        """
        root = self.result.joints.mean(axis=1)
        solution = self.result.solution
        solution_to_result = fit_rotation(solution.joints, self.result.joints - root[:, None])
        return (
            self.intrinsics.focal / root[:, 2],
            solution_to_result @ solution.cameras.rotation,
            self.intrinsics.project(root),
        )


def save(path: Path, reconstruction: ReconstructedSequence) -> None:
    """Write a reconstruction; the suffix of `path`, one of `SUFFIXES`, selects the format.

    Raises:
        InputError: The frames are too far apart in time for a format with a constant frame rate.
        RecordingError: A bag cannot be written.
        OSError: A file of another format cannot be written.
    """
    WRITERS[path.suffix](path, reconstruction)


def _save_npz(path: Path, reconstruction: ReconstructedSequence) -> None:
    result = reconstruction.result
    scale, rotation, translation = reconstruction.estimate_cameras()
    np.savez_compressed(
        path,
        joints3d=result.joints.astype('f4'),
        joint_names=np.array(result.skeleton.joints),
        parents=np.array(result.skeleton.parents),
        timestamps=reconstruction.sequence.timestamps,
        seen=result.seen,
        scale=scale,
        rotation=rotation,
        translation=translation,
        residual_px=result.solution.residual,
        theta=result.solution.theta,
    )


def _save_csv(path: Path, reconstruction: ReconstructedSequence) -> None:
    timestamps, result = reconstruction.sequence.timestamps, reconstruction.result
    with path.open('w', newline='', encoding='utf-8') as file:
        writer = csv.writer(file)
        names = result.skeleton.joints
        writer.writerow(['time_s', *(f'{n}_{axis}_m' for n in names for axis in 'xyz')])
        for time, joints in zip(timestamps, result.joints, strict=True):
            writer.writerow([f'{time:.6f}', *(f'{v:.6f}' for v in joints.ravel())])


def _save_bag(path: Path, reconstruction: ReconstructedSequence) -> None:
    """Write the keypoints and the outputs in the same way as `replay`, but into a single .mcap file."""
    with TemporaryDirectory(dir=path.parent, prefix='.mocap_ros_') as folder:
        bag = Path(folder) / 'bag'
        try:
            with Recorder(bag, RecorderConfig(min_free_mb=0), name=path.stem) as recorder:
                _record(recorder, reconstruction)
        except RecordingError as error:
            raise RecordingError(f'{path}: {str(error).rpartition(": ")[2]}') from None
        (file,) = bag.glob('*.mcap')
        file.replace(path)


def _record(recorder: Recorder, reconstruction: ReconstructedSequence) -> None:
    sequence = reconstruction.sequence
    markers = MarkerEncoder()
    stamps = sequence.stamps_ns
    for topic, msgtype in LATCHED_OUTPUTS.items():
        recorder.declare_topic('/' + topic, msgtype, latched=True)
    definition = build_skeleton_definition()
    recorder.write('/' + definition.topic, definition.type, definition.data, stamps[0], stamps[0])
    for frame, (stamp, person) in enumerate(zip(stamps, _iterate_people(reconstruction), strict=True)):
        header = Header(stamp, sequence.frame_id or DEFAULT_FRAME_ID)
        keypoints = [sequence.person(frame, person.id)]
        recorder.write(
            '/keypoints',
            KEYPOINTS,
            encode_keypoints(header, sequence.image_size, keypoints),
            stamp,
            stamp,
        )
        outputs = {
            'skeletons': encode_skeletons(header, [person]),
            'cameras': encode_cameras(header, [person]),
            'markers': markers.encode_update(header, [person], MARKER_LIFETIME_S),
        }
        for topic, data in outputs.items():
            recorder.write('/' + topic, OUTPUTS[topic], data, stamp, stamp)


def _iterate_people(reconstruction: ReconstructedSequence) -> Iterator[Person3D]:
    """Yield the person of each frame."""
    result, nan = reconstruction.result, float('nan')
    for frame, (scale, rotation, translation) in enumerate(zip(*reconstruction.estimate_cameras(), strict=True)):
        seen = result.seen[frame]
        yield Person3D(
            id=reconstruction.sequence.person_id or DEFAULT_PERSON_ID,
            joints=result.joints[frame],
            std=np.full(len(seen), nan),
            inferred=~seen,
            scale=float(scale),
            rotation=rotation,
            translation=translation,
            motion=Motion(MotionKind.UNKNOWN, result.category, nan, nan),
            residual=float(result.solution.residual[frame]),
            scale_known=reconstruction.intrinsics.is_focal_known,
            predicted=not seen.any(),
        )


def _save_bvh(path: Path, reconstruction: ReconstructedSequence) -> None:
    fps, joints = _resample_at_constant_rate(reconstruction)
    save_bvh(path, build_armature(joints, fps))


def _save_trc(path: Path, reconstruction: ReconstructedSequence) -> None:
    fps, joints = _resample_at_constant_rate(reconstruction)
    save_trc(path, reconstruction.result.skeleton.joints, joints, fps)


def _resample_at_constant_rate(reconstruction: ReconstructedSequence) -> tuple[float, Array]:
    """Interpolate the joints linearly at a constant frame rate, about the median rate of the sequence.

    Returns:
        Frames per second, and joints (F, J, 3) in m, y up.
    """
    result = reconstruction.result
    times = reconstruction.sequence.timestamps - reconstruction.sequence.timestamps[0]
    if len(times) < 2:
        return 1.0, result.joints * CAMERA_TO_Y_UP
    frame_count = round(float(times[-1] / np.median(np.diff(times)))) + 1
    if frame_count > MAX_RESAMPLED_FRAMES:
        raise InputError(f'timestamps: {times[-1]:.0f} s would be {frame_count} frames at a constant rate')
    grid = np.linspace(0.0, times[-1], frame_count)
    columns = result.joints.reshape(len(times), -1)
    resampled = np.stack([np.interp(grid, times, column) for column in columns.T], axis=1)
    return (frame_count - 1) / float(times[-1]), resampled.reshape(frame_count, -1, 3) * CAMERA_TO_Y_UP


# The function that writes each format, by file suffix.
WRITERS: dict[str, Callable[[Path, ReconstructedSequence], None]] = {
    '.npz': _save_npz,
    '.csv': _save_csv,
    '.mcap': _save_bag,
    '.bvh': _save_bvh,
    '.trc': _save_trc,
}
SUFFIXES = tuple(WRITERS)  # the file suffixes that `save` accepts
