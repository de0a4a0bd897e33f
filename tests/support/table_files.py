# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Tables of a walker's keypoints (F, 17, 3) of `coco17` in an image of 640 x 480 px, as programs write them."""

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from mocap_ros.skeleton import keypoint_layout
from tests.support.input_files import FPS

NAMES = [n.replace('l', 'left_', 1) if n[0] == 'l' else n for n in keypoint_layout('coco17').joints]
MEDIAPIPE = keypoint_layout('mediapipe33').joints


def write_rows(path: Path, rows: Iterable[Iterable[object]], separator: str = ',') -> Path:
    """Write rows of texts and numbers, empty where NaN."""
    path.write_text('\n'.join(separator.join(str(x).replace('nan', '') for x in row) for row in rows) + '\n')
    return path


def write_deeplabcut(folder: Path, points: np.ndarray) -> Path:
    """Write labels of an animal, which have names of images in three columns, and a part of no animal."""
    columns = [(n, axis) for n in NAMES for axis in ('x', 'y', 'likelihood')] + [('ball', 'x'), ('ball', 'y')]
    heads = [['net'] * 53, ['anna'] * 51 + ['single'] * 2, *zip(*columns, strict=True)]
    kinds = 'scorer', 'individuals', 'bodyparts', 'coords'
    rows = [['labeled', 'walk', f'{f}.png', *p, 3, 4] for f, p in enumerate(points.reshape(-1, 51))]
    return write_rows(folder / 'a.csv', [[k, '', '', *h] for k, h in zip(kinds, heads, strict=True)] + rows)


def write_shares(folder: Path, points: np.ndarray) -> Path:
    """Write landmarks as of MediaPipe, which have a depth, and times."""
    heads = [f'{n}.{axis}' for n in NAMES for axis in ('x', 'y', 'z', 'visibility')]
    values = np.insert(points / [640, 480, 1], 2, 0.3, axis=2).reshape(-1, 68)
    rows = [[1e3 * f / FPS, *row] for f, row in enumerate(values)]
    return write_rows(folder / 'a.csv', [['timestamp_ms', *heads], *rows], ';')


def write_ultralytics(folder: Path, points: np.ndarray) -> Path:
    """Write the files of `save_txt` with scores and ids."""
    for frame, values in enumerate(np.nan_to_num(points / [640, 480, 1]).reshape(-1, 51)):
        write_rows(folder / f'walk_{frame + 1}.txt', [[0, 0.5, 0.5, 0.2, 0.6, *values, 0.9, 7]], ' ')
    return folder


def write_sports2d(folder: Path, points: np.ndarray, person: str = 'px_person00', depth: float = 0.0) -> Path:
    heads = ['Frame#', 'Time', *(x for n in NAMES for x in (n, '', ''))], ['', '', *'XYZ' * 17]
    places = np.dstack([points[..., :2], np.full(points.shape[:2], depth)]).reshape(-1, 51)
    rows = [[f, f / FPS, *row] for f, row in enumerate(places)]
    return write_rows(
        folder / f'walk_Sports2D_{person}.trc', [['Type', '4'], ['Rate'], ['30'], *heads, *rows], '\t'
    )


def write_freemocap(folder: Path, points: np.ndarray) -> Path:
    """Write the points of body, hands and face from one camera, with depths in px."""
    whole = np.full((1, len(points), 553, 3), np.nan)
    whole[0, :, [MEDIAPIPE.index(n) for n in keypoint_layout('coco17').joints]] = np.moveaxis(
        points * [1, 1, -90], 1, 0
    )
    np.save(folder / 'a.npy', whole)
    return folder / 'a.npy'


def write_array(folder: Path, points: np.ndarray) -> Path:
    np.save(folder / 'a.npy', points)
    return folder / 'a.npy'


FORMS: dict[str, Callable[[Path, np.ndarray], Path]] = {
    'DeepLabCut': write_deeplabcut,
    'shares': write_shares,
    'Ultralytics': write_ultralytics,
    'Sports2D': write_sports2d,
    'FreeMoCap': write_freemocap,
    'array': write_array,
}
