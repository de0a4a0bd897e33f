# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""How large a person is: what feet on a floor show, what they do not, and that the image stays the same; the
vertical of the camera: found, given, contradicted, forgotten, and of use."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mocap_ros.config import Config, with_settings, with_values
from mocap_ros.demo.scene import make_recording
from mocap_ros.errors import ConfigError
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.level import Floor, is_level
from mocap_ros.geometry.rigid_transform import parse_camera_pose
from mocap_ros.keypoints.keypoint_sequence import KeypointSequence
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.models.model_file import load_base_pose_models
from mocap_ros.people import CameraVertical, Person3D, PoseSequence
from mocap_ros.skeleton import find_roots
from mocap_ros.solvers.vertical import MAX_STD_DEG, read_given_vertical
from mocap_ros.tracking.body_size import ANKLE_SHARE, ANKLES, BodySize, SizeEvidence, assume_size
from mocap_ros.tracking.tracker import PeopleTracker
from mocap_ros.verdict.input_faults import MIN_JUDGED_S, VerticalCheck
from tests.support.bodies import STANDING, UPRIGHT, angles_deg, gather, make_person_3d
from tests.support.synthetic_walk import STEP_NS, make_sequence, make_walk, see
from tests.support.whole_sequence import reconstruct_sequence

HEIGHT_M = 1.7
ASSUMED = assume_size(Config().tracker)
CAMERA_HEIGHT_M = 1.5
LEVEL = Floor(np.array([0.0, -1.0, 0.0]), CAMERA_HEIGHT_M)
CAMERA = Intrinsics(600.0, (320.0, 240.0), is_focal_known=True)


def make_standing(ratio: float, distance: float = 4.0, lift: float = 0.0) -> Person3D:
    """A person of the assumed size with the image of one `ratio` times as large, at a true distance in m.

    Those feet are on the floor of `LEVEL` or `lift` m above it.
    """
    body = STANDING * ratio
    lowest = body[list(ANKLES), 1].max()
    down = CAMERA_HEIGHT_M - lift - ANKLE_SHARE * HEIGHT_M * ratio - lowest
    joints = (body + [0.2, down, distance]) / ratio
    return replace(
        make_person_3d('anna'),
        joints=joints,
        joint_std=np.full(15, 0.03),
        joint_velocity=np.zeros((15, 3)),
        joint_velocity_std=np.full(15, 0.3),
        root_velocity_covariance=np.eye(3),
    )


def advance(
    before: SizeEvidence | None, stamp_ns: int, person: Person3D, floor: Floor = LEVEL
) -> SizeEvidence | None:
    seen = np.where(person.inferred, 0.0, 1.0)
    return SizeEvidence.add_floor(before, stamp_ns, person.joints, person.joint_velocity, seen, floor, HEIGHT_M)


def contact_after(frames: int, person: Person3D, floor: Floor = LEVEL) -> SizeEvidence | None:
    contact = None
    for frame in range(frames):
        contact = advance(contact, frame * STEP_NS, person, floor)
    return contact


@given(st.floats(0.5, 1.2), st.floats(1.5, 8.0))
@settings(max_examples=40)
def test_feet_on_the_floor_show_the_size(ratio: float, distance: float) -> None:
    contact = contact_after(60, make_standing(ratio, distance))
    assert contact is not None
    assert contact.mean == pytest.approx(math.log(ratio), abs=1e-9)
    size = contact.find_size(BodySize(1.0, 1e3))
    assert size.ratio == pytest.approx(ratio, rel=1e-6)
    among_adults = contact.find_size(ASSUMED)
    assert min(1, ratio) - 1e-9 <= among_adults.ratio <= max(1, ratio) + 1e-9, 'between what is usual and seen'
    assert among_adults.share < min(ASSUMED.share, size.share)


def test_the_longer_and_the_nearer_the_more_certain() -> None:
    def find_share(frames: int, distance: float = 4.0, camera_height: float = CAMERA_HEIGHT_M) -> float:
        floor = LEVEL._replace(camera_height=camera_height)
        contact = contact_after(frames, make_standing(1.1, distance), floor)
        return contact.find_size(ASSUMED).share if contact else math.inf

    shares = [find_share(n) for n in (1, 30, 300, 3000)]
    assert shares == sorted(shares, reverse=True)
    assert shares[-1] > 0.02, 'the tilt of the camera stays unknown'
    assert min(find_share(300, distance=10.0), find_share(300, camera_height=0.5)) > shares[2]
    assert assume_size(Config().tracker, '', True, 0.01).share < ASSUMED.share, 'little of the body is hidden'
    assert assume_size(Config().tracker, '', True, 6e-16) == ASSUMED, 'rounding hides nothing'


