"""The lifter: errors on real detections and on unseen motion capture, and CPU time.

The motion capture is evaluated with a lifter and base poses that were not trained on the tested subjects. This
program trains that lifter if it is missing (half an hour; `mocap-ros train-lifter --without-subject ...`). The
detections are evaluated with the shipped lifter.
"""

from __future__ import annotations

import common

# isort: split
import argparse
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from common import View
from report import Records, Report, group, run

from mocap_ros.compiled.kernel import compile_kernels
from mocap_ros.config import Config, SolverConfig
from mocap_ros.formats.mocap.trials import Trial
from mocap_ros.formats.sequence_file import load_sequence
from mocap_ros.geometry.virtual_camera import VirtualCamera
from mocap_ros.keypoints.joint_map import build_joint_map
from mocap_ros.models import lifter, lifter_input, model_file
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.lifter import LiftedPoses, Lifter
from mocap_ros.models.lifter_input import HISTORY_SLOTS_S
from mocap_ros.models.model_file import load_base_poses
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.joint.solver import solve_hypotheses
from mocap_ros.solvers.observed_window import observe_sequence
from mocap_ros.solvers.window import Window

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
CAMERAS = (1, 2, 3)  # cameras of the recorded detections
# mm, targets of MPJPE and PA-MPJPE by detector.
DETECTOR_TARGETS_MM = {'openpose': (75, 58), 'mediapipe': (85, 68)}
# ms, targets of the CPU time per person and frame by number of people.
COST_TARGETS_MS = {1: 0.2, 10: 0.1, 30: 0.1}
COST_FOCAL_PX = 1000.0  # px; with a known focal length, each history is turned to face its newest frame
MAX_SOLVED_FRAMES = 120  # frames of a sequence that the solver is given, to limit the time
METHODS = ('network', 'factorisation', 'both')  # with the solver


@dataclass(frozen=True, eq=False)
class Detections:
    """A recorded sequence in the image of virtual cameras that look at the person."""

    view: View
    virtual_camera: VirtualCamera
    window: Window

    @staticmethod
    def load(detector: str, camera: int, undo_swaps: bool = True) -> Detections:
        file = common.data_path('data', 'detections', f'balance_{detector}_cam{camera}.npz')
        with np.load(file) as archive:
            sequence = {k: archive[k] for k in archive.files}
        settings = replace(Config().tracker, undo_swaps=undo_swaps)
        recorded = load_sequence(file)
        intrinsics = recorded.intrinsics(settings.nominal_focal_length)
        seen = observe_sequence(
            recorded.keypoints, recorded.joint_names, recorded.timestamps, intrinsics, settings, CMU15
        )
        window = replace(seen, focal=intrinsics.focal).build_solver_window()
        return Detections(View(sequence), seen.virtual_camera, window)

    def score(self, joints: np.ndarray) -> dict[str, float]:
        return common.compute_errors(self.view, self.virtual_camera.to_real_camera(joints), CMU15.joints, 'limbs')

    def score_detector(self) -> dict[str, float]:
        """Compute the errors of the detector's own 3D joints."""
        s = self.view.sequence
        return common.compute_errors(
            self.view, s['mediapipe_world'].astype(float), list(s['joint_names']), 'limbs'
        )


def lift_windows(model: Lifter, windows: Sequence[Window]) -> list[LiftedPoses]:
    return [model.lift_sequence(w.points, w.weight, w.times, w.focal).select_core() for w in windows]


def scale_lifted(out: LiftedPoses, window: Window) -> np.ndarray:
    return lifter.scale_to_metres(out, window.times, Config().tracker.body_height).joints


def load_scaled_base_poses(without: tuple[str, ...] = ()) -> BasePoses:
    model = common.train_base_poses(without_subjects=without) if without else load_base_poses('all')
    return model.rescale(Config().tracker.body_height / model.stature)


