# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Results in every format agree, are read again from files and bags, and are drawn; who was seen, and when."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap_ros.api.files import read
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.cli.main import main
from mocap_ros.config import Config, RecorderConfig, with_values
from mocap_ros.demo.scene import make_recording
from mocap_ros.errors import InputError
from mocap_ros.formats.bvh import load_bvh
from mocap_ros.formats.mocap.joint_maps import map_to_model
from mocap_ros.formats.mocap.trials import load_trials
from mocap_ros.formats.reading_options import ReadingOptions
from mocap_ros.formats.sequence_file import save_sequence
from mocap_ros.geometry.distortion import Distortion
from mocap_ros.keypoints.keypoint_sequence import KeypointSequence
from mocap_ros.messages.camera_info import CAMERA_INFO, decode_camera_info
from mocap_ros.messages.cdr import Header, decode
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from mocap_ros.messages.skeletons import CAMERAS, SKELETONS, encode_skeletons
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.models.model_file import load_base_pose_models
from mocap_ros.people import Motion, MotionKind, Person3D, Posture
from mocap_ros.recordings import save_results
from mocap_ros.recordings.build_scene import build_scene
from mocap_ros.recordings.input_kind import InputKind, find_kind_with_results
from mocap_ros.recordings.load_results import load_recording, load_result
from mocap_ros.recordings.playback import DEFAULT_FRAME_ID
from mocap_ros.recordings.reconstruct import ReconstructionOptions, load_or_reconstruct, reconstruct
from mocap_ros.runtime.appearances import AppearanceLog
from mocap_ros.runtime.replay import ReplayOptions, replay
from mocap_ros.skeleton import BODY26, CMU15
from mocap_ros.units import NS_PER_S
from mocap_ros.viewing.scene import Scene, project_joints
from tests.support.bodies import gather, make_person_3d
from tests.support.camera_messages import encode
from tests.support.input_files import FRAMES, Z_UP_TO_Y_UP, make_walker
from tests.support.pipeline_inputs import FAST_CONFIG


def make_person(name: str, height: float) -> Person3D:
    return replace(make_person_3d(name), joints=np.full((15, 3), height), reprojection_residual=height / 10)


def test_a_result_file_and_a_bag_hold_the_same(results: Path, tmp_path: Path) -> None:
    assert find_kind_with_results(results / 'walk.npz') is InputKind.SEQUENCE
    assert find_kind_with_results(results / 'r.npz') is InputKind.RESULT
    assert find_kind_with_results(results / 'r.mcap') is InputKind.SKELETONS
    file, bag = (load_result(results / name) for name in ('r.npz', 'r.mcap'))
    assert bag.id == 'person_1'
    with np.load(results / 'r.npz') as arrays:
        assert np.array_equal(file.joints, arrays['joints3d'])
        assert np.array_equal(~file.inferred, arrays['seen'])
        assert np.array_equal(file.times, arrays['timestamps'])
    assert bag.joints == pytest.approx(file.joints, abs=1e-6)
    assert bag.reprojection_residual == pytest.approx(file.reprojection_residual, abs=1e-4, nan_ok=True)
    assert np.array_equal(bag.inferred, file.inferred)
    assert file.inferred.any()
    assert bag.stamps_ns == file.stamps_ns
    assert (bag.skeleton, file.skeleton) == (BODY26, BODY26)
    assert np.array_equal(bag.posture, file.posture)
    assert np.array_equal(bag.posture_probability, file.posture_probability)
    assert (file.posture == Posture.STANDING).mean() > 0.8, 'who walks'
    with np.load(results / 'r.npz') as arrays:
        np.savez(tmp_path / 'older.npz', **{k: v for k, v in arrays.items() if 'posture' not in k})
    assert not load_result(tmp_path / 'older.npz').posture.any()


