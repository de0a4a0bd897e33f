"""Sequence files: what is written is read, and everything else is refused in one clear line."""

from __future__ import annotations

import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap_ros.errors import InputError
from mocap_ros.formats.sequence_file import Sequence, Truth, load_sequence, save_sequence
from mocap_ros.skeleton import layout
from tests.support.evaluation_data import shared

FRAMES = 5
JOINTS = layout('coco17').joints


@pytest.fixture
def sequence(rng: np.random.Generator) -> Sequence:
    keypoints = rng.uniform(0.2, 1, (FRAMES, len(JOINTS), 3)).astype('f4').astype(float)
    keypoints[..., :2] *= 512
    keypoints[1, 2] = [np.nan, np.nan, 0]
    return Sequence(
        keypoints=keypoints,
        joint_names=JOINTS,
        timestamps=np.arange(FRAMES) / 30,
        image_size=(640, 480),
        camera_matrix=np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]]),
        distortion=np.array([0.1, 0, 0, 0]),
        truth=Truth(np.ones((FRAMES, 2, 3)), ('neck', 'pelvis')),
    )


def test_round_trip(tmp_path: Path, sequence: Sequence) -> None:
    path = tmp_path / 'walk.npz'
    save_sequence(path, sequence)
    again = load_sequence(path)
    assert sequence.truth is not None
    assert again.truth is not None
    assert again.joint_names == sequence.joint_names
    assert again.image_size == sequence.image_size
    for field in ('keypoints', 'timestamps', 'camera_matrix', 'distortion'):
        np.testing.assert_array_equal(getattr(again, field), getattr(sequence, field))
    np.testing.assert_array_equal(again.truth.joints, sequence.truth.joints)
    assert again.truth.joint_names == sequence.truth.joint_names


def test_only_the_needed_keys_are_needed(tmp_path: Path, sequence: Sequence) -> None:
    path = tmp_path / 'walk.npz'
    save_sequence(path, replace(sequence, camera_matrix=None, distortion=None, truth=None))
    again = load_sequence(path)
    assert again.camera_matrix is None
    assert again.truth is None
    assert again.intrinsics(1.2).focal == pytest.approx(768)
    assert not again.intrinsics(1.2).known


def test_the_lens_is_undone(tmp_path: Path, sequence: Sequence) -> None:
    for count in (4, 5, 8):
        save_sequence(tmp_path / 'walk.npz', replace(sequence, distortion=np.full(count, 0.01)))
        camera = load_sequence(tmp_path / 'walk.npz').intrinsics(1.2)
        assert camera.known
        assert camera.distortion.coefficients == (0.01,) * count


def test_joint_names_are_taken_in_any_spelling(tmp_path: Path, sequence: Sequence) -> None:
    spelt = tuple(n.replace('l', 'left_', 1) if n[0] == 'l' else n.title() for n in JOINTS)
    truth = Truth(np.ones((FRAMES, 2, 3)), ('Neck', 'pelvis'))
    save_sequence(tmp_path / 'walk.npz', replace(sequence, joint_names=spelt, truth=truth))
    again = load_sequence(tmp_path / 'walk.npz')
    assert again.joint_names == JOINTS
    assert again.truth is not None
    assert again.truth.joint_names == ('neck', 'pelvis')


def test_not_seen_is_said_in_one_way(tmp_path: Path, sequence: Sequence) -> None:
    sequence.keypoints[0, 0, 2] = np.nan
    sequence.keypoints[0, 1, 0] = np.nan
    sequence.keypoints[0, 2, 2] = 0
    sequence.keypoints[0, 3, 2] = 1.24
    path = tmp_path / 'walk.npz'
    save_sequence(path, sequence)
    person = load_sequence(path).person(0)
    np.testing.assert_array_equal(person.score[:4], [0, 0, 0, 1])
    np.testing.assert_array_equal(np.isnan(person.points[:4]).all(axis=1), [True] * 3 + [False])


def changed(arrays: dict[str, Any], key: str, index: Any, value: float) -> None:
    arrays[key] = arrays[key].copy()
    arrays[key][index] = value


