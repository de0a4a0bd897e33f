# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Tables of keypoints: every form gives the same people, others are refused by their place."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mocap_ros.errors import InputError
from mocap_ros.formats.reading_options import ReadingOptions
from mocap_ros.formats.tables import load_tables
from mocap_ros.recordings.load_keypoints import load_input, load_people
from tests.support.blob_people import write_video
from tests.support.input_files import FPS, FRAMES, VIDEO, check_same_keypoints, make_walker
from tests.support.table_files import FORMS, MEDIAPIPE, write_array, write_sports2d, write_ultralytics

WALKER = make_walker()
POINTS = WALKER.keypoints


@pytest.mark.parametrize('form', FORMS)
def test_every_form_gives_the_same_keypoints(tmp_path: Path, form: str) -> None:
    fps = None if form in ('shares', 'Sports2D') else FPS
    detections = load_tables(
        FORMS[form](tmp_path, POINTS), ReadingOptions(fps, (640, 480), normalised=form == 'shares')
    )
    expected = WALKER
    if form in ('Sports2D', 'FreeMoCap'):  # without scores
        expected = replace(WALKER, keypoints=np.dstack([POINTS[..., :2], np.isfinite(POINTS[..., 0])]))
    if form == 'FreeMoCap':
        whole = np.full((FRAMES, len(MEDIAPIPE), 3), [np.nan, np.nan, 0])
        whole[:, [MEDIAPIPE.index(n) for n in WALKER.joint_names]] = expected.keypoints
        expected = replace(WALKER, keypoints=whole, joint_names=MEDIAPIPE)
    check_same_keypoints(detections, expected)
    ids = {'DeepLabCut': 'anna', 'Ultralytics': '7', 'Sports2D': '00'}
    assert {p.id for people in detections.people for p in people} == {ids.get(form, '')}


def test_of_sports2d_the_people_of_a_folder_are_read_in_px(tmp_path: Path) -> None:
    write_sports2d(tmp_path, POINTS)
    write_sports2d(tmp_path, POINTS + [3000, 0, 0], 'px_person01')
    metres = write_sports2d(tmp_path, POINTS, 'm_person00', 0.1)
    assert [s.person_id for s in load_people(tmp_path, ReadingOptions())[0]] == ['00', '01']
    with pytest.raises(InputError, match=r'm_person00\.trc: 3D joints'):
        load_input(metres, ReadingOptions())


def test_points_in_stored_pixels_go_with_the_images_that_players_show(tmp_path: Path) -> None:
    images = [np.zeros((480, 640, 3), np.uint8)] * FRAMES
    times_s = [f / FPS for f in range(FRAMES)]
    clip = write_video(tmp_path / 'a.mp4', images, times_s, 'libx264', 'yuv420p', aspect=1.5)
    sequence, _ = load_input(write_array(tmp_path, POINTS), ReadingOptions(video=clip))
    assert sequence.image_size == (960, 480)
    assert sequence.keypoints == pytest.approx(POINTS * [1.5, 1, 1], nan_ok=True)


@pytest.mark.parametrize(
    ('name', 'content', 'place'),
    [
        ('a.csv', 'a,b\n1,2\n', r'a\.csv: .*NAME_x'),
        ('a.csv', 'nose_x,lear_y\n', r'a\.csv: .*NAME_x'),
        ('a.csv', 'nose_x,nose_y\n1\n', r'a\.csv: line 2: expected'),
        ('a.csv', 'nose_x,nose_y,nose_z\n1,2,3\n', r'a\.csv: 3D'),
        ('a.trc', '1\n2\n', r'a\.trc: .*NAME_x'),
        ('a.npy', 'array', r'a\.npy: no array'),
        ('a_1.txt', '0 .5 .5 .2 .6\n', r'a_1\.txt: line 1: no keypoints'),
        ('a_1.txt', '0 .5 .5 .2 .6 one .5 .5\n', r'a_1\.txt: line 1: expected'),
    ],
)
def test_invalid_tables_are_refused_by_line(tmp_path: Path, name: str, content: str, place: str) -> None:
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=place):
        load_input(tmp_path if name.endswith('.txt') else tmp_path / name, VIDEO)


def test_arrays_of_several_cameras_and_shares_without_a_size_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r'\(2, 20, 17, 3\).* of one camera'):
        load_input(write_array(tmp_path, POINTS.reshape(2, 20, 17, 3)), VIDEO)
    with pytest.raises(InputError, match='--image-size'):
        load_tables(write_ultralytics(tmp_path, POINTS), ReadingOptions(FPS))