def evaluate_detections(model: Lifter, cameras: Sequence[int], solved: bool) -> list[dict[str, Any]]:
    records = []
    for detector in DETECTOR_TARGETS_MM:
        for camera in cameras:
            tests = {f'undo swaps {on}': Detections.load(detector, camera, on) for on in (False, True)}
            for name, test in tests.items():
                (out,) = lift_windows(model, [test.window])
                found = {'network': test.score(scale_lifted(out, test.window))}
                if solved and name.endswith('True'):
                    config = SolverConfig()
                    (plain,) = solve_hypotheses([test.window], load_scaled_base_poses(), config)
                    (both,) = solve_hypotheses(
                        [replace(test.window, lifted=out)], load_scaled_base_poses(), config
                    )
                    found |= {'factorisation': test.score(plain.joints), 'both': test.score(both.joints)}
                if detector == 'mediapipe' and name.endswith('False'):
                    found['MediaPipe'] = test.score_detector()
                records += [
                    {'detector': detector, 'camera': camera, 'labels': name, 'method': m, **s}
                    for m, s in found.items()
                ]
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


def make_row_views(row: str, stride: int, frames: int, headings: Sequence[float], **options: float) -> list[View]:
    of, _ = TEST_ROWS[row]
    chosen = [t.name for t in common.list_trials() if t.clean and of(t)][::stride]
    return [v for t in chosen for v in common.make_views(t, headings, frames=frames, **options)]


def evaluate_capture(model: Lifter, quick: bool) -> list[dict[str, Any]]:
    """Evaluate the network alone on all frames; with `--quick`, on a few trials, three headings and 120 frames."""
    stride, frames = (4, MAX_SOLVED_FRAMES) if quick else (1, 1_000_000)
    headings = common.HEADINGS_DEG[::3] if quick else common.HEADINGS_DEG
    records = []
    for row in common.show_progress(TEST_ROWS, 'capture'):
        for noisy in (False, True):
            tests = make_row_views(row, stride, frames, headings, **(NOISY_OPTIONS if noisy else {}))
            found = [scale_lifted(lift_windows(model, [v.window])[0], v.window) for v in tests]
            scored = compute_all_errors(tests, found)
            keys = ('mpjpe_mm', 'pa_mpjpe_mm', 'accel_mm_s2')
            failed = sum(s['failed_frames'] for s in scored)
            records.append(
                {'row': row, 'noisy': noisy, 'failed': failed, **{k: common.mean_error(scored, k) for k in keys}}
            )
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


def compute_all_errors(tests: Sequence[View], found: Sequence[np.ndarray]) -> list[dict[str, float]]:
    return [common.compute_errors(v, joints, CMU15.joints) for v, joints in zip(tests, found, strict=True)]


