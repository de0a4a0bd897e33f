"""What the vertical of the camera gains: errors and leans of people whose camera looks down by 0 to 32 degrees.

Three trials of `data/motion` stand side by side before one orthographic camera, each seen from another side, with
clean points or through the protocol's models of detectors. Whole sequences see one person each; the tracker sees
the three together. `tracker.vertical` is `none`, `auto`, or the truth. By default the models were not trained on
the tested people; `--persons training` tests others, for tuning.

The lean is the angle between the trunk and the vertical along the line of sight; its slope is that of the found
leans over the true ones, up to 60 degrees, and its error that of people who truly lean by less than 20 degrees.
"""

from __future__ import annotations

import common

# isort: split
import argparse
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from common import View
from experiments.detector_views import CLEAN, DETECTORS, HEADING_STEP_DEG, choose_trials, load_motion
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import compile_kernels
from mocap_ros.config import Config, with_values
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.rotations import centre_poses
from mocap_ros.keypoints.person import Person2D
from mocap_ros.models.base_poses import ALL_MOTIONS, BasePoses
from mocap_ros.models.model_file import load_base_pose_models
from mocap_ros.offline.whole_sequence import reconstruct_sequence
from mocap_ros.skeleton import CMU15
from mocap_ros.tracking.tracker import Tracker
from mocap_ros.units import NS_PER_S

Array = NDArray[np.float64]

WAYS = ('whole', 'live')
CHOICES = ('none', 'auto', 'given')
ELEVATIONS_DEG = (0.0, 10.0, 20.0, 32.0)  # degrees by which the camera looks down
PEOPLE = 3  # people before a camera
MIN_FRAMES = 150  # frames of the shortest trial
MAX_LEAN_DEG = 60.0  # degrees; true leans of which the slope is measured
UPRIGHT_DEG = 20.0  # degrees; true leans of which the error is measured
NECK, PELVIS = CMU15.joints.index('neck'), CMU15.joints.index('pelvis')


@dataclass(frozen=True, eq=False)
class Scene:
    """Some people before one camera.

    Attributes:
        views: view of each person, all of the same camera.
        truths: (F, 15, 3) m, true joints of each.
        upward: (3,) true direction upwards in the camera's optical frame.
    """

    views: tuple[View, ...]
    truths: tuple[Array, ...]
    upward: Array


@dataclass(frozen=True)
class Record:
    """Result of one person: errors, and the sums of a straight line through the leans."""

    detector: str
    elevation: float
    way: str
    choice: str
    trial: str
    mpjpe_mm: float
    lean_error_deg: float
    line: tuple[float, ...]


def make_scene(trials: Sequence[str], number: int, elevation: float, detector: str, frames: int) -> Scene:
    """Return some trials before one camera; `number` is that of the first, by which the headings follow."""
    motion, joints, _ = load_motion()
    protocol, views, truths = common.load_protocol(), [], []
    for place, trial in enumerate(trials):
        poses, heading = motion[trial].astype(float), (number + place) * HEADING_STEP_DEG % 360
        first = max(len(poses) - frames, 0) // 2
        options: dict[str, Any] = {'frames': frames, 'seed': number + place}
        if detector != CLEAN:
            options['detector'] = detector
        sequence = protocol.make_view(poses[first : first + frames], joints, heading, elevation, **options)
        views.append(View(sequence, heading))
        names = [str(n) for n in sequence['joints3d_names']]
        truths.append(views[-1].truth[:, [names.index(n) for n in CMU15.joints]])
    upward = protocol.view(np.array([[0.0, 1.0, 0.0]]), 0.0, elevation)[0]
    return Scene(tuple(views), tuple(truths), upward)


def reconstruct(scene: Scene, way: str, models: Mapping[str, BasePoses], config: Config) -> list[Array]:
    """Return the poses (F, 15, 3) m of each person."""
    if way == 'live':
        return track(scene, models, config)
    out = []
    for view in scene.views:
        keypoints, times = view.sequence['keypoints'].astype(float), view.sequence['timestamps']
        out.append(
            reconstruct_sequence(keypoints, view.joint_names, times, view.intrinsics, models, config).joints
        )
    return out


def track(scene: Scene, models: Mapping[str, BasePoses], config: Config) -> list[Array]:
    """Return the poses (F, 15, 3) m of each person as the tracker has them in its newest frame."""
    tracker, views = Tracker(models, config), scene.views
    width, height = (int(v) for v in views[0].sequence['image_size'])
    camera = Intrinsics.from_image_size(width * len(views), height, common.ORTHOGRAPHIC_FOCAL_LENGTH)
    found = [np.full(t.shape, np.nan) for t in scene.truths]
    for frame in range(max(v.frames for v in views)):
        people = [
            Person2D(str(i), v.joint_names, k[:, :2] + [i * width, 0], k[:, 2])
            for i, v in enumerate(views)
            if frame < v.frames
            for k in [v.sequence['keypoints'][frame].astype(float)]
        ]
        for person in tracker.update(round(frame * NS_PER_S / common.FPS) + 1, people, camera):
            if frame < len(found[int(person.id)]):
                found[int(person.id)][frame] = person.joints
        tracker.run_deferred_work()
    return found


