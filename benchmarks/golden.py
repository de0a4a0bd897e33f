# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Every number of a fixed set of runs, kept in a file, so that a change of the code is seen to change no result.

    golden.py record [FILE]     run all of it and keep the numbers (default: build/golden.npz)
    golden.py compare [FILE]    run all of it again; print the largest differences and where the first one is, and
                                end with 1 if joints differ by more than `--tolerance` m or other numbers likewise

The runs go through the public functions and commands alone: the demo, three recordings of `data/detections`,
twelve views of the protocol (four detectors by three motions), each as a whole and frame by frame; the demo by
keyframes; three people before one camera; and a bag, replayed. A file is compared on the machine that made it:
other processors round otherwise. `--short` is the beginning of the demo alone, as a whole and frame by frame, for
an emulated processor (`config/task.sh arm64`).
"""

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any, Literal

import common
import numpy as np
from detected import CLEAN, DETECTORS, load_middle, load_motion
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader
from tqdm import tqdm

import mocap_ros

Array = NDArray[np.float64]
Numbers = dict[str, Array]  # by run and quantity, such as `demo/live/joints`

DEFAULT_FILE = common.ROOT / 'build' / 'golden.npz'
DEMO = common.ROOT / 'mocap_ros' / 'demo' / 'demo.npz'
TOLERANCE_M = 1e-9  # m, or the unit of the quantity; far above what another order of additions changes
RECORDINGS = (('openpose', 1), ('mediapipe', 2), ('mediapipe', 3))
MOTIONS = ('35_02', '14_11', '14_27')  # a walk, housework, sitting down and standing up
FRAMES = 120  # of a view, 4 s
SHORT_FRAMES = 45  # of the demo, 1.5 s
DISTANCE_M = 4.0  # m to the perspective camera of every second view; the others are orthographic
PEOPLE_OFFSET_PX = 640  # px between three people before one camera
# Quantities of a whole sequence, and of a person in a frame.
WHOLE = (
    *('joints', 'joint_orientation', 'turn_inferred', 'inferred', 'reprojection_residual', 'weights', 'scale'),
    *('rotation', 'translation', 'vertical', 'vertical_std', 'cost'),
)
LIVE = (
    *(
        'joints',
        'joint_std',
        'inferred',
        'joint_orientation',
        'turn_inferred',
        'joint_velocity',
        'joint_velocity_std',
        'scale',
        'rotation',
    ),
    *(
        'translation',
        'reprojection_residual',
        'root_covariance',
        'root_velocity_covariance',
        'age',
        'predicted',
        'tentative',
    ),
)


def load_demo(frames: int | None = None) -> dict[str, Any]:
    """Return the demo, or its first frames, without its camera, so that the nominal focal length is assumed."""
    demo = dict(np.load(DEMO))
    del demo['camera_matrix']
    return demo | {key: demo[key][:frames] for key in ('keypoints', 'timestamps', 'joints3d')}


def list_views() -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the names and the arrays of the recordings and of the protocol's views."""
    yield 'demo', load_demo()
    for detector, camera in RECORDINGS:
        yield f'recording_{detector}_{camera}', common.load_recording(detector, camera).sequence
    protocol, names = common.load_protocol(), load_motion()[1]
    for number, (trial, detector) in enumerate(product(MOTIONS, DETECTORS)):
        options: dict[str, Any] = {'seed': number, 'distance': DISTANCE_M if number % 2 else None}
        if detector != CLEAN:
            options['detector'] = detector
        view = protocol.make_view(load_middle(trial, FRAMES), names, 77.0 * number % 360, 10.0, **options)
        yield f'{trial}_{detector}', view