BAD = {
    'missing key': (lambda a: a.pop('keypoints'), 'keypoints: missing'),
    'pickled': (
        lambda a: a.update(keypoints=np.array([None], object)),
        'keypoints: holds Python objects$',
    ),
    'text for numbers': (lambda a: a.update(timestamps=np.array(['now'])), 'timestamps: holds <U3'),
    'wrong shape': (
        lambda a: a.update(keypoints=a['keypoints'][..., :2]),
        r'keypoints: shape \(5, 17, 2\), expected \(5, 17, 3\)',
    ),
    'unequal lengths': (lambda a: a.update(keypoints=a['keypoints'][:3]), r'keypoints: shape \(3,'),
    'too few joints': (
        lambda a: a.update(joint_names=np.array([f'j{i}' for i in range(17)])),
        'joint_names: .* fewer than four',
    ),
    'infinite point': (
        lambda a: changed(a, 'keypoints', (3, 7, 1), np.inf),
        'keypoints: frame 3: y of lelbow is inf',
    ),
    'score above one': (
        lambda a: changed(a, 'keypoints', (4, 0, 2), 1.5),
        'keypoints: frame 4: score of nose is 1.5',
    ),
    'negative score': (
        lambda a: changed(a, 'keypoints', (4, 0, 2), -0.5),
        'keypoints: frame 4: score of nose is -0.5',
    ),
    'shares of the image': (
        lambda a: a['keypoints'].__setitem__((..., slice(2)), a['keypoints'][..., :2] / 512),
        'keypoints: looks normalised; px expected',
    ),
    'a result': (
        lambda a: a.update(theta=np.zeros(0), residual_px=np.zeros(0)),
        'not a sequence file: a result of reconstruct; give the sequence file',
    ),
    'repeated stamp': (
        lambda a: changed(a, 'timestamps', 2, 1 / 30),
        'timestamps: frame 2: .* repeats frame 1',
    ),
    'stamp back in time': (
        lambda a: changed(a, 'timestamps', 4, 0.01),
        'timestamps: frame 4: .* is not later than frame 3',
    ),
    'stamp not finite': (
        lambda a: changed(a, 'timestamps', 1, np.nan),
        'timestamps: frame 1: nan s',
    ),
    'no frames': (lambda a: a.update(timestamps=np.zeros(0)), 'timestamps: no frames'),
    'no image': (lambda a: changed(a, 'image_size', 1, 0), 'image_size: 640 x 0 px'),
    'no camera': (lambda a: changed(a, 'camera_matrix', (0, 0), 0), 'camera_matrix: focal length'),
    'lens of three numbers': (
        lambda a: a.update(distortion=np.ones(3)),
        'distortion: plumb_bob takes 4 or 5 coefficients, not 3',
    ),
    'truth far away': (
        lambda a: changed(a, 'joints3d', (3, 1, 2), 3e38),
        r'joints3d: frame 3: pelvis is more than 1e\+06 m away',
    ),
    'truth of other frames': (
        lambda a: a.update(joints3d=a['joints3d'][:2]),
        r'joints3d: shape \(2, 2, 3\)',
    ),
}


@pytest.mark.parametrize('case', BAD)
def test_bad_content_is_refused_with_file_key_and_frame(tmp_path: Path, sequence: Sequence, case: str) -> None:
    break_it, message = BAD[case]
    path = tmp_path / 'walk.npz'
    save_sequence(path, sequence)
    with np.load(path) as archive:
        arrays = dict(archive)
    break_it(arrays)
    np.savez(path, **arrays)
    with pytest.raises(InputError, match=rf'walk\.npz: {message}') as caught:
        load_sequence(path)
    assert '\n' not in str(caught.value)


def test_bad_files_are_refused(tmp_path: Path, sequence: Sequence) -> None:
    whole = tmp_path / 'walk.npz'
    save_sequence(whole, sequence)
    broken = {
        'cut.npz': whole.read_bytes()[:-700],
        'text.npz': b'keypoints: none',
        'empty.npz': b'',
    }
    for name, content in broken.items():
        path = tmp_path / name
        path.write_bytes(content)
        with pytest.raises(InputError, match=f'{name}: not a sequence file') as caught:
            load_sequence(path)
        assert 'pickle' not in str(caught.value)
    np.save(tmp_path / 'single.npy', np.zeros(3))
    with pytest.raises(InputError, match=r'single\.npy: not a sequence file'):
        load_sequence(tmp_path / 'single.npy')
    for bag in (tmp_path / 'bag', tmp_path / 'bag.mcap'):
        bag.mkdir()
        (bag / 'bag_0.db3').touch()
        with pytest.raises(InputError, match=f'{bag.name}: is a bag, expected a sequence file'):
            load_sequence(bag)
    with pytest.raises(InputError, match='No such file'):
        load_sequence(tmp_path / 'none.npz')
    (tmp_path / 'folder').mkdir()
    with pytest.raises(InputError, match='folder: Is a directory'):
        load_sequence(tmp_path / 'folder')
    with zipfile.ZipFile(tmp_path / 'bomb.npz', 'w', zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for n in range(65):
            archive.writestr(f'{n}.npy', bytes(1 << 24))
    with pytest.raises(InputError, match=r'bomb\.npz: not a sequence file: holds more than 1024 MiB'):
        load_sequence(tmp_path / 'bomb.npz')


def test_real_files_load() -> None:
    files = sorted(shared('data/detections').glob('*.npz'))
    assert files
    for path in files:
        sequence = load_sequence(path)
        assert sequence.truth is not None
        assert len(sequence) == len(sequence.stamps_ns) == len(sequence.truth.joints)