def test_the_person_with_most_skeletons_is_read_from_a_bag(tmp_path: Path) -> None:
    a, *b = (make_person(name, height) for name, height in (('a', 2.0), ('b', 1.0), ('b', 3.0), ('b', 4.0)))
    with Recorder(tmp_path / 'bag', RecorderConfig(min_free_mb=0)) as recorder:
        for frame, people in enumerate(([b[0]], [a, b[1]], [], [b[2]])):
            stamp = 10**9 * (frame + 1) + 1
            recorder.write(
                '/skeletons', SKELETONS, encode_skeletons(Header(stamp, 'c'), gather(people)), stamp, stamp
            )
    result = load_result(tmp_path / 'bag')
    assert result.id == 'b'
    assert result.times == pytest.approx([1, 2, 3, 4])
    assert result.stamps_ns == [1000000001, 2000000001, 3000000001, 4000000001]
    assert result.joints[:, 0, 0] == pytest.approx([1, 3, np.nan, 4], nan_ok=True)
    assert result.reprojection_residual == pytest.approx([0.1, 0.3, np.nan, 0.4], nan_ok=True)
    assert (~result.inferred).sum(axis=1).tolist() == [14, 14, 0, 14]
    assert result.inferred[:, 2].all()
    other = load_result(tmp_path / 'bag', 'a')
    assert (other.id, other.in_sight.tolist()) == ('a', [False, True, False, False])
    with pytest.raises(InputError, match=r"bag: no person 'c'; there are b \(3\), a \(1\)"):
        load_result(tmp_path / 'bag', 'c')


def test_what_others_write_into_skeletons_is_read(tmp_path: Path) -> None:
    """A stamp that was not set, a motion and a posture that are none, and cameras that are not filled in."""
    stamps = [0, 10**18, 10**18 + 10**9]
    with Recorder(tmp_path / 'bag', RecorderConfig(min_free_mb=0)) as recorder:
        for stamp in stamps:
            array = decode(encode_skeletons(Header(stamp, 'c'), gather([make_person('a', 2.0)])), SKELETONS)
            array.people[0].motion.state = array.people[0].posture = 7
            recorder.write('/skeletons', SKELETONS, encode(array, SKELETONS), stamp, stamp)
    scene = build_scene('bag', load_recording(tmp_path / 'bag'))
    (person,) = scene.people
    assert scene.find_frames(person).tolist() == [0, 1]
    assert person.motion.tolist() == [MotionKind.UNKNOWN] * 2
    assert person.posture.tolist() == [Posture.UNKNOWN] * 2
    with Recorder(tmp_path / 'other', RecorderConfig(min_free_mb=0)) as recorder:
        people = gather([replace(make_person('a', 2.0), scale=0.0)])
        recorder.write('/skeletons', SKELETONS, encode_skeletons(Header(1, 'c'), people), 1, 1)
    assert len(load_result(tmp_path / 'other')) == 1
    with pytest.raises(InputError, match='other: /skeletons: scale, translation: not those of a camera'):
        load_recording(tmp_path / 'other')


@pytest.mark.parametrize(
    ('name', 'joint_count', 'flag_count', 'message'),
    [
        ('body26', 26, 0, 'skeletons of several layouts: body26, cmu15'),
        ('cmu15', 14, 0, r'people\[0\]: 14 joints, 0 inferred and 0 joint_std'),
        ('cmu15', 15, 14, r'people\[0\]: 15 joints, 14 inferred and 0 joint_std'),
    ],
)
def test_skeletons_that_do_not_fit_together_are_refused(
    tmp_path: Path, name: str, joint_count: int, flag_count: int, message: str
) -> None:
    arrays = [decode(encode_skeletons(Header(i, 'c'), gather([make_person('a', 1.0)])), SKELETONS) for i in (1, 2)]
    (skeleton,) = arrays[1].people
    skeleton.skeleton, skeleton.joints = name, (skeleton.joints * 2)[:joint_count]
    skeleton.inferred, skeleton.joint_std = np.zeros(flag_count, bool), np.zeros(0, np.float32)
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
        ({'joint_names': np.arange(26).astype(str)}, 'joint_names: 0, 1, .*: not those of a known skeleton'),
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
    with pytest.raises(InputError, match=r'r\.npz: .*--person does not apply'):
        load_result(results / 'r.npz', 'anna')
    with pytest.raises(InputError, match=r'r\.npz: .*--person does not apply'):
        load_recording(results / 'r.npz', ReadingOptions(person='anna'))
    with Recorder(tmp_path / 'bag', RecorderConfig(min_free_mb=0)):
        pass
    assert find_kind_with_results(tmp_path / 'bag') is InputKind.BAG
    with pytest.raises(InputError, match='bag: the bag has no skeletons'):
        load_result(tmp_path / 'bag')


