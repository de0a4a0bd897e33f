"""The lifter: on real detections beside the detector's own 3D, on motion capture it never saw, and its cost.

Motion capture is scored with a lifter and base poses that never saw the tested subjects, which this trains if
there is none (12 minutes; `mocap-ros train-lifter --without-subject ...`); detections with the one that ships.
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

import numpy as np
from common import View

from mocap_ros.config import Config, SolverConfig
from mocap_ros.formats.mocap.trials import Trial
from mocap_ros.formats.sequence_file import load_sequence
from mocap_ros.geometry.virtual_camera import View as Facing
from mocap_ros.keypoints.left_right import swapped_frames
from mocap_ros.models import lifter, model_file
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.lifter import SLOTS, Lifted, Lifter
from mocap_ros.models.model_file import load_base_poses
from mocap_ros.offline.whole_sequence import FACING
from mocap_ros.skeleton import CMU15, joint_map, model_joints
from mocap_ros.solvers.joint.solver import solve_hypotheses
from mocap_ros.solvers.window import Window

HELD_OUT, HELD_OUT_FILE = common.HELD_OUT, common.HELD_OUT_FILE
ROWS: dict[str, tuple[Callable[[Trial], bool], float]] = {
    '35 walk': (lambda t: t.subject == '35' and t.category == 'walk', 16),
    '35 run': (lambda t: t.subject == '35' and t.category == 'run', 22),
    '13 jump': (lambda t: t.subject == '13', 40),
    '05 dance': (lambda t: t.subject == '05' and t.category == 'dance', 65),
    '135 martial arts': (lambda t: t.subject == '135', 60),
    'U* gestures': (lambda t: t.subject.startswith('U') and t.category == 'gesture', 34),
}
NOISY = {'noise': 0.02, 'missing': 0.1}
NOISY_FACTOR = 1.25
CAMERAS = (1, 2, 3)
DETECTORS = {'openpose': (75, 58), 'mediapipe': (85, 68)}
COSTS_MS = {1: 0.3, 10: 0.1}
SOLVED_FRAMES = 120


@dataclass(frozen=True, eq=False)
class Detections:
    """A recorded sequence in the image of virtual cameras that look at the person."""

    view: View
    facing: Facing
    window: Window

    @staticmethod
    def load(detector: str, camera: int, undo_swaps: bool = True) -> Detections:
        file = common.shared('data', 'detections', f'balance_{detector}_cam{camera}.npz')
        with np.load(file) as archive:
            sequence = {k: archive[k] for k in archive.files}
        settings = Config().tracker
        intrinsics = load_sequence(file).intrinsics(settings.nominal_focal_length)
        keypoints, times = sequence['keypoints'].astype(float), sequence['timestamps']
        names = tuple(str(n) for n in sequence['joint_names'])
        points, weight = model_joints(keypoints[..., :2], keypoints[..., 2], names, settings.min_score)
        if undo_swaps:
            mirror = np.array(CMU15.mirror)
            wrong = swapped_frames(times, points, weight, mirror)
            points = np.where(wrong[:, None, None], points[:, mirror], points)
            weight = np.where(wrong[:, None], weight[:, mirror], weight)
        rays = intrinsics.rays(points)
        facing = Facing.of(rays, weight, times, FACING, intrinsics)
        image = np.where(weight[..., None] > 0, facing.image(rays), 0.0)
        return Detections(View(sequence), facing, Window(image, weight, times, focal=intrinsics.focal))

    def score(self, joints: np.ndarray) -> dict[str, float]:
        return common.score(self.view, self.facing.to_camera(joints), CMU15.joints, 'limbs')

    def peer(self) -> dict[str, float]:
        """Of the detector's own 3D."""
        s = self.view.sequence
        return common.score(self.view, s['mediapipe_world'].astype(float), list(s['joint_names']), 'limbs')


def lifted(model: Lifter, windows: Sequence[Window]) -> list[Lifted]:
    return [model.lift_sequence(w.points, w.weight, w.times, w.focal) for w in windows]