@pytest.mark.parametrize(
    'person',
    [
        make_standing(1.0, lift=0.5),  # on a step, a body would have to be 2.5 m tall
        replace(make_standing(1.1), joint_velocity=np.tile([0.0, -1.0, 0.0], (15, 1))),  # jumps
        replace(
            make_standing(1.1), joint_velocity=np.full((15, 3), np.nan)
        ),  # not known whether the foot is still
        replace(make_standing(1.1), joints=make_standing(1.1).joints - [0, 3, 0]),  # above the camera
        replace(make_standing(1.1), inferred=np.ones(15, bool)),
    ],
)
def test_what_is_no_foot_on_the_floor_shows_nothing(person: Person3D) -> None:
    known = contact_after(30, make_standing(1.1))
    assert advance(known, 31 * STEP_NS, person) is known
    assert advance(known, 29 * STEP_NS, make_standing(1.1)) is known, 'the same frame again'
    assert advance(None, 0, person) is None


@pytest.mark.parametrize('height', [1.5, 1.9])
def test_the_tracker_finds_people_of_their_own_size(walk_model: PoseModel, height: float) -> None:
    walk = make_walk(walk_model, 60)
    poses = walk_model.poses(walk.theta) @ np.swapaxes(walk.cameras.rotation[:1], -1, -2)
    upward = walk.cameras.rotation[0] @ [0.0, 0.0, 1.0]
    joints = height / walk_model.stature * poses + [0.0, 0.0, 4.0]
    lowest = (joints[:, list(ANKLES)] @ upward).min()
    floor = Floor(upward, float(ANKLE_SHARE * height - lowest))
    parameters = {'tracker.camera_height': floor.camera_height, 'tracker.vertical': ' '.join(map(str, upward))}
    without = PeopleTracker(walk_model, with_settings(Config(), {'solver.components': 8}))
    with_parameters = PeopleTracker(walk_model, with_settings(Config(), {'solver.components': 8, **parameters}))
    distances = {}
    cases = ('parameters', with_parameters, None), ('floor', without, floor), ('nothing', without, None)
    for name, tracker, known in cases:
        tracker.reset()
        for frame, image in enumerate(CAMERA.project(joints)):
            (person,) = tracker.update(frame * STEP_NS, [see(image)], CAMERA, known).people
        distances[name] = abs(np.log(person.root[2] / (joints[-1, 9, 2] + joints[-1, 12, 2]) * 2))
        (ahead,) = tracker.predict((0.001,))
        np.testing.assert_allclose(ahead.joints[0], person.core, atol=0.02)
        (gap,) = tracker.update(59 * STEP_NS + 1_000_000, [], CAMERA, known).people
        np.testing.assert_allclose(gap.joints, person.joints, atol=0.02)
    assert max(distances['floor'], distances['parameters']) < 0.6 * distances['nothing']
    assert tracker.vertical is None or math.degrees(tracker.vertical.std) > 1, 'that of the floor is forgotten'


def test_the_floor_in_the_frame_of_the_outputs() -> None:
    pose = parse_camera_pose('3 1 1.5 0 0.2 0.7', 'test')
    floor = Floor.find(pose, 0.3)
    assert floor.camera_height == pytest.approx(1.2)
    np.testing.assert_allclose(floor.upward, [0, -np.cos(0.2), -np.sin(0.2)], atol=1e-12)
    for height in (None, 2.0):  # not known, or above the camera
        assert Floor.find(pose, height).camera_height is None
        assert advance(None, 0, make_standing(1.1), Floor.find(pose, height)) is None
    names = ('map', 'robot_1/odom', 'base_link', 'camera_map')
    assert [is_level(name) for name in names] == [True, True, False, False]


