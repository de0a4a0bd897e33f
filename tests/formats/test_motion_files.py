# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Motion capture is read in all formats; joint angles and armatures are written with their signs and lengths."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mocap_ros.errors import InputError, MocapError
from mocap_ros.formats.bvh import load_bvh, save_bvh
from mocap_ros.formats.export.armature import build_armature
from mocap_ros.formats.export.joint_angles import COORDINATES, POSITIONS, UPRIGHT_DEG, compute_joint_angles
from mocap_ros.formats.export.vmc import BONES, convert_armature
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
from tests.support.input_files import AMC, ASF, Z_UP_TO_Y_UP, make_bvh, make_poses, rotation_matrix


@pytest.fixture(scope='module')
def poses() -> np.ndarray:
    return make_poses()


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
    trials = [Trial(n, subject=n[0], category=n[2:], clean=n != '2_run', poses=poses) for n in names]
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


# m; where the joints are in the axes of their segments, of a person who stands upright with hanging arms
STANDING: dict[str, tuple[float, float, float]] = {
    'pelvis': (0, 0, 0), 'lhip': (0.04, -0.1, -0.1), 'rhip': (0.04, -0.1, 0.1),
    'neck': (0, 0.5, 0), 'lshoulder': (0.01, 0.45, -0.18), 'rshoulder': (0.01, 0.45, 0.18), 'head': (0, 0.2, 0),
    'lknee': (0, -0.44, 0), 'rknee': (0, -0.44, 0), 'lankle': (0, -0.42, 0), 'rankle': (0, -0.42, 0),
    'lelbow': (0, -0.3, 0), 'relbow': (0, -0.3, 0), 'lwrist': (0, -0.26, 0), 'rwrist': (0, -0.26, 0),
}  # fmt: skip


def compute_joints(values: np.ndarray, places: dict[str, Any]) -> np.ndarray:
    """Return the joints (F, 15, 3) in m of coordinates (F, C), written out from the formulas of `joint_angles`."""
    q = dict(zip(COORDINATES, values.T, strict=True))

    def turn(axis: str, name: str, sign: float = 1.0) -> Rotation:
        return Rotation.from_euler(axis, sign * q[name][:, None], degrees=True)

    at = {'pelvis': np.column_stack([q['pelvis_tx'], q['pelvis_ty'], q['pelvis_tz']])}

    def place(joint: str, segment: Rotation, origin: str) -> None:
        at[joint] = at[origin] + segment.apply(np.asarray(places[joint], float))

    pelvis = turn('y', 'pelvis_rotation') * turn('x', 'pelvis_list') * turn('z', 'pelvis_tilt')
    torso = pelvis * turn('z', 'lumbar_extension') * turn('x', 'lumbar_bending') * turn('y', 'lumbar_rotation')
    for joint in ('lhip', 'rhip'):
        place(joint, pelvis, 'pelvis')
    for joint in ('neck', 'lshoulder', 'rshoulder'):
        place(joint, torso, 'pelvis')
    place('head', torso * turn('z', 'neck_extension') * turn('x', 'neck_bending'), 'neck')
    for side, sign in (('r', 1.0), ('l', -1.0)):
        thigh = pelvis * turn('z', f'hip_flexion_{side}') * turn('x', f'hip_adduction_{side}', sign)
        thigh = thigh * turn('y', f'hip_rotation_{side}', sign)
        place(f'{side}knee', thigh, f'{side}hip')
        place(f'{side}ankle', thigh * turn('z', f'knee_angle_{side}', -1.0), f'{side}knee')
        arm = torso * turn('z', f'arm_flex_{side}') * turn('x', f'arm_add_{side}', sign)
        arm = arm * turn('y', f'arm_rot_{side}', sign)
        place(f'{side}elbow', arm, f'{side}shoulder')
        place(f'{side}wrist', arm * turn('z', f'elbow_flex_{side}'), f'{side}elbow')
    return np.stack([at[joint] for joint in CMU15.joints], axis=1)


