# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Table 1 of TPAMI 2016 with the methods it is compared with, for fixed, orbiting and shaken cameras.

The rivals are in `rivals/`, written from their papers. Each has a grid of settings; for each motion and camera the
table shows the errors, mean over the headings, of the setting that has the smallest error on two of the views. The
views, the splits and the rows of this project and of Algorithm 1 are those of `paper.py`. Further tables show all
methods where a fixed camera sees a walking person from the side, with a picture (figure 2 of the paper), and the
factorisations against the speed of an orbiting camera.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import product
from typing import Any

import common
import numpy as np
from common import View
from experiments.accuracy import BETAS, PAPER_ERRORS_CM, TABLE_1_TRIALS
from experiments.cameras import CAMERAS
from experiments.methods import ALGORITHM_1, JOINT, PERIODIC, SINES, Method
from matplotlib.figure import Figure
from numpy.typing import NDArray
from panels import make_panels
from report import Report, run
from rivals import bregler, gotardo, ramakrishna, zhou
from rivals.factorisation import reflect_in_depth
from scipy.cluster.vq import kmeans2

from mocap_ros.geometry.rotations import centre_poses, fit_heading_rotation, fit_rotation
from mocap_ros.skeleton import CMU15
from mocap_ros.training.fit_base_poses import align_to_mean
from mocap_ros.viewing.plots import TRUTH_COLOUR, draw_bones, project_from_side

Array = NDArray[np.float64]
# Image points of the views of one case to its poses (F, 15, 3) in the camera's optical frame, one array a view.
Solver = Callable[['Case'], Sequence[Array]]

PICTURE = 'docs/img/rivals/side_view.png'  # from the root of the repository
SIDE_HEADINGS = (90.0, 270.0)  # degrees, for which a fixed camera sees the person walk by
CHOICE_HEADINGS = (0.0, 90.0)  # degrees; on these views, from the front and the side, the setting is chosen
ORBITS_DEG_S = (0.0, 10.0, 30.0, 90.0, 360.0)  # degrees/s; a real camera that follows somebody does 30 at most
PICTURE_FRAMES = (0.2, 0.3, 0.4)  # share of the sequence
# cm, the printed errors of the two references of table 1 on these motions.
PRINTED_RIVALS_CM = {'Bregler': {'walk': 4.557, 'run': 10.821, 'jump': 8.531}}
PRINTED_RIVALS_CM['Gotardo'] = {'walk': 16.359, 'run': 11.395, 'jump': 17.139}
EXAMPLE_SEED = 0  # of the choice of example poses; any fixed number
EXAMPLE_EVERY = 5  # frames; neighbours are much alike


@dataclass(frozen=True, eq=False)
class Case:
    """The views of one motion by one kind of camera, and what may be trained for it: nothing knows the trial."""

    category: str
    trial: str
    camera: str
    views: Sequence[View]

    @cached_property
    def points(self) -> list[Array]:
        """Image points of each view (F, 15, 2), m."""
        return [v.window.points / common.load_protocol().PX_PER_M for v in self.views]

    @cached_property
    def truth(self) -> list[Array]:
        """True poses of each view (F, 15, 3), m, centred, in the camera's optical frame."""
        return [centre_poses(v.truth) for v in self.views]

    @cached_property
    def true_cameras(self) -> list[Array]:
        """Rotations (F, 3, 3) from the world to the camera, up to one rotation of the world."""
        world = centre_poses(common.load_capture()[0][self.trial][: self.views[0].frames] * 1e-3)
        return [fit_rotation(world, t) for t in self.truth]

    @cached_property
    def choice(self) -> Case:
        """Return the case with the views on which the settings are chosen."""
        return replace(self, views=[v for v in self.views if v.heading in CHOICE_HEADINGS] or self.views[:1])

    @cache  # noqa: B019 - a case lives as long as its results
    def find_cameras(self, shapes: int) -> list[Array]:
        """Find the cameras of each view (F, 3, 3) by a factorisation with so many basis shapes."""
        return [gotardo.find_cameras(p, shapes) for p in self.points]

    @cache  # noqa: B019
    def relax(self, categories: str, size: int, sparsity: float) -> zhou.Relaxation:
        """Solve the convex relaxation of the images of all views, one after the other."""
        examples = choose_examples(categories, self.trial, size)
        return zhou.relax(np.concatenate(self.points), examples, sparsity)

    def split(self, poses: Array) -> list[Array]:
        """Return for each view its part of the poses of all views, one after the other."""
        return np.split(poses, np.cumsum([len(p) for p in self.points])[:-1])


