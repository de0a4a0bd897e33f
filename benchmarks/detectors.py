# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Errors with points as real detectors give them, on people that no model was trained on.

Motion capture of `data/motion` is seen through the protocol's models of detectors (`DETECTORS` of protocol.py) and
with clean points, from headings all around the person, by an orthographic camera and by a perspective one that is
3 m away. 15 joints; poses are compared about their centres, with one scale for a sequence. Base poses and lifter
were not trained on the tested people. Sections of `--only`:

    whole       whole sequences
    live        the tracker's newest frame
    recordings  the recorded detections of `data/detections`, 12 joints of the limbs
    extremities where heads and feet point, and how far off toes, hands and faces are
    labs        people of two other labs whom the lifter (`--set solver.prior=FILE`) was not trained on, by posture
                and by where the wrists are, and whether depths are as certain as live standard deviations say;
                `lifter_heldout.npz` saw others of these labs

`--persons training` tests other people, for tuning. `--against FILE` compares with the JSON of an earlier run,
view by view.
"""

import argparse
import json
import multiprocessing
import statistics
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import common
import numpy as np
import yaml
from common import WAYS, View
from detected import CLEAN, DETECTORS, ViewOptions, choose_trials, list_views, load_middle, load_motion
from numpy.typing import NDArray
from report import Records, Report, Section, cross, group, run

from mocap_ros.engine import motion
from mocap_ros.models import model_file
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.skeleton import BODY26, CMU15, CORE_COUNT
from mocap_ros.training.example_arrays import find_trunks

Array = NDArray[np.float64]

MAX_FRAMES, SHORT_FRAMES = 600, 150  # frames of a view, 20 s and 5 s
TRIALS_PER_MOTION = 4  # trials of each held-out person and kind of motion; one with `--quick`
COMPARED = {'mpjpe_mm': 1.0, 'pa_mpjpe_mm': 1.0, 'accel_mm_s2': 1e3}  # errors, with their divisors, of `--against`
VIEW_KEYS = ('trial', 'detector', 'seed', 'heading', 'camera', 'frames', 'way')
# What the tables of the pages call detectors and ways.
PAGE_NAMES = {d: f'{n}-like' for d, n in zip(DETECTORS[1:], ('OpenPose', 'MediaPipe', 'MoveNet'), strict=True)}
PAGE_NAMES |= {'detector': 'points', 'category': 'motion', 'whole': 'whole sequence'}

CALM_MOTIONS = ('walk', 'gesture', 'expression')  # categories for which targets of directions are set
START_FRAMES = 15  # frames at the beginning that do not count for extremities: nobody is known before
# Joints whose error is measured, and the core joint on which they hang.
OUTER = {
    'toes': (('ltoe', 'lankle'), ('rtoe', 'rankle')),
    'hands': (('lhand', 'lwrist'), ('rhand', 'rwrist')),
    'face': tuple((n, 'head') for n in ('nose', 'leye', 'reye', 'lear', 'rear')),
}

LABS = ('ui_', 'pf_')  # how their trials begin
LAB_POINTS = (CLEAN, 'mediapipe')
# Postures, by the least height of the hips above the lower ankle in lengths of a leg, and places of the wrists.
POSTURES = {'standing': 0.88, 'knees bent': 0.65, 'low or seated': -1.0}
PLACES = ['above the shoulders', 'hanging', 'at the trunk', 'ahead', 'aside']
NEAR_M = 0.25  # m, from the middle of the trunk to a wrist that is at the trunk


def load_models(args: argparse.Namespace, *others: str) -> tuple[PoseModel, dict[str, Any]]:
    """Return base poses, without `others` too, and parameters with a lifter; those of `--set` have precedence."""
    given = {name: yaml.safe_load(text) for name, _, text in (a.partition('=') for a in args.set)}
    model, parameters = common.provide_held_out(*others)
    return model, parameters | given


def measure_views(
    report: Report, ways: Sequence[str], frames: int, count: int, measure: Callable[..., Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """Return one record for each view and way: how the trial is seen, and what is measured of its joints."""
    args, (model, parameters) = report.args, load_models(report.args)
    trials = choose_trials(args.persons, 1 if report.quick else count)[:: 4 if report.quick else 1]
    views = list_views(trials, args.detectors, frames, args.seeds)
    measure_one = partial(measure_view, ways=ways, model=model, parameters=parameters, measure=measure)
    with multiprocessing.get_context('spawn').Pool(args.jobs) as pool:
        measured = list(common.show_progress(pool.imap(measure_one, views), ' and '.join(ways), len(views)))
    return [record for some in measured for record in some]


def measure_view(
    options: ViewOptions,
    ways: Sequence[str],
    model: PoseModel | str,
    parameters: common.Parameters,
    measure: Callable[..., Mapping[str, Any]],
) -> list[dict[str, Any]]:
    """Return a record of a view for each way."""
    view, about = options.make_view(), {**asdict(options), 'category': options.category}
    found = [common.reconstruct(way, view, model, parameters) for way in ways]
    return [{**about, 'way': way, **measure(options, view, j)} for way, j in zip(ways, found, strict=True)]


def compute_errors(_options: ViewOptions, view: View, joints: Array) -> dict[str, Any]:
    """Return the protocol's errors, and the RMS accelerations of the joints about the centre in m/s^2."""
    core = joints[:, :CORE_COUNT]
    accelerations = [np.diff(p, 2, axis=0) * common.FPS**2 for p in common.align_scale(core, view.true_poses)]
    squares = [(a**2).sum(axis=-1).mean(axis=1) for a in accelerations]
    usable = np.isfinite(squares[0])
    found, true = (float(np.sqrt(s[usable].mean())) for s in squares)
    errors = common.compute_errors(view, core, CMU15.joints, 'body15')
    return {**errors, 'found_acceleration': found, 'true_acceleration': true}


