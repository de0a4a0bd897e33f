"""Other people's files: detections and motion capture are read, results for others are read back."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.cli.main import main
from mocap_ros.config import NodeConfig, RecorderConfig
from mocap_ros.demo.scene import make_recording
from mocap_ros.errors import InputError, MocapError
from mocap_ros.formats.coco_json import load_coco
from mocap_ros.formats.detections import Detections, Video, person_of, sequence_of, tracks
from mocap_ros.formats.export.armature import armature
from mocap_ros.formats.export.bvh import save_bvh
from mocap_ros.formats.mocap import trials
from mocap_ros.formats.mocap.asf import load_amc
from mocap_ros.formats.mocap.bvh import load_bvh
from mocap_ros.formats.mocap.joint_maps import RIGS, UNITS, load_markers, model_joints, unit_of
from mocap_ros.formats.mocap.trials import Source, load_trials
from mocap_ros.formats.openpose_json import load_openpose
from mocap_ros.formats.sequence_file import NS, Sequence, save_sequence
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.cdr import Header, decode
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from mocap_ros.messages.skeletons import SKELETONS
from mocap_ros.models.model_file import load_base_poses
from mocap_ros.runtime.load_keypoints import load_input
from mocap_ros.skeleton import CMU15, joint_map, layout
from mocap_ros.training.base_poses import fit_base_poses

FRAMES = 40
FPS = 25.0
COCO = layout('coco17').joints
VIDEO = Video(fps=FPS, image_size=(640, 480))
LIMITS = NodeConfig()
Z_UP_TO_Y_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


@pytest.fixture(scope='module')
def walker() -> Sequence:
    """The beginning of the demo, where somebody walks; no camera matrix, no truth."""
    demo = make_recording().sequence()
    return Sequence(demo.keypoints[:FRAMES], demo.joint_names, demo.timestamps[:FRAMES], demo.image_size)


@pytest.fixture(scope='module')
def poses() -> np.ndarray:
    """(F, 15, 3) m, z up, moved about."""
    model = load_base_poses('walk')
    theta = np.sin(np.arange(FRAMES)[:, None] / 5 + np.arange(4)) * model.std[:4]
    return model.poses(theta) + np.linspace([0, 0, 0.9], [2, 1, 0.9], FRAMES)[:, None]


def raw(sequence: Sequence) -> list[list[float]]:
    """x, y, score of all joints for each frame, zeros where not seen, as detectors write it."""
    return np.nan_to_num(sequence.keypoints).reshape(len(sequence), -1).tolist()


def same_keypoints(found: Detections, wanted: Sequence) -> None:
    sequence, _ = sequence_of(found)
    assert sequence.joint_names == wanted.joint_names
    assert sequence.keypoints == pytest.approx(wanted.keypoints, nan_ok=True, abs=1e-4)
    assert sequence.timestamps == pytest.approx(np.arange(FRAMES) / FPS)
    assert sequence.image_size == (640, 480)


# --- detections ---


def test_openpose_folder(tmp_path: Path, walker: Sequence) -> None:
    for frame, keypoints in enumerate(raw(walker)):
        person = {'person_id': [-1], 'pose_keypoints_2d': keypoints, 'face_keypoints_2d': []}
        content = {'version': 1.3, 'people': [person]}
        (tmp_path / f'clip2_{frame:012d}_keypoints.json').write_text(json.dumps(content))
    same_keypoints(load_openpose(tmp_path, VIDEO), walker)
    (tmp_path / 'clip2_000000000007_keypoints.json').unlink()
    sequence, _ = sequence_of(load_openpose(tmp_path, VIDEO))
    assert len(sequence) == FRAMES
    assert not sequence.keypoints[7, :, 2].any()
    with pytest.raises(InputError, match='--fps'):
        load_openpose(tmp_path, Video())


def mmpose(frames: list[list[float]]) -> list[dict[str, Any]]:
    return [
        {
            'frame_id': f,
            'instances': [
                {
                    'keypoints': np.reshape(k, (-1, 3))[:, :2].tolist(),
                    'keypoint_scores': k[2::3],
                    'bbox_score': 0.9,
                }
            ],
        }
        for f, k in enumerate(frames)
    ]


def yolo(keypoints: list[float]) -> dict[str, Any]:
    """A person as `to_json` writes it."""
    x, y, visible = keypoints[::3], keypoints[1::3], keypoints[2::3]
    return {'name': 'person', 'confidence': 0.8, 'keypoints': {'x': x, 'y': y, 'visible': visible}}


def annotations(frames: list[list[float]]) -> dict[str, Any]:
    """With ids that say nothing of the order."""
    number = range(len(frames))
    return {
        'images': [{'id': 900 - f, 'file_name': f'cam1/{f:05d}.png', 'width': 640, 'height': 480} for f in number],
        'categories': [
            {
                'id': 1,
                'name': 'person',
                'keypoints': [n.replace('l', 'left_', 1) if n[0] == 'l' else n for n in COCO],
            }
        ],
        'annotations': [{'image_id': 900 - f, 'category_id': 1, 'keypoints': frames[f]} for f in number],
    }


FORMS: dict[str, Callable[[list[list[float]]], Any]] = {
    'COCO results': lambda k: [{'image_id': i + 100, 'keypoints': p, 'score': 0.9} for i, p in enumerate(k)],
    'AlphaPose': lambda k: [
        {'image_id': f'{i}.jpg', 'category_id': 1, 'keypoints': p, 'score': 2.9, 'idx': [3.0]}
        for i, p in enumerate(k)
    ],
    'MMPose': mmpose,
    'MMPose demo': lambda k: {'meta_info': {}, 'instance_info': mmpose(k)},
    'YOLO to_json': lambda k: [[yolo(p)] for p in k],
    'YOLO unlikely others': lambda k: [
        *({'image_id': i, 'keypoints': p, 'score': 0.9} for i, p in enumerate(k)),
        *({'image_id': i, 'keypoints': p, 'score': 0.01} for i, p in enumerate(k)),
    ],
}


@pytest.mark.parametrize('form', FORMS)
def test_coco_and_its_kin(tmp_path: Path, walker: Sequence, form: str) -> None:
    path = tmp_path / 'people.json'
    path.write_text(json.dumps(FORMS[form](raw(walker))))
    same_keypoints(load_coco(path, VIDEO), walker)


def test_coco_annotations_bring_names_sizes_and_flags(tmp_path: Path, walker: Sequence) -> None:
    path = tmp_path / 'people.json'
    flagged = np.nan_to_num(walker.keypoints).reshape(FRAMES, -1, 3).copy()
    flagged[..., 2] = np.where(flagged[..., 2] > 0, 2, 0)
    flagged[3, 0, 2] = 1
    path.write_text(json.dumps(annotations(flagged.reshape(FRAMES, -1).tolist())))
    sequence, _ = sequence_of(load_coco(path, Video(fps=FPS)))
    assert sequence.image_size == (640, 480)
    assert sequence.joint_names == COCO
    assert sequence.keypoints[0, :, :2] == pytest.approx(walker.keypoints[0, :, :2], nan_ok=True)
    assert set(np.unique(sequence.keypoints[..., 2])) == {0.0, 0.5, 1.0}


def test_bag(tmp_path: Path, walker: Sequence) -> None:
    start = 1_760_000_000_123_456_789
    stamps = [start + f * NS // 25 for f in range(FRAMES)]
    with Recorder(tmp_path / 'bag', RecorderConfig(min_free_mb=0)) as recorder:
        for frame, stamp in enumerate(stamps):
            data = encode_keypoints(Header(stamp, 'cam'), (640, 480), [walker.person(frame, 'anna')])
            recorder.write('/k', KEYPOINTS, data, stamp, stamp)
        recorder.write('/k', KEYPOINTS, b'\0\1\0\0', stamps[-1] + 1, stamps[-1] + 1)
    sequence, lines = load_input(tmp_path / 'bag', Video(), LIMITS)
    assert sequence.stamps_ns == stamps
    assert (sequence.person_id, sequence.frame_id, sequence.image_size) == ('anna', 'cam', (640, 480))
    assert sequence.keypoints == pytest.approx(walker.keypoints, nan_ok=True, abs=1e-3)
    assert "'anna', seen in 40 of 40 frames" in lines[0]
    assert '1 messages left out; /k: message 41' in lines[1]
    with pytest.raises(InputError, match="bag: no person 'bob'; there are anna"):
        load_input(tmp_path / 'bag', Video(), LIMITS, person='bob')


def standing(x: float, person_id: str = '') -> Person2D:
    """Somebody 100 px tall."""
    points = np.stack([x + np.linspace(0, 30, 17), np.linspace(100, 200, 17), np.ones(17)], axis=1)
    return person_of(points, person_id=person_id)


def every_40_ms(people: list[list[Person2D]]) -> Detections:
    return Detections(people, [f * NS // 25 for f in range(len(people))], (640, 480))


def test_people_without_ids_are_told_apart_by_position() -> None:
    here, there = [standing(100 + f) for f in range(30)], [standing(400 - f) for f in range(30)]
    people = [[a, b] if f % 2 else [b, a] for f, (a, b) in enumerate(zip(here, there, strict=True))]
    people[10:15] = [[a] for a in here[10:15]]
    left, right = sorted(tracks(every_40_ms(people)), key=lambda t: t.seen[0].points[0, 0])
    assert (len(left.seen), len(right.seen)) == (30, 25)
    assert [p.points[0, 0] for p in left.seen.values()] == list(range(100, 130))
    sequence, lines = sequence_of(every_40_ms(people))
    assert sequence.keypoints[0, 0, 0] == 100
    assert f'person {left.id!r}, seen in 30 of 30 frames; 1 more, choose by --person: ' in lines[0]
    assert f'{left.id} (30), {right.id} (25)' in lines[0]
    other, _ = sequence_of(every_40_ms(people), right.id)
    assert other.keypoints[0, 0, 0] == 400


def test_somebody_alone_stays_the_same_through_any_gap() -> None:
    people = [[standing(100)], *[[] for _ in range(200)], [standing(500)]]
    assert len(tracks(every_40_ms(people))) == 1
    named = [[standing(100, 'a')], [standing(500, 'b')], [standing(100, 'a')]]
    assert [t.id for t in tracks(every_40_ms(named))] == ['a', 'b']


BAD_JSON = {
    'not json': ('{', 'not JSON'),
    'deep': ('[' * 100_000, 'nested too deep'),
    'number': ('3', 'expected a list'),
    'other mapping': ('{"a": 1}', 'neither annotations nor instance_info'),
    'openpose frame': ('{"people": []}', 'one frame of OpenPose, give its folder'),
    'empty': ('[]', 'no frames'),
    'no image': ('[{"keypoints": [1, 2, 3]}]', r'\[0\]: expected image_id'),
    'text': ('[{"image_id": 1, "keypoints": "abc"}]', r'\[0\]: keypoints: expected x, y, score'),
    'odd length': ('[{"image_id": 1, "keypoints": [1, 2, 3, 4]}]', r'\[0\]: keypoints: expected x, y, score'),
    'one number': ('[{"image_id": 1, "keypoints": 7}]', r'\[0\]: keypoints: expected x, y, score'),
    'few': ('[{"image_id": 1, "keypoints": [1, 2, 1]}]', r'\[0\]: 1 keypoints: no layout known'),
    'infinite': (
        json.dumps([{'image_id': 1, 'keypoints': [1e300] * 51}]),
        r'\[0\]: x of nose is 1e\+300',
    ),
    'far apart': (
        json.dumps([{'image_id': i, 'keypoints': [100.0, 100.0, 1.0] * 17} for i in (1, 2, 10**9)]),
        'frames are numbered 1 to 1000000000',
    ),
    'normalised': (
        json.dumps([{'image_id': i, 'keypoints': [0.5, 0.5, 1.0] * 17} for i in (1, 2)]),
        'look normalised',
    ),
    'nobody': (json.dumps([{'image_id': i, 'keypoints': [0] * 51} for i in (1, 2)]), 'nobody is seen'),
}


@pytest.mark.parametrize('case', BAD_JSON)
def test_bad_json_is_refused_in_one_line(tmp_path: Path, case: str) -> None:
    content, message = BAD_JSON[case]
    path = tmp_path / 'people.json'
    path.write_text(content)
    with pytest.raises(InputError, match=rf'people\.json: .*{message}') as caught:
        load_input(path, VIDEO, LIMITS)
    assert '\n' not in str(caught.value)


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4)
    | st.dictionaries(
        st.sampled_from(
            ['image_id', 'keypoints', 'frame_id', 'instances', 'annotations', 'images', 'id', 'idx', 'score',
             'people', 'pose_keypoints_2d', 'person_id', 'x', 'y', 'visible', 'keypoint_scores', 'categories']
        ),
        inner,
        max_size=4,
    ),
    max_leaves=12,
)  # fmt: skip


@settings(max_examples=150, deadline=None)
@given(content=json_values)
def test_any_json_is_read_or_refused(tmp_path_factory: pytest.TempPathFactory, content: object) -> None:
    folder = tmp_path_factory.mktemp('any')
    for path in (folder / 'a.json', folder / 'a_0_keypoints.json'):
        path.write_text(json.dumps(content))
    for path in (folder / 'a.json', folder):
        with contextlib.suppress(MocapError):
            load_input(path, VIDEO, LIMITS)


# --- results ---


@pytest.fixture(scope='module')
def written(tmp_path_factory: pytest.TempPathFactory, walker: Sequence) -> Path:
    """A folder with the walk reconstructed in every form."""
    folder = tmp_path_factory.mktemp('written')
    save_sequence(folder / 'walk.npz', walker)
    for ending in ('npz', 'csv', 'mcap', 'bvh', 'trc'):
        quick = ['--model', 'walk', '--set', 'solver.max_iterations=5']
        assert main(['reconstruct', str(folder / 'walk.npz'), '-o', str(folder / f'r.{ending}'), *quick]) == 0
    return folder


def test_cameras_of_results_show_the_keypoints(written: Path, walker: Sequence) -> None:
    result = np.load(written / 'r.npz')
    body = result['joints3d'] - result['joints3d'].mean(axis=1, keepdims=True)
    image = result['scale'][:, None, None] * body[..., :2] + result['translation'][:, None]
    points, score = joint_map(walker.joint_names).apply(walker.keypoints[..., :2], walker.keypoints[..., 2])
    off = np.linalg.norm(image - points, axis=-1)[score > 0]
    assert np.sqrt((off**2).mean()) < 1.2 * np.sqrt((result['residual_px'] ** 2).mean())
    turns = result['rotation']
    assert turns @ np.swapaxes(turns, 1, 2) == pytest.approx(np.broadcast_to(np.eye(3), turns.shape), abs=1e-6)


def y_up(folder: Path) -> np.ndarray:
    return np.load(folder / 'r.npz')['joints3d'] * np.array([1, -1, -1])


def test_bag_of_results(written: Path) -> None:
    joints = np.load(written / 'r.npz')['joints3d']
    with Bag(written / 'r.mcap') as bag:
        assert {'/keypoints', '/skeletons', '/cameras', '/markers', '/skeleton_definition'} <= bag.topics.keys()
        found = [decode(m.raw, SKELETONS) for m in bag.messages(['/skeletons'])]
    assert len(found) == FRAMES
    points = np.array([[(p.x, p.y, p.z) for p in m.people[0].joints] for m in found])
    assert points == pytest.approx(joints, abs=1e-5)
    assert not list(written.glob('.*'))


def test_bvh_of_results_has_constant_bones_and_the_same_joints(written: Path) -> None:
    bvh = load_bvh(written / 'r.bvh')
    assert bvh.frame_time == pytest.approx(1 / 30)
    joints = y_up(written)
    positions = dict(zip(bvh.names, np.moveaxis(bvh.positions() / 100, 1, 0), strict=True))
    read = model_joints(positions)
    lengths = np.stack([np.linalg.norm(joints[:, a] - joints[:, b], axis=1) for a, b in CMU15.bones])
    off = np.abs(lengths - np.median(lengths, axis=1)[:, None]).max(axis=1).sum()
    assert np.linalg.norm(read - joints, axis=-1).max() < off + 1e-4
    assert np.linalg.norm(read - joints, axis=-1).max() < 0.03
    for a, b in CMU15.bones:
        assert np.ptp(np.linalg.norm(read[:, a] - read[:, b], axis=1)) < 1e-4
    assert np.abs(np.diff(bvh.motion, axis=0)).max() < 180
    (trial,) = load_trials(written / 'r.bvh')
    assert trial.poses - trial.poses.mean(axis=1, keepdims=True) == pytest.approx(
        (joints - joints.mean(axis=1, keepdims=True)) @ Z_UP_TO_Y_UP, abs=0.03
    )


@pytest.mark.filterwarnings('error')
def test_a_line_and_a_point_make_an_armature_too() -> None:
    for joints in (np.zeros((3, 15, 3)), np.repeat(np.linspace([0, 0, 0], [0, 2, 0], 15)[None], 3, axis=0)):
        assert np.isfinite(armature(joints, 30.0).motion).all()


def test_trc_of_results(written: Path) -> None:
    lines = (written / 'r.trc').read_text().splitlines()
    assert lines[0] == 'PathFileType\t4\t(X/Y/Z)\tr.trc'
    assert lines[1].split('\t')[:5] == ['DataRate', 'CameraRate', 'NumFrames', 'NumMarkers', 'Units']
    assert lines[2].split('\t') == ['30', '30', '40', '15', 'mm', '30', '1', '40']
    assert lines[3].split('\t')[:6] == ['Frame#', 'Time', 'head', '', '', 'neck']
    assert lines[4].split('\t')[:5] == ['', '', 'X1', 'Y1', 'Z1']
    assert {len(line.split('\t')) for line in (lines[3], lines[4], *lines[6:])} == {2 + 45}
    assert not lines[5]
    table = np.loadtxt(written / 'r.trc', skiprows=6)
    assert table[:, 0].tolist() == list(range(1, FRAMES + 1))
    assert table[:, 1] == pytest.approx(np.arange(FRAMES) / 30, abs=1e-5)
    assert table[:, 2:].reshape(-1, 15, 3) / 1000 == pytest.approx(y_up(written), abs=1e-6)


def test_uneven_times_become_a_constant_rate(tmp_path: Path, walker: Sequence) -> None:
    kept = [f for f in range(FRAMES) if f not in (9, 10, 11)]
    uneven = Sequence(walker.keypoints[kept], COCO, walker.timestamps[kept], walker.image_size)
    save_sequence(tmp_path / 'w.npz', uneven)
    quick = ['--model', 'walk', '--set', 'solver.max_iterations=3']
    assert main(['reconstruct', str(tmp_path / 'w.npz'), '-o', str(tmp_path / 'w.bvh'), *quick]) == 0
    bvh = load_bvh(tmp_path / 'w.bvh')
    assert (len(bvh.motion), bvh.frame_time) == (FRAMES, pytest.approx(1 / 30))


# --- motion capture ---


def turn(axis: str, degrees: float) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array({
        'x': [[1, 0, 0], [0, c, -s], [0, s, c]],
        'y': [[c, 0, s], [0, 1, 0], [-s, 0, c]],
        'z': [[c, -s, 0], [s, c, 0], [0, 0, 1]],
    }[axis])  # fmt: skip


def test_bvh_kinematics(tmp_path: Path) -> None:
    path = tmp_path / 'a.bvh'
    path.write_text(
        'HIERARCHY\nROOT Hips {\n OFFSET 9 9 9\n'
        ' CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n'
        ' JOINT A\n {\n OFFSET 0 2 0\n CHANNELS 3 Yrotation Zrotation Xrotation\n End Site\n {\n OFFSET 1 0 0\n'
        ' }\n }\n}\nMOTION\nFrames: 2\nFrame Time: .05\n0 0 0 0 0 0 0 0 0\n1 2 3 10 20 30 40 50 60\n'
    )
    bvh = load_bvh(path)
    assert bvh.names == ('Hips', 'A', 'A_end')
    root = turn('z', 10) @ turn('x', 20) @ turn('y', 30)
    a = np.array([1, 2, 3]) + root @ [0, 2, 0]
    end = a + root @ turn('y', 40) @ turn('z', 50) @ turn('x', 60) @ [1, 0, 0]
    assert bvh.positions()[1] == pytest.approx(np.array([[1, 2, 3], a, end]))
    assert bvh.positions()[0] == pytest.approx(np.array([[0, 0, 0], [0, 2, 0], [1, 2, 0]]))
    save_bvh(tmp_path / 'b.bvh', bvh)
    assert load_bvh(tmp_path / 'b.bvh').positions() == pytest.approx(bvh.positions(), abs=1e-4)


ASF = """# made for a test
:version 1.10
:name x
:units
  mass 1.0
  length 0.45
  angle deg
