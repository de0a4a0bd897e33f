# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Motion capture is read from files and folders in all formats, and what is none is refused by its place."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap_ros.errors import InputError, MocapError
from mocap_ros.formats.bvh import load_bvh, save_bvh
from mocap_ros.formats.export.armature import build_armature
from mocap_ros.formats.mocap.asf import load_amc
from mocap_ros.formats.mocap.joint_maps import LENGTH_UNITS_M, RIGS, infer_unit, load_marker_map, map_to_model
from mocap_ros.formats.mocap.trials import (
    Trial,
    TrialOptions,
    find_vertical_axis,
    load_trials,
    rotate_z_up,
    select_trials,
)
from mocap_ros.skeleton import CMU15
from tests.support.motion_files import AMC, ASF, Z_UP_TO_Y_UP, make_bvh, rotation_matrix


def test_positions_of_asf_follow_from_the_degrees_of_freedom(tmp_path: Path) -> None:
    (tmp_path / '07.asf').write_text(ASF)
    (tmp_path / '07_01.amc').write_text(AMC)
    positions = load_amc(tmp_path / '07_01.amc', tmp_path / '07.asf')
    root = rotation_matrix('z', 30) @ rotation_matrix('y', 20) @ rotation_matrix('x', 10)
    axes = rotation_matrix('z', 40) @ rotation_matrix('y', 30) @ rotation_matrix('x', 20)
    upper = root @ axes @ rotation_matrix('z', 35) @ rotation_matrix('y', 25) @ rotation_matrix('x', 15) @ axes.T
    axes = rotation_matrix('z', -7) @ rotation_matrix('x', 5)
    lower = upper @ axes @ rotation_matrix('x', 45) @ axes.T
    knee = np.array([1, 2, 3]) + upper @ [0, -3, 0]
    assert positions['root'][0] == pytest.approx([1, 2, 3])
    assert positions['upper'][0] == pytest.approx(knee)
    assert positions['lower'][0] == pytest.approx(knee + lower @ [1.2, -1.6, 0])
    assert positions['lower'][1] == pytest.approx([1.2, -4.6, 0])


def test_positions_of_bvh_follow_from_the_channels(tmp_path: Path) -> None:
    path = tmp_path / 'a.bvh'
    path.write_text(
        'HIERARCHY\nROOT Hips {\n OFFSET 9 9 9\n'
        ' CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n'
        ' JOINT A\n {\n OFFSET 0 2 0\n CHANNELS 3 Yrotation Zrotation Xrotation\n End Site\n {\n OFFSET 1 0 0\n'
        ' }\n }\n}\nMOTION\nFrames: 2\nFrame Time: .05\n0 0 0 0 0 0 0 0 0\n1 2 3 10 20 30 40 50 60\n'
    )
    bvh = load_bvh(path)
    assert bvh.names == ('Hips', 'A', 'A_end')
    root = rotation_matrix('z', 10) @ rotation_matrix('x', 20) @ rotation_matrix('y', 30)
    joint = np.array([1, 2, 3]) + root @ [0, 2, 0]
    end = joint + root @ rotation_matrix('y', 40) @ rotation_matrix('z', 50) @ rotation_matrix('x', 60) @ [1, 0, 0]
    assert bvh.compute_positions()[1] == pytest.approx(np.array([[1, 2, 3], joint, end]))
    assert bvh.compute_positions()[0] == pytest.approx(np.array([[0, 0, 0], [0, 2, 0], [1, 2, 0]]))
    save_bvh(tmp_path / 'b.bvh', bvh)
    assert load_bvh(tmp_path / 'b.bvh').compute_positions() == pytest.approx(bvh.compute_positions(), abs=1e-4)


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


def rename_joints(bvh: str, names: dict[str, str]) -> str:
    """Return the text of a BVH file in which joints have other names."""
    for name, replacement in names.items():
        bvh = bvh.replace(f' {name}\n', f' {replacement}\n')
    return bvh


