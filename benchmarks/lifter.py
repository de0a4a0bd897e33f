# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The lifter: errors on real detections and on unseen motion capture, and CPU time.

The motion capture is evaluated with a lifter and base poses that were not trained on the tested subjects. This
program trains that lifter if it is missing (half an hour; `mocap-ros train --lifter --without-subject ...`). The
detections are evaluated with the shipped lifter.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import common
import numpy as np
from common import View
from experiments.detector_pictures import draw_case
from numpy.typing import NDArray
from report import Records, Report, group, run

from mocap_ros.compiled.kernel import compile_kernels
from mocap_ros.config import Config, SolverConfig
from mocap_ros.formats.mocap.trials import Trial
from mocap_ros.geometry.virtual_camera import VirtualCamera
from mocap_ros.models import lifter, lifter_input, model_file
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.lifter import LiftedPoses, Lifter
from mocap_ros.models.lifter_input import HISTORY_SLOTS_S
from mocap_ros.models.model_file import load_base_poses
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.joint.solver import solve_hypotheses
from mocap_ros.solvers.observed_window import observe_sequence
from mocap_ros.solvers.window import Window

Array = NDArray[np.float64]

# Rows of the table of motion capture: which trials belong to the row, and the target of its MPJPE in mm.
TEST_ROWS: dict[str, tuple[Callable[[Trial], bool], float]] = {
    '35 walk': (lambda t: t.subject == '35' and t.category == 'walk', 16),
    '35 run': (lambda t: t.subject == '35' and t.category == 'run', 22),
    '13 jump': (lambda t: t.subject == '13' and t.category == 'jump', 40),
    '05 dance': (lambda t: t.subject == '05' and t.category == 'dance', 65),
    '135 martial arts': (lambda t: t.subject == '135', 60),
    'U* gestures': (lambda t: t.subject.startswith('U') and t.category == 'gesture', 34),
}
# Options of the protocol for a bad detector.
NOISY_OPTIONS = {'noise': 0.02, 'missing': 0.1}
MAX_NOISY_RATIO = 1.25  # target of the ratio of the noisy to the clean error
# mm, targets of MPJPE and PA-MPJPE by detector.
DETECTOR_TARGETS_MM = {'openpose': (75, 58), 'mediapipe': (85, 68)}
# ms, targets of the CPU time per person and frame by number of people.
COST_TARGETS_MS = {1: 0.2, 10: 0.1, 30: 0.1}
COST_FOCAL_PX = 1000.0  # px; with a known focal length, each history is turned to face its newest frame
MAX_SOLVED_FRAMES = 120  # frames of a sequence that the solver is given, to limit the time
METHODS = ('network', 'factorisation', 'both')  # with the solver


def observe(view: View, undo_swaps: bool) -> tuple[VirtualCamera, Window]:
    """Return the image of virtual cameras that look at the person of a recording."""
    settings, camera = replace(Config().tracker, undo_swaps=undo_swaps), view.intrinsics
    keypoints, times = view.sequence['keypoints'].astype(float), view.sequence['timestamps']
    seen = observe_sequence(keypoints, view.joint_names, times, camera, settings, CMU15)
    return seen.virtual_camera, replace(seen, focal=camera.focal).build_solver_window()


def lift_windows(model: Lifter, windows: Sequence[Window]) -> list[LiftedPoses]:
    return [model.lift_sequence(w.points, w.weight, w.times, w.focal).select_core() for w in windows]


def scale_lifted(lifted: Sequence[LiftedPoses], windows: Sequence[Window]) -> list[Array]:
    height = Config().tracker.body_height
    return [lifter.scale_to_metres(out, w.times, height).joints for out, w in zip(lifted, windows, strict=True)]


def reconstruct(
    model: Lifter, windows: Sequence[Window], poses: BasePoses
) -> tuple[dict[str, Sequence[Array]], float]:
    """Return the poses of each of `METHODS`, and the CPU time in s of the solver with the lifter."""
    lifted = lift_windows(model, windows)
    plain = solve_hypotheses(windows, poses, SolverConfig())
    with_lifted = [replace(w, lifted=out) for w, out in zip(windows, lifted, strict=True)]
    both, seconds = common.measure_time(partial(solve_hypotheses, with_lifted, poses, SolverConfig()))
    found = scale_lifted(lifted, windows), [r.joints for r in plain], [r.joints for r in both]
    return dict(zip(METHODS, found, strict=True)), seconds