@dataclass(frozen=True, eq=False)
class Row:
    """A row of the table.

    Attributes:
        name: as printed.
        settings: the grid, each setting by its label.
        categories: motions that the method can do.
        mirrored: whether the method cannot tell a motion from its mirror image in depth, so that the better one
            counts.
        printed: errors in cm that the paper prints for this row, by motion.
    """

    name: str
    settings: Mapping[str, Solver]
    categories: Sequence[str] = tuple(TABLE_1_TRIALS)
    mirrored: bool = False
    printed: Mapping[str, float | None] | None = None


@dataclass(frozen=True)
class Result:
    """The best setting of a method in one case."""

    setting: str
    e_cm: float
    mpjpe_mm: float
    residual_mm: float
    ms_per_frame: float
    poses: Sequence[Array]

    def to_record(self) -> dict[str, object]:
        record = {'setting': self.setting, 'e_paper_cm': self.e_cm}
        return record | {key: getattr(self, key) for key in ('mpjpe_mm', 'residual_mm', 'ms_per_frame')}

    def __str__(self) -> str:
        return f'{self.e_cm:.2f} / {self.mpjpe_mm:.0f}'


Results = dict[str, dict[str, dict[str, Result]]]  # by method, camera and motion


def list_methods(quick: bool) -> list[Row]:
    """List the rows of the table, best known first."""
    return [*list_project(quick), *list_factorisations(quick), *list_single_images(quick)]


def list_project(quick: bool) -> list[Row]:
    """List the project's solvers and the paper's own method, as `paper.py` runs them."""

    def by(method: Method, category: str | None = None, **values: Any) -> Solver:
        """Solve with base poses of the motion's category, or of another one."""

        def solve(case: Case) -> list[Array]:
            of = case.category if category is None else category
            return [r.joints for r in method.solve(case.views, of, case.trial, **values)]

        return solve

    betas = BETAS[3:4] if quick else BETAS
    slow: dict[str, dict[str, Any]] = {f'beta {b:g}': {'bone_weight': b, 'tolerance': 2e-4} for b in betas}
    gait = ('walk', 'run')
    best = {name: by(ALGORITHM_1, **values) for name, values in slow.items()}
    everything = {name: by(ALGORITHM_1, '', components=15, **values) for name, values in slow.items()}
    return [
        Row('this project, joint solver', {'': by(JOINT)}),
        Row('this project, all motions', {'': by(JOINT, '')}),
        Row('this project, periodic', {'': by(PERIODIC)}, gait),
        Row('Algorithm 1, best', best, printed=PAPER_ERRORS_CM['best']),
        Row(
            'Algorithm 1, np (beta = 0)',
            {'': by(ALGORITHM_1, bone_weight=0.0)},
            printed=PAPER_ERRORS_CM['np (beta = 0)'],
        ),
        Row('Algorithm 1, np all', everything, printed=PAPER_ERRORS_CM['np all']),
        Row('periodic, one sine', {'': by(SINES)}, gait, printed=PAPER_ERRORS_CM['periodic']),
    ]


