"""Trains the motion predictor that ships: tracks people of the training data, and fits what they did next.

It is no benchmark. The people are seen by four detectors, 2 to 6 m away, with their heights known. Those of
`common.HELD_OUT_SUBJECTS` are left out, so `robots.py` tests what ships.
"""

from __future__ import annotations

import common

# isort: split
import argparse
from dataclasses import asdict
from pathlib import Path

import numpy as np
from experiments.detector_views import load_motion
from experiments.predictor_fit import TIMES_S, fit_predictor
from experiments.robot_scenes import look_ahead, make_robot_scene, track_scene
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import compile_kernels
from mocap_ros.config import Config, with_values
from mocap_ros.models.base_poses import ALL_MOTIONS
from mocap_ros.models.model_file import load_base_pose_models
from mocap_ros.models.motion_predictor import PREDICTOR_NAME, Past
from mocap_ros.npz_file import write_npz
from mocap_ros.tracking.prediction import sample_past

Array = NDArray[np.float64]

FRAMES_A_TRIAL = 240  # from the middle of each trial
STEP = 2  # frames between two samples; neighbouring ones are much the same
MIN_FRAMES = 60  # of a trial; 1 s of the past and 1 s ahead
GAITS = {'walk', 'run'}  # whose trials come three times as soon as others
FILE = common.ROOT / 'mocap_ros' / 'models' / 'shipped' / f'{PREDICTOR_NAME}.npz'


def order_trials() -> list[str]:
    """Return the trials of the training data, the kinds of motion in turn."""
    queues: dict[str, list[str]] = {}
    rng, rows = np.random.default_rng(5), load_motion()[2]
    for name, row in rows.items():
        if row['subject'] not in common.HELD_OUT_SUBJECTS and int(row['frames']) >= MIN_FRAMES:
            queues.setdefault(row['category'], []).append(name)
    for queue in queues.values():
        rng.shuffle(queue)
    out: list[str] = []
    while any(queues.values()):
        for category, queue in queues.items():
            count = 3 if category in GAITS else 1
            out += queue[:count]
            del queue[:count]
    return out


def collect(frames: int) -> tuple[list[Past], Array]:
    """Track trials until so many frames are tracked.

    Returns:
        The past of N samples, and the true joints (N, K, 15, 3) m ahead, moved so that the root was right.
    """
    models, pasts, futures, done = load_base_pose_models(ALL_MOTIONS), [], [], 0
    for number, trial in enumerate(common.show_progress(order_trials(), 'trials')):
        if done >= frames:
            break
        scene = make_robot_scene(trial, number, FRAMES_A_TRIAL)
        config = with_values(Config(), {'tracker.body_height': scene.stature})
        truth = scene.view.true_poses
        for frame, tracker, person in track_scene(scene, models, config):
            if person.predicted or frame % STEP:
                continue
            (track,) = tracker.snapshot().tracks
            upward = None if tracker.vertical is None else tracker.vertical.direction
            pasts.append(sample_past(track, person, tracker.models[track.solved.model_name], upward))
            futures.append(look_ahead(truth, frame, TIMES_S) + person.root - scene.root[frame])
        done += scene.view.frames
    return pasts, np.array(futures)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('-o', '--output', type=Path, default=FILE, metavar='FILE')
    parser.add_argument('--frames', type=int, default=15_000, metavar='N', help='to track (two minutes)')
    args = parser.parse_args()
    common.choose_capture('motion')
    compile_kernels()
    pasts, futures = collect(args.frames)
    predictor = fit_predictor(pasts, futures)
    write_npz(args.output, {name: array.astype('f4') for name, array in asdict(predictor).items()})
    print(f'{args.output}: fitted to {len(pasts)} samples')


if __name__ == '__main__':
    main()
