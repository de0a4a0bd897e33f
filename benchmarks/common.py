# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Functions that the benchmarks share: evaluation data, test views, models, solvers, errors and timing.

Import this module before numpy, since it limits the linear algebra to one thread. It is not a benchmark itself.
"""

# ruff: noqa: E402
from __future__ import annotations

from mocap_ros.runtime import cpu_setup

cpu_setup.configure_process()

# isort: split
import importlib.util
import os
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache, cached_property
from multiprocessing import get_context
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky
from tqdm import tqdm

from mocap_ros.config import SolverConfig, TrackerConfig
from mocap_ros.evaluation.metrics import scale_to_reference
from mocap_ros.formats.mocap.trials import Trial, load_trials, select_trials
from mocap_ros.formats.sequence_file import create_intrinsics, load_sequence
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.rotations import centre_poses, fit_heading_rotation, fit_rotation
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers import alternation, joint, periodic
from mocap_ros.solvers.window import Reconstruction, Window
from mocap_ros.training.fit_base_poses import fit_base_poses
from mocap_ros.training.motion_library import balance_trials

Array = NDArray[np.float64]
T = TypeVar('T')

ROOT = Path(__file__).resolve().parent.parent
HEADINGS_DEG = tuple(range(0, 360, 45))  # degrees, directions from which the test views look; 0 is the front
FPS = 30.0  # Hz, frame rate of the motion capture
# Subjects of the motion capture that the held-out lifter and the base poses beside it are not trained on.
HELD_OUT_SUBJECTS = (
    *('35', '13', '05', '135', 'UB', 'UT', 'UWW', 'UJ', 'UW', '12', '26', '27'),
    *('14', '86', '94', 'uiprmd_s07', 'uiprmd_s08'),
)
# File of the lifter that never saw these subjects, trained like the shipped one (docs/lifter.md).
HELD_OUT_LIFTER = ROOT / 'benchmarks' / 'models' / 'lifter_heldout.npz'
# Files of motion capture below `data`, and the one that this program uses.
CAPTURE_FILES = {'cmu': ('cmu', 'cmu15_30fps.npz'), 'motion': ('motion', 'body26_30fps.npz')}
_chosen_capture = ['cmu']
RECORDED_DETECTORS, CAMERAS = ('openpose', 'mediapipe'), (1, 2, 3)  # of the recorded detections
ORTHOGRAPHIC_FOCAL_LENGTH = (
    20.0  # longer sides of the image; so long that perspective looks orthographic, as in the views
)
# The fixed amount of linear algebra by which machines are compared.
REFERENCE_KERNEL = '200 Cholesky factorisations of a 512 x 512 matrix'


def _data_folder() -> Path:
    return Path(os.environ.get('MOCAP_ROS_SHARED') or ROOT.parent / 'shared')


def data_path(*parts: str) -> Path:
    """Return the path of a file of the evaluation data: protocol, motion capture, detections."""
    return _data_folder().joinpath(*parts)


@cache
def load_protocol() -> ModuleType:
    """Load the measuring protocol, which is part of the evaluation data."""
    spec = importlib.util.spec_from_file_location('protocol', data_path('bench', 'protocol.py'))
    if spec is None or spec.loader is None:
        raise ImportError('protocol.py')
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def choose_capture(name: str) -> None:
    """Choose the motion capture of this program: a key of `CAPTURE_FILES`; `cmu` if no program chooses.

    The models for detectors are trained and tested on `motion`, whose wrists are those of people. The papers'
    experiments keep `cmu`, whose wrists are two thirds down the forearm.
    """
    _chosen_capture[:] = [name]
    for cached in (load_capture, list_trials, train_base_poses):
        cached.cache_clear()


def _capture_path() -> Path:
    return data_path('data', *CAPTURE_FILES[_chosen_capture[0]])


@cache
def load_capture() -> tuple[dict[str, Array], list[str]]:
    """Load the trials, (F, 15, 3) mm with y up at `FPS`, by name, and the names of their joints."""
    with np.load(_capture_path()) as archive:
        names = [str(j) for j in archive['_joints']]
        order = [names.index(j) for j in CMU15.joints]
        motion = {k: archive[k][:, order].astype(float) for k in archive.files if not k.startswith('_')}
        return motion, list(CMU15.joints)


@cache
def list_trials() -> list[Trial]:
    """Load the trials of the motion capture with their subjects and categories."""
    return load_trials(_capture_path())


@dataclass(frozen=True, eq=False)
class View:
    """A test sequence that the protocol made.

    Attributes:
        sequence: arrays of a sequence file.
        heading: degrees, direction from which the camera looks at the person; 0 is the front.
    """

    sequence: dict[str, Array]
    heading: float = 0.0

    @cached_property
    def window(self) -> Window:
        keypoints = self.sequence['keypoints'].astype(float)
        return Window(np.nan_to_num(keypoints[..., :2]), keypoints[..., 2], self.sequence['timestamps'])

    @property
    def intrinsics(self) -> Intrinsics:
        width, height = (int(v) for v in self.sequence['image_size'])
        matrix, distortion = (self.sequence.get(k) for k in ('camera_matrix', 'distortion'))
        return create_intrinsics((width, height), matrix, distortion, ORTHOGRAPHIC_FOCAL_LENGTH)

    @property
    def joint_names(self) -> tuple[str, ...]:
        return tuple(str(name) for name in self.sequence['joint_names'])

    @property
    def truth(self) -> Array:
        return self.sequence['joints3d'].astype(float)

    @property
    def true_poses(self) -> Array:
        """True joints (F, 15, 3) m in the camera's optical frame, in the order of `CMU15`."""
        names = [str(name) for name in self.sequence['joints3d_names']]
        return self.truth[:, [names.index(joint) for joint in CMU15.joints]]

    @property
    def frames(self) -> int:
        return len(self.sequence['timestamps'])

    def hide_joints(self, joints: Sequence[str], frames: slice = slice(None)) -> View:
        """Return the same view, in which some joints are not seen in some frames."""
        keypoints = self.sequence['keypoints'].copy()
        columns = [self.joint_names.index(j) for j in joints]
        keypoints[frames, columns] = [np.nan, np.nan, 0]
        return View({**self.sequence, 'keypoints': keypoints}, self.heading)


