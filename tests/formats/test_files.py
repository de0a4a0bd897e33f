# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Sequence files are read as they were written, invalid ones refused; files are written whole or not at all."""

import errno
import os
import stat
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap_ros import npz_file
from mocap_ros.errors import InputError, MocapError
from mocap_ros.formats.sequence_file import (
    GroundTruth,
    KeypointSequence,
    load_sequence,
    save_sequence,
    validate_sequence,
)
from mocap_ros.formats.text_files import replace_output
from mocap_ros.skeleton import keypoint_layout

FRAMES = 5
JOINTS = keypoint_layout('coco17').joints


@pytest.fixture
def sequence(rng: np.random.Generator) -> KeypointSequence:
    keypoints = rng.uniform(0.2, 1, (FRAMES, len(JOINTS), 3)).astype('f4').astype(float)
    keypoints[..., :2] *= 512
    keypoints[1, 2] = [np.nan, np.nan, 0]
    return KeypointSequence(
        keypoints=keypoints,
        joint_names=JOINTS,
        timestamps=np.arange(FRAMES) / 30,
        image_size=(640, 480),
        camera_matrix=np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]]),
        distortion=np.array([0.1, 0, 0, 0]),
        truth=GroundTruth(np.ones((FRAMES, 2, 3)), ('neck', 'pelvis')),
    )


def test_round_trip(tmp_path: Path, sequence: KeypointSequence) -> None:
    path = tmp_path / 'walk.npz'
    save_sequence(path, sequence)
    loaded = load_sequence(path)
    assert sequence.truth is not None
    assert loaded.truth is not None
    assert loaded.joint_names == sequence.joint_names
    assert loaded.image_size == sequence.image_size
    for field in ('keypoints', 'timestamps', 'camera_matrix', 'distortion'):
        np.testing.assert_array_equal(getattr(loaded, field), getattr(sequence, field))
    np.testing.assert_array_equal(loaded.truth.joints, sequence.truth.joints)
    assert loaded.truth.joint_names == sequence.truth.joint_names


def set_element(arrays: dict[str, Any], key: str, index: Any, value: float) -> None:
    arrays[key] = arrays[key].copy()
    arrays[key][index] = value


INVALID: list[tuple[Callable[[dict[str, Any]], object], str]] = [
    (lambda a: a.pop('keypoints'), 'keypoints: missing'),
    (lambda a: a.update(keypoints=np.array([None], object)), 'keypoints: holds Python objects$'),
    (lambda a: a.update(timestamps=np.array(['now'])), 'timestamps: holds <U3'),
    (lambda a: a.update(keypoints=a['keypoints'][..., :2]), r'keypoints: shape .* expected \(5, 17, 3\)'),
    (lambda a: a.update(keypoints=a['keypoints'][:3]), r'keypoints: shape \(3,'),
    (lambda a: a.update(joint_names=np.array([f'j{i}' for i in range(17)])), 'joint_names: .* fewer than four'),
    (lambda a: set_element(a, 'keypoints', (3, 7, 1), np.inf), 'keypoints: frame 3: y of lelbow is inf'),
    (lambda a: set_element(a, 'keypoints', (4, 0, 2), np.inf), 'keypoints: frame 4: score of nose is inf'),
    (lambda a: set_element(a, 'keypoints', (..., 2), 0), 'keypoints: every score is 0'),
    (lambda a: a.update(keypoints=a['keypoints'] / [512, 512, 1]), 'keypoints: looks normalised; px expected'),
    (lambda a: a.update(theta=np.zeros(0), residual_px=np.zeros(0)), 'is a result of reconstruct'),
    (lambda a: set_element(a, 'timestamps', 2, 1 / 30), 'timestamps: frame 2: .* repeats frame 1'),
    (lambda a: set_element(a, 'timestamps', 4, 0.01), 'timestamps: frame 4: .* is not later than frame 3'),
    (lambda a: set_element(a, 'timestamps', 1, np.nan), 'timestamps: frame 1: nan s'),
    (
        lambda a: a.update(timestamps=1.76e12 + np.arange(FRAMES) * 33.3),
        r'timestamps: frame 0: 1\.76e\+12 s: looks like milliseconds; s expected$',
    ),
    (
        lambda a: a.update(keypoints=a['keypoints'] + [400, -50, 0], image_size=np.array([480, 1000])),
        'image_size: .* look transposed$',
    ),
    (lambda a: a.update(timestamps=np.zeros(0)), 'timestamps: no frames'),
    (lambda a: set_element(a, 'image_size', 1, 0), 'image_size: 640 x 0 px'),
    (lambda a: set_element(a, 'camera_matrix', (0, 0), 0), 'camera_matrix: focal length'),
    (lambda a: a.update(distortion=np.ones(3)), 'distortion: plumb_bob takes 4 or 5 coefficients, not 3'),
    (lambda a: a.update(distortion=np.array([0.1, -1e300, 0, 0])), r'distortion: -1e\+300'),
    (lambda a: set_element(a, 'joints3d', (3, 1, 2), 3e38), 'joints3d: frame 3: pelvis is more than'),
    (lambda a: a.update(joints3d=a['joints3d'][:2]), r'joints3d: shape \(2, 2, 3\)'),
]


@pytest.mark.parametrize(('edit', 'message'), INVALID)
def test_invalid_content_is_refused_by_file_key_and_frame(
    tmp_path: Path, sequence: KeypointSequence, edit: Callable[[dict[str, Any]], object], message: str
) -> None:
    path = tmp_path / 'walk.npz'
    save_sequence(path, sequence)
    with np.load(path) as archive:
        arrays = dict(archive)
    edit(arrays)
    np.savez(path, **arrays)
    with pytest.raises(InputError, match=rf'walk\.npz: {message}'):
        load_sequence(path)


