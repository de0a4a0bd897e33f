# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Where cameras are, found from the people whom they see.

Walks of people on whom no model was trained are continued along a figure of eight of changing curvature, and
others of them exercise, mop, fight, give signs or sit down, before cameras on tripods at frame rates of 30, 15
and 10 Hz, whose clocks are seconds apart. Keypoints are as OpenPose and MediaPipe give them; each recording is
reconstructed as a whole. Measures, in the median: the angle of the error of rotations; that of the direction
from the first camera; the error of the place after one scale for all cameras, and of the distance before it, in
per cent of the distance; that of the clock in ms; and the root mean squares of both errors over their standard
deviations; the worst angle that the command does not refuse, and the share that it refuses. Recorded: one and
two people before three cameras for 1.7 s.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from typing import Any, NamedTuple

import common
import numpy as np
from detected import load_motion
from report import Record, Records, Report, group, run
from scipy.interpolate import CubicSpline

from mocap_ros.config import Config, with_values
from mocap_ros.errors import InputError
from mocap_ros.formats.sequence_file import load_sequence
from mocap_ros.geometry.rotations import rotation_from_vector, vector_from_rotation
from mocap_ros.keypoints.keypoint_sequence import KeypointSequence
from mocap_ros.people import PoseSequence
from mocap_ros.recordings.find_cameras import MAX_ROTATION_STD
from mocap_ros.recordings.reconstruct import ReconstructionOptions, reconstruct
from mocap_ros.solvers.camera_poses import FoundCameras, find_camera_poses

Array = common.Array

WALKS = ('35_29', 'UW_24', 'UW_22', '12_02', '05_01')  # of held-out subjects, straight ahead
TRAINING_WALKS = ('07_01', '16_15', '38_02', '32_01', '02_01')
OTHERS = ('14_06', '14_15', '135_02', 'UT_04', '86_09')  # exercises, mopping, martial arts, signs, sitting down
TRAINING_OTHERS = ('03_04', '29_23', '17_10', '85_12', '61_09')
SECONDS = (5, 10, 20)
CYCLE_FRAMES = (25, 45)  # of two steps at 30 Hz
RADIUS_M, BENDING = 1.2, 0.5  # of the figure of eight, and by which share its curvature changes
RATES_HZ, CLOCKS_S = (30.0, 15.0, 10.0, 30.0), (0.0, 3.217, -7.533, 1.104)  # of the four cameras
AZIMUTHS_DEG = (0.0, 45.0, 95.0, 200.0)  # about the figure, each with up to 25 degrees more
TRIPODS = (4.0, 5.5), (1.0, 2.2)  # m, distances from the middle and heights
CHOSEN = ((0, 1), (0, 2), (0, 1, 2, 3))  # of these cameras
SIZE_PX, FOCAL_PX = (1280, 960), 900.0
AIM = np.array([0.0, 0.9, 0.0])  # m, y up; where the cameras look


MEASURES = ('rotation', 'direction', 'place', 'size', 'clock', 'ratio', 'place ratio')
HEADER = (
    'rotation, deg', 'direction, deg', 'place, %', 'distance, %', 'clock, ms', 'angle / deviation',
    'place / deviation', 'worst not refused', 'refused', 'number',
)  # fmt: skip


class Camera(NamedTuple):
    """A camera: x_camera = rotation x_world + translation, in m, world y up."""

    rotation: Array
    translation: Array
    rate_hz: float
    clock_s: float  # its time less that of the world