@pytest.fixture(scope='module')
def walker() -> KeypointSequence:
    return make_walker()


@pytest.fixture(scope='module')
def results(tmp_path_factory: pytest.TempPathFactory, walker: KeypointSequence) -> Path:
    """Return a folder that holds the reconstruction of the walk in every format."""
    return run_reconstruct(tmp_path_factory.mktemp('results'), walker, 5, 'npz', 'csv', 'mcap', 'bvh', 'trc')


def run_reconstruct(
    folder: Path, sequence: KeypointSequence, iterations: int, *suffixes: str, **values: str
) -> Path:
    save_sequence(folder / 'walk.npz', sequence)
    outputs = [option for suffix in suffixes for option in ('-o', str(folder / f'r.{suffix}'))]
    settings = {'solver.max_iterations': iterations, **{f'tracker.{k}': v for k, v in values.items()}}
    options = [option for name, value in settings.items() for option in ('--set', f'{name}={value}')]
    assert main(['reconstruct', str(folder / 'walk.npz'), *outputs, '--model', 'walk', *options]) == 0
    return folder


def load_joints_in_world(folder: Path) -> np.ndarray:
    """Return the joints (F, 26, 3) in m of the .npz file: x ahead, y left, z up, over the floor."""
    result = np.load(folder / 'r.npz')
    world = result['world_from_camera']
    return result['joints3d'] @ world[:3, :3].T + world[:3, 3]


def test_bvh_has_constant_bones_and_the_same_joints(results: Path) -> None:
    bvh = load_bvh(results / 'r.bvh')
    assert bvh.frame_time == pytest.approx(1 / 30)
    joints = load_joints_in_world(results)[..., [1, 2, 0]]
    outer, joints = joints[:, len(CMU15.joints) :], joints[:, : len(CMU15.joints)]
    positions = dict(zip(bvh.names, np.moveaxis(bvh.compute_positions() / 100, 1, 0), strict=True))
    bvh_joints = map_to_model(positions)
    assert positions['Hips'][0, [0, 2]] == pytest.approx(0.0, abs=1e-6)
    assert 0.9 < positions['Hips'][0, 1] < 1.2  # m, over the floor
    lengths = np.stack([np.linalg.norm(joints[:, a] - joints[:, b], axis=1) for a, b in CMU15.bones])
    length_variation = np.abs(lengths - np.median(lengths, axis=1)[:, None]).max(axis=1).sum()
    assert np.linalg.norm(bvh_joints - joints, axis=-1).max() < length_variation + 1e-4
    assert np.linalg.norm(bvh_joints - joints, axis=-1).max() < 1.1 * 0.00133  # m, measured
    for a, b in CMU15.bones:
        # The bones are constant; the distance from a joint whose branches begin 1 cm beside it is nearly so.
        is_at_branches = bool({CMU15.joints[a], CMU15.joints[b]} & {'pelvis', 'neck'})
        limit = 1e-3 if is_at_branches else 1e-6
        assert np.ptp(np.linalg.norm(bvh_joints[:, a] - bvh_joints[:, b], axis=1)) < limit
    assert np.abs(np.diff(bvh.motion, axis=0)).max() < 1.1 * 11.8  # degrees, measured; no angle jumps by a turn
    for node, joint in (('LeftToe', 'ltoe'), ('RightHand_end', 'rhand')):
        end = outer[:, BODY26.index(joint) - len(CMU15.joints)]
        assert np.linalg.norm(positions[node] - end, axis=1).max() < 0.01  # m; bones are constant
    (trial,) = load_trials(results / 'r.bvh')
    assert trial.poses - trial.poses.mean(axis=1, keepdims=True) == pytest.approx(
        (joints - joints.mean(axis=1, keepdims=True)) @ Z_UP_TO_Y_UP, abs=0.002
    )


