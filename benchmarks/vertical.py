# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What the vertical of the camera gains: errors and leans of people whose camera looks down by 0 to 32 degrees.

Three trials of `data/motion` stand side by side before one orthographic camera, each seen from another side, with
clean points or through the protocol's models of detectors. Whole sequences see one person each; the tracker sees
the three together. `tracker.vertical` is `none`, `auto`, or the truth. By default the models were not trained on
the tested people; `--persons training` tests others, for tuning.

The lean is the angle between the trunk and the vertical along the line of sight; its slope is that of the found
leans over the true ones, up to 60 degrees, and its error that of people who truly lean by less than 20 degrees.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import common
import numpy as np
from common import View
from experiments.detector_views import CLEAN, DETECTORS, HEADING_STEP_DEG, choose_trials, load_middle, load_motion
from numpy.typing import NDArray
from reconstruction import WAYS, Models, provide_held_out, reconstruct_whole, track_people
from report import Records, Report, cross, group, run

from mocap_ros.compiled.kernel import compile_kernels
from mocap_ros.config import Config, with_values
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.rotations import centre_poses
from mocap_ros.keypoints.person import Person2D
from mocap_ros.models.base_poses import ALL_MOTIONS
from mocap_ros.models.model_file import load_base_pose_models
from mocap_ros.skeleton import CMU15

Array = NDArray[np.float64]

CHOICES = ('none', 'auto', 'given')
ELEVATIONS_DEG = (0.0, 10.0, 20.0, 32.0)  # degrees by which the camera looks down
PEOPLE = 3  # people before a camera
DISTURBED = 'mediapipe'  # detector whose errors the page shows
PAGE_NAMES = {'whole': 'whole, each person alone', 'live': 'live, three people together'}
MIN_FRAMES = 150  # frames of the shortest trial
MAX_LEAN_DEG = 60.0  # degrees; true leans of which the slope is measured
UPRIGHT_DEG = 20.0  # degrees; true leans of which the error is measured
NECK, PELVIS = CMU15.joints.index('neck'), CMU15.joints.index('pelvis')


@dataclass(frozen=True, eq=False)
class Scene:
    """Some people before one camera.

    Attributes:
        views: view of each person, all of the same camera.
        upward: (3,) true direction upwards in the camera's optical frame.
    """

    views: tuple[View, ...]
    upward: Array


def make_scene(trials: Sequence[str], number: int, elevation: float, detector: str, frames: int) -> Scene:
    """Return some trials before one camera; `number` is that of the first, by which the headings follow."""
    joints, protocol, views = load_motion()[1], common.load_protocol(), []
    for place, trial in enumerate(trials):
        heading = (number + place) * HEADING_STEP_DEG % 360
        options: dict[str, Any] = {'frames': frames, 'seed': number + place}
        if detector != CLEAN:
            options['detector'] = detector
        sequence = protocol.make_view(load_middle(trial, frames), joints, heading, elevation, **options)
        views.append(View(sequence, heading))
    upward = protocol.view(np.array([[0.0, 1.0, 0.0]]), 0.0, elevation)[0]
    return Scene(tuple(views), upward)


def reconstruct(scene: Scene, way: str, models: Models, config: Config) -> list[Array]:
    """Return the poses (F, 15, 3) m of each person."""
    if way == 'live':
        return track(scene, models, config)
    return [reconstruct_whole(view, models, config) for view in scene.views]


def track(scene: Scene, models: Models, config: Config) -> list[Array]:
    """Return the poses (F, 15, 3) m of each person as the tracker has them in its newest frame."""
    views = scene.views
    width, height = (int(v) for v in views[0].sequence['image_size'])
    camera = Intrinsics.from_image_size(width * len(views), height, common.ORTHOGRAPHIC_FOCAL_LENGTH)
    found = [np.full(v.true_poses.shape, np.nan) for v in views]
    seen = [
        [
            Person2D(str(i), v.joint_names, k[:, :2] + [i * width, 0], k[:, 2])
            for i, v in enumerate(views)
            for k in v.sequence['keypoints'][frame : frame + 1].astype(float)
        ]
        for frame in range(max(v.frames for v in views))
    ]
    times = np.arange(len(seen)) / common.FPS
    for frame, (_, people) in enumerate(track_people(seen, times, camera, models, config)):
        for person in people:
            if frame < len(found[int(person.id)]):
                found[int(person.id)][frame] = person.joints[: len(CMU15.joints)]
    return found


def measure_leans(joints: Array, upward: Array) -> Array:
    """Return the leans of trunks (F,) in degrees along the line of sight, of poses (F, 15, 3)."""
    along = np.array([0.0, 0.0, 1.0])
    along -= (along @ upward) * upward
    trunk = joints[:, NECK] - joints[:, PELVIS]
    return np.asarray(np.degrees(np.arctan2(trunk @ along / np.linalg.norm(along), trunk @ upward)))


