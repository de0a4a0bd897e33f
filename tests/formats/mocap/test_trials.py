# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Trials are read from files and folders in all formats of motion capture."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap_ros.errors import InputError
from mocap_ros.formats.bvh import save_bvh
from mocap_ros.formats.export.armature import build_armature
from mocap_ros.formats.mocap.joint_maps import LENGTH_UNITS_M, RIGS, infer_unit, map_to_model
from mocap_ros.formats.mocap.trials import (
    Trial,
    TrialOptions,
    find_vertical_axis,
    load_trials,
    rotate_z_up,
    select_trials,
)
from mocap_ros.skeleton import CMU15
from tests.support.motion_files import AMC, Z_UP_TO_Y_UP, rotation_matrix


def make_cmu_asf(pose: np.ndarray) -> str:
    """Return a skeleton with CMU's names and the rest pose (15, 3) in CMU's unit, y up."""
    position = dict(zip(CMU15.joints, pose, strict=True))
    names = RIGS['CMU ASF']
    pairs = [(CMU15.joints[parent], CMU15.joints[child]) for parent, child in CMU15.outward_bones()]
    bones = ''
    for parent, child in pairs:
        bone = position[child] - position[parent]
        length = np.linalg.norm(bone)
        direction = ' '.join(f'{v:.12f}' for v in bone / length)
        freedom = 'dof rx ry rz\n' if child == 'lknee' else ''
        bones += f'begin\nname {names[child]}\ndirection {direction}\nlength {length:.12f}\n'
        bones += f'axis 0 0 0 XYZ\n{freedom}end\n'
    tree = ''.join(f'{names[p]} {names[c]}\n' for p, c in pairs)
    return (
        ':units\nangle deg\n:root\norder TX TY TZ RX RY RZ\naxis XYZ\nposition 0 0 0\norientation 0 0 0\n'
        f':bonedata\n{bones}:hierarchy\nbegin\n{tree}end\n'
    )


def test_a_trial_has_the_subject_and_category_of_its_name_or_manifest(tmp_path: Path, poses: np.ndarray) -> None:
    folder = tmp_path / 'walk'
    folder.mkdir()
    unit = LENGTH_UNITS_M['unit of the CMU database']
    rest = (poses[0] - poses[0, 8]) @ Z_UP_TO_Y_UP.T / unit
    (folder / '99.asf').write_text(make_cmu_asf(rest))
    (folder / '99_03.amc').write_text(':DEGREES\n1\nroot 0 0 0 0 0 0\n2\nroot 10 0 0 0 90 0\n')
    (trial,) = load_trials(tmp_path)
    assert (trial.name, trial.subject, trial.category) == ('99_03', '99', 'walk')
    assert trial.poses[0] == pytest.approx(poses[0] - poses[0, 8], abs=1e-6)
    rotated = (poses[0] - poses[0, 8]) @ rotation_matrix('z', 90).T + [10 * unit, 0, 0]
    assert trial.poses[1] == pytest.approx(rotated, abs=1e-6)
    (folder / 'manifest.csv').write_text('trial,subject,category,interior_glitches\n99_03,5,run,2\n')
    (trial,) = load_trials(tmp_path)
    assert (trial.subject, trial.category, trial.clean) == ('5', 'run', False)


@pytest.mark.parametrize(
    ('options', 'selected'),
    [
        ({}, ['1_walk', '1_run', '2_walk', '3_walk', '3_jump']),
        ({'categories': ['run', 'jump']}, ['1_run', '3_jump']),
        ({'only_subjects': ['1', '2']}, ['1_walk', '1_run', '2_walk']),
        ({'without_subjects': ['1', '2']}, ['3_walk', '3_jump']),
        ({'without_trials': ['1_walk', '3_jump']}, ['1_run', '2_walk', '3_walk']),
        ({'categories': ['walk'], 'only_subjects': ['1', '3'], 'without_trials': ['3_walk']}, ['1_walk']),
        ({'only_subjects': ['4']}, []),
    ],
)
def test_clean_trials_are_selected(poses: np.ndarray, options: dict[str, Any], selected: list[str]) -> None:
    names = '1_walk', '1_run', '2_walk', '2_run', '3_walk', '3_jump'
    trials = [
        Trial(name, subject=name[0], category=name[2:], clean=name != '2_run', poses=poses) for name in names
    ]
    assert [t.name for t in select_trials(trials, **options)] == selected


@pytest.mark.parametrize('up', range(3))
def test_unit_and_vertical_axis_are_found(poses: np.ndarray, up: int) -> None:
    bvh = build_armature(poses @ Z_UP_TO_Y_UP.T, 30.0)
    positions = dict(zip(bvh.names, np.moveaxis(bvh.compute_positions(), 1, 0), strict=True))
    joints = map_to_model(positions)
    for name, metres in LENGTH_UNITS_M.items():
        rolled = np.roll(joints * 0.01 / metres, up - 1, axis=-1)
        assert infer_unit(rolled) == metres, name
        vertical = find_vertical_axis(rolled, usual=0)
        assert vertical == up
        upright = rotate_z_up(rolled, vertical)
        assert np.linalg.det(np.linalg.lstsq(rolled[0], upright[0], rcond=None)[0]) == pytest.approx(1)
        assert (upright[:, 0, 2] > upright[:, 11, 2]).all()
        assert find_vertical_axis(-rolled, usual=0) == ~up


@pytest.mark.parametrize('height', [1.7, 1700.0])
def test_somebody_who_leans_halfway_has_no_vertical_axis_of_their_own(poses: np.ndarray, height: float) -> None:
    upright = poses / np.ptp(poses[0, :, 2]) * height
    leaning = upright @ rotation_matrix('x', 45).T
    assert [find_vertical_axis(j, usual=0) for j in (upright, leaning)] == [2, 0]