def read_sequence(view: Mapping[str, Any]) -> mocap_ros.KeypointSequence:
    """Return the keypoints of a view as the public functions take them."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'view.npz'
        np.savez(path, **view)
        return mocap_ros.read(path)


def run_whole(
    name: str, sequence: mocap_ros.KeypointSequence, method: Literal['whole', 'keyframes'] = 'whole'
) -> Numbers:
    result = mocap_ros.reconstruct(sequence, method=method)
    return {f'{name}/{method}/{q}': np.asarray(getattr(result, q), float) for q in WHOLE}


def run_live(name: str, sequences: Sequence[mocap_ros.KeypointSequence]) -> Numbers:
    """Track the people of one camera, who stand beside each other and have no ids."""
    first = sequences[0]
    width, height = first.image_size
    size = (width + PEOPLE_OFFSET_PX * (len(sequences) - 1), height)
    tracker = mocap_ros.Tracker(first.joint_names, image_size=size, camera_matrix=first.camera_matrix)
    frames = [
        tracker.update(
            time_s + 1.0,
            [s.keypoints[f] + [PEOPLE_OFFSET_PX * i, 0, 0] for i, s in enumerate(sequences)],
        ).people
        for f, time_s in enumerate(first.timestamps)
    ]
    found: Numbers = {}
    for person_id in sorted({person.id for people in frames for person in people}):
        rows = [next((p for p in people if p.id == person_id), None) for people in frames]
        known = next(row for row in rows if row is not None)
        for quantity in LIVE:
            unknown = np.full(np.shape(getattr(known, quantity)), np.nan)
            values = [unknown if row is None else getattr(row, quantity) for row in rows]
            found[f'{name}/live/{person_id}/{quantity}'] = np.array(values, float)
    return found


def run_replay() -> Numbers:
    """Replay a bag of the demo's keypoints by the commands, and read what it publishes of people."""
    with tempfile.TemporaryDirectory() as folder:
        demo, bag, replayed = (Path(folder) / name for name in ('demo.npz', 'bag.mcap', 'replayed'))
        np.savez(demo, **load_demo())
        program = [sys.executable, '-c', 'import sys; from mocap_ros.cli.main import main; sys.exit(main())']
        for arguments in (['reconstruct', demo, '-o', bag], ['replay', bag, '-o', replayed]):
            subprocess.run([*program, *map(str, arguments)], check=True, stdout=subprocess.DEVNULL)
        columns: dict[str, list[float]] = {}
        with AnyReader([replayed]) as reader:
            chosen = [c for c in reader.connections if c.topic in ('/skeletons', '/cameras')]
            for connection, _, raw in reader.messages(chosen):
                message = reader.deserialize(raw, connection.msgtype)
                for field, value in list_numbers(connection.topic, message):
                    columns.setdefault(f'replay{field}', []).append(value)
    return {name: np.array(values) for name, values in columns.items()}


def list_numbers(place: str, value: Any) -> Iterator[tuple[str, float]]:
    """Yield the fields with numbers of a message, each with its place."""
    if isinstance(value, bool | int | float | np.number):
        yield place, float(value)
    elif isinstance(value, np.ndarray | list | tuple):
        for item in value:
            yield from list_numbers(place, item)
    elif hasattr(value, '__dataclass_fields__'):
        for name in value.__dataclass_fields__:
            if not name.startswith('__'):
                yield from list_numbers(f'{place}/{name}', getattr(value, name))


def run_short() -> Numbers:
    demo = read_sequence(load_demo(SHORT_FRAMES))
    return run_whole('demo', demo) | run_live('demo', [demo])


def run_all() -> Numbers:
    found: Numbers = {}
    sequences = {name: read_sequence(view) for name, view in list_views()}
    for name, sequence in tqdm(sequences.items(), 'runs', disable=not sys.stderr.isatty()):
        found |= run_whole(name, sequence) | run_live(name, [sequence])
    found |= run_whole('demo', sequences['demo'], 'keyframes')
    return found | run_live('three_people', [sequences[f'{t}_openpose'] for t in MOTIONS]) | run_replay()


def compare(found: Numbers, expected: Mapping[str, Array], tolerance: float) -> bool:
    """Print how numbers differ from those that are kept; return whether they are the same."""
    largest: dict[str, tuple[float, str]] = {}  # by quantity, with its place
    first = ''
    for name in sorted({*found, *expected}):
        if name not in found or name not in expected:
            first = first or f'{name}: {"new" if name in found else "missing"}'
            continue
        new, old = map(np.atleast_1d, (found[name], expected[name]))
        if new.shape != old.shape or not np.array_equal(np.isnan(new), np.isnan(old)):
            first = first or f'{name}: shape {new.shape}, before {old.shape}, or other values are NaN'
            continue
        difference = np.nan_to_num(np.abs(new - old))
        place = f'{name}{list(map(int, np.unravel_index(int(difference.argmax()), difference.shape)))}'
        quantity, value = name.rpartition('/')[2], float(difference.max(initial=0.0))
        largest[quantity] = max(largest.get(quantity, (0.0, '')), (value, place))
        if value > tolerance:
            where = [int(i[0]) for i in np.nonzero(difference > tolerance)]
            first = first or f'{name}{where}: {new[tuple(where)]:.9g}, before {old[tuple(where)]:.9g}'
    for quantity, (value, place) in sorted(largest.items(), key=lambda item: -item[1][0]):
        if value > 0 or quantity == 'joints':
            print(f'{quantity:28} {value:9.2e}  {place}')
    count = sum(map(np.size, found.values()))
    print(f'{count} numbers of {len(found)} quantities; first difference: {first or "none"}')
    return not first


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('command', choices=['record', 'compare'])
    parser.add_argument('file', nargs='?', type=Path, default=DEFAULT_FILE)
    parser.add_argument('--short', action='store_true', help='the beginning of the demo alone')
    parser.add_argument('--tolerance', type=float, default=TOLERANCE_M, help='m (default: %(default)s)')
    args = parser.parse_args()
    found = run_short() if args.short else run_all()
    if args.command == 'compare':
        with np.load(args.file) as archive:
            return 0 if compare(found, dict(archive), args.tolerance) else 1
    args.file.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(args.file, **found)  # type: ignore[arg-type]
    print(f'{args.file}: {sum(map(np.size, found.values()))} numbers of {len(found)} quantities')
    return 0


if __name__ == '__main__':
    sys.exit(main())