def format_errors(records: Records) -> str:
    """Return MPJPE ± spread of the seeds / PA / acceleration error / ratio of RMS accelerations."""
    means = [common.mean_error(mine) for mine in group(records, 'seed').values()]
    spread = f' ± {statistics.stdev(means):.1f}' if len(means) > 1 else ''
    pa, acceleration = (common.mean_error(records, key) for key in ('pa_mpjpe_mm', 'accel_mm_s2'))
    squares = [np.mean([r[k] ** 2 for r in records]) for k in ('found_acceleration', 'true_acceleration')]
    ratio = np.sqrt(squares[0] / squares[1])
    return f'{common.mean_error(records):.1f}{spread} / {pa:.1f} / {acceleration / 1e3:.1f} / {ratio:.1f}'


def report_errors(report: Report, way: str) -> dict[str, Any]:
    frames = SHORT_FRAMES if report.quick else MAX_FRAMES
    records = measure_views(report, [way], frames, TRIALS_PER_MOTION, compute_errors)
    both = [*report.results.get('errors', []), *records]
    report.table(*cross(both, 'detector', 'way', format_errors, PAGE_NAMES), page='detectors.points')
    motions = cross(records, 'category', 'detector', lambda r: f'{common.mean_error(r):.0f}', PAGE_NAMES)
    page = 'detectors.motions' if way == 'whole' else ''
    report.table(*motions, f'{way}, by motion: MPJPE, mm', page)
    if report.args.against:
        before = json.loads(report.args.against.read_text(encoding='utf-8'))['results']['errors']
        show_comparison(report, records, before)
    return {'errors': both}


def show_comparison(report: Report, records: Records, before: Records) -> None:
    """Show the mean changes since an earlier run over the views of both, with their standard errors."""
    earlier, rows = group(before, *VIEW_KEYS), []
    for (detector, way), mine in group(records, 'detector', 'way').items():
        pairs = [(r, earlier[name][-1]) for r in mine if (name := tuple(r[k] for k in VIEW_KEYS)) in earlier]
        row: list[object] = [detector, way, len(pairs)]
        for key, divisor in COMPARED.items():
            change = np.array([r[key] - b[key] for r, b in pairs]) / divisor
            row.append(f'{change.mean():+.2f} ± {change.std() / np.sqrt(len(change)):.2f}')
        rows += [row] if pairs else []
    header = ['detector', 'way', 'views', 'MPJPE, mm', 'PA, mm', 'accel., m/s^2']
    report.table(header, rows, 'Change since the earlier run, with its standard error')


