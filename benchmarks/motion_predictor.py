# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Trains the motion predictor that ships: tracks people of the training data, and fits what they did next.

It is no benchmark. The people are seen by four detectors, 2 to 6 m away, with their heights known. Those of
`common.HELD_OUT_SUBJECTS` are left out, also by the lifter, so `robots.py` tests what ships. It wants PyTorch (the
extra `train`).
"""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path

import common
import numpy as np
from experiments.detector_views import load_motion
from experiments.predictor_fit import TIMES_S, fit_predictor
from experiments.robot_scenes import look_ahead, make_robot_scene, track_scene
from numpy.typing import NDArray
from reconstruction import provide_held_out

from mocap_ros.compiled.kernel import compile_kernels
from mocap_ros.config import with_values
from mocap_ros.models.model_file import PREDICTOR_NAME
from mocap_ros.models.motion_predictor import Past
from mocap_ros.npz_file import write_npz
from mocap_ros.tracking.prediction import sample_past

Array = NDArray[np.float64]

FRAMES_A_TRIAL = 240  # from the middle of each trial
WARM_UP = 15  # frames at the beginning of a trial that are left out
FIRST_TRIALS = 366  # that are seen first, of all kinds of motion alike; the others are mostly exercises
LATER_FRAMES = 160  # of each of the others
OTHER_VIEW = 1001  # added to the number of a trial, so that it is seen from elsewhere by another detector
EXERCISES = 'uiprmd'  # begins the names of persons who do the same few exercises, which are not seen again
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


def list_views() -> list[tuple[str, int, int]]:
    """Return trials, numbers of their views, and most frames of each.

    First come trials of all kinds, then in turn the others, and again those of the first that are no exercises.
    """
    views, rows = list(enumerate(order_trials())), load_motion()[2]
    first = [(trial, number, FRAMES_A_TRIAL) for number, trial in views[:FIRST_TRIALS]]
    later = [(trial, number, LATER_FRAMES) for number, trial in views[FIRST_TRIALS:]]
    again = [
        (trial, number + OTHER_VIEW, frames)
        for trial, number, frames in first
        if not rows[trial]['subject'].startswith(EXERCISES)
    ]
    return first + [view for pair in zip(later, again, strict=False) for view in pair]


def collect(frames: int) -> tuple[list[Past], Array, NDArray[np.str_]]:
    """Track trials until so many frames are tracked.

    Returns:
        The past of N samples, the true joints (N, K, 15, 3) m ahead, moved so that the root was right, and who it
        is.
    """
    (models, held_out), pasts, futures, persons, done = provide_held_out(), [], [], [], 0
    rows = load_motion()[2]
    for trial, number, most in common.show_progress(list_views(), 'trials'):
        if done >= frames:
            break
        scene = make_robot_scene(trial, number, most)
        config = with_values(held_out, {'tracker.body_height': scene.stature})
        truth = scene.view.true_poses
        for frame, tracker, person in track_scene(scene, models, config):
            if person.predicted or frame < WARM_UP or frame % STEP:
                continue
            (track,) = tracker.tracks
            upward = None if tracker.vertical is None else tracker.vertical.direction
            pasts.append(sample_past(track, tracker.models[track.solved.model_name], upward))
            persons.append(rows[trial]['subject'])
            futures.append(look_ahead(truth, frame, TIMES_S) + person.root - scene.root[frame])
        done += scene.view.frames
    return pasts, np.array(futures), np.array(persons)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('-o', '--output', type=Path, default=FILE, metavar='FILE')
    parser.add_argument('--frames', type=int, default=68_700, metavar='N', help='to track (15 minutes)')
    args = parser.parse_args()
    common.choose_capture('motion')
    compile_kernels()
    pasts, futures, persons = collect(args.frames)
    predictor = fit_predictor(pasts, futures, persons)
    write_npz(args.output, {name: array.astype('f4') for name, array in asdict(predictor).items()})
    print(f'{args.output}: fitted to {len(pasts)} samples')


if __name__ == '__main__':
    main()