def make_views(trial: str | Array, headings: Iterable[float] = HEADINGS_DEG, **options: Any) -> list[View]:
    """Make one view for each heading of a trial.

    Args:
        trial: name of a trial, or poses (F, 15, 3) in mm with y up.
        headings: degrees.
        options: options of `make_view` of the protocol.
    """
    motion, joints = load_capture()
    xyz = motion[trial] if isinstance(trial, str) else trial
    return [View(load_protocol().make_view(xyz, joints, h, **options), h) for h in headings]


def load_recording(detector: str, camera: int) -> View:
    """Load what one of `RECORDED_DETECTORS` found in the images of one of `CAMERAS`: 3 s of a person on a beam."""
    path = data_path('data', 'detections', f'balance_{detector}_cam{camera}.npz')
    with np.load(path) as archive:
        return View({**archive, 'keypoints': load_sequence(path).keypoints})


def choose_trials(
    category: str = '',
    without_trials: Sequence[str] = (),
    without_subjects: Sequence[str] = (),
    only_subjects: Sequence[str] = (),
) -> list[Trial]:
    """Choose the trials to train on; arguments as of `train_base_poses`."""
    return select_trials(
        list_trials(),
        categories=category.split('+') if category else [],
        without_trials=without_trials,
        without_subjects=without_subjects,
        only_subjects=only_subjects,
    )


