"""What becomes of a reconstructed sequence: arrays, a table, a bag, or a file for animation or biomechanics."""

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
from mocap_ros.formats.export.armature import armature
from mocap_ros.formats.export.bvh import save_bvh
from mocap_ros.formats.export.trc import save_trc
from mocap_ros.formats.sequence_file import Sequence
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.rotations import rotation_to
from mocap_ros.messages.cameras import encode_cameras
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from mocap_ros.messages.markers import MarkerMemory
from mocap_ros.messages.skeletons import encode_skeletons
from mocap_ros.offline.whole_sequence import SequenceResult
from mocap_ros.people import Motion, MotionKind, Person3D
from mocap_ros.runtime.pipeline import LATCHED_OUTPUTS, OUTPUTS, skeleton_definition
from mocap_ros.runtime.sequence_messages import CAMERA_FRAME

Array = NDArray[np.float64]

SOMEBODY = 'person_1'
MARKER_SECONDS = 0.5
MOST_FRAMES = 1_000_000
Y_UP = np.array([1.0, -1.0, -1.0])


@dataclass(frozen=True, eq=False)
class Reconstructed:
    """A sequence, what became of it, and the camera that was assumed."""

    sequence: Sequence
    result: SequenceResult
    intrinsics: Intrinsics

    def cameras(self) -> tuple[Array, Array, Array]:
        """Weak-perspective cameras: (F,) scale px/m, (F, 3, 3) rotation body to camera, (F, 2) translation px."""
        root = self.result.joints.mean(axis=1)
        solution = self.result.solution
        turn = rotation_to(solution.joints, self.result.joints - root[:, None])
        return self.intrinsics.focal / root[:, 2], turn @ solution.cameras.rotation, self.intrinsics.project(root)


def save(path: Path, done: Reconstructed) -> None:
    """Write a result; the ending of `path`, one of `ENDINGS`, chooses the form.

    Raises:
        InputError: frames too far apart in time for a form with a constant rate.
        RecordingError: a bag cannot be written.
        OSError: any other file cannot be written.
    """
    WRITERS[path.suffix](path, done)


def _save_npz(path: Path, done: Reconstructed) -> None:
    result = done.result
    scale, rotation, translation = done.cameras()
    np.savez_compressed(
        path,
        joints3d=result.joints.astype('f4'),
        joint_names=np.array(result.skeleton.joints),
        parents=np.array(result.skeleton.parents),
        timestamps=done.sequence.timestamps,
        seen=result.seen,
        scale=scale,
        rotation=rotation,
        translation=translation,
        residual_px=result.solution.residual,
        theta=result.solution.theta,
    )


def _save_csv(path: Path, done: Reconstructed) -> None:
    with path.open('w', newline='', encoding='utf-8') as file:
        writer = csv.writer(file)
        names = done.result.skeleton.joints
        writer.writerow(['time_s', *(f'{n}_{axis}_m' for n in names for axis in 'xyz')])
        for time, joints in zip(done.sequence.timestamps, done.result.joints, strict=True):
            writer.writerow([f'{time:.6f}', *(f'{v:.6f}' for v in joints.ravel())])


def _save_bag(path: Path, done: Reconstructed) -> None:
    """The keypoints and all outputs as `replay` records them, in one .mcap file."""
    with TemporaryDirectory(dir=path.parent, prefix='.mocap_ros_') as folder:
        bag = Path(folder) / 'bag'
        try:
            with Recorder(bag, RecorderConfig(min_free_mb=0), name=path.stem) as recorder:
                _record(recorder, done)
        except RecordingError as error:
            raise RecordingError(f'{path}: {str(error).rpartition(": ")[2]}') from None
        (file,) = bag.glob('*.mcap')
        file.replace(path)


def _record(recorder: Recorder, done: Reconstructed) -> None:
    sequence = done.sequence
    markers = MarkerMemory()
    stamps = sequence.stamps_ns
    for topic, msgtype in LATCHED_OUTPUTS.items():
        recorder.announce('/' + topic, msgtype, latched=True)
    definition = skeleton_definition()
    recorder.write('/' + definition.topic, definition.type, definition.data, stamps[0], stamps[0])
    for frame, (stamp, person) in enumerate(zip(stamps, _people(done), strict=True)):
        header = Header(stamp, sequence.frame_id or CAMERA_FRAME)
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
            'markers': markers.update(header, [person], MARKER_SECONDS),
        }
        for topic, data in outputs.items():
            recorder.write('/' + topic, OUTPUTS[topic], data, stamp, stamp)


def _people(done: Reconstructed) -> Iterator[Person3D]:
    """The person in each frame."""
    result, nan = done.result, float('nan')
    for frame, (scale, rotation, translation) in enumerate(zip(*done.cameras(), strict=True)):
        seen = result.seen[frame]
        yield Person3D(
            id=done.sequence.person_id or SOMEBODY,
            joints=result.joints[frame],
            std=np.full(len(seen), nan),
            inferred=~seen,
            scale=float(scale),
            rotation=rotation,
            translation=translation,
            motion=Motion(MotionKind.UNKNOWN, result.category, nan, nan),
            residual=float(result.solution.residual[frame]),
            scale_known=done.intrinsics.known,
            predicted=not seen.any(),
        )


def _save_bvh(path: Path, done: Reconstructed) -> None:
    fps, joints = _at_constant_rate(done)
    save_bvh(path, armature(joints, fps))


def _save_trc(path: Path, done: Reconstructed) -> None:
    fps, joints = _at_constant_rate(done)
    save_trc(path, done.result.skeleton.joints, joints, fps)


def _at_constant_rate(done: Reconstructed) -> tuple[float, Array]:
    """Frames a second, and (F, J, 3) m joints, y up, at that rate: the median one of the sequence."""
    result, times = done.result, done.sequence.timestamps - done.sequence.timestamps[0]
    if len(times) < 2:
        return 1.0, result.joints * Y_UP
    frames = round(float(times[-1] / np.median(np.diff(times)))) + 1
    if frames > MOST_FRAMES:
        raise InputError(f'timestamps: {times[-1]:.0f} s would be {frames} frames at a constant rate')
    grid = np.linspace(0.0, times[-1], frames)
    flat = result.joints.reshape(len(times), -1)
    even = np.stack([np.interp(grid, times, column) for column in flat.T], axis=1)
    return (frames - 1) / float(times[-1]), even.reshape(frames, -1, 3) * Y_UP


WRITERS: dict[str, Callable[[Path, Reconstructed], None]] = {
    '.npz': _save_npz,
    '.csv': _save_csv,
    '.mcap': _save_bag,
    '.bvh': _save_bvh,
    '.trc': _save_trc,
}
ENDINGS = tuple(WRITERS)