def test_trc_has_the_header_of_opensim(results: Path) -> None:
    lines = [line.split('\t') for line in (results / 'r.trc').read_text().splitlines()]
    assert lines[0] == ['PathFileType', '4', '(X/Y/Z)', 'r.trc']
    assert lines[1][:5] == ['DataRate', 'CameraRate', 'NumFrames', 'NumMarkers', 'Units']
    assert lines[2] == ['30', '30', '40', '26', 'mm', '30', '1', '40']
    assert (lines[3][:6], lines[4][:5]) == (['Frame#', 'Time', 'head', '', '', 'neck'], ['', '', 'X1', 'Y1', 'Z1'])
    assert {len(line) for line in (lines[3], lines[4], *lines[6:])} == {2 + 78}
    assert [int(line[0]) for line in lines[6:]] == list(range(1, FRAMES + 1))


SCALE_KNOWN = 1  # the value of Skeleton3D


@pytest.mark.parametrize('lens', [(0.1, -0.05, 0.001, -0.002), ()])
def test_a_bag_holds_the_camera_of_the_sequence(tmp_path: Path, walker: KeypointSequence, lens: Any) -> None:
    """The bag is an input again, with the same focal length, principal point and lens."""
    matrix = np.array([[910.0, 0.0, 331.0], [0.0, 905.0, 236.0], [0.0, 0.0, 1.0]])
    known = replace(walker, camera_matrix=matrix, distortion=np.array(lens) if lens else None)
    file = run_reconstruct(tmp_path, known, 2, 'mcap') / 'r.mcap'
    with Bag(file) as bag:
        messages = list(bag.messages(['/camera_info', '/keypoints']))
    assert [m.type for m in messages] == [CAMERA_INFO, KEYPOINTS] * FRAMES
    headers = [decode(m.raw, m.type).header for m in messages]
    assert headers[::2] == headers[1::2]
    camera = decode_camera_info(messages[0].raw)
    assert camera.size == walker.image_size
    assert camera.intrinsics.focal_lengths == pytest.approx([910.0, 905.0])
    assert camera.intrinsics.center == (331.0, 236.0)
    assert camera.intrinsics.distortion == Distortion('plumb_bob', lens)
    rectified = decode_camera_info(messages[0].raw, rectified=True).intrinsics
    assert rectified.focal_lengths == pytest.approx([910.0, 905.0])
    again = read(file).intrinsics(1.0)
    assert (again.focal, again.center, again.is_focal_known) == (camera.intrinsics.focal, (331.0, 236.0), True)
    quick = ['--set', 'tracker.model=walk', '--set', 'tracker.iterations=1']
    assert main(['replay', str(file), '-o', str(tmp_path / 'replayed'), *quick]) == 0
    with Bag(tmp_path / 'replayed') as bag:
        skeletons = [decode(m.raw, SKELETONS) for m in bag.messages(['/skeletons'])]
    assert {person.scale_source for message in skeletons for person in message.people} == {SCALE_KNOWN}


FIRST, LAST = 10, 29  # frames in which the person of the next test is seen first and last
GAP = slice(18, 21)  # frames between these in which the person is not seen


@pytest.fixture(scope='module')
def passing(tmp_path_factory: pytest.TempPathFactory, walker: KeypointSequence) -> Path:
    """Return a folder that holds, in every format, the reconstruction of a person who passes by."""
    folder = tmp_path_factory.mktemp('passing')
    keypoints = walker.keypoints.copy()
    for unseen in (slice(FIRST), GAP, slice(LAST + 1, None)):
        keypoints[unseen] = [np.nan, np.nan, 0.0]
    return run_reconstruct(folder, replace(walker, keypoints=keypoints), 5, 'npz', 'csv', 'mcap', 'bvh', 'trc')


