"""What the benchmarks share: evaluation data, test views, trained models, solvers, scores, tables and timing.

Import it before numpy: it limits the linear algebra to one thread. Nothing happens when it is run.
"""

# ruff: noqa: E402
from __future__ import annotations

from mocap_ros.runtime import cpu_setup

cpu_setup.prepare()

# isort: split
import argparse
import importlib.util
import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.linalg import cholesky
from tqdm import tqdm

from mocap_ros.config import SolverConfig, TrackerConfig
from mocap_ros.evaluation.metrics import scale_to
from mocap_ros.formats.mocap.trials import Trial, load_trials, select
from mocap_ros.geometry.rotations import centred, rotation_to
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.solvers import alternation, joint, periodic
from mocap_ros.solvers.window import Reconstruction, Window
from mocap_ros.training.base_poses import fit_base_poses

Array = NDArray[np.float64]
T = TypeVar('T')

ROOT = Path(__file__).resolve().parent.parent
HEADINGS = tuple(range(0, 360, 45))
FPS = 30.0
HELD_OUT = ('35', '13', '05', '135', 'UB', 'UT', 'UWW', 'UJ', 'UW')
HELD_OUT_FILE = ROOT / 'build' / 'lifter_heldout.npz'
REFERENCE = '200 Cholesky factorisations of a 512 x 512 matrix'


