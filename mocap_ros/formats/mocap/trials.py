"""Motion capture for training: trials of joint positions, with what is known about them.

Read are ASF/AMC, BVH and C3D, files or folders of them, and .npz archives of joints.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap_ros.errors import InputError, reader_reason
from mocap_ros.formats.mocap.asf import load_amc
from mocap_ros.formats.mocap.bvh import load_bvh
from mocap_ros.formats.mocap.c3d import load_c3d
from mocap_ros.formats.mocap.joint_maps import Markers, model_joints, unit_of
from mocap_ros.formats.text_files import read_text
from mocap_ros.npz_file import open_npz
from mocap_ros.skeleton import CMU15, own_names

Array = NDArray[np.float64]

RECORDINGS = ('.amc', '.bvh', '.c3d')
ENDINGS = ('.npz', *RECORDINGS)
LARGEST_ARCHIVE = 8 << 30
MANIFEST = 'manifest.csv'
MM = 1e-3
CLEARLY_UPRIGHT = 0.8


@dataclass(frozen=True, eq=False)
class Trial:
    """One motion-capture recording.

    Attributes:
        name: such as `35_02`.
        subject: who moved.
        category: walk, run, jump, ...; empty if unknown.
        clean: False where the recording is known to have glitches.
        poses: (F, J, 3) m, z up, joints as `skeleton.CMU15`.
    """

    name: str
    subject: str
    category: str
    clean: bool
    poses: Array


@dataclass(frozen=True)
class Source:
    """What the files do not say.

    Attributes:
        manifest: CSV with columns trial, subject, category, interior_glitches; by default `MANIFEST` beside the
            files, and optional.
        markers: joint of the model -> names of joints or markers; by default those of known rigs.
        unit: m, the unit of length; by default what the file says, or what makes people as tall as they are.
        every: which frames to take: all, every second, ...
    """

    manifest: Path | None = None
    markers: Markers | None = None
    unit: float | None = None
    every: int = 1


EVERYTHING = Source()


def load_trials(
    path: Path, source: Source = EVERYTHING, watch: Callable[[list[Path]], Iterable[Path]] = iter
) -> list[Trial]:
    """Trials of a file, or of all files below a folder.

    An .npz holds (F, 15, 3) arrays in mm, y up, one key a trial, joint names under `_joints`. An .amc needs its
    skeleton beside it: `35.asf` for `35_01.amc`, or the only .asf there. What is not in the manifest has the
    part of its name before the `_` as subject, and the name of its folder as category.

    Args:
        path: of the file or folder.
        source: what they do not say.
        watch: wrapped around the files.

    Raises:
        InputError: nothing to read, or something that cannot be read; names file and place.
    """
    if path.is_dir():
        files = sorted(f for f in path.rglob('*') if f.suffix.lower() in RECORDINGS)
        if not files:
            raise InputError(f'{path}: no {", ".join(RECORDINGS)} in it')
    else:
        files = [path]
    manifests: dict[Path, Mapping[str, Mapping[str, str]]] = {}
    trials: list[Trial] = []
    for file in watch(files):
        manifest = source.manifest or file.with_name(MANIFEST)
        if manifest not in manifests:
            manifests[manifest] = _manifest(manifest, required=source.manifest is not None)
        known = manifests[manifest]
        if file.suffix.lower() in RECORDINGS:
            trials.append(_trial(file.stem, _recording(file, source), known, file.parent.resolve().name))
        else:
            trials += _archive(file, known)
    return [replace(trial, poses=trial.poses[:: source.every]) for trial in trials]


def _trial(name: str, poses: Array, known: Mapping[str, Mapping[str, str]], category: str) -> Trial:
    row = known.get(name, {'category': category})
    return Trial(
        name,
        row.get('subject') or name.partition('_')[0],
        row.get('category') or '',
        (row.get('interior_glitches') or '0') == '0',
        poses,
    )


def _archive(path: Path, known: Mapping[str, Mapping[str, str]]) -> Iterator[Trial]:
    key = ''
    try:
        with open_npz(path, LARGEST_ARCHIVE) as archive:
            keys = [k for k in archive.files if not k.startswith('_')]
            names = own_names([str(n) for n in archive['_joints']]) if '_joints' in archive.files else ()
            if sorted(names) != sorted(CMU15.joints):
                raise InputError(f'key _joints must name the joints of {CMU15.name}')
            order = [names.index(j) for j in CMU15.joints]
            for key in keys:
                array = np.asarray(archive[key], float)
                if array.ndim != 3 or array.shape[1:] != (len(names), 3) or not len(array):
                    raise InputError(f'key {key} has shape {array.shape}')
                if not np.isfinite(array).all():
                    raise InputError(f'key {key} holds numbers that are not finite')
                yield _trial(key, _z_up(array[:, order], 1) * MM, known, '')
    except InputError as error:
        raise InputError(f'{path}: {error}') from None
    except OSError as error:
        raise InputError(f'{path}: {error.strerror or error}') from None
    except Exception as error:  # zip, npy and JSON readers raise almost anything on garbage
        where = f'key {key}' if key else 'not motion capture in .npz form'
        raise InputError(f'{path}: {where} ({reader_reason(error)})') from None


def _recording(path: Path, source: Source) -> Array:
    """(F, 15, 3) m, z up; frames in which a joint is missing are left out."""
    unit = None
    kind = path.suffix.lower()
    if kind == '.amc':
        positions = load_amc(path, _skeleton_beside(path))
    elif kind == '.bvh':
        bvh = load_bvh(path)
        positions = dict(zip(bvh.names, np.moveaxis(bvh.positions(), 1, 0), strict=True))
    else:
        positions, unit = load_c3d(path)
    try:
        joints = model_joints(positions, source.markers)
        joints = joints[np.isfinite(joints).all(axis=(1, 2))]
        if not len(joints):
            raise InputError('no frame with all joints')
        return _z_up(joints, _vertical(joints, usual=2 if kind == '.c3d' else 1)) * (
            source.unit or unit or unit_of(joints)
        )
    except InputError as error:
        raise InputError(f'{path}: {error}') from None


def _skeleton_beside(motion: Path) -> Path:
    own = [motion.with_suffix('.asf'), motion.with_name(motion.stem.rpartition('_')[0] + '.asf')]
    beside = (
        [f for f in sorted(motion.parent.iterdir()) if f.suffix.lower() == '.asf'] if motion.is_file() else own
    )
    found = [f for f in own if f in beside] or beside
    if not found or (len(beside) > 1 and found == beside):
        raise InputError(f'{motion}: no skeleton beside it, {own[0].name} or {own[1].name}')
    return found[0]


def _vertical(joints: Array, usual: int) -> int:
    """Which axis is up (0, 1, 2), negative where it points down (`~axis`): the way from ankles to neck."""
    at = {name: joints[:, i] for i, name in enumerate(CMU15.joints)}
    up = (at['neck'] - (at['lankle'] + at['rankle']) / 2).mean(axis=0)
    axis = int(np.abs(up).argmax())
    if abs(up[axis]) < CLEARLY_UPRIGHT * np.linalg.norm(up):
        return usual
    return axis if up[axis] > 0 else ~axis


def _z_up(joints: Array, vertical: int) -> Array:
    """Joints (..., 3) turned so that the axis that `_vertical` found is z."""
    x, y, z = np.moveaxis(joints, -1, 0)
    if vertical < 0:
        return _z_up(joints, ~vertical) * [1.0, -1.0, -1.0]
    return np.stack(((y, z, x), (x, -z, y), (x, y, z))[vertical], axis=-1)


def _manifest(path: Path, *, required: bool) -> dict[str, dict[str, str]]:
    if not required and not path.is_file():
        return {}
    try:
        rows = list(csv.DictReader(io.StringIO(read_text(path), newline='')))
    except csv.Error as error:
        raise InputError(f'{path}: not CSV: {error}') from None
    if any('trial' not in row for row in rows):
        raise InputError(f'{path}: no column trial')
    return {row['trial']: row for row in rows}


def select(
    trials: Iterable[Trial],
    *,
    categories: Sequence[str] = (),
    without_subjects: Sequence[str] = (),
    without_trials: Sequence[str] = (),
    only_subjects: Sequence[str] = (),
) -> list[Trial]:
    """The clean trials of these categories (all if none) less the excluded ones."""
    return [
        t
        for t in trials
        if t.clean
        and (not categories or t.category in categories)
        and (not only_subjects or t.subject in only_subjects)
        and t.subject not in without_subjects
        and t.name not in without_trials
    ]