def test_a_single_skeleton_beside_a_motion_is_its_own_whatever_its_name(tmp_path: Path, poses: np.ndarray) -> None:
    (tmp_path / 'walk_01.amc').write_text(':DEGREES\n1\nroot 0 0 0 0 0 0\n')
    rest = (poses[0] - poses[0, 8]) @ Z_UP_TO_Y_UP.T / LENGTH_UNITS_M['unit of the CMU database']
    (tmp_path / 'ann.asf').write_text(make_cmu_asf(rest))
    (trial,) = load_trials(tmp_path / 'walk_01.amc')
    assert trial.poses[0] == pytest.approx(poses[0] - poses[0, 8], abs=1e-6)
    (tmp_path / 'ben.asf').write_text(make_cmu_asf(rest))
    with pytest.raises(InputError, match=r'walk_01\.amc: no skeleton beside it'):
        load_trials(tmp_path / 'walk_01.amc')


def test_missing_files_are_named(tmp_path: Path) -> None:
    (tmp_path / '35_01.amc').write_text(AMC)
    with pytest.raises(InputError, match=r'35_01\.amc: no skeleton beside it, 35_01\.asf or 35\.asf'):
        load_trials(tmp_path)
    (tmp_path / 'empty').mkdir()
    with pytest.raises(InputError, match=r'no \.amc, \.bvh, \.c3d in it'):
        load_trials(tmp_path / 'empty')
    with pytest.raises(InputError, match=r'none\.amc: no skeleton beside it'):
        load_trials(tmp_path / 'none.amc')


def test_an_archive_is_in_mm_unless_another_unit_is_given(tmp_path: Path, poses: np.ndarray) -> None:
    np.savez(tmp_path / 'm.npz', _joints=np.array(CMU15.joints), t=poses)
    np.savez(tmp_path / 'mm.npz', _joints=np.array(CMU15.joints), t=1000 * poses)
    (plain,) = load_trials(tmp_path / 'mm.npz')
    (given,) = load_trials(tmp_path / 'm.npz', TrialOptions(unit=1.0))
    assert given.poses == pytest.approx(plain.poses)
    with pytest.raises(InputError, match=r'm\.npz: key t: a body 0\.00\d+ m tall, if .* units of 0\.001 m'):
        load_trials(tmp_path / 'm.npz')


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        (lambda motion: motion[:, :3], r'key t has shape \(40, 3, 3\) of float64'),
        (lambda motion: motion[:0], r'key t has shape \(0, 15, 3\)'),
        (lambda motion: motion.astype(str), 'key t has shape .* of <U'),
        (lambda motion: np.where(np.arange(3) == 1, np.nan, motion), 'key t holds numbers that are not finite'),
        (lambda motion: motion.astype(object), 'holds Python objects'),
    ],
)
def test_what_is_no_motion_in_an_archive_is_refused_by_its_key(
    tmp_path: Path, poses: np.ndarray, change: Callable[[np.ndarray], np.ndarray], message: str
) -> None:
    np.savez(tmp_path / 'm.npz', _joints=np.array(CMU15.joints), t=change(1000 * poses))
    with pytest.raises(InputError, match=rf'm\.npz: .*{message}'):
        load_trials(tmp_path / 'm.npz')


@pytest.mark.parametrize(
    ('content', 'message'),
    [
        ('name,subject\na,1\n', 'no column trial'),
        ('trial\n' + 'x' * 200_000, 'not CSV: field larger than'),
    ],
)
def test_a_manifest_that_cannot_be_read_is_refused(
    tmp_path: Path, poses: np.ndarray, content: str, message: str
) -> None:
    np.savez(tmp_path / 'm.npz', _joints=np.array(CMU15.joints), t=1000 * poses)
    (tmp_path / 'list.csv').write_text(content)
    with pytest.raises(InputError, match=rf'list\.csv: .*{message}'):
        load_trials(tmp_path / 'm.npz', TrialOptions(manifest=tmp_path / 'list.csv'))


def test_a_motion_without_a_complete_frame_or_of_a_giant_is_refused(tmp_path: Path, poses: np.ndarray) -> None:
    bvh = build_armature(poses @ Z_UP_TO_Y_UP.T * 1e6, 30.0)
    save_bvh(tmp_path / 'walk.bvh', bvh)
    with pytest.raises(
        InputError, match=r'walk\.bvh: people are .* units tall, which is not the height of a person'
    ):
        load_trials(tmp_path / 'walk.bvh')


def test_an_archive_may_hold_more_joints_than_the_model(tmp_path: Path, poses: np.ndarray) -> None:
    names = ['nose', *CMU15.joints[::-1], 'ltoe']
    motion = np.concatenate([poses[:, :1], poses[:, ::-1], poses[:, :1]], axis=1) @ Z_UP_TO_Y_UP.T * 1e3
    arrays: dict[str, Any] = {'_joints': np.array(names), '99_01': motion}
    np.savez(tmp_path / 'm.npz', **arrays)
    (trial,) = load_trials(tmp_path / 'm.npz')
    assert trial.poses == pytest.approx(poses, abs=1e-9)


@pytest.mark.parametrize('names', [CMU15.joints[1:], (*CMU15.joints, CMU15.joints[0])])
def test_an_archive_names_each_joint_of_the_model_once(tmp_path: Path, names: tuple[str, ...]) -> None:
    arrays: dict[str, Any] = {'_joints': np.array(names), '99_01': np.zeros((5, len(names), 3))}
    np.savez(tmp_path / 'm.npz', **arrays)
    with pytest.raises(InputError, match='_joints must name'):
        load_trials(tmp_path / 'm.npz')
