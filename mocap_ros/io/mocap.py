"""Motion capture for training: trials of joint positions, with what is known about them."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap_ros.errors import InputError, reader_reason
from mocap_ros.skeleton import CMU15, own_names

Array = NDArray[np.float64]


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


def load_trials(path: Path, manifest: Path | None = None) -> list[Trial]:
    """Trials of an .npz of (F, 15, 3) arrays in mm, y up, one key a trial, joint names under `_joints`.

    Args:
        path: the .npz.
        manifest: CSV with columns trial, subject, category, interior_glitches; `manifest.csv` beside the
            .npz by default, and optional.

    Raises:
        InputError: the file is not one of that form; names it and the key.
    """
    known = _manifest(manifest or path.with_name('manifest.csv'), required=manifest is not None)
    trials = []
    try:
        with np.load(path, allow_pickle=False) as archive:
            keys = [k for k in archive.files if not k.startswith('_')]
            names = own_names([str(n) for n in archive['_joints']]) if '_joints' in archive.files else ()
            if sorted(names) != sorted(CMU15.joints):
                raise InputError(f'{path}: key _joints must name the joints of {CMU15.name}')
            order = [names.index(j) for j in CMU15.joints]
            for key in keys:
                array = np.asarray(archive[key], float)
                if array.ndim != 3 or array.shape[1:] != (len(names), 3) or not len(array):
                    raise InputError(f'{path}: key {key} has shape {array.shape}')
                if not np.isfinite(array).all():
                    raise InputError(f'{path}: key {key} holds numbers that are not finite')
                row = known.get(key, {})
                trials.append(
                    Trial(
                        key,
                        row.get('subject') or key.split('_')[0],
                        row.get('category', ''),
                        row.get('interior_glitches', '0') == '0',
                        _z_up(array[:, order] * 1e-3),
                    )
                )
    except InputError:
        raise
    except OSError as error:
        raise InputError(f'{path}: {error.strerror or error}') from None
    except Exception as error:  # zip, npy and JSON readers raise almost anything on garbage
        raise InputError(f'{path}: not motion capture in .npz form ({reader_reason(error)})') from None
    return trials


def _z_up(y_up: Array) -> Array:
    return np.stack([y_up[..., 0], -y_up[..., 2], y_up[..., 1]], axis=-1)


def _manifest(path: Path, *, required: bool) -> dict[str, dict[str, str]]:
    if not path.is_file():
        if required:
            raise InputError(f'{path}: no such manifest')
        return {}
    with path.open(newline='', encoding='utf-8') as file:
        return {row.get('trial', ''): row for row in csv.DictReader(file)}


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