def test_there_is_no_skeleton_before_the_first_and_after_the_last_sight(passing: Path) -> None:
    expected = np.zeros(FRAMES, bool)
    expected[FIRST : LAST + 1] = True
    with np.load(passing / 'r.npz') as result:
        for key in ('joints3d', 'scale', 'translation'):
            values = result[key].reshape(FRAMES, -1)
            assert np.array_equal(np.isfinite(values).all(axis=1), expected), key
            assert np.array_equal(np.isfinite(values).any(axis=1), expected), key
        assert not result['seen'][~expected].any()
        assert not result['seen'][GAP].any()
        joints = result['joints3d']
    table = np.genfromtxt(passing / 'r.csv', delimiter=',', skip_header=1)[:, 1:]
    assert table.reshape(FRAMES, 26, 3) == pytest.approx(joints, abs=1e-5, nan_ok=True)
    with Bag(passing / 'r.mcap') as bag:
        for topic, msgtype in (('/skeletons', SKELETONS), ('/cameras', CAMERAS)):
            messages = [decode(m.raw, msgtype) for m in bag.messages([topic])]
            counts = [len(m.people if msgtype == SKELETONS else m.cameras) for m in messages]
            assert counts == expected.astype(int).tolist()
        assert bag.count(['/keypoints']) == FRAMES


def test_a_trc_has_empty_fields_and_a_bvh_the_nearest_pose_where_there_is_no_skeleton(passing: Path) -> None:
    joints = load_joints_in_world(passing)[..., [0, 2, 1]] * [1, 1, -1]
    rows = [line.split('\t') for line in (passing / 'r.trc').read_text().splitlines()[6:]]
    assert len(rows) == FRAMES
    for frame, (_, time, *fields) in enumerate(rows):
        assert float(time) == pytest.approx(frame / 30, abs=1e-5)
        if FIRST <= frame <= LAST:
            assert np.array(fields, float).reshape(26, 3) / 1000 == pytest.approx(joints[frame], abs=1e-6)
        else:
            assert fields == [''] * 79
    bvh = load_bvh(passing / 'r.bvh').motion
    assert len(bvh) == FRAMES
    for held, frames in ((FIRST, range(FIRST)), (LAST, range(LAST + 1, FRAMES))):
        for frame in frames:
            assert np.array_equal(bvh[frame], bvh[held])
    assert not np.array_equal(bvh[FIRST], bvh[FIRST + 1])


DRAWN_FRAMES = 20
MODELS: dict[str, PoseModel] = load_base_pose_models('walk')
OPTIONS = ReconstructionOptions(with_values(Config(), {'solver.max_iterations': 2}), MODELS, max_people=None)


def show(path: Path, reading: ReadingOptions = OPTIONS.reading) -> Scene:
    """Return the scene of a result as it is, or of a recording that is reconstructed."""
    return build_scene(path.name, load_or_reconstruct(path, OPTIONS._replace(reading=reading)))


@pytest.fixture(scope='module')
def sequence() -> KeypointSequence:
    """The first frames of the demo recording, with one frame in which no person is seen."""
    whole = make_recording().sequence()
    keypoints = whole.keypoints[:DRAWN_FRAMES].copy()
    keypoints[12] = [np.nan, np.nan, 0]
    return replace(whole, keypoints=keypoints, timestamps=whole.timestamps[:DRAWN_FRAMES] + 5, truth=None)


