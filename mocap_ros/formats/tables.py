# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Keypoints in tables: columns with names, or, where a table has none, the order of a layout.

- DeepLabCut's CSV: the rows `scorer`, `individuals` (of several), `bodyparts` and `coords` name the columns.
- CSV with one row of names: NAME_x and NAME_y of each keypoint, perhaps a score such as NAME_likelihood; of the
  row perhaps the frame and the time.
- TRC of Sports2D, a file `VIDEO_Sports2D_px_person00.trc` for each person, in px and without scores.
- An array (.npy) of points in frames (F, J, 2 or 3), of FreeMoCap (1, F, J, 3) of one camera. The third number is
  the score if all are in [0, 1]; FreeMoCap has the depth there, which is not used.
- Ultralytics' `save_txt`: a file for each frame, with a row for each person: class, box, x, y and score of every
  keypoint, perhaps the score and the id of the person. Places are shares of the image.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.errors import InputError, describe_read_error, naming
from mocap_ros.formats.detections import SECONDS_BY_KEY, Detections, arrange_frames, create_person
from mocap_ros.formats.image_names import ImageName
from mocap_ros.formats.json_keypoints import Names, rank_score
from mocap_ros.formats.npz_arrays import ArrayReader
from mocap_ros.formats.reading_options import ReadingOptions
from mocap_ros.formats.text_files import check_position_count, quote_line, read_text
from mocap_ros.keypoints.person import Person2D
from mocap_ros.skeleton import detector_joint_names
from mocap_ros.units import NS_PER_S

PIXEL_FILES = '*_px_person*.trc'
HEAD_ROWS = 5  # before the numbers of TRC, more than of any other table; the last two name the columns
MAX_COLUMNS = 10_000  # guards against names without end; 10 people of 133 keypoints have 4,000
BOX_COLUMNS = 5  # of a row of Ultralytics: the class and the box
UNIQUE_PARTS = 'single'  # what DeepLabCut calls the individual that has the parts of no animal
# Names of columns that are no keypoints: of the image and of the time
IMAGE_NAMES = (
    'bodyparts',
    '',
    'frame',
    'frame_id',
    'frame_number',
    'image',
    'image_id',
    'image_name',
    'file_name',
)
SECONDS_BY_NAME = {**SECONDS_BY_KEY, 'time': 1.0, 'time_s': 1.0, 'time_ms': 1e-3}  # in the unit


class _Head(NamedTuple):
    """What a column holds: an axis of a joint, or, without a joint, something of the row."""

    axis: str
    joint: str = ''
    person: str = ''


class _Row(NamedTuple):
    """The keypoints (J, 3) of a person in an image: x, y and score."""

    place: str
    image: ImageName
    keypoints: Array
    joints: Names = ()
    person: str = ''
    time_s: float | None = None


def list_tables(path: Path) -> list[Path]:
    """Return the path of a file, or those of a folder: the people of Sports2D, or the frames of Ultralytics."""
    return (sorted(path.glob(PIXEL_FILES)) or sorted(path.glob('*.txt'))) if path.is_dir() else [path]


def load_tables(path: Path, options: ReadingOptions) -> Detections:
    """Load the people of a file or a folder.

    `options` give the image size, which is required for shares of the image, and the frame rate where the rows
    have no times.
    """
    people_by_image: dict[ImageName, list[Person2D]] = {}
    times_s: dict[ImageName, float] = {}
    for file in list_tables(path):
        suffix = file.suffix.lower()
        unit = [1.0, 1.0, 1.0]
        if options.normalised or suffix == '.txt':
            if options.image_size is None:
                raise InputError(
                    f'{path}: shares of the image; give its size (--image-size) or the video (--video)'
                )
            unit[:2] = options.image_size
        with naming(file):
            for row in READERS[suffix](file, options):
                with naming(row.place):
                    person = create_person(row.keypoints * unit, options.layout, row.person, row.joints)
                people_by_image.setdefault(row.image, []).extend([person] * bool((person.score > 0).any()))
                if row.time_s is not None:
                    times_s[row.image] = row.time_s
    with naming(path):
        return arrange_frames(people_by_image, options, times_s)


def _read_columns(path: Path, options: ReadingOptions) -> Iterator[_Row]:
    lines = read_text(path).splitlines()
    is_trc = path.suffix.lower() == '.trc'
    file_id = path.stem.rpartition('person')[2] if is_trc else ''
    separator = max(',;\t', key=(lines or [''])[0].count)
    rows = [_split(line, separator) for line in lines[:HEAD_ROWS]]
    if any(len(row) > MAX_COLUMNS for row in rows):
        raise InputError(f'more than {MAX_COLUMNS} columns')
    heads, start = _read_heads(rows, is_trc=is_trc)
    check_position_count(len(lines), len(heads))
    people = _find_people(heads)
    is_2d = options.normalised or any(head.axis == 'score' for head in heads)
    depths = [i for i, head in enumerate(heads) if head.joint and head.axis == 'z' and not is_2d]
    columns = {head.axis: index for index, head in enumerate(heads) if not head.joint}
    time, image = (
        next((columns[name] for name in names if name in columns), None)
        for names in (SECONDS_BY_NAME, IMAGE_NAMES)
    )
    for index, line in enumerate(lines[start:]):
        if not line.strip():
            continue
        place, time_s, name = f'line {start + index + 1}', None, index
        with naming(place, f'expected {len(heads)} columns, with numbers for joints: {quote_line(line)}'):
            cells = _split(line, separator)
            numbers = np.array([float(cells[i] or 'nan') if h.joint else 1.0 for i, h in enumerate(heads)] + [1.0])
            if time is not None:
                time_s = float(cells[time]) * SECONDS_BY_NAME[heads[time].axis]
                name = round(time_s * NS_PER_S)
            image_name = name if image is None else cells[image].removesuffix('.0')
        if np.nan_to_num(numbers[depths]).any():
            raise InputError(f'3D joints, x, y and z; expected x and y in px, of Sports2D in files {PIXEL_FILES}')
        for person, (joints, places) in people.items():
            yield _Row(place, image_name, numbers[places], joints, person or file_id, time_s)