def arguments(
    description: str, add: Callable[[argparse.ArgumentParser], None] | None = None
) -> argparse.Namespace:
    """The command line every benchmark has, and this process put on one core."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument('--quick', action='store_true', help='less of everything, under 40 s')
    parser.add_argument('--json', type=Path, metavar='FILE', help='also write the results here')
    if add is not None:
        add(parser)
    args = parser.parse_args()
    if hasattr(os, 'sched_setaffinity'):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    if not shared('bench', 'protocol.py').is_file():
        print(f'skipped: no evaluation data in {_data_folder()} (MOCAP_ROS_SHARED says where it is)')
        sys.exit(0)
    return args


def _data_folder() -> Path:
    return Path(os.environ.get('MOCAP_ROS_SHARED') or ROOT.parent / 'shared')


def shared(*parts: str) -> Path:
    """A file of the evaluation data: protocol, motion capture, detections."""
    return _data_folder().joinpath(*parts)


@cache
def protocol() -> ModuleType:
    """The measuring protocol, as it stands beside the data."""
    spec = importlib.util.spec_from_file_location('protocol', shared('bench', 'protocol.py'))
    if spec is None or spec.loader is None:
        raise ImportError('protocol.py')
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@cache
def capture() -> tuple[dict[str, Array], list[str]]:
    """Trials in mm, y up, 30 fps, and the names of their joints."""
    with np.load(shared('data', 'cmu', 'cmu15_30fps.npz')) as archive:
        joints = [str(j) for j in archive['_joints']]
        return {k: archive[k].astype(float) for k in archive.files if not k.startswith('_')}, joints


@cache
def trials() -> list[Trial]:
    return load_trials(shared('data', 'cmu', 'cmu15_30fps.npz'))


@dataclass(frozen=True, eq=False)
class View:
    """A test sequence as the protocol makes it."""

    sequence: dict[str, Array]
    heading: float = 0.0

    @cached_property
    def window(self) -> Window:
        keypoints = self.sequence['keypoints'].astype(float)
        return Window(np.nan_to_num(keypoints[..., :2]), keypoints[..., 2], self.sequence['timestamps'])

    @property
    def truth(self) -> Array:
        return self.sequence['joints3d'].astype(float)

    @property
    def frames(self) -> int:
        return len(self.sequence['timestamps'])

    def hiding(self, joints: Sequence[str], frames: slice = slice(None)) -> View:
        """The same view with some joints not seen in some frames."""
        keypoints = self.sequence['keypoints'].copy()
        columns = [list(self.sequence['joint_names']).index(j) for j in joints]
        keypoints[frames, columns] = [np.nan, np.nan, 0]
        return View({**self.sequence, 'keypoints': keypoints}, self.heading)


def views(trial: str | Array, headings: Iterable[float] = HEADINGS, **options: Any) -> list[View]:
    """One view a heading of a trial (or of (F, 15, 3) mm, y up); options as in `make_view` of the protocol."""
    motion, joints = capture()
    xyz = motion[trial] if isinstance(trial, str) else trial
    return [View(protocol().make_view(xyz, joints, h, **options), h) for h in headings]


def names(items: str | Sequence[str]) -> tuple[str, ...]:
    return (items,) if isinstance(items, str) else tuple(items)


@cache
def trained(
    category: str = '',
    *,
    without_trials: tuple[str, ...] = (),
    without_subjects: tuple[str, ...] = (),
    only_subjects: tuple[str, ...] = (),
    plain: bool = False,
) -> BasePoses:
    """Base poses as `mocap-ros train` makes them, at the stature the tracker assumes.

    Categories: names joined by `+`, or none for all motions. `plain`: the poses alone, neither mirrored nor on
    other bodies.
    """
    chosen = select(
        trials(),
        categories=category.split('+') if category else [],
        without_trials=without_trials,
        without_subjects=without_subjects,
        only_subjects=only_subjects,
    )
    augmented = bool(category) and not plain
    model = fit_base_poses(
        [t.poses for t in chosen],
        name=category or 'all',
        alignment='heading' if category else 'rotation',
        mirror=augmented,
        bodies=2 if augmented else 0,
        provenance={'trials': [t.name for t in chosen]},
    )
    return model.rescaled(TrackerConfig().body_height / model.stature)


def held_out_lifter(path: Path = HELD_OUT_FILE) -> Path:
    """The file of a lifter that never saw the subjects `HELD_OUT`; trained if there is none (12 minutes)."""
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        command = [sys.executable, '-m', 'mocap_ros.cli.main', 'train-lifter']
        command += [str(shared('data', 'cmu', 'cmu15_30fps.npz')), '-o', str(path)]
        command += [word for s in HELD_OUT for word in ('--without-subject', s)]
        print(f'training a lifter without the tested subjects: {" ".join(command)}', file=sys.stderr)
        subprocess.run(command, check=True)
    return path


def solved(
    tests: Sequence[View], model: BasePoses, config: SolverConfig | None = None
) -> Sequence[Reconstruction]:
    """The joint solver over all these views as one batch."""
    return joint.solve_hypotheses([v.window for v in tests], model, config or SolverConfig())


def alternate(tests: Sequence[View], model: BasePoses, config: SolverConfig) -> Sequence[Reconstruction]:
    """Algorithm 1 over each of these views."""
    return [alternation.reconstruct(v.window, model, config) for v in tests]


def periodically(
    tests: Sequence[View], model: BasePoses, config: SolverConfig | None = None
) -> Sequence[periodic.PeriodicReconstruction]:
    """The periodic model over these views."""
    return periodic.solve([v.window for v in tests], model, config or SolverConfig())


def changed(**overrides: Any) -> SolverConfig:
    """The defaults but for these."""
    return replace(SolverConfig(), **overrides)


def paper_config(**overrides: Any) -> SolverConfig:
    """The paper's model: no prior, no smoothness, least squares, a start camera for each frame alone."""
    paper = {
        'method': 'alternation',
        'adapt_noise': False,
        'components': 6,
        'prior_weight': 0.0,
        'smooth_weight': 0.0,
        'robust_scale': 0.0,
        'start_window': 0.0,
        'flip_weight': 1e-4,
        'heading_flip_factor': 1.0,
        'heading_prior_factor': 1.0,
        'tilt_weight': 0.0,
        'scale_weight': 0.0,
        'bone_weight': 1.0,
        'max_iterations': 100,
    }
    return changed(**{**paper, **overrides})


def score(view: View, joints3d: Array, joint_names: Sequence[str], joints: str = 'common') -> dict[str, float]:
    """The protocol's errors of one reconstruction."""
    s = view.sequence
    fps = 1 / float(np.median(np.diff(s['timestamps'])))
    return protocol().score(
        joints3d, joint_names, s['joints3d'], s['joints3d_names'], s['keypoints'], s['joint_names'], joints, fps
    )