def list_factorisations(quick: bool) -> list[Row]:
    """List the methods that know nothing about bodies."""
    counts = (2,) if quick else (1, 2, 3, 4)

    def view_by_view(solve: Callable[..., Array], *options: Any) -> Solver:
        return lambda case: [solve(p, *options) for p in case.points]

    def along(model: Callable[[Array], gotardo.Coefficients], cameras: int) -> Solver:
        """Solve with cameras of a factorisation of so many basis shapes; 0: the true ones."""

        def solve(case: Case) -> list[Array]:
            found = case.find_cameras(cameras) if cameras else case.true_cameras
            return [gotardo.reconstruct(p, r, model(p)) for p, r in zip(case.points, found, strict=True)]

        return solve

    def cosines(points: Array, share: float) -> Array:
        return gotardo.cosine_basis(len(points), max(round(share * len(points)), 6))

    def smooth(share: float, shapes: int) -> Callable[[Array], gotardo.Coefficients]:
        return lambda p: gotardo.LinearCoefficients(cosines(p, share), shapes)

    def kernel(share: float, shapes: int, width: float) -> Callable[[Array], gotardo.Coefficients]:
        return lambda p: gotardo.KernelCoefficients(cosines(p, share), shapes, 2, width)

    def mapping(functions: int, shapes: int, width: float) -> Callable[[Array], gotardo.Coefficients]:
        return lambda p: gotardo.LinearCoefficients(gotardo.image_kernel_basis(p, functions, width), shapes)

    cameras, shapes, shares = ((2,), (3,), (0.1,)) if quick else ((1, 2, 3), (2, 3, 4), (0.1, 0.2))
    widths = (1.0,) if quick else (0.5, 1.0)
    by_time = {(s, k): smooth(s, k) for s, k in product(shares, shapes)}
    return [
        Row(
            'Bregler et al. 2000, as printed',
            {f'K = {k}': view_by_view(bregler.reconstruct_as_printed, k) for k in counts},
            mirrored=True,
            printed=PRINTED_RIVALS_CM['Bregler'],
        ),
        Row(
            'Bregler et al. 2000, full upgrade',
            {f'K = {k}': view_by_view(bregler.reconstruct_with_full_upgrade, k) for k in counts},
            mirrored=True,
        ),
        Row(
            'smooth trajectories 2011',
            {
                f'K = {k}, d = {s:g} F, cameras {c}': along(model, c)
                for c, ((s, k), model) in product(cameras, by_time.items())
            },
            mirrored=True,
        ),
        Row(
            'smooth trajectories 2011, true cameras',
            {f'K = {k}, d = {s:g} F': along(model, 0) for (s, k), model in by_time.items()},
        ),
        Row(
            'kernel shape trajectories 2011',
            {
                f'K = {k}, s = {1 / w:g}, cameras {c}': along(kernel(0.1, k, w), c)
                for c, k, w in product(cameras, shapes[-2:], widths)
            },
            mirrored=True,
        ),
        Row(
            'spatially-smooth mappings 2012',
            {
                f'K = {k}, s = {w:g}, cameras {c}': along(mapping(12, k, w), c)
                for c, k, w in product(cameras, shapes, widths)
            },
            mirrored=True,
            printed=PRINTED_RIVALS_CM['Gotardo'],
        ),
    ]


def list_single_images(quick: bool) -> list[Row]:
    """List the methods that take each image alone."""
    words = {'category': ('{}',), 'walk, run, jump': ('walk', 'run', 'jump')}
    counts = (4,) if quick else (3, 6, 12)
    sparsities = (0.1,) if quick else (0.01, 0.1)
    sizes = (16,) if quick else (16, 64)

    def pursue(kinds: Sequence[str], count: int) -> Solver:
        def solve(case: Case) -> list[Array]:
            categories = [k.format(case.category) for k in kinds]
            base_poses = np.concatenate([JOINT.train(c, case.trial).components[:20] for c in categories])
            mean = JOINT.train('+'.join(categories), case.trial).mean
            images = np.concatenate(case.points)
            return case.split(ramakrishna.reconstruct(images, mean, base_poses, CMU15.bones, count))

        return solve

    def relax(kinds: Sequence[str], size: int, sparsity: float, refine: bool) -> Solver:
        def solve(case: Case) -> list[Array]:
            found = case.relax('+'.join(kinds).format(case.category), size, sparsity)
            return case.split(found.refine_poses() if refine else found.compose_poses())

        return solve

    return [
        Row(
            'Ramakrishna et al. 2012',
            {f'{w}, {n} base poses': pursue(kinds, n) for (w, kinds), n in product(words.items(), counts)},
        ),
        *(
            Row(
                f'Zhou et al. 2015, {name}',
                {
                    f'{w}, {n} poses, a = {a:g}': relax(kinds, n, a, refine)
                    for (w, kinds), n, a in product(words.items(), sizes, sparsities)
                },
            )
            for name, refine in (('convex', False), ('refined', True))
        ),
    ]


