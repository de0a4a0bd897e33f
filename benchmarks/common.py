# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What the benchmarks share: evaluation data, test views, models, the ways to reconstruct, errors and timing.

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
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky
from tqdm import tqdm

import mocap_ros
from mocap_ros.config import TrackerConfig
from mocap_ros.formats.mocap.trials import Trial, load_trials, select_trials
from mocap_ros.formats.sequence_file import load_sequence
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.rotations import centre_poses, fit_rotation
from mocap_ros.keypoints.keypoint_sequence import create_intrinsics
from mocap_ros.keypoints.person import Person2D
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.window import Window
from mocap_ros.training.fit_base_poses import fit_base_poses
from mocap_ros.training.motion_library import balance_trials

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Parameters = Mapping[str, Any]
T = TypeVar('T')

ROOT = Path(__file__).resolve().parent.parent
WAYS = ('whole', 'live')  # how a view is reconstructed: all frames together, or frame by frame by the tracker
HEADINGS_DEG = tuple(range(0, 360, 45))  # degrees, directions from which the test views look; 0 is the front
FPS = 30.0  # Hz, frame rate of the motion capture
# Subjects of the motion capture that the held-out lifter and the base poses beside it are not trained on.
HELD_OUT_SUBJECTS = (
    *('35', '13', '05', '135', 'UB', 'UT', 'UWW', 'UJ', 'UW', '12', '26', '27'),
    *('14', '86', '94', 'uiprmd_s07', 'uiprmd_s08'),
)
# File of the lifter that never saw these subjects, trained like the shipped one.
HELD_OUT_LIFTER = ROOT / 'benchmarks' / 'models' / 'lifter_heldout.npz'
# Files of motion capture below `data`, and the one that this program uses.
CAPTURE_FILES = {'cmu': ('cmu', 'cmu15_30fps.npz'), 'motion': ('motion', 'body26_30fps.npz')}
_chosen_capture = ['cmu']
RECORDED_DETECTORS, CAMERAS = ('openpose', 'mediapipe'), (1, 2, 3)  # of the recorded detections
ORTHOGRAPHIC_FOCAL_LENGTH = 20.0  # longer sides of the image; with it perspective looks orthographic
# The fixed amount of linear algebra by which machines are compared.
REFERENCE_KERNEL = '200 Cholesky factorisations of a 512 x 512 matrix'


def data_path(*parts: str) -> Path:
    """Return the path of a file of the evaluation data: protocol, motion capture, detections."""
    return Path(os.environ.get('MOCAP_ROS_SHARED') or ROOT.parent / 'shared').joinpath(*parts)