def in_metres(out: Lifted, window: Window) -> np.ndarray:
    return lifter.metric(out, window.times, Config().tracker.body_height).joints


def base_poses(without: tuple[str, ...] = ()) -> BasePoses:
    model = common.trained(without_subjects=without) if without else load_base_poses('all')
    return model.rescaled(Config().tracker.body_height / model.stature)


def on_detections(model: Lifter, cameras: Sequence[int], solved: bool) -> list[dict[str, object]]:
    records = []
    for detector in DETECTORS:
        for camera in cameras:
            tests = {f'undo swaps {on}': Detections.load(detector, camera, on) for on in (False, True)}
            for name, test in tests.items():
                (out,) = lifted(model, [test.window])
                found = {'network': test.score(in_metres(out, test.window))}
                if solved and name.endswith('True'):
                    config = SolverConfig()
                    (plain,) = solve_hypotheses([test.window], base_poses(), config)
                    (both,) = solve_hypotheses([replace(test.window, lifted=out)], base_poses(), config)
                    found |= {'factorisation': test.score(plain.joints), 'both': test.score(both.joints)}
                if detector == 'mediapipe' and name.endswith('False'):
                    found['MediaPipe'] = test.peer()
                records += [
                    {'detector': detector, 'camera': camera, 'labels': name, 'method': m, **s}
                    for m, s in found.items()
                ]
    return records


def print_detections(records: Sequence[dict[str, object]], cameras: Sequence[int]) -> None:
    print('\n## Detections: MPJPE / PA-MPJPE, mm, twelve limb joints\n')
    rows = []
    for key in dict.fromkeys((r['detector'], r['method'], r['labels']) for r in records):
        mine = [r for r in records if (r['detector'], r['method'], r['labels']) == key]
        each = [f'{r["mpjpe_mm"]:.0f} / {r["pa_mpjpe_mm"]:.0f}' for r in mine]
        means = [common.mean(mine, k) for k in ('mpjpe_mm', 'pa_mpjpe_mm')]
        failed = sum(int(r['failed_frames']) for r in mine)
        reach = DETECTORS[str(key[0])]
        rows.append(
            [
                f'{key[0]}, {key[1]}',
                'put right' if str(key[2]).endswith('True') else 'as they come',
                *each,
                '{:.0f} / {:.0f}'.format(*means),
                '{} / {}'.format(*reach),
                failed,
            ]
        )
    header = ['points and method', 'labels', *(f'cam {c}' for c in cameras), 'mean', 'reach', 'failed']
    print(common.table(header, rows))


def row_views(row: str, stride: int, frames: int, headings: Sequence[float], **options: float) -> list[View]:
    of, _ = ROWS[row]
    chosen = [t.name for t in common.trials() if t.clean and of(t)][::stride]
    return [v for t in chosen for v in common.views(t, headings, frames=frames, **options)]


def on_capture(model: Lifter, quick: bool) -> list[dict[str, object]]:
    """The network alone, all frames; `--quick`: every fourth trial, three headings, 120 frames."""
    stride, frames = (4, SOLVED_FRAMES) if quick else (1, 1_000_000)
    headings = common.HEADINGS[::3] if quick else common.HEADINGS
    records = []
    for row in common.progress(ROWS, 'capture'):
        for noisy in (False, True):
            tests = row_views(row, stride, frames, headings, **(NOISY if noisy else {}))
            found = [in_metres(lifted(model, [v.window])[0], v.window) for v in tests]
            scored = scores(tests, found)
            keys = ('mpjpe_mm', 'pa_mpjpe_mm', 'accel_mm_s2')
            failed = sum(s['failed_frames'] for s in scored)
            records.append(
                {'row': row, 'noisy': noisy, 'failed': failed, **{k: common.mean(scored, k) for k in keys}}
            )
    return records