def measure_recordings(model: PoseModel | str, parameters: common.Parameters, ways: Sequence[str]) -> Records:
    """Return the errors on the recorded detections, and those of MediaPipe's own 3D joints."""
    records = []
    for detector, camera in product(common.RECORDED_DETECTORS, common.CAMERAS):
        view = common.load_recording(detector, camera)
        found = [common.reconstruct(way, view, model, parameters) for way in ways]
        by_way = dict(zip(ways, common.compute_all_errors([view] * len(found), found, 'limbs'), strict=True))
        if (own := view.sequence.get('mediapipe_world')) is not None:
            scores = common.compute_errors(view, own.astype(float), view.joint_names, 'limbs')
            by_way["the detector's own 3D"] = scores
        records += [{'detector': detector, 'camera': camera, 'way': w, **s} for w, s in by_way.items()]
    return records


def report_recordings(report: Report) -> dict[str, Any]:
    rows, records = [], measure_recordings(*load_models(report.args), WAYS)
    for names, mine in group(records, 'detector', 'way').items():
        cells = [[r[k] for k in ('mpjpe_mm', 'pa_mpjpe_mm')] for r in mine]
        cells.append(np.mean(cells, axis=0).tolist())
        acceleration = f'{common.mean_error(mine, "accel_mm_s2") / 1e3:.1f}'
        failed = sum(int(r['failed_frames']) for r in mine)
        rows.append([*names, *('{:.1f} / {:.1f}'.format(*c) for c in cells), acceleration, failed])
    header = ['detector', 'result', *(f'camera {c}' for c in common.CAMERAS), 'mean', 'accel.', 'failed']
    report.table(header, rows, 'Recorded detections: MPJPE / PA-MPJPE, mm; m/s^2', 'detectors.recordings')
    return {'recordings': records}


def find_directions(poses: Array) -> Array:
    """Return the directions (F, 3, 3) of the head, from the ears to the nose, and of the feet, heel to toe."""
    at = {name: poses[:, i] for i, name in enumerate(BODY26.joints)}
    head = at['nose'] - (at['lear'] + at['rear']) / 2
    directions = np.stack([head, at['ltoe'] - at['lheel'], at['rtoe'] - at['rheel']], axis=1)
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)


def compute_angles(first: Array, second: Array) -> Array:
    """Return the angles in degrees between unit vectors (..., 3)."""
    return np.asarray(np.degrees(np.arccos(np.clip((first * second).sum(axis=-1), -1, 1))))


def compute_extremity_errors(_options: ViewOptions, view: View, joints: Array) -> dict[str, float]:
    """Return the median errors of directions in degrees, and the mean errors of joints in mm.

    Poses are about the mean of their core, with one scale for the sequence as in the MPJPE. `toes alone` and so on
    are the errors of the joints relative to the core joint on which they hang. `jitter` is the median angle in
    degrees between the directions of the head and those to which two frames before lead.
    """
    known = np.asarray(np.isfinite(joints).all(axis=(1, 2)))
    known[:START_FRAMES] = False
    both = (joints, view.select_truth(BODY26.joints))
    found, truth = (p[known] - p[known, :CORE_COUNT].mean(axis=1, keepdims=True) for p in both)
    core, true_core = found[:, :CORE_COUNT], truth[:, :CORE_COUNT]
    found = found * ((core * true_core).sum() / (core * core).sum())
    directions = find_directions(found)
    angles = compute_angles(directions, find_directions(truth))
    ahead = 2 * directions[1:-1, 0] - directions[:-2, 0]
    ahead /= np.linalg.norm(ahead, axis=-1, keepdims=True)
    out = {'head': float(np.median(angles[:, 0])), 'feet': float(np.median(angles[:, 1:]))}
    out['jitter'] = float(np.median(compute_angles(directions[2:, 0], ahead)))
    error = found - truth
    for name, pairs in OUTER.items():
        outer, anchors = ([BODY26.index(pair[i]) for pair in pairs] for i in (0, 1))
        out[name] = float(np.linalg.norm(error[:, outer], axis=-1).mean() * 1e3)
        out[f'{name} alone'] = float(np.linalg.norm(error[:, outer] - error[:, anchors], axis=-1).mean() * 1e3)
    return out