@cache
def choose_examples(categories: str, trial: str, size: int) -> Array:
    """Choose example poses (size, 15, 3), the centres of clusters of the training poses turned to one heading."""
    chosen = common.choose_trials(categories, without_trials=(trial,))
    poses = centre_poses(np.concatenate([t.poses for t in chosen])[::EXAMPLE_EVERY])
    _, aligned = align_to_mean(poses, np.full(len(poses), 1 / len(poses)), fit_heading_rotation)
    centres, _ = kmeans2(aligned.reshape(len(aligned), -1), size, minit='++', seed=EXAMPLE_SEED)
    return np.asarray(centres.reshape(size, -1, 3))


def measure_method(method: Row, case: Case) -> Result:
    """Choose the setting of a method on the views of `CHOICE_HEADINGS`, and measure it on all views."""
    chosen = next(iter(method.settings))
    if len(method.settings) > 1:
        chosen = min(method.settings, key=lambda s: _run(method, s, case.choice)[0])
    e, mpjpe, poses = _run(method, chosen, case)
    first = replace(case, views=case.views[:1])  # with nothing solved yet
    _, seconds = common.measure_time(lambda: method.settings[chosen](first))
    return Result(chosen, e, mpjpe, _residual_mm(case, poses), seconds / len(first.points[0]) * 1e3, poses)


def _run(method: Row, setting: str, case: Case) -> tuple[float, float, list[Array]]:
    """Return e in cm and the MPJPE in mm, means over the views, and the poses of one setting."""
    found = method.settings[setting](case)
    errors, poses = [], []
    for view, candidate in zip(case.views, found, strict=True):
        sides = [candidate, reflect_in_depth(candidate)] if method.mirrored else [candidate]
        scores = [common.compute_errors(view, side, view.joint_names) for side in sides]
        best = min(range(len(sides)), key=lambda i: scores[i]['e_paper_cm'])
        errors.append(scores[best])
        poses.append(sides[best])
    return common.mean_error(errors, 'e_paper_cm'), common.mean_error(errors), poses


def _residual_mm(case: Case, poses: Sequence[Array]) -> float:
    """Return the root mean square of the image errors of the scored poses, one scale for a view, mm."""
    squares = []
    for found, seen in zip(map(centre_poses, poses), case.points, strict=True):
        image, target = found[..., :2], seen - seen.mean(axis=1, keepdims=True)
        scale = (image * target).sum() / max((image * image).sum(), 1e-12)
        squares.append(((scale * image - target) ** 2).sum(axis=-1).mean())
    return float(np.sqrt(np.mean(squares)) * 1e3)


def make_case(category: str, camera: str, headings: Sequence[float]) -> Case:
    trial = TABLE_1_TRIALS[category]
    return Case(category, trial, camera, common.make_views(trial, headings, **CAMERAS[camera]))


def measure_errors(
    methods: Sequence[Row], cameras: Sequence[str], categories: Sequence[str], headings: Sequence[float]
) -> Results:
    """Return the results by method, camera and motion."""
    found: Results = {m.name: {c: {} for c in cameras} for m in methods}
    cases = [make_case(category, camera, headings) for camera, category in product(cameras, categories)]
    for case in common.show_progress(cases, 'table 1'):
        for method in methods:
            if case.category in method.categories:
                found[method.name][case.camera][case.category] = measure_method(method, case)
    return found


def show_orbits(report: Report, methods: Sequence[Row], speeds: Sequence[float]) -> None:
    """Measure a walk seen by a camera that orbits faster and faster: MPJPE in mm."""
    trial = TABLE_1_TRIALS['walk']
    errors: dict[str, dict[str, float]] = {m.name: {} for m in methods}
    for speed in speeds:
        case = Case('walk', trial, f'{speed:g}', common.make_views(trial, CHOICE_HEADINGS, orbit=speed))
        for method in methods:
            errors[method.name][case.camera] = measure_method(method, case).mpjpe_mm
    rows = [[name, *(f'{e:.0f}' for e in by_speed.values())] for name, by_speed in errors.items()]
    report.table(['MPJPE, mm, at degrees/s', *(f'{s:g}' for s in speeds)], rows, page='rivals.orbits')
    report.add(orbits=errors)