:root
   order TX TY TZ RX RY RZ
   axis XYZ
   position 0 0 0
   orientation 0 0 0
:bonedata
  begin
     id 1
     name upper
     direction 0 -1 0
     length 3
     axis 20 30 40   XYZ
    dof rx ry rz
    limits (-160.0 20.0)
           (-70.0 70.0)
           (-60.0 70.0)
  end
  begin
     id 2
     name lower
     direction 0.6 -0.8 0
     length 2
     axis 5 0 -7  XYZ
    dof rx
    limits (-10.0 170.0)
  end
:hierarchy
  begin
    root upper
    upper lower
  end
"""
AMC = """:FULLY-SPECIFIED
:DEGREES
1
root 1 2 3 10 20 30
upper 15 25 35
lower 45
2
root 0 0 0 0 0 0
upper 0 0 0
lower 0
"""


def test_asf_kinematics(tmp_path: Path) -> None:
    (tmp_path / '07.asf').write_text(ASF)
    (tmp_path / '07_01.amc').write_text(AMC)
    found = load_amc(tmp_path / '07_01.amc', tmp_path / '07.asf')
    root = turn('z', 30) @ turn('y', 20) @ turn('x', 10)
    axes = turn('z', 40) @ turn('y', 30) @ turn('x', 20)
    upper = root @ axes @ turn('z', 35) @ turn('y', 25) @ turn('x', 15) @ axes.T
    axes = turn('z', -7) @ turn('x', 5)
    lower = upper @ axes @ turn('x', 45) @ axes.T
    knee = np.array([1, 2, 3]) + upper @ [0, -3, 0]
    assert found['root'][0] == pytest.approx([1, 2, 3])
    assert found['upper'][0] == pytest.approx(knee)
    assert found['lower'][0] == pytest.approx(knee + lower @ [1.2, -1.6, 0])
    assert found['lower'][1] == pytest.approx([1.2, -4.6, 0])


def cmu_asf(pose: np.ndarray) -> str:
    """A skeleton with the CMU names whose rest pose is `pose` (15, 3) in CMU units, y up."""
    at = dict(zip(CMU15.joints, pose, strict=True))
    names = RIGS['CMU ASF']
    ways = [(p, c) for p, c in ((CMU15.joints[p], CMU15.joints[c]) for p, c in CMU15.outward())]
    bones = ''
    for parent, child in ways:
        way = at[child] - at[parent]
        length = np.linalg.norm(way)
        direction = ' '.join(f'{v:.12f}' for v in way / length)
        freedom = 'dof rx ry rz\n' if child == 'lknee' else ''
        bones += f'begin\nname {names[child]}\ndirection {direction}\nlength {length:.12f}\n'
        bones += f'axis 0 0 0 XYZ\n{freedom}end\n'
    tree = ''.join(f'{names[p]} {names[c]}\n' for p, c in ways)
    return (
        ':units\nangle deg\n:root\norder TX TY TZ RX RY RZ\naxis XYZ\nposition 0 0 0\norientation 0 0 0\n'
        f':bonedata\n{bones}:hierarchy\nbegin\n{tree}end\n'
    )


def test_trials_of_asf_and_amc(tmp_path: Path, poses: np.ndarray) -> None:
    folder = tmp_path / 'walk'
    folder.mkdir()
    rest = (poses[0] - poses[0, 8]) @ Z_UP_TO_Y_UP.T / UNITS['unit of the CMU database']
    (folder / '99.asf').write_text(cmu_asf(rest))
    (folder / '99_03.amc').write_text(':DEGREES\n1\nroot 0 0 0 0 0 0\n2\nroot 10 0 0 0 90 0\n')
    (trial,) = load_trials(tmp_path)
    assert (trial.name, trial.subject, trial.category) == ('99_03', '99', 'walk')
    assert trial.poses[0] == pytest.approx(poses[0] - poses[0, 8], abs=1e-6)
    turned = (poses[0] - poses[0, 8]) @ turn('z', 90).T + [10 * UNITS['unit of the CMU database'], 0, 0]
    assert trial.poses[1] == pytest.approx(turned, abs=1e-6)
    (folder / 'manifest.csv').write_text('trial,subject,category,interior_glitches\n99_03,5,run,2\n')
    (trial,) = load_trials(tmp_path)
    assert (trial.subject, trial.category, trial.clean) == ('5', 'run', False)


def test_training_from_bvh_is_training_from_the_poses(tmp_path: Path, poses: np.ndarray, capsys) -> None:
    bvh = armature(poses @ Z_UP_TO_Y_UP.T, 30.0)
    stretched = np.moveaxis(bvh.positions() / 100, 1, 0)
    wanted = fit_base_poses(
        [model_joints(dict(zip(bvh.names, stretched, strict=True))) @ Z_UP_TO_Y_UP], alignment='heading'
    )
    for name in ('one_1.bvh', 'one_2.bvh'):
        save_bvh(tmp_path / name, bvh)
    options = ['--alignment', 'heading', '--no-mirror', '--bodies', '0', '-o', str(tmp_path / 'm.npz')]
    assert main(['train', str(tmp_path), *options]) == 0
    assert '2 trials, 80 poses' in capsys.readouterr().out
    model = load_base_poses(tmp_path / 'm.npz')
    assert model.mean == pytest.approx(wanted.mean, abs=1e-4)
    assert model.std[:4] == pytest.approx(wanted.std[:4], rel=1e-3)
    assert main(['train', str(tmp_path), '--every', '4', *options]) == 0
    assert '2 trials, 20 poses' in capsys.readouterr().out


def renamed(bvh: str, names: dict[str, str]) -> str:
    for old, new in names.items():
        bvh = bvh.replace(f' {old}\n', f' {new}\n')
    return bvh


@pytest.mark.parametrize('rig', ['Mixamo', 'LAFAN', 'joints'])
def test_other_rigs_by_name(tmp_path: Path, poses: np.ndarray, rig: str) -> None:
    path = tmp_path / 'a.bvh'
    save_bvh(path, armature(poses @ Z_UP_TO_Y_UP.T, 30.0))
    wanted = load_trials(path)[0].poses
    text = path.read_text()
    words = [w for line in text.splitlines() for w in line.split()[1:2] if 'JOINT' in line or 'ROOT' in line]
    if rig == 'Mixamo':
        text = renamed(text, {w: f'mixamorig:{w}' for w in words})
    elif rig == 'LAFAN':
        text = renamed(text, {w: f'Model_{w}' for w in words})
    else:
        parts = ('Shoulder', 'Collar'), ('Arm', 'Shoulder'), ('ForeArm', 'Elbow'), ('Hand', 'Wrist')
        parts += ('UpLeg', 'Hip'), ('Leg', 'Knee'), ('Foot', 'Ankle')
        for side in ('Left', 'Right'):
            text = renamed(text, {side + old: f'{side}{new}!' for old, new in parts})
        text = text.replace('!', '')
    path.write_text(text)
    assert load_trials(path)[0].poses == pytest.approx(wanted, abs=1e-5)


@pytest.mark.parametrize('up', range(3))
def test_units_and_the_vertical_are_found(poses: np.ndarray, up: int) -> None:
    bvh = armature(poses @ Z_UP_TO_Y_UP.T, 30.0)
    positions = dict(zip(bvh.names, np.moveaxis(bvh.positions(), 1, 0), strict=True))
    joints = model_joints(positions)
    for name, metres in UNITS.items():
        rolled = np.roll(joints * 0.01 / metres, up - 1, axis=-1)
        assert unit_of(rolled) == metres, name
        vertical = trials._vertical(rolled, usual=0)
        assert vertical == up
        upright = trials._z_up(rolled, vertical)
        assert np.linalg.det(np.linalg.lstsq(rolled[0], upright[0], rcond=None)[0]) == pytest.approx(1)
        assert (upright[:, 0, 2] > upright[:, 11, 2]).all()
        assert trials._vertical(-rolled, usual=0) == ~up


def test_c3d(tmp_path: Path, poses: np.ndarray) -> None:
    ezc3d = pytest.importorskip('ezc3d')
    content = ezc3d.c3d()
    content['parameters']['POINT']['RATE']['value'] = [100]
    content['parameters']['POINT']['UNITS']['value'] = ['mm']
    content['parameters']['POINT']['LABELS']['value'] = [f'anna:{j}' for j in CMU15.joints]
    points = np.ones((4, 15, FRAMES))
    points[:3] = np.moveaxis(poses, 0, -1).transpose(1, 0, 2) * 1000
    points[:3, 4, 7] = np.nan
    content['data']['points'] = points
    path = tmp_path / 'anna_1.c3d'
    content.write(str(path))
    (trial,) = load_trials(path)
    assert trial.subject == 'anna'
    assert trial.poses == pytest.approx(np.delete(poses, 7, axis=0), abs=1e-4)

    mapping = tmp_path / 'markers.yaml'
    lines = [f'{joint}: {joint}' for joint in CMU15.joints if joint != 'pelvis']
    mapping.write_text('\n'.join([*lines, 'pelvis: [lhip, rhip]']))
    (trial,) = load_trials(path, Source(markers=load_markers(mapping)))
    hips = (trial.poses[:, CMU15.index('lhip')] + trial.poses[:, CMU15.index('rhip')]) / 2
    assert trial.poses[:, CMU15.index('pelvis')] == pytest.approx(hips)
    mapping.write_text('\n'.join([*lines, 'pelvis: [LASI, RASI]']))
    with pytest.raises(InputError, match=r'anna_1\.c3d: no LASI, RASI; there are head, neck'):
        load_trials(path, Source(markers=load_markers(mapping)))


def test_c3d_without_its_library(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, 'ezc3d', None)
    (tmp_path / 'a.c3d').write_bytes(b'')
    with pytest.raises(MocapError, match=r"a\.c3d: C3D needs ezc3d: pip install 'mocap_ros\[c3d\]'"):
        load_trials(tmp_path)


def small_bvh(change: Callable[[str], str]) -> str:
    return change(
        'HIERARCHY\nROOT Hips\n{\nOFFSET 0 0 0\nCHANNELS 3 Zrotation Xrotation Yrotation\nEnd Site\n{\n'
        'OFFSET 0 1 0\n}\n}\nMOTION\nFrames: 1\nFrame Time: 0.1\n1 2 3\n'
    )


BAD_MOCAP = {
    'a.bvh': {
        'empty': ('', 'not BVH'),
        'rig': (small_bvh(lambda t: t), 'joints of no known rig; .* lacks .*; there are Hips, Hips_end'),
        'cut': (small_bvh(lambda t: t.split('MOTION')[0][:-4]), 'not BVH, or cut off'),
        'value': (small_bvh(lambda t: t.replace('1 2 3', '1 x 3')), 'MOTION: could not convert'),
        'values': (small_bvh(lambda t: t.replace('1 2 3', '1 3')), r'1 frames of 2 values, expected 1 of 3'),
        'nan': (small_bvh(lambda t: t.replace('1 2 3', '1 nan 3')), 'not finite'),
        'channel': (small_bvh(lambda t: t.replace('Xrot', 'Wrot')), 'line 5: .CHANNELS 3'),
        'no values': (small_bvh(lambda t: t.replace('1 2 3', '')), 'MOTION: no frames'),
        'no time': (small_bvh(lambda t: t.replace('0.1', '0')), 'MOTION: no frames'),
        'deep': ('HIERARCHY\nROOT a\n{\n' + 'JOINT b\n{\n' * 5000, 'line 4002'),
    },
    'a.amc': {
        'empty': ('', r'a\.amc: no frames'),
        'bone': ('1\nnose 1 2\n', r"a\.amc: line 2: 'nose 1 2' is not AMC, or of another skeleton"),
        'degrees': (':RADIANS\n', 'line 1: angles in radians'),
        'cut': ('1\nroot 0 0 0 0 0 0\nupper 1 2 3\n2\nroot 0 0 0 0 0 0\n', 'upper: a frame is cut off'),
        'rig': (AMC, r'a\.amc: joints of no known rig'),
    },
    'a.c3d': {'garbage': ('nothing of use', r'a\.c3d: not a C3D file')},
}


@pytest.mark.parametrize(('name', 'case'), [(n, c) for n, cases in BAD_MOCAP.items() for c in cases])
def test_bad_motion_capture_is_refused_in_one_line(tmp_path: Path, name: str, case: str) -> None:
    if name.endswith('c3d'):
        pytest.importorskip('ezc3d')
    content, message = BAD_MOCAP[name][case]
    (tmp_path / 'a.asf').write_text(ASF)
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=message) as caught:
        load_trials(tmp_path)
    assert name in str(caught.value)
    assert '\n' not in str(caught.value)


@pytest.mark.filterwarnings('error')
@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_mangled_motion_capture_is_read_or_refused(tmp_path_factory: pytest.TempPathFactory, data) -> None:
    folder = tmp_path_factory.mktemp('mangled')
    for name, content in (('a.asf', ASF), ('a.amc', AMC), ('b.bvh', small_bvh(lambda t: t))):
        start = data.draw(st.integers(0, len(content)))
        end = data.draw(st.integers(start, min(start + 20, len(content))))
        filling = data.draw(st.text('0 123eE.-{}\n:naifr', max_size=5))
        (folder / name).write_text(content[:start] + filling + content[end:])
    for name in ('a.amc', 'b.bvh'):
        with pytest.raises(MocapError, match=str(folder)):
            load_trials(folder / name)


def test_what_is_missing_beside_an_amc_is_said(tmp_path: Path) -> None:
    (tmp_path / '35_01.amc').write_text(AMC)
    with pytest.raises(InputError, match=r'35_01\.amc: no skeleton beside it, 35_01\.asf or 35\.asf'):
        load_trials(tmp_path)
    (tmp_path / 'empty').mkdir()
    with pytest.raises(InputError, match=r'no \.amc, \.bvh, \.c3d in it'):
        load_trials(tmp_path / 'empty')
    with pytest.raises(InputError, match=r'none\.amc: no skeleton|none\.amc: No such'):
        load_trials(tmp_path / 'none.amc')


@pytest.mark.parametrize(
    ('content', 'message'),
    [
        ('[1]', 'expected joint'),
        ('nose: x', 'nose unknown; joints missing: head, neck'),
        ('\n'.join(f'{j}: []' for j in CMU15.joints), 'head: expected the name of a marker'),
        ('{' * 3000, 'm.yaml: not YAML: '),
        ('a: 1\na: 2', "'a' twice"),
    ],
)
def test_bad_markers_are_refused(tmp_path: Path, content: str, message: str) -> None:
    (tmp_path / 'm.yaml').write_text(content)
    with pytest.raises(MocapError, match=message):
        load_markers(tmp_path / 'm.yaml')