def report_extremities(report: Report) -> dict[str, Any]:
    records = measure_views(report, WAYS, SHORT_FRAMES, 1, compute_extremity_errors)
    calm, rows = [r for r in records if r['category'] in CALM_MOTIONS], []
    for motions, some in (('walking, gestures', calm), ('all', records)):
        for names, mine in group(some, 'detector', 'way').items():
            mean = partial(common.mean_error, mine)
            joints, alone = (' / '.join(f'{mean(n + k):.0f}' for n in OUTER) for k in ('', ' alone'))
            angles = (f'{mean(k):.1f}' for k in ('head', 'feet'))
            shown = (PAGE_NAMES.get(n, n) for n in names)
            rows.append([motions, *shown, *angles, joints, alone, f'{mean("jitter"):.1f}'])
    header = ['motions', 'points', 'result', 'head', 'feet', 'toes / hands / face', 'alone', 'jitter']
    report.table(header, rows, 'Face, feet and hands: degrees; mm; degrees a frame', 'detectors.extremities')
    return {'extremities': records}


def list_lab_trials(seen: Collection[str], count: int) -> list[str]:
    """Return the longest trials of `LABS` that were not seen, `count` of each lab, kind of motion and person."""
    groups: dict[tuple[str, ...], list[tuple[int, str]]] = {}
    for name, row in load_motion()[2].items():
        if name.startswith(LABS) and name not in seen:
            groups.setdefault((name[:2], row['category']), []).append((-int(row['frames']), name))
    return [name for group in groups.values() for _, name in sorted(group)[:count]]


def describe_frames(trial: str, frames: int) -> tuple[NDArray[np.str_], NDArray[np.str_]]:
    """Return the posture (F,) of each frame and the places of the wrists (F, 2), by the true joints."""
    poses, joints = load_middle(trial, frames) / 1e3, load_motion()[1]
    hip, knee, ankle, shoulder, wrist = (
        poses[:, [joints.index(s + n) for s in 'lr']] for n in ('hip', 'knee', 'ankle', 'shoulder', 'wrist')
    )
    leg = (np.linalg.norm(hip - knee, axis=-1) + np.linalg.norm(knee - ankle, axis=-1)).mean(axis=1)
    height = (hip[..., 1].mean(axis=1) - ankle[..., 1].min(axis=1)) / leg
    middle = hip.mean(axis=1)
    length = np.linalg.norm(shoulder.mean(axis=1) - middle, axis=-1, keepdims=True)
    bodies = poses[:, None, [joints.index(n) for n in BODY26.joints]].astype(np.float32)
    trunks = find_trunks(bodies)[:, 0]
    x, y, z = np.moveaxis((wrist - middle[:, None]) @ trunks, -1, 0)
    at = [z > length, z < 0.1 * length, np.hypot(x, y) < NEAR_M, x > np.abs(y) - NEAR_M, x < np.inf]
    return np.select([height > h for h in POSTURES.values()], [*POSTURES], ''), np.select(at, PLACES, '')