FPS = 30.0
# m; the hips of `STANDING` lie below the pelvis at the angle by which joint angles take a pelvis as upright
HIP_DROP = np.hypot(*STANDING['rhip'][:2])
HIP = HIP_DROP * np.sin(np.radians(UPRIGHT_DEG)), -HIP_DROP * np.cos(np.radians(UPRIGHT_DEG))
SHOULDERS = {'lshoulder': (0.0, 0.45, -0.18), 'rshoulder': (0.0, 0.45, 0.18)}
PLACES = {**STANDING, **SHOULDERS, 'rhip': (*HIP, 0.1), 'lhip': (*HIP, -0.1)}
ANGLES = [name for name in COORDINATES if name not in POSITIONS]
# degrees; beyond these, the angles of other coordinates mean little
LIMITS = {'pelvis_list': (-70, 70), 'lumbar_bending': (-60, 60), 'neck_bending': (-60, 60)}
LIMITS |= {f'{name}_{side}': (20, 150) for side in 'rl' for name in ('knee_angle', 'elbow_flex')}
LIMITS |= {f'{name}_{side}': (-60, 60) for side in 'rl' for name in ('hip_adduction', 'arm_add')}


def build_values(frames: int = 1, /, **values: Any) -> np.ndarray:
    """Return coordinates (F, C) that are 0 but for these; knees and elbows are bent by 30 degrees."""
    bent = {f'{name}_{side}': 30.0 for side in 'rl' for name in ('knee_angle', 'elbow_flex')}
    columns = {**dict.fromkeys(COORDINATES, 0.0), **bent, **values}
    return np.column_stack([np.broadcast_to(np.asarray(columns[name], float), frames) for name in COORDINATES])


def measure(values: np.ndarray) -> dict[str, np.ndarray]:
    found = compute_joint_angles(compute_joints(values, PLACES), FPS)
    return dict(zip(COORDINATES, found.T, strict=True))


@settings(max_examples=60)
@given(st.data())
def test_the_angles_of_a_pose_are_found_again(data: st.DataObject) -> None:
    values = {name: data.draw(st.floats(*LIMITS.get(name, (-80, 80)))) for name in ANGLES}
    values |= {name: data.draw(st.floats(-5, 5)) for name in POSITIONS}
    found = measure(build_values(**values))
    for name, value in values.items():
        assert found[name][0] == pytest.approx(value, abs=1e-3), name


@pytest.mark.parametrize(
    ('joint', 'axis', 'name', 'sign'),
    [  # in which direction a joint moves, of a person who faces along x, if an angle grows
        ('rknee', 0, 'hip_flexion_r', 1), ('lknee', 0, 'hip_flexion_l', 1),
        ('rknee', 2, 'hip_adduction_r', -1), ('lknee', 2, 'hip_adduction_l', 1),
        ('rankle', 0, 'knee_angle_r', -1), ('lankle', 0, 'knee_angle_l', -1),
        ('relbow', 0, 'arm_flex_r', 1), ('lelbow', 2, 'arm_add_l', 1), ('relbow', 2, 'arm_add_r', -1),
        ('rwrist', 0, 'elbow_flex_r', 1), ('neck', 0, 'lumbar_extension', -1), ('neck', 2, 'lumbar_bending', 1),
        ('head', 0, 'neck_extension', -1), ('neck', 0, 'pelvis_tilt', -1), ('rhip', 1, 'pelvis_list', -1),
        ('rhip', 0, 'pelvis_rotation', 1), ('rshoulder', 0, 'lumbar_rotation', 1),
        ('rankle', 2, 'hip_rotation_r', 1), ('lankle', 2, 'hip_rotation_l', -1),
    ],
)  # fmt: skip
def test_the_signs_are_those_of_the_documents(joint: str, axis: int, name: str, sign: int) -> None:
    index = CMU15.joints.index(joint)
    before = compute_joints(build_values(), PLACES)[0, index, axis]
    bent = build_values()[0, COORDINATES.index(name)] + 20.0
    moved = compute_joints(build_values(**{name: bent}), PLACES)
    assert np.sign(moved[0, index, axis] - before) == sign
    assert compute_joint_angles(moved, FPS)[0, COORDINATES.index(name)] == pytest.approx(bent, abs=1e-3)