def score(
    scene: Scene, trials: Sequence[str], way: str, choice: str, models: Models, config: Config
) -> Iterator[dict[str, Any]]:
    """Yield the results of each person of a scene."""
    text = ' '.join(map(repr, scene.upward.tolist())) if choice == 'given' else choice
    found = reconstruct(scene, way, models, with_values(config, {'tracker.vertical': text}))
    for view, joints, trial in zip(scene.views, found, trials, strict=True):
        known = np.isfinite(joints).all(axis=(1, 2))
        true, own = (measure_leans(centre_poses(p[known]), scene.upward) for p in (view.true_poses, joints))
        some, upright = np.abs(true) < MAX_LEAN_DEG, np.abs(true) < UPRIGHT_DEG
        x, y = true[some], own[some]
        yield {
            'trial': trial,
            'mpjpe_mm': common.compute_errors(view, joints, CMU15.joints, 'body15')['mpjpe_mm'],
            'lean_error_deg': float(np.sqrt(((own - true)[upright] ** 2).mean())) if upright.any() else math.nan,
            'line': (float(len(x)), float(x.sum()), float(y.sum()), float((x * x).sum()), float((x * y).sum())),
        }


def fit_slope(lines: Sequence[tuple[float, ...]]) -> float:
    """Return the slope of a straight line by sums of 1, x, y, x^2 and x y."""
    n, x, y, xx, xy = np.sum(lines, axis=0).tolist()
    return float((n * xy - x * y) / (n * xx - x * x))


def show_results(report: Report, records: Records) -> None:
    rows = []
    for (detector, way, choice), mine in group(records, 'detector', 'way', 'choice').items():
        by_elevation = [common.mean_error(r) for r in group(mine, 'elevation').values()]
        rows.append(
            {
                'detector': detector,
                'way': way,
                'vertical': choice,
                'MPJPE, mm': f'{common.mean_error(mine):.1f}',
                'by elevation': ' / '.join(f'{e:.1f}' for e in by_elevation),
                'slope of the lean': f'{fit_slope([r["line"] for r in mine]):.2f}',
                'its error, degrees': f'{np.nanmean([r["lean_error_deg"] for r in mine]):.1f}',
            }
        )
    report.rows('', rows)
    names = {'none': 'not used', 'auto': 'found', **PAGE_NAMES}
    for (detector,), mine in group(records, 'detector').items():
        page = 'vertical.errors' if detector == DISTURBED else ''
        report.table(*cross(mine, 'way', 'choice', format_errors, names), detector, page=page)


def format_errors(records: Records) -> str:
    """Return MPJPE in mm, slope of the lean, and its error in degrees."""
    slope, lean = fit_slope([r['line'] for r in records]), np.nanmean([r['lean_error_deg'] for r in records])
    return f'{common.mean_error(records):.1f} / {slope:.2f} / {lean:.1f}'


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--persons', choices=('held-out', 'training'), default='held-out')
    parser.add_argument('--detectors', nargs='+', choices=DETECTORS, default=[CLEAN, 'mediapipe', 'movenet'])
    parser.add_argument('--ways', nargs='+', choices=WAYS, default=list(WAYS))
    parser.add_argument('--elevations', nargs='+', type=float, default=list(ELEVATIONS_DEG), metavar='DEGREES')
    parser.add_argument('--trials', type=int, default=1, metavar='N', help='of each kind of motion')
    parser.add_argument('--frames', type=int, default=300, metavar='N', help='of a trial, at 30 Hz')


def measure(args: argparse.Namespace, report: Report) -> None:
    common.choose_capture('motion')
    compile_kernels()
    if args.persons == 'held-out':
        models, config = provide_held_out()
    else:
        models, config = load_base_pose_models(ALL_MOTIONS), Config()
    trials = choose_trials(args.persons, args.trials, MIN_FRAMES)
    elevations, frames = args.elevations, args.frames
    if args.quick:
        trials, elevations, frames = trials[: 2 * PEOPLE], [10.0], 60
    groups = [trials[i : i + PEOPLE] for i in range(0, len(trials), PEOPLE)]
    work = [(d, e, n, g) for d in args.detectors for e in elevations for n, g in enumerate(groups)]
    records = []
    for detector, elevation, number, chosen in common.show_progress(work, 'scenes'):
        scene = make_scene(chosen, number * PEOPLE, elevation, detector, frames)
        for way in args.ways:
            for choice in CHOICES:
                about = {'detector': detector, 'elevation': elevation, 'way': way, 'choice': choice}
                records += [{**about, **r} for r in score(scene, chosen, way, choice, models, config)]
    show_results(report, records)
    report.add(records=records)


if __name__ == '__main__':
    run(__doc__, 'The vertical of the camera', measure, add_options, one_core=False)