def show_errors(report: Report, methods: Sequence[Row], found: Results) -> None:
    """Show the table of all methods, cameras and motions."""
    cameras = list(next(iter(found.values())))
    categories = list(found[methods[0].name][cameras[0]])
    header = ['method', *(f'{camera.split()[0]}: {c}' for camera in cameras for c in categories)]
    header += ['ms a frame', *(f'paper: {c}' for c in categories)]
    rows = []
    for method in methods:
        by_camera = found[method.name]
        everything = [r for by_category in by_camera.values() for r in by_category.values()]
        printed = method.printed or {}
        rows.append(
            [
                method.name,
                *(by_camera[camera].get(c) for camera in cameras for c in categories),
                f'{np.mean([r.ms_per_frame for r in everything]):.2f}',
                *(f'{printed[c]:.2f}' if printed.get(c) else None for c in categories),
            ]
        )
    report.table(header, rows, page='rivals.errors')


def show_settings(report: Report, methods: Sequence[Row], found: Results) -> None:
    """Show the table of the grids and of the settings that were best."""
    rows = []
    for method in methods:
        if len(method.settings) > 1:
            best = [r.setting for by in found[method.name].values() for r in by.values()]
            names = sorted(set(best), key=lambda s: (-best.count(s), s))
            shown = '; '.join(f'{n} ({best.count(n)})' for n in names[:3])
            rows.append([method.name, len(method.settings), shown + ('; ...' if len(names) > 3 else '')])
    report.table(['method', 'settings', 'best in so many of the cases'], rows, page='rivals.settings')


def show_side_view(report: Report, methods: Sequence[Row]) -> None:
    """Measure a walk that passes by a fixed camera, and draw it."""
    case = make_case('walk', 'fixed', SIDE_HEADINGS)
    found = {m.name: measure_method(m, case) for m in methods}
    report.picture(draw_side_view(case, found), PICTURE)
    rows = [[n, f'{r.residual_mm:.1f}', f'{r.mpjpe_mm:.0f}', f'{r.e_cm:.2f}'] for n, r in found.items()]
    report.table(['method', 'image error, mm', 'MPJPE, mm', 'e, cm'], rows, page='rivals.side_view')


def draw_side_view(case: Case, found: Mapping[str, Result]) -> Figure:
    """Draw a rival and the project as the camera sees them and from the side, with the truth in grey."""
    shown = ('spatially-smooth mappings 2012', 'Ramakrishna et al. 2012', 'this project, joint solver')
    figure, axes = make_panels(2 * len(PICTURE_FRAMES), rows=len(shown), width=7.4, height=2.1 * len(shown))
    truth = case.truth[0]
    frames = [round(share * (len(truth) - 1)) for share in PICTURE_FRAMES]
    columns = list(product(('camera', 'side'), frames))
    for row, name in zip(axes, shown, strict=True):
        first = name == shown[0]
        poses = centre_poses(found[name].poses[0])
        poses = poses * ((poses * truth).sum() / (poses**2).sum())
        for ax, (where, frame) in zip(row, columns, strict=True):
            for joints, colour, width in ((truth[frame], TRUTH_COLOUR, 4.0), (poses[frame], None, 1.5)):
                seen = joints[:, :2] if where == 'camera' else project_from_side(joints)
                draw_bones(ax, seen, CMU15, colour, linewidth=width)
            ax.set(xlim=(-0.6, 0.6), ylim=(1.0, -1.15), aspect='equal')
            ax.axis('off')
            ax.set_title(f'{where}, {case.views[0].sequence["timestamps"][frame]:.1f} s' if first else '')
        label = row[0].text(0, 1, f'{name}: {found[name].mpjpe_mm:.0f} mm', transform=row[0].transAxes, va='top')
        label.set_in_layout(False)
    return figure


def measure(args: argparse.Namespace, report: Report) -> None:
    methods = list_methods(args.quick)
    headings = common.HEADINGS_DEG[1:2] if args.quick else common.HEADINGS_DEG
    categories = list(TABLE_1_TRIALS)[: 1 if args.quick else 3]
    found = measure_errors(methods, list(CAMERAS)[:3], categories, headings)
    records = {
        name: {camera: {c: r.to_record() for c, r in by.items()} for camera, by in by_camera.items()}
        for name, by_camera in found.items()
    }
    report.add(**records)
    show_errors(report, methods, found)
    show_settings(report, methods, found)
    show_side_view(report, methods)
    speeds = ORBITS_DEG_S[:3:2] if args.quick else ORBITS_DEG_S
    show_orbits(report, [methods[0], *list_factorisations(args.quick)], speeds)


if __name__ == '__main__':
    run(__doc__, 'Other methods on the same views', measure, one_core=False)
