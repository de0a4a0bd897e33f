# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Keypoints of Sports2D: a file `VIDEO_Sports2D_px_person00.trc` for each person, in px and without scores."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mocap_ros.errors import InputError, naming
from mocap_ros.formats.detections import Detections, Video, create_person
from mocap_ros.formats.text_files import quote_line, read_text
from mocap_ros.keypoints.image_size import resolve_image_size
from mocap_ros.keypoints.person import Person2D
from mocap_ros.skeleton import detector_joint_names
from mocap_ros.units import NS_PER_S

PIXEL_FILES = '*_px_person*.trc'
NAMES_LINE, FIRST_ROW = 3, 5  # indices of lines


def list_pixel_files(path: Path) -> list[Path]:
    """Return the path of a file, or those of all people in a folder of Sports2D."""
    return sorted(path.glob(PIXEL_FILES)) if path.is_dir() else [path]


def load_pixel_files(path: Path, video: Video) -> Detections:
    """Load the people of a file or folder of Sports2D; the files have the times."""
    people_by_stamp: dict[int, list[Person2D]] = {}
    for file in list_pixel_files(path):
        person_id = file.stem.rpartition('person')[2]
        lines = read_text(file).splitlines()
        with naming(file):
            names = detector_joint_names(lines[NAMES_LINE].split()[2:] if len(lines) > NAMES_LINE else [])
            expected = f'expected time and x, y, z of {len(names)} markers: '
            for number, line in enumerate(lines[FIRST_ROW:], FIRST_ROW + 1):
                if not line.strip():
                    continue
                with naming(f'line {number}', expected + quote_line(line)):
                    row = np.array([float(text or 'nan') for text in line.split('\t')[1 : 3 * len(names) + 2]])
                    stamp_ns = round(row[0] * NS_PER_S)
                    points = row[1:].reshape(len(names), 3)
                if (np.nan_to_num(points[:, 2]) != 0).any():
                    raise InputError('3D markers; of Sports2D the files VIDEO_Sports2D_px_person00.trc are read')
                points[:, 2] = np.isfinite(points[:, :2]).all(axis=1)
                person = create_person(points, video.layout, person_id, names)
                people_by_stamp.setdefault(stamp_ns, []).extend([person] * bool((person.score > 0).any()))
    stamps = sorted(people_by_stamp)
    size = resolve_image_size(configured=video.image_size)
    return Detections([people_by_stamp[s] for s in stamps], stamps, size)