def evaluate_detections(model: Lifter, cameras: Sequence[int]) -> list[dict[str, Any]]:
    """Evaluate the network with labels as detected, and all methods with swaps undone."""
    shipped = load_base_poses('all')
    shipped = shipped.rescale(Config().tracker.body_height / shipped.stature)
    records = []
    for detector, camera, undo_swaps in product(DETECTOR_TARGETS_MM, cameras, (False, True)):
        view = common.load_recording(detector, camera)
        virtual_camera, window = observe(view, undo_swaps)
        if undo_swaps:
            found, _ = reconstruct(model, [window], shipped)
        else:
            found = {'network': scale_lifted(lift_windows(model, [window]), [window])}
        real = [virtual_camera.to_real_camera(joints) for (joints,) in found.values()]
        scores = dict(zip(found, common.compute_all_errors([view] * len(real), real, 'limbs'), strict=True))
        if not undo_swaps and (own := common.compute_errors_of_detector(view)):
            scores['MediaPipe'] = own
        about = {'detector': detector, 'camera': camera, 'labels': f'undo swaps {undo_swaps}'}
        records += [{**about, 'method': method, **errors} for method, errors in scores.items()]
    return records


def show_detections(report: Report, records: Records, cameras: Sequence[int]) -> None:
    rows = []
    for (detector, method, labels), mine in group(records, 'detector', 'method', 'labels').items():
        each = [f'{r["mpjpe_mm"]:.0f} / {r["pa_mpjpe_mm"]:.0f}' for r in mine]
        mean = ' / '.join(f'{common.mean_error(mine, k):.0f}' for k in ('mpjpe_mm', 'pa_mpjpe_mm'))
        shown = 'swaps undone' if labels.endswith('True') else 'as detected'
        target = '{} / {}'.format(*DETECTOR_TARGETS_MM[detector])
        failed = sum(int(r['failed_frames']) for r in mine)
        rows.append([f'{detector}, {method}', shown, *each, mean, target, failed])
    report.table(
        ['points and method', 'labels', *(f'cam {c}' for c in cameras), 'mean', 'target', 'failed'],
        rows,
        'Real detections: MPJPE / PA-MPJPE, mm, twelve joints of the limbs',
        page='lifter.detections',
    )