def evaluate_with_solver(model: Lifter, quick: bool) -> list[dict[str, Any]]:
    """Evaluate the network, the solver without it, and both, on the first frames of some trials of each row."""
    rows = list(TEST_ROWS)[:1] if quick else list(TEST_ROWS)
    records = []
    for row in common.show_progress(rows, 'solver'):
        for noisy in (False, True):
            of, _ = TEST_ROWS[row]
            count = sum(t.clean and of(t) for t in common.list_trials())
            stride = max(1, count // (1 if quick else 3))
            tests = make_row_views(
                row, stride, MAX_SOLVED_FRAMES, common.HEADINGS_DEG[::2], **(NOISY_OPTIONS if noisy else {})
            )
            windows = [v.window for v in tests]
            poses, config = load_scaled_base_poses(common.HELD_OUT_SUBJECTS), SolverConfig()
            out = lift_windows(model, windows)
            plain = solve_hypotheses(windows, poses, config)
            lifted_windows = [replace(w, lifted=o) for w, o in zip(windows, out, strict=True)]
            both, seconds = common.measure_time(partial(solve_hypotheses, lifted_windows, poses, config))
            methods = {
                'network': [scale_lifted(o, w) for o, w in zip(out, windows, strict=True)],
                'factorisation': [r.joints for r in plain],
                'both': [r.joints for r in both],
            }
            records.append(
                {
                    'row': row,
                    'noisy': noisy,
                    'views': len(tests),
                    'seconds': seconds / len(tests),
                    **{
                        name: common.mean_error(compute_all_errors(tests, found))
                        for name, found in methods.items()
                    },
                }
            )
    return records


def show_with_solver(report: Report, records: Records) -> None:
    report.table(
        ['row', 'image', 'views', *METHODS, 'both, s per sequence'],
        [
            [r['row'], 'noisy' if r['noisy'] else 'clean', r['views'], *(r[m] for m in METHODS), r['seconds']]
            for r in records
        ],
        f'Motion capture, at most {MAX_SOLVED_FRAMES} frames: network, solver without it, and both: MPJPE, mm',
    )
    report.keep(
        'lifter.solver',
        [
            'motion',
            *(f'{m}, {image}' for image in ('clean', 'noisy') for m in METHODS),
            'target, clean',
            'noisy / clean',
        ],
        [
            [
                row,
                *(f'{r[m]:.1f}' for r in (clean, noisy) for m in METHODS),
                f'{TEST_ROWS[row][1]:g}',
                noisy['both'] / clean['both'],
            ]
            for (row,), (clean, noisy) in group(records, 'row').items()
        ],
    )


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
    """Draw the truth and the lifted poses of the best and the worst sequence, in the image and from the side."""
    import matplotlib as mpl

    mpl.use('Agg')
    from matplotlib import pyplot as plt

    from mocap_ros.viewing.plots import draw_bones, project_from_side, save_figure

    folder.mkdir(parents=True, exist_ok=True)
    tests = {(d, c): Detections.load(d, c) for d in DETECTOR_TARGETS_MM for c in CAMERAS}
    found = {k: scale_lifted(lift_windows(model, [t.window])[0], t.window) for k, t in tests.items()}
    errors = {k: t.score(found[k])['mpjpe_mm'] for k, t in tests.items()}
    order = sorted(errors, key=errors.__getitem__)
    for name, key in (('best', order[0]), ('worst', order[-1])):
        test = tests[key]
        joints = test.virtual_camera.to_real_camera(found[key])
        names = tuple(str(n) for n in test.view.sequence['joints3d_names'])
        known = np.isfinite(test.view.truth).all(-1).astype(float)
        truth, _ = build_joint_map(names).apply(test.view.truth, known)
        truth -= np.nanmean(truth, axis=1, keepdims=True)
        good = np.isfinite(joints).all((1, 2)) & np.isfinite(truth).all((1, 2))
        joints = joints * (joints[good] * truth[good]).sum() / (joints[good] ** 2).sum()
        frames = np.flatnonzero(good)[:: max(1, good.sum() // 6)][:6]
        figure, axes = plt.subplots(2, len(frames), figsize=(2.2 * len(frames), 5))
        for column, frame in enumerate(frames):
            for row, turn in enumerate((lambda p: p, project_from_side)):
                for points, style in ((truth, {'colour': '#999999'}), (joints, {})):
                    draw_bones(axes[row, column], turn(points[frame])[:, :2], CMU15, **style)
                axes[row, column].set(aspect='equal', xlim=(-1.1, 1.1), ylim=(1.1, -1.1), xticks=[], yticks=[])
            axes[0, column].set_title(f'{test.window.times[frame] - test.window.times[0]:.1f} s', fontsize=8)
        axes[0, 0].set_ylabel('as the camera sees it')
        axes[1, 0].set_ylabel('from the side')
        figure.suptitle(f'{key[0]}, camera {key[1]}: {errors[key]:.0f} mm; grey: triangulated from four cameras')
        figure.tight_layout()
        save_figure(figure, folder / f'{name}.png')


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        '--lifter',
        type=Path,
        default=common.HELD_OUT_LIFTER,
        metavar='NPZ',
        help='lifter that was not trained on the tested subjects',
    )
    parser.add_argument(
        '--pictures',
        type=Path,
        metavar='FOLDER',
        help='also draw the best and the worst sequence into this folder',
    )


def measure(args: argparse.Namespace, report: Report) -> None:
    common.choose_capture('motion')
    compile_kernels()
    cameras = CAMERAS[1:2] if args.quick else CAMERAS
    shipped = model_file.load_shipped_lifter()
    report.add(cost_ms=(found := measure_cost(shipped, args.quick)))
    show_cost(report, found)
    report.add(detections=(detections := evaluate_detections(shipped, cameras, solved=True)))
    show_detections(report, detections, cameras)
    if args.quick and not args.lifter.is_file():
        report.text(f'skipped: motion capture, which needs {args.lifter}; run without --quick to train it')
    else:
        unseen = model_file.load_lifter(common.provide_held_out_lifter(args.lifter))
        report.add(capture=(captured := evaluate_capture(unseen, args.quick)))
        show_capture(report, captured)
        report.add(solver=(solved := evaluate_with_solver(unseen, args.quick)))
        show_with_solver(report, solved)
    if args.pictures:
        draw_pictures(shipped, args.pictures)


def main() -> None:
    run(__doc__, 'Lifter', measure, add_options)


if __name__ == '__main__':
    main()