def walk_about(trial: str, frames: int) -> Array:
    """Return a walk (F, 26, 3) m at 30 Hz, y up, along the figure of eight, from the best cycle of a trial."""
    poses, names = load_motion()[0][trial].astype(float) / 1e3, load_motion()[1]
    root = poses[:, [names.index('lhip'), names.index('rhip')]].mean(axis=1)
    ahead = root[-1] - root[0]
    turn = rotation_from_vector(np.array([0.0, -np.arctan2(ahead[0], ahead[2]), 0.0]))
    poses, root = poses @ turn.T, root @ turn.T  # ahead is z
    about = poses - root[:, None]
    speed = np.gradient(about, axis=0)
    cycles = [
        (float(np.linalg.norm([about[i] - about[j], 3 * (speed[i] - speed[j])], axis=-1).sum()), i, j)
        for i in range(3, len(poses) - CYCLE_FRAMES[0] - 3)
        for j in range(i + CYCLE_FRAMES[0], min(i + CYCLE_FRAMES[1], len(poses) - 3))
    ]
    _, i, j = min(cycles)
    at = np.arange(frames) % (j - i)
    drift = (np.arange(j - i) / (j - i))[:, None]
    cycle = about[i:j] - drift[..., None] * (about[j] - about[i])
    sway = (root[i:j] - root[i] - drift * (root[j] - root[i]))[at]
    step = np.diff(root[i : j + 1, 2])[at]
    length = np.cumsum(step)
    side = np.where(length // (2 * np.pi * RADIUS_M) % 2, -1, 1)
    heading = np.cumsum(step * side * (1 + BENDING * np.sin(length)) / RADIUS_M)
    place = np.cumsum(
        step[:, None] * np.stack([np.sin(heading), np.zeros(frames), np.cos(heading)], axis=1), axis=0
    )
    turned = rotation_from_vector(heading[:, None] * [0.0, 1.0, 0.0])
    sway[:, 2] = 0.0
    body = (cycle[at] + sway[:, None]) @ np.swapaxes(turned, 1, 2) + place[:, None]
    return body - [*body.mean(axis=(0, 1))[[0]], body[..., 1].min(), *body.mean(axis=(0, 1))[[2]]]


def stay_about(trial: str, frames: int) -> Array:
    """Return the motion (F, 26, 3) m of a trial from its fourth second on, in the middle."""
    body = load_motion()[0][trial][90 : 90 + frames].astype(float) / 1e3
    return body - [body[..., 0].mean(), body[..., 1].min(), body[..., 2].mean()]


def place_cameras(rng: np.random.Generator) -> list[Camera]:
    """Return four cameras on tripods that look at the middle."""
    cameras = []
    for azimuth, rate, clock in zip(AZIMUTHS_DEG, RATES_HZ, CLOCKS_S, strict=True):
        angle, (distance, height) = np.radians(azimuth + rng.uniform(0, 25)), (rng.uniform(*r) for r in TRIPODS)
        centre = np.array([distance * np.sin(angle), height, distance * np.cos(angle)])
        forward = (AIM - centre) / np.linalg.norm(AIM - centre)
        right = np.cross(forward, [0.0, 1.0, 0.0])
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward])
        cameras.append(Camera(rotation, -rotation @ centre, rate, clock))
    return cameras


def film(body: CubicSpline, camera: Camera, seconds: float, detector: str, seed: int) -> KeypointSequence:
    """Return what a detector sees of a body (by times in s, in the world) in the first seconds."""
    protocol, names = common.load_protocol(), load_motion()[1]
    times = np.arange(0.0, seconds, 1 / camera.rate_hz)
    seen = body(times) @ camera.rotation.T + camera.translation
    rng = np.random.default_rng(seed)
    points, errors, scores, order = protocol.detect(seen, names, camera.rate_hz, detector, rng)
    pixels = (points[..., :2] + errors) / points[..., 2:] * FOCAL_PX + np.array(SIZE_PX) / 2
    pixels, scores = np.take_along_axis(pixels, order[..., None], 1), np.take_along_axis(scores, order, 1)
    is_seen = (scores > 0) & ((pixels >= 0) & (pixels < SIZE_PX)).all(axis=-1) & (points[..., 2] > 0)
    keypoints = np.concatenate(
        [np.where(is_seen[..., None], pixels, np.nan), (is_seen * scores)[..., None]], axis=-1
    )
    given = [
        (j, protocol.GIVEN[detector][name]) for j, name in enumerate(names) if name in protocol.GIVEN[detector]
    ]
    matrix = np.array([[FOCAL_PX, 0, SIZE_PX[0] / 2], [0, FOCAL_PX, SIZE_PX[1] / 2], [0, 0, 1.0]])
    columns, labels = zip(*given, strict=True)
    return KeypointSequence(keypoints[:, list(columns)], labels, times + camera.clock_s, SIZE_PX, matrix)