def measure_lab_view(options: ViewOptions, view: View, joints: Array, std: Array | None) -> Records:
    """Return the errors in mm of the frames of each posture, and those of the wrists at each place.

    With standard deviations (F, J) m the shares of depths about the centre within one and two of them, likewise.
    """
    found, truth = common.align_scale(joints[:, :CORE_COUNT], view.true_poses)
    known, error = np.isfinite(found).all(axis=(1, 2)), np.abs(found - truth) * 1e3
    postures, places = describe_frames(options.trial, options.frames)
    wrists = error[:, [CMU15.index(j) for j in ('lwrist', 'rwrist')]]
    turned = common.compute_pose_errors(found, truth, similarity=True)
    all_frames = np.linalg.norm(error, axis=-1).mean(axis=1), turned
    all_wrists = np.linalg.norm(wrists, axis=-1), wrists[..., 2]
    records = []
    for part, labels, errors in (('body', postures, all_frames), ('wrists', places, all_wrists)):
        for kind in np.unique(labels):
            own = (kind == labels.T) & known
            means = [float(e.T[own].mean()) for e in errors] if own.any() else [0.0, 0.0]
            records.append({'part': part, 'kind': str(kind), 'count': int(own.sum()), 'errors': means})
    if std is None:
        return records
    sight = joints[:, :CORE_COUNT] / np.linalg.norm(joints[:, :CORE_COUNT], axis=-1, keepdims=True)
    off = np.abs(((found - truth) * sight).sum(axis=-1)) / (np.sqrt(motion.VARIANCE_ALONG) * std[:, :CORE_COUNT])
    kinds = np.array([n.lstrip('lr') for n in CMU15.joints])
    for posture, kind in product(np.unique(postures[known]), dict.fromkeys(kinds)):
        own = off[known & (postures == posture)][:, kinds == kind]
        about = {'part': 'depths', 'kind': str(kind), 'posture': str(posture)}
        records.append({**about, 'count': own.size, 'errors': [float((own < n).mean()) for n in (1, 2)]})
    return records


def report_labs(report: Report) -> dict[str, Any]:
    frames, count = (SHORT_FRAMES, 4) if report.quick else (MAX_FRAMES, 16)
    persons = {r['subject'] for n, r in load_motion()[2].items() if n.startswith(LABS)}
    model, parameters = load_models(report.args, *sorted(persons))
    seen: Any = model_file.load_lifter(parameters['solver.prior']).provenance['trials']
    records = []
    for options in common.show_progress(list_views(list_lab_trials(seen, count), LAB_POINTS, frames, [0]), 'labs'):
        view = options.make_view()
        live, whole = common.track(view, model, parameters), common.reconstruct_whole(view, model, parameters)
        for way, joints, std in zip(WAYS, (whole, live.joints), (None, live.std), strict=True):
            about = {**asdict(options), 'lab': options.trial[:2], 'way': way}
            records += [{**about, **r} for r in measure_lab_view(options, view, joints, std)]

    def show(some: Records, digits: int = 0) -> str:
        means = np.average([r['errors'] for r in some], axis=0, weights=[r['count'] for r in some])
        return ' / '.join(f'{m:.{digits}f}' for m in means)

    for part, unit in (('body', 'MPJPE / PA'), ('wrists', 'error / along the line of sight')):
        mine = [{**r, 'points': f'{r["detector"]}, {r["way"]}'} for r in records if r['part'] == part]
        mine += [{**r, 'kind': f'all of {r["lab"]}'} for r in mine]
        table = cross(mine, 'kind', 'points', show)
        report.table(*table, f'People of other labs, {part}: {unit}, mm', f'detectors.labs_{part}')
    mine = [r for r in records if r['part'] == 'depths']
    for key in ('kind', 'posture'):
        mine += [{**r, key: 'all'} for r in mine]
    table = cross(mine, 'kind', 'posture', partial(show, digits=2))
    report.table(*table, 'Shares of depths within one and two live standard deviations (0.68 / 0.95)')
    return {'labs': records}


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--persons', choices=('held-out', 'training'), default='held-out')
    parser.add_argument('--detectors', nargs='+', choices=DETECTORS, default=list(DETECTORS))
    parser.add_argument('--seeds', nargs='+', type=int, metavar='N', default=[0, 1, 2], help='of the errors')
    parser.add_argument('--jobs', type=int, default=2)
    parser.add_argument('--set', action='append', default=[], metavar='NAME=VALUE', help='set a parameter')
    parser.add_argument('--against', type=Path, metavar='FILE', help='compare with the results of an earlier run')


if __name__ == '__main__':
    sections: dict[str, Section] = {way: partial(report_errors, way=way) for way in WAYS}
    sections |= {'recordings': report_recordings, 'extremities': report_extremities, 'labs': report_labs}
    run(__doc__, sections, add_options)