def measure_leans(joints: Array, upward: Array) -> Array:
    """Return the leans of trunks (F,) in degrees along the line of sight, of poses (F, 15, 3)."""
    along = np.array([0.0, 0.0, 1.0])
    along -= (along @ upward) * upward
    trunk = joints[:, NECK] - joints[:, PELVIS]
    return np.asarray(np.degrees(np.arctan2(trunk @ along / np.linalg.norm(along), trunk @ upward)))


def measure(
    scene: Scene, trials: Sequence[str], way: str, choice: str, models: Mapping[str, BasePoses], config: Config
) -> Iterator[dict[str, Any]]:
    """Yield the results of each person of a scene."""
    text = ' '.join(map(repr, scene.upward.tolist())) if choice == 'given' else choice
    found = reconstruct(scene, way, models, with_values(config, {'tracker.vertical': text}))
    for view, truth, joints, trial in zip(scene.views, scene.truths, found, trials, strict=True):
        known = np.isfinite(joints).all(axis=(1, 2))
        true, own = (measure_leans(centre_poses(p[known]), scene.upward) for p in (truth, joints))
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


def print_results(records: Sequence[Record]) -> None:
    rows = []
    for detector, way in dict.fromkeys((r.detector, r.way) for r in records):
        for choice in CHOICES:
            mine = [r for r in records if (r.detector, r.way, r.choice) == (detector, way, choice)]
            elevations = dict.fromkeys(r.elevation for r in mine)
            by_elevation = [np.mean([r.mpjpe_mm for r in mine if r.elevation == e]) for e in elevations]
            rows.append(
                [
                    *(detector, way, choice, f'{np.mean([r.mpjpe_mm for r in mine]):.1f}'),
                    ' / '.join(f'{e:.1f}' for e in by_elevation),
                    f'{fit_slope([r.line for r in mine]):.2f}',
                    f'{np.nanmean([r.lean_error_deg for r in mine]):.1f}',
                ]
            )
    header = [
        'detector',
        'way',
        'vertical',
        'MPJPE, mm',
        'by elevation',
        'slope of the lean',
        'its error, degrees',
    ]
    print(common.format_table(header, rows))


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--persons', choices=('held-out', 'training'), default='held-out')
    parser.add_argument('--detectors', nargs='+', choices=DETECTORS, default=[CLEAN, 'mediapipe', 'movenet'])
    parser.add_argument('--ways', nargs='+', choices=WAYS, default=list(WAYS))
    parser.add_argument('--elevations', nargs='+', type=float, default=list(ELEVATIONS_DEG), metavar='DEGREES')
    parser.add_argument('--trials', type=int, default=1, metavar='N', help='of each kind of motion')
    parser.add_argument('--frames', type=int, default=300, metavar='N', help='of a trial, at 30 Hz')


def main() -> None:
    args = common.parse_arguments(__doc__ or '', add_options, one_core=False)
    common.choose_capture('motion')
    compile_kernels()
    config, models = Config(), load_base_pose_models(ALL_MOTIONS)
    if args.persons == 'held-out':
        models = {ALL_MOTIONS: common.train_base_poses(without_subjects=common.HELD_OUT_SUBJECTS)}
        config = with_values(config, {'solver.prior': str(common.provide_held_out_lifter())})
    trials = choose_trials(args.persons, args.trials, MIN_FRAMES)
    elevations, frames = args.elevations, args.frames
    if args.quick:
        trials, elevations, frames = trials[: 2 * PEOPLE], [10.0], 60
    groups = [trials[i : i + PEOPLE] for i in range(0, len(trials), PEOPLE)]
    work = [(d, e, n, g) for d in args.detectors for e in elevations for n, g in enumerate(groups)]
    records = []
    for detector, elevation, number, group in common.show_progress(work, 'scenes'):
        scene = make_scene(group, number * PEOPLE, elevation, detector, frames)
        for way in args.ways:
            for choice in CHOICES:
                found = measure(scene, group, way, choice, models, config)
                records += [Record(detector, elevation, way, choice, **result) for result in found]
    print_results(records)
    common.write_json(args.json, [asdict(r) for r in records])


if __name__ == '__main__':
    main()