def test_a_known_height_counts_from_when_the_detector_names_the_person() -> None:
    sequence = make_recording().sequence()
    people: list[list[Person3D]] = [[], []]
    for text, found in (('bob=2.0', people[0]), ('ann=1.36', people[1])):
        tracker = PeopleTracker(
            load_base_pose_models('all'), with_settings(Config(), {'tracker.body_heights': text})
        )
        for frame, name in enumerate(('', '', 'ann', '', 'ann_again')):
            seen = [sequence.person(frame, name)]
            found.extend(tracker.update(frame * STEP_NS, seen, sequence.intrinsics(1.0)).people)
            if frame > 1:
                (ahead,) = tracker.predict((0.0,))
                np.testing.assert_allclose(find_roots(ahead.joints[0]), found[-1].root, atol=1e-6)
    for before, after, ratio in zip(*people, (1, 1, 0.8, 0.8, 1), strict=True):
        assert (before.id, after.id) == ('person_1', 'person_1'), 'the name of a person is stable'
        for name, power in (
            ('joints', 1),
            ('joint_velocity', 1),
            ('joint_velocity_std', 1),
            ('scale', -1),
        ):
            np.testing.assert_allclose(getattr(after, name), ratio**power * getattr(before, name), rtol=1e-6)
        covariance = ratio**2 * before.root_velocity_covariance
        np.testing.assert_allclose(after.root_velocity_covariance, covariance, rtol=1e-6)
        is_surer = after.joint_std < (1 - 1e-6) * ratio * before.joint_std
        assert is_surer.all() == is_surer.any() == (ratio < 1), 'of a known size'


@pytest.mark.parametrize('text', ['1.82', '7=182', '7=nan', '=1.8', '7=tall', '7=1.82; anna=1.65', '7=1.8, 7=1.9'])
def test_wrong_heights_are_refused_at_the_start(walk_model: PoseModel, text: str) -> None:
    with pytest.raises(ConfigError, match=r'tracker\.body_heights'):
        PeopleTracker(walk_model, with_settings(Config(), {'tracker.body_heights': text}))


SEQUENCE = make_recording().sequence()
DEMO_CAMERA = SEQUENCE.intrinsics(1.0)
MODELS = load_base_pose_models('all')
FRAMES = 60


def make_tracker(**values: object) -> PeopleTracker:
    return PeopleTracker(MODELS, with_values(Config(), {f'tracker.{k}': v for k, v in values.items()}))


def feed_demo(
    tracker: PeopleTracker,
    first: int,
    last: int,
    camera: Intrinsics = DEMO_CAMERA,
    sequence: KeypointSequence = SEQUENCE,
) -> list[np.ndarray]:
    """Return the joints of one person in some frames of the demo."""
    given = [(sequence.stamps_ns[frame], [sequence.person(frame, 'ann')], camera) for frame in range(first, last)]
    return [tracker.update(*frame).people[-1].joints for frame in given]


def reconstruct(vertical: str, frames: int = FRAMES, sequence: KeypointSequence = SEQUENCE) -> PoseSequence:
    config = with_values(Config(), {'tracker.vertical': vertical})
    times = SEQUENCE.timestamps[:frames]
    part = make_sequence(sequence.keypoints[:frames].astype(float), times, DEMO_CAMERA, SEQUENCE.joint_names)
    return reconstruct_sequence(part, MODELS, config)


def find(tracker: PeopleTracker) -> CameraVertical:
    assert tracker.vertical is not None
    return tracker.vertical


def test_it_is_found_from_certain_people_and_is_that_of_the_whole_sequence() -> None:
    tracker = make_tracker()
    feed_demo(tracker, 0, 2)
    assert tracker.vertical is None, 'a tentative person may be none'
    feed_demo(tracker, 2, 4)
    early = find(tracker)
    feed_demo(tracker, 4, FRAMES)
    late, whole = find(tracker), reconstruct('auto')
    assert late.std < early.std
    assert np.linalg.norm(late.direction) == pytest.approx(1)
    assert late.direction[1] < -0.9, 'y is down in the camera, which is nearly level'
    assert angles_deg(late.direction, whole.vertical[-1]) < 3
    assert late.std == pytest.approx(whole.vertical_std[-1], rel=0.2)


def test_half_bodies_leave_it_uncertain() -> None:
    keypoints = SEQUENCE.keypoints.copy()
    keypoints[:, [name[1:] in ('hip', 'knee', 'ankle') for name in SEQUENCE.joint_names], 2] = 0
    half, tracker = replace(SEQUENCE, keypoints=keypoints), make_tracker()
    feed_demo(tracker, 0, FRAMES, sequence=half)
    for std in (find(tracker).std, reconstruct('auto', sequence=half).vertical_std[-1]):
        assert std == pytest.approx(math.radians(MAX_STD_DEG))