def test_whole_turns_are_counted() -> None:
    turns = np.linspace(-30.0, 750.0, 120)
    found = measure(build_values(120, pelvis_rotation=turns))
    assert found['pelvis_rotation'] - found['pelvis_rotation'][0] == pytest.approx(turns + 30.0, abs=1e-3)
    found = measure(build_values(120, arm_flex_r=turns))  # arms that circle
    assert found['arm_flex_r'] - found['arm_flex_r'][0] == pytest.approx(turns + 30.0, abs=1e-3)


def test_an_arm_is_raised_sideways_above_the_head_without_a_jump() -> None:
    raised = np.linspace(0.0, -170.0, 61)
    found = measure(build_values(61, arm_add_r=raised, arm_add_l=raised, arm_rot_r=10.0))
    for side in 'rl':
        assert found[f'arm_add_{side}'] == pytest.approx(raised, abs=1.0)
        assert found[f'arm_flex_{side}'] == pytest.approx(np.zeros(61), abs=3.0)
    assert found['arm_rot_r'] == pytest.approx(np.full(61, 10.0), abs=3.0)


def test_the_turn_of_a_straight_leg_is_interpolated() -> None:
    bend = np.r_[np.full(20, 40.0), np.full(10, 2.0), np.full(20, 40.0)]
    turn = np.r_[np.full(20, 0.0), np.full(10, 90.0), np.full(20, 20.0)]  # what noise makes of a straight leg
    found = measure(build_values(50, knee_angle_r=bend, hip_rotation_r=turn))
    assert found['hip_rotation_r'][[0, 18, 31, 49]] == pytest.approx([0.0, 0.0, 20.0, 20.0], abs=1.0)
    assert (np.diff(found['hip_rotation_r']) >= -1e-6).all()
    assert found['hip_rotation_r'][25] == pytest.approx(10.0, abs=6.0)


@pytest.mark.parametrize(('first', 'last'), [(40.0, 40.0), (-4.0, 40.0), (-4.0, -4.0)])
def test_a_knee_that_is_overstretched_turns_no_leg(first: float, last: float) -> None:
    bend = np.r_[np.full(30, first), np.full(60, -4.0), np.full(30, last)]
    found = measure(build_values(120, knee_angle_r=bend, hip_rotation_r=10.0, hip_flexion_r=100.0))
    for name, expected in (('knee_angle_r', bend), ('hip_rotation_r', 10.0), ('hip_flexion_r', 100.0)):
        assert found[name] == pytest.approx(np.broadcast_to(expected, 120), abs=0.5)


@pytest.mark.filterwarnings('error')
def test_degenerate_bodies_give_finite_angles_and_bones() -> None:
    point = np.zeros((3, 15, 3))
    line = np.repeat(np.linspace([0, 0, 0], [0, 2, 0], 15)[None], 3, axis=0)
    across = line[..., [1, 0, 2]]
    for joints in (point, line, across, line[:1]):
        assert np.isfinite(compute_joint_angles(joints, FPS)).all()
        bvh = build_armature(joints, FPS)
        assert np.isfinite(bvh.motion).all()
        assert (np.linalg.norm(bvh.offsets[1:], axis=1) > 0.99).all()


def test_vmc_has_the_joints_of_the_bvh_in_the_axes_of_unity(poses: np.ndarray) -> None:
    bvh = build_armature(poses, FPS)
    expected = bvh.compute_positions()[7] / 100 * [-1, 1, 1]
    pose = list(convert_armature(bvh))[7]
    places: dict[str, np.ndarray] = {}
    turns = {'': Rotation.identity()}
    for name, position, quaternion in zip(pose.names, pose.positions, pose.quaternions, strict=True):
        parent = BONES[name][1]
        places[name] = turns[parent].apply(position) + (places[parent] if parent else 0)
        turns[name] = turns[parent] * Rotation.from_quat(quaternion)
    for lower, upper in (
        ('LowerArm', 'UpperArm'),
        ('Hand', 'LowerArm'),
        ('LowerLeg', 'UpperLeg'),
        ('Foot', 'LowerLeg'),
    ):
        for side in ('Left', 'Right'):
            ends = [bvh.names.index(BONES[side + bone][0]) for bone in (lower, upper)]
            bone = places[side + lower] - places[side + upper]
            assert bone == pytest.approx(expected[ends[0]] - expected[ends[1]], abs=1e-9)