@cache
def load_module(path: Path) -> ModuleType:
    """Load the module of a file."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise ImportError(str(path))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def load_protocol() -> ModuleType:
    """Load the measuring protocol, which is part of the evaluation data."""
    return load_module(data_path('bench', 'protocol.py'))


def choose_capture(name: str) -> None:
    """Choose the capture: `motion`, with the wrists of people, or `cmu` of the paper's experiments (default)."""
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
    """A test sequence that the protocol made: a sequence file's arrays; heading in degrees, 0 is the front."""

    sequence: dict[str, Array]
    heading: float = 0.0

    @property
    def keypoints(self) -> Array:
        return self.sequence['keypoints'].astype(float)

    @property
    def depth(self) -> Array | None:
        """Measured depths (F, J) m of surfaces at the keypoints, if there are any."""
        found = self.sequence.get('depth')
        return None if found is None else found.astype(float)

    @property
    def times(self) -> Array:
        return self.sequence['timestamps']

    @property
    def frames(self) -> int:
        return len(self.times)

    @cached_property
    def window(self) -> Window:
        keypoints = self.keypoints
        return Window(np.nan_to_num(keypoints[..., :2]), keypoints[..., 2], self.times)

    @property
    def joint_names(self) -> tuple[str, ...]:
        return tuple(str(name) for name in self.sequence['joint_names'])

    @property
    def camera(self) -> dict[str, Any]:
        """The camera as arguments of the public functions; without a matrix it is nearly orthographic."""
        width, height = (int(v) for v in self.sequence['image_size'])
        calibration = {k: self.sequence.get(k) for k in ('camera_matrix', 'distortion')}
        return {'image_size': (width, height), **calibration}

    @property
    def intrinsics(self) -> Intrinsics:
        given = self.camera
        calibration = given['camera_matrix'], given['distortion']
        return create_intrinsics(given['image_size'], *calibration, ORTHOGRAPHIC_FOCAL_LENGTH)

    @property
    def truth(self) -> Array:
        return self.sequence['joints3d'].astype(float)

    @property
    def true_poses(self) -> Array:
        """True joints (F, 15, 3) m in the camera's optical frame, in the order of `CMU15`."""
        return self.select_truth(CMU15.joints)

    def select_truth(self, joints: Sequence[str]) -> Array:
        """Return the true joints (F, J, 3) m with these names."""
        names = [str(name) for name in self.sequence['joints3d_names']]
        return self.truth[:, [names.index(joint) for joint in joints]]

    def hide_joints(self, joints: Sequence[str], frames: slice = slice(None)) -> View:
        """Return the same view, in which some joints are not seen in some frames."""
        keypoints = self.sequence['keypoints'].copy()
        keypoints[frames, [self.joint_names.index(j) for j in joints]] = [np.nan, np.nan, 0]
        return replace(self, sequence={**self.sequence, 'keypoints': keypoints})

    def list_people(self, person_id: str = 'p') -> list[Person2D]:
        """Return the person of each frame."""
        return [Person2D(person_id, self.joint_names, k[:, :2], k[:, 2]) for k in self.keypoints]