@pytest.fixture(scope='module')
def bag(sequence: KeypointSequence, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A replay of these keypoints of two people, one message of which repeats a stamp and is dropped."""
    folder = tmp_path_factory.mktemp('bag')
    with Recorder(folder / 'in', RecorderConfig()) as recorder:
        for frame, stamp in enumerate(sequence.stamps_ns):
            anna, ben = sequence.person(frame, 'anna'), sequence.person(frame, 'ben')
            people = [anna, replace(ben, points=ben.points + [-90.0, 10.0])]
            raw = encode_keypoints(Header(stamp, DEFAULT_FRAME_ID), sequence.image_size, people)
            recorder.write('/keypoints', KEYPOINTS, raw, stamp, stamp)
            if frame == 7:
                recorder.write('/keypoints', KEYPOINTS, raw, stamp + 1, stamp + 1)
    with Bag(folder / 'in') as recorded:
        replay(recorded, folder / 'out', ReplayOptions(FAST_CONFIG))
    return folder / 'out'


def test_a_bag_is_drawn_as_it_was_recorded(bag: Path, sequence: KeypointSequence) -> None:
    recording = load_recording(bag, config=OPTIONS.config)
    scene, (line,) = build_scene(bag.name, recording), recording.notes
    assert '1 messages left out; /keypoints: message 9: ' in line
    assert scene.image_size == sequence.image_size
    assert scene.stamps_ns == sequence.stamps_ns
    assert {person.id for person in scene.people} == {'anna', 'ben'}
    by_id = {person.id: person for person in scene.people}
    with Bag(bag) as recorded:
        arrays = [decode(message.raw, SKELETONS) for message in recorded.messages(['/skeletons'])]
    skeletons = [(frame, skeleton) for frame, array in enumerate(arrays) for skeleton in array.people]
    assert len(skeletons) == sum(map(len, scene.people)) > DRAWN_FRAMES
    for frame, skeleton in skeletons:
        person = by_id[skeleton.id]
        (row,) = np.flatnonzero(scene.find_frames(person) == frame)
        joints = np.array([[j.x, j.y, j.z] for j in skeleton.joints])
        assert person.joints[row] == pytest.approx(joints, abs=1e-5)
        assert person.joint_std[row] == pytest.approx(skeleton.joint_std, nan_ok=True)
        assert person.inferred[row].tolist() == list(skeleton.inferred)
        assert project_joints(person)[row].mean(axis=0) == pytest.approx(skeleton.camera.translation, abs=8)
        assert person.reprojection_residual[row] == pytest.approx(skeleton.reprojection_residual, nan_ok=True)
        states = person.motion[row], person.predicted[row], person.tentative[row]
        assert states == (skeleton.motion.state, skeleton.predicted, skeleton.tentative)
    assert by_id['anna'].predicted[scene.find_frames(by_id['anna']) == 12].all()
    (keypoints,) = scene.keypoints
    rows = keypoints.frames == 3
    assert rows.sum() == 2
    assert keypoints.points[rows][0] == pytest.approx(sequence.keypoints[3, :, :2], abs=1e-3, nan_ok=True)
    (drop,) = scene.marks
    assert drop.time_s == pytest.approx(scene.times[7])
    assert 'repeats' in drop.text


def test_one_person_of_a_bag_is_shown_alone(bag: Path) -> None:
    scene = show(bag, ReadingOptions(person='ben'))
    assert [person.id for person in scene.people] == ['ben']
    with pytest.raises(InputError, match="no person 'carl'"):
        show(bag, ReadingOptions(person='carl'))
    with pytest.raises(InputError, match='there is no topic /nothing'):
        show(bag, ReadingOptions(topic='/nothing'))


def test_a_bag_of_keypoints_shows_all_people(bag: Path) -> None:
    scene = show(bag.with_name('in'))
    assert [person.id for person in scene.people] == ['anna', 'ben']
    assert all((np.diff(scene.find_frames(person)) == 1).all() for person in scene.people)
    anna, ben = scene.people
    left_of = np.median(project_joints(ben)[..., 0] - project_joints(anna)[..., 0])
    assert left_of == pytest.approx(-90, abs=15)
    assert (scene.keypoints[0].frames == 12).sum() == 0
    assert anna.predicted[scene.find_frames(anna) == 12].all()


@pytest.mark.parametrize('is_calibrated', [False, True])
def test_a_sequence_file_and_its_results_look_the_same(
    sequence: KeypointSequence, tmp_path: Path, *, is_calibrated: bool
) -> None:
    if is_calibrated:
        sequence = replace(sequence, camera_matrix=np.array([[480.0, 0, 320], [0, 480, 240], [0, 0, 1]]))
    save_sequence(tmp_path / 'in.npz', sequence)
    whole = build_scene('in', reconstruct(tmp_path / 'in.npz', OPTIONS._replace(max_people=1)))
    assert whole.summary.startswith('good; 1 person')
    (person,) = whole.people
    recording = reconstruct([sequence], OPTIONS)
    (result,) = recording.people
    assert person.joints == pytest.approx(result.joints, abs=1e-4)
    assert whole.intrinsics.is_focal_known == is_calibrated
    for suffix in ('.npz', '.mcap'):
        path = tmp_path / f'result{suffix}'
        save_results.save(path, result)
        scene = show(path)
        assert (scene.summary == str(recording.summary)) == (suffix == '.npz')
        (stored,) = scene.people
        assert stored.joints == pytest.approx(person.joints, abs=1e-4)
        assert project_joints(stored) == pytest.approx(project_joints(person), abs=1)
        assert stored.inferred.tolist() == person.inferred.tolist()
        assert scene.image_size == pytest.approx(sequence.image_size, abs=1)
        for found, known in zip(scene.keypoints, whole.keypoints, strict=True):
            seen = found.points[np.isfinite(found.points).any(axis=(1, 2))]
            assert seen == pytest.approx(known.points, abs=1e-3, nan_ok=True)
        assert scene.intrinsics.is_focal_known == is_calibrated
    with np.load(tmp_path / 'result.npz') as archive:  # as earlier versions wrote it
        old = {key: archive[key] for key in archive if not key.startswith(('keypoint', 'image_size', 'camera'))}
    np.savez(tmp_path / 'old.npz', **old)
    scene = show(tmp_path / 'old.npz')
    assert project_joints(scene.people[0]) == pytest.approx(project_joints(person), abs=1)
    assert not scene.keypoints


def test_what_shows_no_person_is_refused(sequence: KeypointSequence, tmp_path: Path) -> None:
    with Recorder(tmp_path / 'empty', RecorderConfig()) as recorder:
        for stamp in sequence.stamps_ns:
            raw = encode_keypoints(Header(stamp, DEFAULT_FRAME_ID), sequence.image_size, [])
            recorder.write('/keypoints', KEYPOINTS, raw, stamp, stamp)
    with pytest.raises(InputError, match='empty: no person is seen'):
        show(tmp_path / 'empty')
    with Bag(tmp_path / 'empty') as recorded:
        replay(recorded, tmp_path / 'replayed', ReplayOptions(FAST_CONFIG))
    with pytest.raises(InputError, match='replayed: no person is in any message'):
        show(tmp_path / 'replayed')


NAN = float('nan')
WALK = Motion(MotionKind.PERIODIC, 'walk', 0.01, 0.9)
OTHER = Motion(MotionKind.NON_PERIODIC, 'all', 0.1, NAN)
STRANGE = Motion(MotionKind.UNKNOWN, '', NAN, NAN)


def appear(name: str, motion: Motion = WALK, residual: float = 2.0, is_predicted: bool = False) -> Person3D:
    return replace(make_person(name, 10 * residual), motion=motion, predicted=is_predicted)


def test_times_motions_cadence_and_residual_are_added_up() -> None:
    log = AppearanceLog(absence_s=5, gap_s=4)
    for second, motion in enumerate([STRANGE, WALK, WALK, OTHER]):
        log.add(second * NS_PER_S, gather([appear('ann', motion, residual=1.0 + second)]))
    log.add(4 * NS_PER_S, gather([appear('ann', OTHER, NAN, is_predicted=True)]))
    (ann,) = log.list_all()
    assert (ann.person, ann.from_ns, ann.to_ns) == ('ann', 0, 4 * NS_PER_S)
    assert ann.seconds == {'unknown': 0.0, 'periodic': 2.0, 'non_periodic': 2.0}
    assert (ann.cadence, ann.residual) == (0.9, 2.5)


def test_who_was_away_for_long_appears_anew() -> None:
    log = AppearanceLog(absence_s=5, gap_s=4)
    for second in (0, 4, 10, 11):
        log.add(second * NS_PER_S, gather([appear('ann'), replace(appear('ghost'), tentative=True)]))
    log.add(12 * NS_PER_S, gather([appear('ben', STRANGE, NAN)]))
    assert log.list_all()[0].seconds['periodic'] == 4.0, 'the time away is no motion'
    spans = [(a.person, a.from_ns // NS_PER_S, a.to_ns // NS_PER_S) for a in log.list_all()]
    assert spans == [('ann', 0, 4), ('ann', 10, 11), ('ben', 12, 12)]