def make_row_views(
    row: str, noisy: bool, headings: Sequence[float], frames: int, trials: int = 1_000, stride: int = 1
) -> list[View]:
    """Return views of the trials of a row of the table: of every so many, or of so many in all."""
    chosen = [t.name for t in common.list_trials() if t.clean and TEST_ROWS[row][0](t)]
    chosen = chosen[:: max(stride, len(chosen) // trials)]
    options: dict[str, Any] = {'frames': frames, **(NOISY_OPTIONS if noisy else {})}
    return [v for t in chosen for v in common.make_views(t, headings, **options)]


def evaluate_capture(model: Lifter, quick: bool) -> list[dict[str, Any]]:
    """Evaluate the network alone on all frames; with `--quick`, on a few trials, three headings and 120 frames."""
    headings = common.HEADINGS_DEG[::3] if quick else common.HEADINGS_DEG
    frames, stride = (MAX_SOLVED_FRAMES, 4) if quick else (1_000_000, 1)
    records = []
    for row, noisy in common.show_progress(list(product(TEST_ROWS, (False, True))), 'capture'):
        tests = make_row_views(row, noisy, headings, frames, stride=stride)
        windows = [v.window for v in tests]
        scored = common.compute_all_errors(tests, scale_lifted(lift_windows(model, windows), windows))
        errors = {k: common.mean_error(scored, k) for k in ('mpjpe_mm', 'pa_mpjpe_mm', 'accel_mm_s2')}
        records.append({'row': row, 'noisy': noisy, 'failed': sum(s['failed_frames'] for s in scored), **errors})
    return records


def show_capture(report: Report, records: Records) -> None:
    rows: list[list[object]] = []
    for (row,), (clean, noisy) in group(records, 'row').items():
        errors = [f'{r["mpjpe_mm"]:.1f} / {r["pa_mpjpe_mm"]:.1f}' for r in (clean, noisy)]
        ratio, failed = float(noisy['mpjpe_mm'] / clean['mpjpe_mm']), int(clean['failed'] + noisy['failed'])
        rows.append([row, *errors, f'{TEST_ROWS[row][1]:g}', ratio, MAX_NOISY_RATIO, failed])
    report.table(
        ['row', 'clean', 'noise 0.02, missing 0.1', 'target', 'ratio', 'target', 'failed'],
        rows,
        'Motion capture, subject left out, network alone: MPJPE / PA-MPJPE, mm, 15 joints',
        page='lifter.capture',
    )


def evaluate_with_solver(model: Lifter, quick: bool) -> list[dict[str, Any]]:
    """Evaluate the network, the solver without it, and both, on the first frames of some trials of each row."""
    poses = common.train_base_poses(without_subjects=common.HELD_OUT_SUBJECTS)
    records = []
    cases = list(product(list(TEST_ROWS)[: 1 if quick else None], (False, True)))
    for row, noisy in common.show_progress(cases, 'solver'):
        headings, trials = common.HEADINGS_DEG[::2], 1 if quick else 3
        tests = make_row_views(row, noisy, headings, MAX_SOLVED_FRAMES, trials)
        found, seconds = reconstruct(model, [v.window for v in tests], poses)
        errors = {m: common.mean_error(common.compute_all_errors(tests, f)) for m, f in found.items()}
        about = {'row': row, 'noisy': noisy, 'views': len(tests), 'seconds': seconds / len(tests)}
        records.append({**about, **errors})
    return records


def show_with_solver(report: Report, records: Records) -> None:
    rows = [
        {
            'motion': row,
            **{f'{m}, clean': f'{clean[m]:.1f}' for m in METHODS},
            **{f'{m}, noisy': f'{noisy[m]:.1f}' for m in METHODS},
            'target, clean': f'{TEST_ROWS[row][1]:g}',
            'noisy / clean': noisy['both'] / clean['both'],
        }
        for (row,), (clean, noisy) in group(records, 'row').items()
    ]
    title = f'Motion capture, at most {MAX_SOLVED_FRAMES} frames: network, solver without it, and both: MPJPE, mm'
    report.rows(title, rows, page='lifter.solver')


def measure_cost(model: Lifter, quick: bool) -> dict[int, float]:
    """Measure the CPU ms per person and frame of the histories and the network; the fastest of several runs.

    The people differ, because a processor learns what it repeats.
    """
    (view,) = common.make_views('35_02', (45,))
    w = view.window
    out = {}
    for people in COST_TARGETS_MS:
        ends = np.linspace(31, 91, people, dtype=int).tolist()

        def once(ends: Sequence[int] = ends) -> None:
            seen = [
                lifter_input.sample_histories(w.points[:end], w.weight[:end], w.times[:end], np.array([end - 1]))
                for end in ends
            ]
            points, weight = (np.concatenate(each) for each in zip(*seen, strict=True))
            model.lift(points, weight, COST_FOCAL_PX)

        fastest = math.inf
        for _ in range(10 if quick else 60):
            start_s = time.process_time()
            for _ in range(10):
                once()
            fastest = min(fastest, (time.process_time() - start_s) / 10)
        out[people] = fastest / people * 1e3
    return out


def show_cost(report: Report, found: dict[int, float]) -> None:
    rows = [[people, f'{ms:.3f}', COST_TARGETS_MS[people]] for people, ms in found.items()]
    title = f'CPU ms per person and frame ({len(HISTORY_SLOTS_S)} slots)'
    report.table(['people', 'ms', 'target'], rows, title, page='lifter.cost')


def draw_pictures(model: Lifter, folder: Path) -> None:
    """Draw the best and the worst lifted sequence of the recorded detections, beside the truth."""
    cases = []
    for detector, camera in product(DETECTOR_TARGETS_MM, common.CAMERAS):
        view = common.load_recording(detector, camera)
        virtual_camera, window = observe(view, undo_swaps=True)
        joints = virtual_camera.to_real_camera(scale_lifted(lift_windows(model, [window]), [window])[0])
        (errors,) = common.compute_all_errors([view], [joints], 'limbs')
        cases.append((errors['mpjpe_mm'], detector, camera, view, joints))
    cases.sort(key=lambda case: case[0])
    for name, (error, detector, camera, view, joints) in (('best', cases[0]), ('worst', cases[-1])):
        title = f'{detector}, camera {camera}: {error:.0f} mm; grey: triangulated from four cameras'
        draw_case(view, joints, title, folder / f'{name}.png')


def add_options(parser: argparse.ArgumentParser) -> None:
    help_text = 'lifter that was not trained on the tested subjects'
    parser.add_argument('--lifter', type=Path, default=common.HELD_OUT_LIFTER, metavar='NPZ', help=help_text)
    help_text = 'also draw the best and the worst sequence into this folder'
    parser.add_argument('--pictures', type=Path, metavar='FOLDER', help=help_text)


def measure(args: argparse.Namespace, report: Report) -> None:
    common.choose_capture('motion')
    compile_kernels()
    cameras = common.CAMERAS[1:2] if args.quick else common.CAMERAS
    shipped = model_file.load_shipped_lifter()
    report.add(cost_ms=(found := measure_cost(shipped, args.quick)))
    show_cost(report, found)
    report.add(detections=(detections := evaluate_detections(shipped, cameras)))
    show_detections(report, detections, cameras)
    unseen = model_file.load_lifter(args.lifter)
    report.add(capture=(captured := evaluate_capture(unseen, args.quick)))
    show_capture(report, captured)
    report.add(solver=(solved := evaluate_with_solver(unseen, args.quick)))
    show_with_solver(report, solved)
    if args.pictures:
        draw_pictures(shipped, args.pictures)


if __name__ == '__main__':
    run(__doc__, 'Lifter', measure, add_options)