def relate(rotations: Array, translations: Array) -> Array:
    """Return the transforms (C, 4, 4) from cameras to the first, of transforms from the world to them."""
    to_camera = np.tile(np.eye(4), (len(rotations), 1, 1))
    to_camera[:, :3, :3], to_camera[:, :3, 3] = rotations, translations
    return np.asarray(to_camera[0] @ np.linalg.inv(to_camera))


def measure(found: FoundCameras, truth: Array, clocks: Sequence[float]) -> Iterator[dict[str, Any]]:
    """Yield the errors of each camera but the first; `truth` (C, 4, 4), `clocks` (C,) s as `Camera.clock_s`."""
    places, true_places = found.poses[:, :3, 3], truth[:, :3, 3]
    scale = (places * true_places).sum() / (places * places).sum()
    for c in range(1, len(truth)):
        angle = float(np.linalg.norm(vector_from_rotation(found.poses[c, :3, :3].T @ truth[c, :3, :3])))
        length, true_length = np.linalg.norm(places[c]), np.linalg.norm(true_places[c])
        cosine = places[c] @ true_places[c] / (length * true_length)
        place = float(np.linalg.norm(scale * places[c] - true_places[c]))
        yield {
            'rotation': np.degrees(angle),
            'direction': np.degrees(np.arccos(min(cosine, 1.0))),
            'place': 100 * place / true_length,
            'size': 100 * abs(length / true_length - 1),
            'clock': 1e3 * abs(found.clock_offsets[c] - clocks[0] + clocks[c]),
            'ratio': angle / found.rotation_std[c],
            'place ratio': place / found.translation_std[c],
            'refused': float(found.rotation_std[c] > MAX_ROTATION_STD),
        }


def summarise(records: Records) -> list[object]:
    """Return the cells of a row."""
    middle = {key: np.nanmedian([r[key] for r in records]) for key in MEASURES[:5]}
    rms = [f'{np.sqrt(np.nanmean([r[key] ** 2 for r in records])):.2f}' for key in ('ratio', 'place ratio')]
    kept = [r['rotation'] for r in records if not r['refused']]
    shown = [f'{middle[key]:.1f}' for key in MEASURES[:4]]
    refused = f'{100 * np.mean([r["refused"] for r in records]):.0f} %'
    return [*shown, f'{middle["clock"]:.0f}', *rms, f'{max(kept):.1f}' if kept else None, refused, len(records)]


def provide_options() -> ReconstructionOptions:
    model, parameters = common.provide_held_out()
    return ReconstructionOptions(with_values(Config(), parameters), {'all': model}, max_people=None)