@pytest.mark.parametrize('rig', ['Mixamo', 'LAFAN', 'joints'])
def test_known_rigs_are_recognised(tmp_path: Path, poses: np.ndarray, rig: str) -> None:
    path = tmp_path / 'a.bvh'
    save_bvh(path, build_armature(poses @ Z_UP_TO_Y_UP.T, 30.0))
    expected = load_trials(path)[0].poses
    text = path.read_text()
    names = [w for line in text.splitlines() for w in line.split()[1:2] if 'JOINT' in line or 'ROOT' in line]
    if rig == 'Mixamo':
        text = rename_joints(text, {w: f'mixamorig:{w}' for w in names})
    elif rig == 'LAFAN':
        text = rename_joints(text, {w: f'Model_{w}' for w in names})
    else:
        arm = [('Shoulder', 'Collar'), ('Arm', 'Shoulder'), ('ForeArm', 'Elbow'), ('Hand', 'Wrist')]
        leg = [('UpLeg', 'Hip'), ('Leg', 'Knee'), ('Foot', 'Ankle')]
        for side in ('Left', 'Right'):
            text = rename_joints(text, {side + part: f'{side}{name}!' for part, name in arm + leg})
        text = text.replace('!', '')
    path.write_text(text)
    assert load_trials(path)[0].poses == pytest.approx(expected, abs=1e-5)


def write_c3d(path: Path, labels: Sequence[str], positions: np.ndarray) -> None:
    """Write markers (F, M, 3) in m as a C3D file in mm."""
    ezc3d = pytest.importorskip('ezc3d')
    content = ezc3d.c3d()
    content['parameters']['POINT']['RATE']['value'] = [100]
    content['parameters']['POINT']['UNITS']['value'] = ['mm']
    content['parameters']['POINT']['LABELS']['value'] = list(labels)
    points = np.ones((4, len(labels), len(positions)))
    points[:3] = positions.transpose(2, 1, 0) * 1000
    content['data']['points'] = points
    content.write(str(path))


def test_markers_give_the_poses(tmp_path: Path, poses: np.ndarray) -> None:
    path = tmp_path / 'anna_1.c3d'
    positions = poses.copy()
    positions[7, 4] = np.nan
    write_c3d(path, [f'anna:{j}' for j in CMU15.joints], positions)
    (trial,) = load_trials(path)
    assert trial.subject == 'anna'
    assert trial.poses == pytest.approx(np.delete(poses, 7, axis=0), abs=1e-4)

    marker_map = tmp_path / 'markers.yaml'
    lines = [f'{joint}: {joint}' for joint in CMU15.joints if joint != 'pelvis']
    marker_map.write_text('\n'.join([*lines, 'pelvis: [lhip, rhip]']))
    (trial,) = load_trials(path, TrialOptions(markers=load_marker_map(marker_map)))
    hips = (trial.poses[:, CMU15.index('lhip')] + trial.poses[:, CMU15.index('rhip')]) / 2
    assert trial.poses[:, CMU15.index('pelvis')] == pytest.approx(hips)
    marker_map.write_text('\n'.join([*lines, 'pelvis: [LASI, RASI]']))
    with pytest.raises(InputError, match=r'anna_1\.c3d: no LASI, RASI; there are head, neck'):
        load_trials(path, TrialOptions(markers=load_marker_map(marker_map)))


BAD_FILES: list[tuple[str, str, str]] = [
    ('a.amc', '', r'a\.amc: no frames'),
    ('a.amc', '1\nnose 1 2\n', r"a\.amc: line 2: 'nose 1 2'"),
    ('a.amc', ':RADIANS\n', r'a\.amc: line 1: angles in radians'),
    ('a.amc', '1\nroot 0 0 0 0 0 0\nupper 1 2 3\n2\nroot 0 0 0 0 0 0\n', r'a\.amc: upper: a frame is cut off'),
    ('a.amc', AMC.replace('lower 45', 'lower nan'), r'a\.amc: lower: '),
    ('a.amc', AMC, r'a\.amc: joints of no known rig'),
    ('a.asf', ASF.replace('upper lower', 'upper hand'), r"a\.asf: hierarchy: there is no bone 'hand'"),
    ('a.asf', ASF.replace('upper lower', 'hand lower'), r"a\.asf: hierarchy: no path from the root to 'lower'"),
    ('a.asf', ASF.replace('0.6 -0.8 0', '0.6 nan 0'), r"a\.asf: line 33: 'end'"),
    ('a.bvh', '', 'not BVH'),
    ('a.bvh', make_bvh(lambda t: t), 'joints of no known rig; .* there are Hips, Hips_end'),
    ('a.bvh', make_bvh(lambda t: t.split('MOTION')[0][:-4]), 'cut off'),
    ('a.bvh', make_bvh(lambda t: t.replace('1 2 3', '1 3')), 'MOTION: 1 frames of 2 values, expected 1 of 3'),
    ('a.bvh', make_bvh(lambda t: t.replace('1 2 3', '1 nan 3')), 'MOTION: .* not finite'),
    ('a.bvh', make_bvh(lambda t: t.replace('0.1', '0')), 'MOTION: no frames'),
    ('a.bvh', make_bvh(lambda t: t.replace('Xrot', 'Wrot')), "line 5: 'CHANNELS 3"),
    ('a.bvh', make_bvh(lambda t: t.replace('End Site', 'JOINT Hips')), "two joints are called 'Hips'"),
    ('a.bvh', 'HIERARCHY\nROOT a\n{\n' + 'JOINT b\n{\n' * 5000, 'line 4002'),
    ('a.c3d', 'nothing of use', r'a\.c3d: not a C3D file'),
    ('manifest.csv', 'name,subject\na,1\n', 'no column trial'),
]


