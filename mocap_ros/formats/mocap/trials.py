# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Motion-capture trials for training: joint positions with the subject and the category of each trial.

The trials are read from ASF/AMC, BVH and C3D files, from folders of such files, and from .npz archives of joints.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.errors import InputError, naming
from mocap_ros.formats.bvh import load_bvh
from mocap_ros.formats.mocap.asf import load_amc
from mocap_ros.formats.mocap.c3d import load_c3d
from mocap_ros.formats.mocap.joint_maps import MarkerMap, infer_unit, map_to_model
from mocap_ros.formats.npz_arrays import ArrayReader, iterate_arrays, list_keys
from mocap_ros.formats.text_files import read_text
from mocap_ros.skeleton import BODY26, CMU15

MOTION_SUFFIXES = ('.amc', '.bvh', '.c3d')  # files of one trial each; other files are read as .npz archives
MAX_ARCHIVE_BYTES = 8 << 30  # unpacked; guards the memory; the CMU database (15 joints, 30 Hz) takes below 1 GB
MANIFEST_NAME = 'manifest.csv'  # file with the subject, the category and the quality of each trial
ARCHIVE = 'motion capture in .npz form'  # in the words of messages
NAMES_KEY = '_joints'  # of an archive: the names of the joints
M_PER_MM = 1e-3  # archives of joints are in mm
HEIGHT_RANGE_M = 0.3, 3.0  # m, body heights of archives; children to giants, but not mm taken for m
MIN_VERTICAL_COSINE = 0.8  # of 37 degrees between trunk and axis; beyond it the format's usual axis is taken

# Rows of a manifest by the name of the trial; each row maps the columns to texts.
Manifest = Mapping[str, Mapping[str, str]]


@dataclass(frozen=True, eq=False)
class Trial:
    """One motion-capture recording."""

    name: str  # such as `35_02`
    subject: str  # who moved
    category: str  # category of motion, such as walk, run or jump; empty if unknown
    clean: bool  # False where the manifest counts glitches in the recording
    poses: Array  # (F, J, 3) m, z up, joints in the order of `skeleton.CMU15`
    # (F, 11, 3) m, the other joints of `skeleton.BODY26`; None where the file lacks one
    extremities: Array | None = None

    def take_every(self, step: int) -> Trial:
        """Return the trial with one frame in `step`."""
        extremities = None if self.extremities is None else self.extremities[::step]
        return replace(self, poses=self.poses[::step], extremities=extremities)

    @property
    def all_joints(self) -> Array:
        """Joints of `skeleton.BODY26`, (F, 26, 3) m; without extremities those of `skeleton.CMU15`, (F, 15, 3)."""
        return self.poses if self.extremities is None else np.concatenate([self.poses, self.extremities], axis=1)


@dataclass(frozen=True)
class TrialOptions:
    """How trials are read, where the files do not say it."""

    # Path of a CSV file with the columns trial, subject, category and interior_glitches; by default
    # `MANIFEST_NAME` beside the files, if it exists
    manifest: Path | None = None
    # Names of the joints or markers whose mean is each joint of the model; None for a known rig
    markers: MarkerMap | None = None
    # Unit of length in m; by default the unit that the file names, or that gives a plausible body height; of an
    # .npz archive, mm
    unit: float | None = None
    every: int = 1  # step between the frames that are taken


DEFAULT_OPTIONS = TrialOptions()


def load_trials(
    path: Path,
    options: TrialOptions = DEFAULT_OPTIONS,
    report_progress: Callable[[list[Path]], Iterable[Path]] = iter,
) -> list[Trial]:
    """Load the trials of a file, or of all files in a folder and the folders below it.

    An .npz archive holds (F, J, 3) arrays, by default in mm, y up, under one key for each trial, and under
    `_joints` the names of the J joints, among them the 15 of the model. The skeleton of an .amc file is beside it:
    `35.asf` for `35_01.amc`, or the only .asf file there. A trial that is not in the manifest has as subject the
    part of its name before the `_`, and as category the name of its folder.

    `report_progress` iterates over the files and may show the progress.
    """
    manifests: dict[Path, Manifest] = {}
    trials: list[Trial] = []
    for file in report_progress(list_files(path)):
        manifest_path = options.manifest or file.with_name(MANIFEST_NAME)
        if manifest_path not in manifests:
            manifests[manifest_path] = _read_manifest(manifest_path, required=options.manifest is not None)
        manifest = manifests[manifest_path]
        if file.suffix.lower() in MOTION_SUFFIXES:
            poses = _read_motion(file, options)
            trials.append(_create_trial(file.stem, poses, manifest, file.parent.resolve().name))
        else:
            trials += _read_archive(file, manifest, options.unit or M_PER_MM)
    return [trial.take_every(options.every) for trial in trials]


def list_files(path: Path) -> list[Path]:
    """Return the files that `load_trials` reads; InputError where there are none in a folder."""
    if not path.is_dir():
        return [path]
    files = sorted(f for f in path.rglob('*') if f.suffix.lower() in MOTION_SUFFIXES)
    if not files:
        raise InputError(f'{path}: no {", ".join(MOTION_SUFFIXES)} in it')
    return files


def _create_trial(
    name: str, poses: Array, manifest: Manifest, category: str, extremities: Array | None = None
) -> Trial:
    row = manifest.get(name, {'category': category})
    subject = row.get('subject') or name.partition('_')[0]
    is_clean = (row.get('interior_glitches') or '0') == '0'
    return Trial(name, subject, row.get('category') or '', is_clean, poses, extremities)