def print_capture(records: Sequence[dict[str, object]]) -> None:
    print('\n## Motion capture, subject left out, network alone: MPJPE / PA-MPJPE, mm, 15 joints\n')
    rows = []
    for row, (_, reach) in ROWS.items():
        clean, noisy = (next(r for r in records if r['row'] == row and r['noisy'] == n) for n in (False, True))
        rows.append(
            [
                row,
                *(f'{r["mpjpe_mm"]:.1f} / {r["pa_mpjpe_mm"]:.1f}' for r in (clean, noisy)),
                f'{reach:g}',
                float(noisy['mpjpe_mm'] / clean['mpjpe_mm']),
                NOISY_FACTOR,
                int(clean['failed'] + noisy['failed']),
            ]
        )
    print(common.table(['row', 'clean', 'noise 0.02, missing 0.1', 'reach', 'ratio', 'reach', 'failed'], rows))


def scores(tests: Sequence[View], found: Sequence[np.ndarray]) -> list[dict[str, float]]:
    return [common.score(v, joints, CMU15.joints) for v, joints in zip(tests, found, strict=True)]


def with_solver(model: Lifter, quick: bool) -> list[dict[str, object]]:
    """Network, factorisation, and both, on the first 120 frames of some trials of each row."""
    rows = list(ROWS)[:1] if quick else list(ROWS)
    records = []
    for row in common.progress(rows, 'solver'):
        for noisy in (False, True):
            of, _ = ROWS[row]
            count = sum(t.clean and of(t) for t in common.trials())
            stride = max(1, count // (1 if quick else 3))
            tests = row_views(row, stride, SOLVED_FRAMES, common.HEADINGS[::2], **(NOISY if noisy else {}))
            windows = [v.window for v in tests]
            poses, config = base_poses(HELD_OUT), SolverConfig()
            out = lifted(model, windows)
            plain = solve_hypotheses(windows, poses, config)
            lifted_windows = [replace(w, lifted=o) for w, o in zip(windows, out, strict=True)]
            both, seconds = common.timed(partial(solve_hypotheses, lifted_windows, poses, config))
            methods = {
                'network': [in_metres(o, w) for o, w in zip(out, windows, strict=True)],
                'factorisation': [r.joints for r in plain],
                'both': [r.joints for r in both],
            }
            records.append(
                {
                    'row': row,
                    'noisy': noisy,
                    'views': len(tests),
                    'seconds': seconds / len(tests),
                    **{name: common.mean(scores(tests, found)) for name, found in methods.items()},
                }
            )
    return records


def print_with_solver(records: Sequence[dict[str, object]]) -> None:
    print(f'\n## The same, at most {SOLVED_FRAMES} frames, in the factorisation: MPJPE, mm\n')
    methods = ('network', 'factorisation', 'both')
    print(
        common.table(
            ['row', 'image', 'views', *methods, 'both, s a sequence'],
            [
                [r['row'], 'noisy' if r['noisy'] else 'clean', r['views'], *(r[m] for m in methods), r['seconds']]
                for r in records
            ],
        )
    )


def cost(model: Lifter, quick: bool) -> dict[str, float]:
    """CPU ms a person and frame: histories and network, least of several."""
    (view,) = common.views('35_02', (45,))
    w = view.window
    newest = np.array([60])
    window = w.points[:61], w.weight[:61], w.times[:61]
    out = {}
    for people in COSTS_MS:
        for mirrored in (False, True):

            def once(people: int = people, mirrored: bool = mirrored) -> None:
                seen = [lifter.histories(*window, newest) for _ in range(people)]
                points, weight = (np.concatenate(each) for each in zip(*seen, strict=True))
                model.lift(points, weight, mirrored=mirrored)

            least = math.inf
            for _ in range(10 if quick else 60):
                begun = time.process_time()
                for _ in range(10):
                    once()
                least = min(least, (time.process_time() - begun) / 10)
            out[f'{people}, {"both sides" if mirrored else "one side"}'] = least / people * 1e3
    return out


def print_cost(found: dict[str, float]) -> None:
    print(f'\n## CPU ms a person and frame ({len(SLOTS)} slots)\n')
    rows = [[name, f'{ms:.3f}', COSTS_MS[int(name.split(',')[0])]] for name, ms in found.items()]
    print(common.table(['people, lifted', 'ms', 'reach'], rows))


def pictures(model: Lifter, folder: Path) -> None:
    """The best and the worst recorded sequence: truth and lifted pose, in the image and from the side."""
    import matplotlib as mpl

    mpl.use('Agg')
    from matplotlib import pyplot as plt

    from mocap_ros.viewing.plots import draw_bones, from_the_side, save_figure

    folder.mkdir(parents=True, exist_ok=True)
    tests = {(d, c): Detections.load(d, c) for d in DETECTORS for c in CAMERAS}
    found = {k: in_metres(lifted(model, [t.window])[0], t.window) for k, t in tests.items()}
    errors = {k: t.score(found[k])['mpjpe_mm'] for k, t in tests.items()}
    order = sorted(errors, key=errors.__getitem__)
    for name, key in (('best', order[0]), ('worst', order[-1])):
        test = tests[key]
        joints = test.facing.to_camera(found[key])
        names = tuple(str(n) for n in test.view.sequence['joints3d_names'])
        known = np.isfinite(test.view.truth).all(-1).astype(float)
        truth, _ = joint_map(names).apply(test.view.truth, known)
        truth -= np.nanmean(truth, axis=1, keepdims=True)
        good = np.isfinite(joints).all((1, 2)) & np.isfinite(truth).all((1, 2))
        joints = joints * (joints[good] * truth[good]).sum() / (joints[good] ** 2).sum()
        frames = np.flatnonzero(good)[:: max(1, good.sum() // 6)][:6]
        figure, axes = plt.subplots(2, len(frames), figsize=(2.2 * len(frames), 5))
        for column, frame in enumerate(frames):
            for row, turn in enumerate((lambda p: p, from_the_side)):
                for points, style in ((truth, {'colour': '#999999'}), (joints, {})):
                    draw_bones(axes[row, column], turn(points[frame])[:, :2], CMU15, **style)
                axes[row, column].set(aspect='equal', xlim=(-1.1, 1.1), ylim=(1.1, -1.1), xticks=[], yticks=[])
            axes[0, column].set_title(f'{test.window.times[frame] - test.window.times[0]:.1f} s', fontsize=8)
        axes[0, 0].set_ylabel('as the camera sees it')
        axes[1, 0].set_ylabel('from the side')
        figure.suptitle(f'{key[0]}, camera {key[1]}: {errors[key]:.0f} mm; grey: triangulated from four cameras')
        figure.tight_layout()
        save_figure(figure, folder / f'{name}.png')


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        '--lifter', type=Path, default=HELD_OUT_FILE, metavar='NPZ', help='that never saw the tested subjects'
    )
    parser.add_argument('--pictures', type=Path, metavar='FOLDER', help='also draw the best and worst sequence')


def main() -> None:
    args = common.arguments(__doc__, options)
    cameras = CAMERAS[1:2] if args.quick else CAMERAS
    machine = common.machine()
    print(f'# Lifter\n\n{machine}')
    shipped = model_file.shipped_lifter()
    record: dict[str, object] = {'machine': machine}
    record['cost_ms'] = found = cost(shipped, args.quick)
    print_cost(found)
    record['detections'] = detections = on_detections(shipped, cameras, solved=True)
    print_detections(detections, cameras)
    if args.quick and not args.lifter.is_file():
        print(f'\nskipped: motion capture, which needs {args.lifter}; run without --quick to train it')
    else:
        unseen = model_file.load_lifter(common.held_out_lifter(args.lifter))
        record['capture'] = captured = on_capture(unseen, args.quick)
        print_capture(captured)
        record['solver'] = solved = with_solver(unseen, args.quick)
        print_with_solver(solved)
    if args.pictures:
        pictures(shipped, args.pictures)
    common.write_json(args.json, record)


if __name__ == '__main__':
    main()