@pytest.mark.parametrize(('name', 'content', 'place'), BAD_FILES)
def test_an_invalid_file_is_refused_in_one_line(tmp_path: Path, name: str, content: str, place: str) -> None:
    if name == 'a.c3d':
        pytest.importorskip('ezc3d')
    beside = {'a.amc': ('a.asf', ASF), 'a.asf': ('a.amc', AMC), 'manifest.csv': ('b.bvh', make_bvh(str))}
    if name in beside:
        (tmp_path / beside[name][0]).write_text(beside[name][1])
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=place) as caught:
        load_trials(tmp_path)
    assert str(caught.value).startswith(f'{tmp_path / name}: ')
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize(
    ('names', 'change', 'place'),
    [
        (CMU15.joints, lambda motion: motion[:, :3], r't: shape \(40, 3, 3\), expected \(n, 15, 3\)'),
        (CMU15.joints, lambda motion: motion.astype(str), 't: holds <U'),
        (CMU15.joints, lambda motion: np.where(np.arange(3) == 1, np.nan, motion), 't: not finite'),
        (CMU15.joints[1:], lambda motion: motion, '_joints: expected the joints'),
    ],
)
def test_an_invalid_archive_is_refused_by_its_key(
    tmp_path: Path,
    poses: np.ndarray,
    names: tuple[str, ...],
    change: Callable[[np.ndarray], np.ndarray],
    place: str,
) -> None:
    np.savez(tmp_path / 'm.npz', _joints=np.array(names), t=change(1000 * poses))
    with pytest.raises(InputError, match=rf'm\.npz: .*{place}'):
        load_trials(tmp_path / 'm.npz')


def test_missing_files_and_giants_are_named(tmp_path: Path, poses: np.ndarray) -> None:
    (tmp_path / '35_01.amc').write_text(AMC)
    (tmp_path / 'empty').mkdir()
    save_bvh(tmp_path / 'walk.bvh', build_armature(poses @ Z_UP_TO_Y_UP.T * 1e6, 30.0))
    for name, place in (
        ('35_01.amc', r'35_01\.amc: no skeleton beside it, 35_01\.asf or 35\.asf'),
        ('none.amc', r'none\.amc: no skeleton beside it'),
        ('empty', r'no \.amc, \.bvh, \.c3d in it'),
        ('walk.bvh', r'walk\.bvh: people are .* units tall'),
    ):
        with pytest.raises(InputError, match=place):
            load_trials(tmp_path / name)


@pytest.mark.parametrize(
    ('content', 'message'),
    [
        ('[1]', 'expected joint'),
        ('nose: x', 'nose unknown; joints missing: head, neck'),
        ('\n'.join(f'{j}: []' for j in CMU15.joints), 'head: expected the name of a marker'),
        ('a: 1\na: 2', "line 2: the key 'a' occurs twice"),
    ],
)
def test_an_invalid_marker_map_is_refused(tmp_path: Path, content: str, message: str) -> None:
    (tmp_path / 'm.yaml').write_text(content)
    with pytest.raises(MocapError, match=message):
        load_marker_map(tmp_path / 'm.yaml')