def _split(line: str, separator: str) -> list[str]:
    return [cell.strip(' "') for cell in line.split(separator)]


def _read_heads(rows: Sequence[Sequence[str]], *, is_trc: bool) -> tuple[list[_Head], int]:
    """Return what the columns hold, and the index of the first row of numbers."""
    found, heads, joint = {row[0].lower(): row for row in rows}, [], ''
    if is_trc and len(rows) == HEAD_ROWS:
        found = {'bodyparts': rows[-2], 'coords': [axis[:1] for axis in rows[-1]]}
    if not {'bodyparts', 'coords'} <= found.keys():
        for cell in rows[0] if rows else ():
            part, _, word = re.sub('[ .:/-]', '_', cell).rpartition('_')
            axis = _find_axis(word) if part else ''
            heads.append(_Head(axis, part) if axis else _Head(cell.lower()))
        return heads, 1
    people = found.get('individuals', [''] * len(found['coords']))
    for part, word, person in zip(found['bodyparts'], found['coords'], people, strict=False):
        joint, axis = part or joint, _find_axis(word)
        heads.append(_Head(axis, joint, person) if axis else _Head(joint.lower()))
    return heads, HEAD_ROWS if is_trc else 3 + len(found.keys() & {'individuals'})


def _find_axis(word: str) -> str:
    word = word.lower()
    return word if word in ('x', 'y', 'z') else 'score' if rank_score(word) >= 0 else ''


def _find_people(heads: Sequence[_Head]) -> dict[str, tuple[Names, NDArray[np.intp]]]:
    """Return by person the joints and the columns (J, 3) of x, y and score, -1 for none."""
    found: dict[str, dict[str, dict[str, int]]] = {}
    for index, head in enumerate(heads):
        if head.joint:
            found.setdefault(head.person, {}).setdefault(head.joint, {})[head.axis] = index
    if len(found) > 1:
        found.pop(UNIQUE_PARTS, None)
    people = {}
    for person, joints in found.items():
        places = {j: [c['x'], c['y'], c.get('score', -1)] for j, c in joints.items() if {'x', 'y'} <= c.keys()}
        if places:
            people[person] = detector_joint_names([*places]), np.array([*places.values()])
    if not people:
        raise InputError('its columns are called neither NAME_x and NAME_y nor as DeepLabCut does it')
    return people


def _read_array(path: Path, _: ReadingOptions) -> Iterator[_Row]:
    try:
        array = np.lib.format.open_memmap(path, mode='r')
    except Exception as error:  # NumPy's reader raises almost any exception on malformed bytes
        raise InputError(f'no array of NumPy: {describe_read_error(error)}') from None
    frames = array[0] if array.ndim == 4 and len(array) == 1 else array
    if frames.ndim != 3 or frames.shape[2] not in (2, 3):
        raise InputError(f'shape {array.shape}, expected (frames, points, 2 or 3), of one camera')
    check_position_count(*frames.shape[:2])
    points = ArrayReader({'array': frames}).read_numbers('array', (None, None, None))
    third = np.nan_to_num(points[..., 2:], nan=-1.0)
    if not third.size or third.min() < 0 or third.max() > 1:
        points = np.dstack([points[..., :2], np.ones(points.shape[:2])])
    for index, keypoints in enumerate(points):
        yield _Row(f'frame {index}', index, keypoints)


def _read_people(path: Path, _: ReadingOptions) -> Iterator[_Row]:
    for number, line in enumerate(read_text(path).splitlines(), 1):
        with naming(f'line {number}', f'expected class, box, and x, y, score of keypoints: {quote_line(line)}'):
            numbers = np.array(line.split(), np.float64)
            count = (len(numbers) - BOX_COLUMNS) // 3
            if count < 1:
                raise InputError('no keypoints, as of a model that finds boxes; run a model for poses')
            keypoints, rest = np.split(numbers[BOX_COLUMNS:], [3 * count])
            person = str(int(rest[-1])) if rest.size and rest[-1].is_integer() else ''
        yield _Row(f'line {number}', path.stem, keypoints.reshape(count, 3), (), person)


READERS: Mapping[str, Callable[[Path, ReadingOptions], Iterator[_Row]]] = {
    '.csv': _read_columns, '.trc': _read_columns, '.npy': _read_array, '.txt': _read_people,
}  # fmt: skip