@pytest.mark.parametrize(
    ('given', 'note'),
    [
        (JOINTS, ()),
        (
            ['lwirst' if j == 'lwrist' else j for j in JOINTS],
            ("joint_names: no known joints, used by their places: 'lwirst' as 'lwrist'",),
        ),
    ],
)
def test_names_that_no_layout_has_are_noted(given: Sequence[str], note: tuple[str, ...]) -> None:
    keypoints = np.ones((1, len(JOINTS), 3)) * np.arange(1, 1 + len(JOINTS))[:, None]
    arrays = {'keypoints': keypoints, 'timestamps': np.zeros(1), 'image_size': np.array([640, 480])}
    sequence = validate_sequence({**arrays, 'joint_names': np.array(given)})
    assert (sequence.joint_names, sequence.notes) == (JOINTS, note)


def test_invalid_files_are_refused(tmp_path: Path, sequence: KeypointSequence) -> None:
    valid = tmp_path / 'walk.npz'
    save_sequence(valid, sequence)
    invalid = {'cut.npz': valid.read_bytes()[:-700], 'text.npz': b'keypoints: none', 'empty.npz': b''}
    for name, content in invalid.items():
        path = tmp_path / name
        path.write_bytes(content)
        with pytest.raises(InputError, match=f'{name}: not a sequence file') as caught:
            load_sequence(path)
        assert 'pickle' not in str(caught.value)
    np.save(tmp_path / 'single.npy', np.zeros(3))
    (tmp_path / 'folder').mkdir()
    faults = {'single.npy': 'not a sequence file', 'none': 'No such file', 'folder': 'Is a directory'}
    for name, fault in faults.items():
        with pytest.raises(InputError, match=f'{name}: {fault}'):
            load_sequence(tmp_path / name)


def test_an_archive_that_unpacks_to_too_much_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, fault = tmp_path / 'bomb.npz', r'bomb\.npz: not a sequence file: unpacks to more than 100 times its size'
    np.savez_compressed(path, timestamps=np.zeros(10**6))
    with pytest.raises(InputError, match='holds more than 1 MiB'), npz_file.open_npz(path, 1 << 20):
        pass
    monkeypatch.setattr(npz_file, 'UNPACKED_BYTES', 0)
    with pytest.raises(InputError, match=fault):
        load_sequence(path)


@pytest.mark.parametrize('is_old', [False, True])
@pytest.mark.parametrize(
    ('error', 'told', 'message'),
    [
        (OSError(errno.ENOSPC, 'No space left'), MocapError, r'out\.npz: cannot be written: No space left$'),
        (InputError('frame 3'), InputError, 'frame 3'),
        (KeyboardInterrupt(), KeyboardInterrupt, '^$'),
        (SystemExit(1), SystemExit, '1'),
    ],
)
def test_an_error_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, error: BaseException, told: type[BaseException], message: str, is_old: bool
) -> None:
    path = tmp_path / 'out.npz'
    if is_old:
        path.write_text('old')

    def write() -> None:
        with replace_output(path) as unfinished:
            assert unfinished.name == 'out.npz'
            unfinished.write_text('ne')
            raise error

    with pytest.raises(told, match=message) as raised:
        write()
    assert type(raised.value) is told
    assert [file.read_text() for file in tmp_path.iterdir()] == ['old'] * is_old


def test_an_existing_file_keeps_its_permissions_and_a_new_one_has_the_usual_ones(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        for name, mode in (('old.npz', 0o604), ('new.npz', None)):
            path = tmp_path / name
            if mode is not None:
                path.write_text('old')
                path.chmod(mode)
            with replace_output(path) as unfinished:
                unfinished.write_text('new')
            assert path.read_text() == 'new'
            assert stat.S_IMODE(path.stat().st_mode) == (mode or 0o640)
    finally:
        os.umask(before)


def test_a_link_stays_and_its_file_is_replaced(tmp_path: Path) -> None:
    for folder in ('here', 'there'):
        (tmp_path / folder).mkdir()
    link, file = tmp_path / 'here' / 'link.npz', tmp_path / 'there' / 'data'
    link.symlink_to(file)
    for content in ('first', 'second'):
        with replace_output(link) as unfinished:
            assert unfinished.name == 'link.npz'
            assert unfinished.parent.parent == file.parent
            unfinished.write_text(content)
        assert link.is_symlink()
        assert file.read_text() == content
    assert set(tmp_path.rglob('*')) == {link.parent, file.parent, link, file}


def test_a_source_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / 'in').write_text('old')
    (tmp_path / 'out').symlink_to('in')
    places = [tmp_path / name for name in ('out', 'other', 'in')]
    message = 'out: not written, because it is the input file'
    with pytest.raises(MocapError, match=message), replace_output(*places) as unfinished:
        unfinished.write_text('new')
    assert (tmp_path / 'in').read_text() == 'old'


def test_the_standard_output_is_written_directly(tmp_path: Path) -> None:
    """Also where it leads to a file, which has no name that could be given to another one."""
    code = (
        'from pathlib import Path; from mocap_ros.formats.text_files import replace_output\n'
        "with replace_output(Path('/dev/stdout')) as place: place.write_text(str(place))\n"
    )
    with (tmp_path / 'out').open('wb') as file:
        subprocess.run([sys.executable, '-c', code], cwd=tmp_path, stdout=file, check=True)
        assert os.fstat(file.fileno()).st_ino == (tmp_path / 'out').stat().st_ino
    assert (tmp_path / 'out').read_text() == '/dev/stdout'