@cache
def train_base_poses(
    category: str = '',
    *,
    without_trials: tuple[str, ...] = (),
    without_subjects: tuple[str, ...] = (),
    only_subjects: tuple[str, ...] = (),
    plain: bool = False,
) -> BasePoses:
    """Train base poses as `mocap-ros train` does, scaled to the body height that the tracker assumes.

    Those of `cmu` are not balanced, for the papers' are not.

    Args:
        category: names of categories joined by `+`; empty for all motions.
        without_trials: trials that are left out.
        without_subjects: subjects that are left out.
        only_subjects: subjects to train on; empty for all.
        plain: train on the poses alone, without their mirror images and without other bone lengths.
    """
    chosen = choose_trials(category, without_trials, without_subjects, only_subjects)
    augmented = bool(category) and not plain
    balanced = balance_trials(
        [t.category for t in chosen], [t.subject for t in chosen], [len(t.poses) for t in chosen]
    )
    model = fit_base_poses(
        [t.poses for t in chosen],
        shares=None if _chosen_capture == ['cmu'] else balanced,
        name=category or 'all',
        alignment='heading' if category else 'rotation',
        mirror=augmented,
        bodies=2 if augmented else 0,
        provenance={'trials': [t.name for t in chosen]},
    )
    return model.rescale(TrackerConfig().body_height / model.stature)


def solve_jointly(
    tests: Sequence[View], model: BasePoses, config: SolverConfig | None = None
) -> Sequence[Reconstruction]:
    """Solve all views as one batch of the joint solver."""
    return joint.solve_hypotheses([v.window for v in tests], model, config or SolverConfig())


def solve_by_alternation(
    tests: Sequence[View], model: BasePoses, config: SolverConfig
) -> Sequence[Reconstruction]:
    """Solve each view by Algorithm 1 of the paper."""
    return [alternation.reconstruct(v.window, model, config) for v in tests]


def solve_periodically(
    tests: Sequence[View], model: BasePoses, config: SolverConfig | None = None
) -> Sequence[periodic.PeriodicReconstruction]:
    """Solve the views with the periodic model."""
    return periodic.solve([v.window for v in tests], model, config or SolverConfig())


def make_config(**overrides: Any) -> SolverConfig:
    """Return the default configuration of the solver with some values replaced."""
    return replace(SolverConfig(), **overrides)