def scores(tests: Sequence[View], found: Sequence[Reconstruction], model: BasePoses) -> list[dict[str, float]]:
    return [score(v, r.joints, model.skeleton.joints) for v, r in zip(tests, found, strict=True)]


def mean(records: Sequence[dict[str, float]], key: str = 'mpjpe_mm') -> float:
    return float(np.mean([r[key] for r in records]))


def worst(records: Sequence[dict[str, float]], key: str = 'mpjpe_mm') -> float:
    return float(np.max([r[key] for r in records]))


def frame_errors(view: View, result: Reconstruction, *, per_frame_similarity: bool = False) -> Array:
    """(F,) mm, the protocol's MPJPE (or PA-MPJPE) before the mean over frames."""
    truth, found = centred(view.truth), centred(result.joints)
    if per_frame_similarity:
        turned = found @ np.swapaxes(rotation_to(found, truth), -1, -2)
        factor = (turned * truth).sum(axis=(1, 2)) / (turned * turned).sum(axis=(1, 2))
        found = turned * factor[:, None, None]
    else:
        found = scale_to(found, truth)
    return np.linalg.norm(found - truth, axis=-1).mean(axis=1) * 1e3


def residual_mm(view: View, result: Reconstruction) -> float:
    """RMS reprojection error of the seen points, mm at the body."""
    count = (view.window.weight > 0).sum(axis=1)
    squared = np.nansum(np.nan_to_num(result.residual) ** 2 * count) / count.sum()
    return float(np.sqrt(squared) / protocol().PX_PER_M * 1e3)


def bone_lengths_mm(result: Reconstruction, model: BasePoses) -> Array:
    """(F, B) mm."""
    return model.skeleton.bone_lengths(result.joints) * 1e3


def timed(action: Callable[[], T], repeats: int = 1) -> tuple[T, float]:
    """The result, and the median of so many runs in seconds."""
    durations = []
    for _ in range(repeats):
        begun = time.perf_counter()
        result = action()
        durations.append(time.perf_counter() - begun)
    return result, float(np.median(durations))


def reference_seconds() -> float:
    """Time of a fixed amount of linear algebra (`REFERENCE`), to compare machines by."""
    a = np.random.default_rng(0).standard_normal((512, 512))
    matrix = a @ a.T + 512 * np.eye(512)
    cholesky(matrix)
    return timed(lambda: [cholesky(matrix, lower=True) for _ in range(200)])[1]


def machine() -> str:
    """One line: processor, versions, and the reference kernel's time just now."""
    cpu = platform.processor() or platform.machine()
    info = Path('/proc/cpuinfo')
    if info.is_file():
        models = [line.partition(':')[2].strip() for line in info.read_text().splitlines() if 'model name' in line]
        cpu = models[0] if models else cpu
    return (
        f'{cpu}, one core, one BLAS thread; Python {platform.python_version()}, NumPy {np.__version__}, '
        f'SciPy {scipy.__version__}; reference kernel ({REFERENCE}): {reference_seconds():.3f} s'
    )


def table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A Markdown table; floats with two decimals, unless they are strings already."""
    cells = [[_cell(c) for c in row] for row in rows]
    lines = ['| ' + ' | '.join(header) + ' |', '|' + ' --- |' * len(header)]
    return '\n'.join(lines + ['| ' + ' | '.join(row) + ' |' for row in cells])


def _cell(value: object) -> str:
    return f'{value:.2f}' if isinstance(value, float) else '-' if value is None else str(value)


def progress(items: Iterable[T], description: str, total: int | None = None) -> Iterable[T]:
    """The items, with a progress bar on a terminal and none in a pipe."""
    return tqdm(items, desc=description, total=total, disable=not sys.stderr.isatty(), leave=False)


def write_json(path: Path | None, record: object) -> None:
    if path is not None:
        path.write_text(json.dumps(record, indent=1, default=_plain) + '\n', encoding='utf-8')


def _plain(value: object) -> object:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f'{type(value).__name__} in the results')