def make_views(trial: str | Array, headings: Iterable[float] = HEADINGS_DEG, **options: Any) -> list[View]:
    """Make a view by the protocol for each heading in degrees of a trial, or of poses (F, 15, 3) mm with y up."""
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
    """Choose the trials to train on."""
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
) -> PoseModel:
    """Train base poses as `mocap-ros train` does, scaled to the body height that the tracker assumes.

    `category` is empty for all motions. Those that are `plain` are trained without mirror images and other bone
    lengths; those of `cmu` are not balanced, for the papers' are not.
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


def provide_held_out(*others: str) -> tuple[PoseModel, dict[str, Any]]:
    """Return base poses of all motions and parameters with a lifter, which saw none of `HELD_OUT_SUBJECTS`.

    The base poses saw none of `others` either.
    """
    choose_capture('motion')
    return train_base_poses(without_subjects=(*HELD_OUT_SUBJECTS, *others)), {'solver.prior': str(HELD_OUT_LIFTER)}


def _fill_in(parameters: Parameters) -> dict[str, Any]:
    return {'tracker.nominal_focal_length': ORTHOGRAPHIC_FOCAL_LENGTH, **parameters}


def reconstruct_whole(
    view: View, model: PoseModel | str = 'auto', parameters: Parameters | None = None, method: Any = 'whole'
) -> Array:
    """Return the joints (F, 26 or 15, 3) m of a whole sequence, by the public function."""
    return mocap_ros.reconstruct(
        view.keypoints,
        view.joint_names,
        view.times,
        **view.camera,
        depth=view.depth,
        model=model,
        parameters=_fill_in(parameters or {}),
        method=method,
    ).joints


@dataclass(frozen=True, eq=False)
class TrackedSequence:
    """Joints (F, 26, 3) m, deviations, orientations and what was inferred, live; NaN in frames without output.

    `root_covariance` (F, 3, 3) is in m^2.
    """

    joints: Array
    std: Array
    turns: Array
    inferred: Bools
    root_covariance: Array


def track(view: View, model: PoseModel | str = 'auto', parameters: Parameters | None = None) -> TrackedSequence:
    """Reconstruct a view frame by frame, by the public tracker."""
    tracker = mocap_ros.Tracker(
        view.joint_names, **view.camera, model=model, parameters=_fill_in(parameters or {})
    )
    joints = np.full((view.frames, 26, 3), np.nan)
    std, inferred = np.full(joints.shape[:2], np.nan), np.zeros(joints.shape[:2], bool)
    turns, covariance = np.full((view.frames, 26, 4), np.nan), np.full((view.frames, 3, 3), np.nan)
    depths = [None] * view.frames if view.depth is None else view.depth[:, None]
    for time_s, keypoints, depth in zip(view.times, view.keypoints, depths, strict=True):
        frame = tracker.update(float(time_s), [keypoints], ids=['p'], depth=depth)
        for person in frame.people:
            at = int(np.argmin(np.abs(view.times - frame.time_s)))
            joints[at], std[at], inferred[at] = person.joints, person.joint_std, person.inferred
            turns[at], covariance[at] = person.joint_orientation, person.root_covariance
    return TrackedSequence(joints, std, turns, inferred, covariance)


def reconstruct(
    way: str, view: View, model: PoseModel | str = 'auto', parameters: Parameters | None = None
) -> Array:
    """Return the joints (F, 26, 3) m of one of `WAYS`."""
    if way == 'whole':
        return reconstruct_whole(view, model, parameters)
    return track(view, model, parameters).joints


def compute_errors(
    view: View, joints3d: Array, joint_names: Sequence[str] = CMU15.joints, joints: str = 'common'
) -> dict[str, float]:
    """Compute the errors of one reconstruction (F, J, 3) m by the protocol; of `CMU15` the first 15 count."""
    s = view.sequence
    fps = 1 / float(np.median(np.diff(view.times)))
    found, names = joints3d[:, : len(joint_names)], s['joints3d_names']
    return load_protocol().score(
        found, joint_names, s['joints3d'], names, s['keypoints'], s['joint_names'], joints, fps
    )


def compute_all_errors(
    views: Sequence[View], found: Sequence[Any], joints: str = 'common'
) -> list[dict[str, float]]:
    """Compute the errors of one result with `joints`, or of its joints, for each view."""
    poses = [getattr(r, 'joints', r) for r in found]
    return [compute_errors(v, p, joints=joints) for v, p in zip(views, poses, strict=True)]


def mean_error(records: Sequence[Mapping[str, Any]], key: str = 'mpjpe_mm') -> float:
    """Return the mean of an error over the records."""
    return float(np.mean([r[key] for r in records]))


def align_scale(found: Array, truth: Array) -> tuple[Array, Array]:
    """Return poses (F, J, 3) about their centres, the found ones with one scale for all frames that have them."""
    found, truth = centre_poses(found), centre_poses(truth)
    known = np.isfinite(found).all(axis=(1, 2))
    return found * ((found * truth)[known].sum() / (found * found)[known].sum()), truth


def compute_frame_errors(view: View, joints: Array) -> Array:
    """Return the MPJPE of each frame of poses (F, 15 or 26, 3), with one scale, (F,) mm."""
    return compute_pose_errors(*align_scale(joints[:, : len(CMU15.joints)], view.true_poses))


def compute_pose_errors(found: Array, truth: Array, *, similarity: bool = False) -> Array:
    """Return the mean joint error of centred poses (F, J, 3) m, (F,) mm; with `similarity`, after one for each."""
    if similarity:
        turned = found @ np.swapaxes(fit_rotation(found, truth), -1, -2)
        factor = (turned * truth).sum(axis=(1, 2)) / (turned * turned).sum(axis=(1, 2))
        found = turned * factor[:, None, None]
    return np.linalg.norm(found - truth, axis=-1).mean(axis=1) * 1e3


def measure_time(action: Callable[[], T]) -> tuple[T, float]:
    """Return the result of an action and the CPU time of this process in s."""
    start_s = time.process_time()
    result = action()
    return result, time.process_time() - start_s


def measure_reference_kernel_s() -> float:
    """Return the CPU time in s of `REFERENCE_KERNEL`."""
    a = np.random.default_rng(0).standard_normal((512, 512))
    matrix = a @ a.T + 512 * np.eye(512)
    cholesky(matrix)
    return measure_time(lambda: [cholesky(matrix, lower=True) for _ in range(200)])[1]


def show_progress(items: Iterable[T], description: str, total: int | None = None) -> Iterable[T]:
    """Yield the items, and show a progress bar on a terminal."""
    return tqdm(items, desc=description, total=total, disable=not sys.stderr.isatty(), leave=False)