def make_paper_config(**overrides: Any) -> SolverConfig:
    """Return the paper's configuration: no prior, no smoothness, least squares, an initial camera per frame."""
    paper = {
        'method': 'alternation',
        'adapt_noise': False,
        'components': 6,
        'prior_weight': 0.0,
        'smooth_weight': 0.0,
        'pose_acceleration_weight': 0.0,
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
    return make_config(**{**paper, **overrides})


def compute_errors(
    view: View, joints3d: Array, joint_names: Sequence[str], joints: str = 'common'
) -> dict[str, float]:
    """Compute the errors of one reconstruction by the protocol."""
    s = view.sequence
    fps = 1 / float(np.median(np.diff(s['timestamps'])))
    return load_protocol().score(
        joints3d, joint_names, s['joints3d'], s['joints3d_names'], s['keypoints'], s['joint_names'], joints, fps
    )


def compute_all_errors(
    tests: Sequence[View], found: Sequence[Reconstruction | Array], joints: str = 'common'
) -> list[dict[str, float]]:
    """Compute the errors of one reconstruction, or of its joints (F, 15, 3) m, per view by the protocol."""
    poses = [r.joints if isinstance(r, Reconstruction) else r for r in found]
    return [compute_errors(v, p, CMU15.joints, joints) for v, p in zip(tests, poses, strict=True)]


def compute_errors_of_detector(view: View) -> dict[str, float] | None:
    """Compute the errors of the detector's own 3D joints on a recording; None if it has none."""
    joints3d = view.sequence.get('mediapipe_world')
    return None if joints3d is None else compute_errors(view, joints3d.astype(float), view.joint_names, 'limbs')


def mean_error(records: Sequence[Mapping[str, Any]], key: str = 'mpjpe_mm') -> float:
    """Return the mean of an error over the records."""
    return float(np.mean([r[key] for r in records]))


def worst_error(records: Sequence[Mapping[str, Any]]) -> float:
    """Return the largest MPJPE of the records in mm."""
    return float(np.max([r['mpjpe_mm'] for r in records]))


def align_scale(found: Array, truth: Array) -> tuple[Array, Array]:
    """Return poses (F, J, 3) about their centres, the found ones with one scale for all frames that have them."""
    found, truth = centre_poses(found), centre_poses(truth)
    known = np.isfinite(found).all(axis=(1, 2))
    return found * ((found * truth)[known].sum() / (found * found)[known].sum()), truth


def compute_frame_errors(view: View, result: Reconstruction, *, per_frame_similarity: bool = False) -> Array:
    """Return the MPJPE (or PA-MPJPE) of the protocol for each frame, (F,) mm."""
    truth, found = centre_poses(view.truth), centre_poses(result.joints)
    if not per_frame_similarity:
        found = scale_to_reference(found, truth)
    return compute_pose_errors(found, truth, similarity=per_frame_similarity)


def find_true_weights(model: BasePoses, trial: str, frames: int) -> tuple[Array, Array]:
    """Return the first poses (F, 15, 3) m of a trial, scaled and turned to a model, and their weights (F, K) m."""
    poses = centre_poses(next(t.poses for t in list_trials() if t.name == trial)[:frames])
    poses = poses * (np.linalg.norm(model.mean) / np.linalg.norm(poses, axis=(1, 2)).mean())
    turned = poses @ np.swapaxes(fit_heading_rotation(poses, model.mean), -1, -2)
    return turned, model.weights(turned)


def compute_pose_errors(found: Array, truth: Array, *, similarity: bool) -> Array:
    """Return the mean joint error of centred poses (F, J, 3) m, (F,) mm; with `similarity`, after one for each."""
    if similarity:
        turned = found @ np.swapaxes(fit_rotation(found, truth), -1, -2)
        factor = (turned * truth).sum(axis=(1, 2)) / (turned * turned).sum(axis=(1, 2))
        found = turned * factor[:, None, None]
    return np.linalg.norm(found - truth, axis=-1).mean(axis=1) * 1e3


def compute_residual_mm(view: View, result: Reconstruction) -> float:
    """Return the RMS reprojection error of the seen points in mm at the distance of the body."""
    count = (view.window.weight > 0).sum(axis=1)
    squared = np.nansum(np.nan_to_num(result.residual) ** 2 * count) / count.sum()
    return float(np.sqrt(squared) / load_protocol().PX_PER_M * 1e3)


def measure_time(action: Callable[[], T], repeats: int = 1) -> tuple[T, float]:
    """Return the result of an action and the median of its CPU time in s over the repeats.

    CPU time is that of this process, so that others on the same core hardly matter.
    """
    durations = []
    for _ in range(repeats):
        start_s = time.process_time()
        result = action()
        durations.append(time.process_time() - start_s)
    return result, float(np.median(durations))


def measure_reference_kernel_s() -> float:
    """Return the CPU time in s of `REFERENCE_KERNEL`, by which machines are compared."""
    a = np.random.default_rng(0).standard_normal((512, 512))
    matrix = a @ a.T + 512 * np.eye(512)
    cholesky(matrix)
    return measure_time(lambda: [cholesky(matrix, lower=True) for _ in range(200)])[1]


def read_peak_mb() -> float:
    """Return the peak resident memory of this process in MB; `ru_maxrss` would include that of its parent."""
    status = Path('/proc/self/status')
    lines = status.read_text().splitlines() if status.is_file() else []
    return next((int(line.split()[1]) / 1024 for line in lines if line.startswith('VmHWM')), float('nan'))


def _run_and_read_peak(action: Callable[..., T], *arguments: Any) -> tuple[T, float]:
    return action(*arguments), read_peak_mb()


def run_in_process(action: Callable[..., T], *arguments: Any, fresh: bool = False) -> tuple[T, float]:
    """Run a function of a module in a process of its own; return its result and its peak memory in MB.

    Unless it is `fresh`, the process has what this one has loaded and compiled.
    """
    with ProcessPoolExecutor(1, get_context('spawn' if fresh else 'fork')) as process:
        return process.submit(_run_and_read_peak, action, *arguments).result()


def show_progress(items: Iterable[T], description: str, total: int | None = None) -> Iterable[T]:
    """Yield the items, and show a progress bar on a terminal."""
    return tqdm(items, desc=description, total=total, disable=not sys.stderr.isatty(), leave=False)