def _read_archive(path: Path, manifest: Manifest, unit: float) -> Iterator[Trial]:
    """Read the trials of an .npz archive, in units of so many m."""
    with naming(path):
        stated = dict(iterate_arrays(path, (NAMES_KEY,), ARCHIVE, MAX_ARCHIVE_BYTES))
        names = ArrayReader(stated).read_joint_names(NAMES_KEY)
        if len(set(names)) != len(names) or not set(CMU15.joints) <= set(names):
            raise InputError(f'{NAMES_KEY}: expected the joints of {CMU15.name}, each once')
        order = [names.index(j) for j in CMU15.joints]
        others = BODY26.joints[len(order) :]
        other_order = [names.index(j) for j in others] if set(others) <= set(names) else []
        keys = [key for key in list_keys(path) if not key.startswith('_')]
        for key, array in iterate_arrays(path, keys, ARCHIVE, MAX_ARCHIVE_BYTES):
            numbers = ArrayReader({key: array}).read_numbers(key, (None, len(names), 3))
            if not len(numbers) or not np.isfinite(numbers).all():
                raise InputError(f'{key}: no frames' if not len(numbers) else f'{key}: not finite')
            joints = rotate_z_up(numbers, 1) * unit
            height = float(CMU15.bone_lengths(joints[:, order]).mean(axis=0) @ CMU15.stature_per_bone)
            if not HEIGHT_RANGE_M[0] <= height <= HEIGHT_RANGE_M[1]:
                raise InputError(f'{key}: a body {height:.3g} m tall, if the numbers are in units of {unit:g} m')
            extremities = joints[:, other_order] if other_order else None
            yield _create_trial(key, joints[:, order], manifest, '', extremities)


def _read_motion(path: Path, options: TrialOptions) -> Array:
    """Read (F, 15, 3) joints in m, z up, from a file of one trial; frames with a missing joint are left out."""
    unit: float | None = None
    suffix = path.suffix.lower()
    if suffix == '.amc':
        positions = load_amc(path, _find_skeleton(path))
    elif suffix == '.bvh':
        bvh = load_bvh(path)
        positions = dict(zip(bvh.names, np.moveaxis(bvh.compute_positions(), 1, 0), strict=True))
    else:
        positions, unit = load_c3d(path)
    with naming(path):
        joints = map_to_model(positions, options.markers)
        joints = joints[np.isfinite(joints).all(axis=(1, 2))]
        if not len(joints):
            raise InputError('no frame with all joints')
        vertical = find_vertical_axis(joints, usual=2 if suffix == '.c3d' else 1)
        return rotate_z_up(joints, vertical) * (options.unit or unit or infer_unit(joints))


def _find_skeleton(motion: Path) -> Path:
    expected = [motion.with_suffix('.asf'), motion.with_name(motion.stem.rpartition('_')[0] + '.asf')]
    if motion.is_file():
        beside = [f for f in sorted(motion.parent.iterdir()) if f.suffix.lower() == '.asf']
    else:
        beside = expected
    found = [f for f in expected if f in beside] or beside
    if not found or (len(beside) > 1 and found == beside):
        raise InputError(f'{motion}: no skeleton beside it, {expected[0].name} or {expected[1].name}')
    return found[0]


def find_vertical_axis(joints: Array, usual: int) -> int:
    """Find the vertical axis of joints (F, 15, 3) from the mean direction from the ankles to the neck.

    Returns the axis that points up (0, 1 or 2), or `~axis` if it points down; `usual` if none is clearly vertical.
    """
    position = {name: joints[:, i] for i, name in enumerate(CMU15.joints)}
    up = (position['neck'] - (position['lankle'] + position['rankle']) / 2).mean(axis=0)
    axis = int(np.abs(up).argmax())
    if abs(up[axis]) < MIN_VERTICAL_COSINE * np.linalg.norm(up):
        return usual
    return axis if up[axis] > 0 else ~axis


def rotate_z_up(joints: Array, vertical: int) -> Array:
    """Rotate joints (..., 3) so that the vertical axis, as `find_vertical_axis` returns it, becomes z."""
    x, y, z = np.moveaxis(joints, -1, 0)
    if vertical < 0:
        return rotate_z_up(joints, ~vertical) * [1.0, -1.0, -1.0]
    return np.stack(((y, z, x), (x, -z, y), (x, y, z))[vertical], axis=-1)


def _read_manifest(path: Path, *, required: bool) -> Manifest:
    if not required and not path.is_file():
        return {}
    try:
        rows = list(csv.DictReader(io.StringIO(read_text(path), newline='')))
    except csv.Error as error:
        raise InputError(f'{path}: not CSV: {error}') from None
    if any('trial' not in row for row in rows):
        raise InputError(f'{path}: no column trial')
    return {row['trial']: row for row in rows}


def select_trials(
    trials: Iterable[Trial],
    *,
    categories: Sequence[str] = (),
    without_subjects: Sequence[str] = (),
    without_trials: Sequence[str] = (),
    only_subjects: Sequence[str] = (),
) -> list[Trial]:
    """Select the clean trials of these categories and subjects (empty for all), without those to leave out."""
    return [
        t
        for t in trials
        if t.clean
        and (not categories or t.category in categories)
        and (not only_subjects or t.subject in only_subjects)
        and t.subject not in without_subjects
        and t.name not in without_trials
    ]