def report_walks(report: Report) -> Record:
    """Measure one and two walkers, and people who stay more or less where they are."""
    options, records = provide_options(), list[dict[str, Any]]()
    walks, others = (TRAINING_WALKS, TRAINING_OTHERS) if report.args.persons == 'train' else (WALKS, OTHERS)
    frames = 30 * SECONDS[-1] + 30
    bodies = {trial: walk_about(trial, frames) for trial in walks}
    scenes = [('1 walking', [bodies[trial]]) for trial in walks]
    pairs = list(zip(walks, (*walks[1:], walks[0]), strict=True))[::2]
    scenes += [('2 walking', [bodies[p], bodies[q][:, :, [2, 1, 0]] * [1, 1, -1]]) for p, q in pairs]
    scenes += [('1 on the spot', [stay_about(trial, frames)]) for trial in others]
    for number, (people, shown) in enumerate(common.show_progress(scenes[:: 3 if report.quick else 1], 'scenes')):
        rng = np.random.default_rng(number)
        splines = [CubicSpline(np.arange(len(body)) / 30, body) for body in shown]
        detector, cameras = common.RECORDED_DETECTORS[number % 2], place_cameras(rng)
        truth = relate(np.array([c.rotation for c in cameras]), np.array([c.translation for c in cameras]))
        for seconds in SECONDS:
            views = [
                reconstruct(
                    [
                        film(body, camera, seconds, detector, 100 * number + 10 * c + p)
                        for p, body in list(enumerate(splines))[:: 1 if c % 2 else -1]
                    ],
                    options,
                ).people
                for c, camera in enumerate(cameras)
            ]
            for chosen in CHOSEN:
                about = {'people': people, 'cameras': len(chosen), 'seconds': seconds, 'scene': number}
                try:
                    found = find_camera_poses([views[c] for c in chosen])
                except InputError:
                    records += [{**about, **dict.fromkeys(MEASURES, np.nan), 'refused': 1.0}] * (len(chosen) - 1)
                    continue
                true_poses = np.linalg.inv(truth[chosen[0]]) @ truth[list(chosen)]
                errors = measure(found, true_poses, [cameras[c].clock_s for c in chosen])
                records += ({**about, **error} for error in errors)
    groups = group(records, 'people', 'cameras', 'seconds')
    header = ['people', 'cameras', 'seconds', *HEADER]
    report.table(header, ([*key, *summarise(groups[key])] for key in sorted(groups)), 'walks', 'cameras.walks')
    return {'walks': records}


def load_recorded() -> Iterator[tuple[str, str, Array, list[list[KeypointSequence]]]]:
    """Yield recordings of three cameras: who, the detector, the poses (3, 4, 4) to the first, and the people."""
    folder = common.data_path('data', 'cameras')
    with np.load(folder / 'balance.npz') as archive:
        truth = relate(archive['rotation'], archive['translation'])
    for detector in common.RECORDED_DETECTORS:
        paths = [common.data_path('data', 'detections', f'balance_{detector}_cam{c}.npz') for c in common.CAMERAS]
        yield 'on a beam', detector, truth, [[load_sequence(path)] for path in paths]
    with np.load(folder / 'two_people.npz') as archive:
        found: Mapping[str, Any] = dict(archive)
    views = []
    for c in range(3):
        width, height = (int(v) for v in found['image_size'][c])
        camera = (width, height), found['camera_matrix'][c], found['distortion'][c]
        names, sequences = tuple(str(name) for name in found['joint_names']), []
        for keypoints in found['keypoints'][:, c].astype(float):
            seen = keypoints[..., 2:] > 0
            if seen.mean() > 0.1:
                points = np.where(seen, keypoints, [np.nan, np.nan, 0.0])
                sequences.append(KeypointSequence(points, names, found['timestamps'], *camera))
        views.append(sequences)
    yield 'two in a room', 'openpose', relate(found['rotation'], found['translation']), views


def report_recorded(report: Report) -> Record:
    """Measure recorded keypoints, 1.7 s long."""
    options, records = provide_options(), list[dict[str, Any]]()
    for people, detector, truth, sequences in load_recorded():
        views: list[Sequence[PoseSequence]] = [reconstruct(own, options).people for own in sequences]
        for chosen in (*combinations(range(3), 2), (0, 1, 2)):
            found = find_camera_poses([views[c] for c in chosen])
            true_poses = np.linalg.inv(truth[chosen[0]]) @ truth[list(chosen)]
            about = {'people': people, 'detector': detector, 'cameras': len(chosen)}
            records += ({**about, **error} for error in measure(found, true_poses, [0.0] * len(chosen)))
    groups = group(records, 'people', 'detector', 'cameras')
    rows = ([*key, *summarise(own)] for key, own in groups.items())
    report.table(['people', 'detector', 'cameras', *HEADER], rows, 'recorded', 'cameras.recorded')
    return {'recorded': records}


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--persons', choices=('test', 'train'), default='test')


if __name__ == '__main__':
    run(
        __doc__,
        {'walks': report_walks, 'recorded': report_recorded},
        add_options,
    )