def test_another_camera_or_a_restart_forgets_what_was_found_and_a_little_drift_does_not() -> None:
    steady, drifting = make_tracker(), make_tracker()
    x, y = DEMO_CAMERA.center
    for frame in range(FRAMES):
        focal = DEMO_CAMERA.focal * (1 + 5e-4 * (-1) ** frame)
        near = replace(DEMO_CAMERA, focal=focal, center=(x + 0.1, y)) if frame else DEMO_CAMERA
        np.testing.assert_array_equal(
            feed_demo(drifting, frame, frame + 1, near), feed_demo(steady, frame, frame + 1)
        )
    known = find(steady).std
    assert find(drifting).std == known
    feed_demo(steady, FRAMES, FRAMES + 1, replace(DEMO_CAMERA, focal=1.002 * DEMO_CAMERA.focal))
    feed_demo(drifting, FRAMES, FRAMES + 1, replace(DEMO_CAMERA, center=(x + 0.002 * DEMO_CAMERA.focal, y)))
    assert min(find(steady).std, find(drifting).std) > known
    drifting.reset()
    assert drifting.vertical is None


def test_a_given_vertical_stays_and_turns_people() -> None:
    tilted = make_tracker(vertical='0 -0.9397 -0.3420')  # the camera looks down by 20 degrees, which is not true
    plain = make_tracker(vertical='none')
    joints = feed_demo(tilted, 0, 30)[-1], feed_demo(plain, 0, 30)[-1]
    assert find(tilted).direction == pytest.approx([0, -0.9397, -0.3420], abs=1e-3)
    assert plain.vertical is None
    trunks = [(j[1] - j[8]) / np.linalg.norm(j[1] - j[8]) for j in joints]  # neck less pelvis
    assert trunks[0][2] < trunks[1][2] - 0.02, 'the upper body is nearer to the camera'
    tilted.reset()
    assert tilted.vertical is not None
    given, none = reconstruct('0 -1 0', 10), reconstruct('none', 10)
    assert np.array_equal(given.vertical, np.tile([0.0, -1.0, 0.0], (10, 1)))
    assert given.vertical_std == pytest.approx(np.full(10, math.radians(1)))
    assert np.isnan(none.vertical).all()


UP = np.array([0.0, 0.0, 1.0])
CHECK_STEP_NS = 100_000_000


def make_leaning(angle_deg: float) -> Person3D:
    turn = Rotation.from_rotvec([np.radians(angle_deg), 0, 0])
    return replace(make_person_3d('anna'), joints=turn.apply(UPRIGHT))


def advance_check(check: VerticalCheck, people: list[Person3D], seconds: float, first: int = 0) -> float | None:
    found = None
    for frame in range(first, first + round(seconds * 10)):
        found = check.advance(frame * CHECK_STEP_NS, gather(people), UP)
    return found


@given(st.floats(0, 180))
@settings(max_examples=30)
def test_the_angle_between_people_and_the_vertical_decides(angle_deg: float) -> None:
    found = advance_check(VerticalCheck(), [make_leaning(angle_deg)], MIN_JUDGED_S + 3)
    if angle_deg < 33:
        assert found is None
    if angle_deg > 47:
        assert found == pytest.approx(angle_deg, abs=6)  # as the body stands a little behind its feet


def test_it_takes_a_while_and_who_stands_among_people_who_lie_confirms_it() -> None:
    assert advance_check(VerticalCheck(), [make_leaning(180)], MIN_JUDGED_S - 0.5) is None
    assert advance_check(VerticalCheck(), [make_leaning(90), make_leaning(0)], 20) is None
    unsure = replace(make_leaning(180), tentative=True), replace(make_leaning(180), predicted=True)
    assert advance_check(VerticalCheck(), [*unsure], 20) is None
    check = VerticalCheck()
    assert advance_check(check, [make_leaning(0)], 10) is None
    assert advance_check(check, [make_leaning(90)], 5, 100) is None, 'a person who lies down'
    assert advance_check(check, [make_leaning(90)], 60, 150) is not None


def test_it_holds_at_any_rate_and_begins_anew_with_the_stamps() -> None:
    lying = gather([make_leaning(180)])
    for hz in (1, 2, 5, 200):
        check = VerticalCheck()
        assert [check.advance(i * 10**9 // hz, lying, UP) for i in range(10 * hz)][-1] is not None
    assert check.advance(0, lying, UP) is None, 'the stamps began anew'
    assert not any(VerticalCheck().advance(t, lying, UP) for t in range(0, 10**12, 60 * 10**9))


@pytest.mark.parametrize(('text', 'upward'), [('0', [0, -1, 0]), ('30', [0, -0.866, -0.5]), ('-90', [0, 0, 1])])
def test_a_vertical_may_be_the_degrees_by_which_the_camera_looks_down(text: str, upward: list[float]) -> None:
    given = read_given_vertical(with_values(Config(), {'tracker.vertical': text}).tracker)
    assert given is not None
    assert given.direction == pytest.approx(np.array(upward), abs=1e-3)
