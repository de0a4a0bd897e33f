# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Results are read again from result files and from bags of skeletons."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mocap_ros.bags.recorder import Recorder
from mocap_ros.cli.main import main
from mocap_ros.config import RecorderConfig
from mocap_ros.errors import InputError
from mocap_ros.formats.sequence_file import save_sequence
from mocap_ros.messages.cdr import Header, decode, encode
from mocap_ros.messages.skeletons import SKELETONS, encode_skeletons
from mocap_ros.people import Motion, MotionKind, Person3D
from mocap_ros.runtime.load_results import holds_result, load_result
from mocap_ros.skeleton import BODY26
from tests.support.keypoint_files import FRAMES, make_walker
from tests.support.quick_options import QUICK_OPTIONS


@pytest.fixture(scope='module')
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder that holds a walk and its reconstruction as a result file and as a bag."""
    folder = tmp_path_factory.mktemp('results')
    save_sequence(folder / 'walk.npz', make_walker())
    for name in ('r.npz', 'r.mcap'):
        assert main(['reconstruct', str(folder / 'walk.npz'), '-o', str(folder / name), *QUICK_OPTIONS]) == 0
    return folder


def make_person(name: str, height: float) -> Person3D:
    """Return a person whose joints are all at one point."""
    return Person3D(
        id=name,
        joints=np.full((15, 3), height),
        std=np.full(15, np.nan),
        inferred=np.arange(15) == 3,
        scale=1.0,
        rotation=np.eye(3),
        translation=np.zeros(2),
        motion=Motion(MotionKind.UNKNOWN, '', np.nan, np.nan),
        residual=height / 10,
        scale_known=False,
        predicted=False,
    )


def test_a_result_file_and_a_bag_hold_the_same(results: Path) -> None:
    assert not holds_result(results / 'walk.npz')
    assert holds_result(results / 'r.npz')
    assert holds_result(results / 'r.mcap')
    file, no_name = load_result(results / 'r.npz')
    bag, person = load_result(results / 'r.mcap')
    assert (no_name, person) == ('', 'person_1')
    with np.load(results / 'r.npz') as arrays:
        assert np.array_equal(file.joints, arrays['joints3d'])
        assert np.array_equal(file.seen, arrays['seen'])
        assert np.array_equal(file.times, arrays['timestamps'])
    assert bag.joints == pytest.approx(file.joints, abs=1e-6)
    assert bag.residual == pytest.approx(file.residual, abs=1e-4, nan_ok=True)
    assert np.array_equal(bag.seen, file.seen)
    assert not file.seen.all()
    assert bag.stamps_ns == file.stamps_ns
    assert (bag.skeleton, file.skeleton) == (BODY26, BODY26)


def test_the_person_with_most_skeletons_is_read_from_a_bag(tmp_path: Path) -> None:
    people_by_frame = [
        [make_person('b', 1.0)],
        [make_person('a', 2.0), make_person('b', 3.0)],
        [],
        [make_person('b', 4.0)],
    ]
    with Recorder(tmp_path / 'bag', RecorderConfig(min_free_mb=0)) as recorder:
        for frame, people in enumerate(people_by_frame):
            stamp = 10**9 * (frame + 1) + 1
            recorder.write('/skeletons', SKELETONS, encode_skeletons(Header(stamp, 'c'), people), stamp, stamp)
    result, person = load_result(tmp_path / 'bag')
    assert person == 'b'
    assert result.times == pytest.approx([1, 2, 3, 4])
    assert result.stamps_ns == [1000000001, 2000000001, 3000000001, 4000000001]
    assert result.joints[:, 0, 0] == pytest.approx([1, 3, np.nan, 4], nan_ok=True)
    assert result.residual == pytest.approx([0.1, 0.3, np.nan, 0.4], nan_ok=True)
    assert result.seen.sum(axis=1).tolist() == [14, 14, 0, 14]
    assert not result.seen[:, 3].any()
    other, person = load_result(tmp_path / 'bag', 'a')
    assert (person, np.isfinite(other.joints).all(axis=(1, 2)).tolist()) == ('a', [False, True, False, False])
    with pytest.raises(InputError, match=r"bag: no person 'c'; there are b \(3\), a \(1\)"):
        load_result(tmp_path / 'bag', 'c')


@pytest.mark.parametrize(
    ('name', 'joint_count', 'flag_count', 'message'),
    [
        ('body26', 26, 0, 'skeletons of several layouts: body26, cmu15'),
        ('cmu15', 14, 0, r'people\[0\]: 14 joints and 0 flags, cmu15 has 15'),
        ('cmu15', 15, 14, r'people\[0\]: 15 joints and 14 flags, cmu15 has 15'),
    ],
)
def test_skeletons_that_do_not_fit_together_are_refused(
    tmp_path: Path, name: str, joint_count: int, flag_count: int, message: str
) -> None:
    arrays = [decode(encode_skeletons(Header(i, 'c'), [make_person('a', 1.0)]), SKELETONS) for i in (1, 2)]
    (skeleton,) = arrays[1].people
    skeleton.skeleton, skeleton.joints = name, (skeleton.joints * 2)[:joint_count]
    skeleton.inferred = np.zeros(flag_count, bool)
    with Recorder(tmp_path / 'bag', RecorderConfig(min_free_mb=0)) as recorder:
        for i, array in enumerate(arrays):
            recorder.write('/skeletons', SKELETONS, encode(array, SKELETONS), i, i)
    with pytest.raises(InputError, match=f'bag: /skeletons: {message}'):
        load_result(tmp_path / 'bag')


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'joints3d': np.zeros((FRAMES, 14, 3))}, r'joints3d: shape \(40, 14, 3\), expected \(40, 26, 3\)'),
        ({'joints3d': np.full((FRAMES, 26, 3), np.inf)}, 'joints3d: not finite'),
        ({'seen': np.ones((FRAMES, 26))}, 'seen: holds float64, expected true or false'),
        ({'seen': np.ones((3, 26), bool)}, r'seen: shape \(3, 26\), expected \(40, 26\)'),
        ({'joints3d': np.full((FRAMES, 26, 3), np.nan)}, 'no frame has a skeleton'),
        ({'timestamps': np.zeros(FRAMES)}, 'timestamps: expected increasing times in s'),
        (
            {'joint_names': np.array([f'j{i}' for i in range(26)])},
            'joint_names: j0, .*: not those of a known skeleton',
        ),
    ],
)
def test_a_damaged_result_is_refused_by_file_and_key(
    results: Path, tmp_path: Path, change: dict[str, np.ndarray], message: str
) -> None:
    with np.load(results / 'r.npz') as arrays:
        np.savez(tmp_path / 'd.npz', **{**arrays, **change})
    with pytest.raises(InputError, match=rf'd\.npz: {message}'):
        load_result(tmp_path / 'd.npz')


def test_what_holds_no_result_is_refused(results: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r'r\.npz: --person does not apply to a result of reconstruct'):
        load_result(results / 'r.npz', 'anna')
    with Recorder(tmp_path / 'bag', RecorderConfig(min_free_mb=0)):
        pass
    assert not holds_result(tmp_path / 'bag')
    with pytest.raises(InputError, match='bag: the bag has no skeletons'):
        load_result(tmp_path / 'bag')
