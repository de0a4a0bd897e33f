# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Every message type gives the same people, live and from a bag; mistakes in the input are described."""

import re
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap_ros.bags.journal import JOURNAL, RESET, Acceptance, Entry, encode_entry
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.bags.topics import Source, list_input_types, make_body_topic
from mocap_ros.config import RecorderConfig, with_values
from mocap_ros.demo.scene import make_recording
from mocap_ros.errors import InputError, RecordingError
from mocap_ros.findings import SOUND
from mocap_ros.formats.reading_options import ReadingOptions
from mocap_ros.geometry.distortion import Distortion
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.joint_map import build_joint_map
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.camera_info import CameraInfo, encode_camera_info
from mocap_ros.messages.cdr import Header, decode
from mocap_ros.messages.foreign_types import HRI_SKELETON, OPENPOSE_POSES, YOLO_DETECTIONS, ZED_OBJECTS
from mocap_ros.messages.input_types import ZED38, decode_body, decode_frame
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.models.model_file import load_base_pose_models
from mocap_ros.recordings.load_keypoints import load_bag, load_input
from mocap_ros.recordings.load_results import load_recording
from mocap_ros.recordings.reconstruct import ReconstructionOptions, reconstruct
from mocap_ros.runtime.input_camera import SILENCE_S, InputCamera
from mocap_ros.runtime.pipeline import Pipeline, ProcessingResult
from mocap_ros.runtime.replay import ReplayOptions, replay
from mocap_ros.skeleton import KEYPOINT_LAYOUTS, keypoint_layout
from mocap_ros.verdict.input_faults import MIN_BOX_IMAGES, UNUSABLE_S, find_misspelt_joint
from tests.support.camera_messages import camera_info, create_message, encode
from tests.support.foreign_messages import (
    BASE_CONFIG,
    HRI_IDS_TOPIC,
    IMAGE_SIZE,
    INPUT_TYPES,
    LIMITS,
    decode_skeletons,
    edit_message,
    encode_body,
    encode_ids,
    feed_all,
    make_config,
    make_header,
    make_inputs,
    make_people,
)
from tests.support.pipeline_inputs import FAST_CONFIG, STEP_NS, encode_demo_frames, read_messages, with_stamp

FRAMES = 10


@pytest.mark.parametrize('msgtype', INPUT_TYPES)
def test_every_input_type_gives_the_same_people_live_and_from_a_bag(msgtype: str, tmp_path: Path) -> None:
    pipeline, reference = Pipeline(make_config(msgtype)), Pipeline(make_config(KEYPOINTS))
    inputs = [i for frame in range(FRAMES) for i in make_inputs(msgtype, frame)]
    results = feed_all(pipeline, inputs)
    assert [o.reason for o in results if o.acceptance is not Acceptance.ACCEPTED] == []
    skeletons = decode_skeletons(results)
    expected = decode_skeletons(feed_all(reference, [i for f in range(FRAMES) for i in make_inputs(KEYPOINTS, f)]))
    assert [len(s.people) for s in skeletons] == [2] * FRAMES
    for skeleton, reference_skeleton in zip(skeletons, expected, strict=True):
        assert skeleton.header == reference_skeleton.header
        for pair in zip(skeleton.people, reference_skeleton.people, strict=True):
            joints = np.array([[[j.x, j.y, j.z] for j in person.joints] for person in pair])
            # m; measured: 1e-7, as the types round coordinates and scores differently
            assert np.linalg.norm(joints[0] - joints[1], axis=-1).max() < (1e-9 if msgtype == KEYPOINTS else 1e-5)

    types = list_input_types(msgtype)
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        for number, (source, raw, topic) in enumerate(inputs):
            recorder.write(topic, types[source], raw, number + 1, number + 1)
    with Bag(tmp_path / 'bag') as bag:
        replay(bag, tmp_path / 'out')
    with Bag(tmp_path / 'bag') as bag, pytest.raises(RecordingError, match='exists already'):
        replay(bag, tmp_path / 'out')
    with Bag(tmp_path / 'bag') as bag:
        replay(bag, tmp_path / 'same', ReplayOptions(config=BASE_CONFIG))
    raws = read_messages(tmp_path / 'same', '/skeletons')
    assert raws == [o.data for c in results for o in c.outputs if o.topic == 'skeletons']


@pytest.mark.parametrize('msgtype', INPUT_TYPES)
def test_a_bag_of_any_detector_is_a_sequence(msgtype: str, tmp_path: Path) -> None:
    inputs = [i for frame in range(FRAMES) for i in make_inputs(msgtype, frame)]
    last = make_inputs(msgtype, FRAMES)
    if msgtype == HRI_SKELETON:
        last = last[::2]  # the body b1 is tracked, but its message is missing
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        for number, (source, raw, topic) in enumerate([*inputs, *last, inputs[-1]], 1):
            recorder.write(topic, list_input_types(msgtype)[source], raw, number, number)
    detections = load_bag(tmp_path / 'bag', LIMITS)
    assert list(detections.stamps_ns) == [make_header(frame).stamp_ns for frame in range(FRAMES + 1)]
    assert [len(p) for p in detections.people] == [2] * FRAMES + [1 if msgtype == HRI_SKELETON else 2]
    (note,) = detections.notes
    assert re.match(r'1 messages left out; /\S+: message \d\d: (its )?stamp ', note)
    sequence, _ = load_input(tmp_path / 'bag', ReadingOptions(node=LIMITS))
    assert (len(sequence), sequence.image_size, sequence.frame_id) == (FRAMES + 1, IMAGE_SIZE, 'camera')
    for frame in (0, FRAMES - 1):
        expected, points = (
            build_joint_map(p.joints).apply(p.points, p.score)[0]
            for p in (make_people(frame)[0], sequence.person(frame))
        )
        np.testing.assert_allclose(points, expected, atol=1e-3)


def test_images_are_complete_when_all_tracked_bodies_have_arrived() -> None:
    pipeline = Pipeline(make_config(HRI_SKELETON))
    first, second = make_people(0)

    def feed_body(person: Person2D, frame: int) -> ProcessingResult:
        topic = make_body_topic(HRI_IDS_TOPIC, person.id)
        return pipeline.feed(Source.BODY, encode_body(person, make_header(frame)), topic)

    assert pipeline.feed(Source.TRACKED_BODIES, encode_ids(0, 'b0', 'b1'), HRI_IDS_TOPIC).outputs == ()
    assert feed_body(first, 0).outputs == ()
    assert feed_body(first, 0).acceptance is Acceptance.DROPPED  # the body repeats in the image
    assert feed_body(first, 1).outputs[0].stamp_ns == make_header(0).stamp_ns  # the next image ends it without b1
    assert feed_body(second, 0).acceptance is Acceptance.DROPPED  # the image has ended
    assert feed_body(second, 1).outputs[0].stamp_ns == make_header(1).stamp_ns  # complete at once
    assert pipeline.feed(Source.TRACKED_BODIES, encode_ids(2, 'b1'), HRI_IDS_TOPIC).outputs == ()
    assert feed_body(second, 2).outputs[0].stamp_ns == make_header(2).stamp_ns
    (empty,) = decode_skeletons([pipeline.feed(Source.TRACKED_BODIES, encode_ids(3), HRI_IDS_TOPIC)])
    assert empty.people == [], 'two frames are too few to predict a person'
    assert pipeline.counters.dropped['stamp'] == 2


def set_keypoint(**fields: float) -> Callable[[Any], None]:
    return lambda m: vars(m.detections[1].keypoints.data[2]).update(fields)


@pytest.mark.parametrize(
    ('msgtype', 'edit', 'error'),
    [
        (YOLO_DETECTIONS, set_keypoint(id=0), r'detections\[1\].keypoints.data\[2\].id: 0, expected 1 to 17'),
        (YOLO_DETECTIONS, set_keypoint(id=18), r'detections\[1\].keypoints.data\[2\].id: 18, expected'),
        (YOLO_DETECTIONS, set_keypoint(id=17), r'detections\[1\].keypoints.data\[2\].id: 17 twice'),
        (YOLO_DETECTIONS, lambda m: setattr(m.detections[1], 'id', 'b0'), "detections: id 'b0' twice"),
        (YOLO_DETECTIONS, set_keypoint(score=np.inf), r'detections\[1\].keypoints: score\[14\]: inf, expected'),
        (ZED_OBJECTS, lambda m: setattr(m.objects[0], 'body_format', 4), r'objects\[0\].body_format: 4, expected'),
        (ZED_OBJECTS, lambda m: setattr(m.header.stamp, 'sec', -1), 'header.stamp: -1 s'),
        (
            OPENPOSE_POSES,
            lambda m: m.pose_key_points_list[1].pose_key_points.pop(),
            r'pose_key_points_list\[1\].pose_key_points: 16 joints, expected 17, 18, 25',
        ),
    ],
)
def test_faults_are_refused_by_field(msgtype: str, edit: Callable[[Any], None], error: str) -> None:
    with pytest.raises(InputError, match=f'^{error}'):
        decode_frame(edit_message(msgtype, edit), msgtype, LIMITS, IMAGE_SIZE)


def test_keypoint_scores_of_the_zed_are_used_if_the_message_has_them() -> None:
    def set_scores(message: Any) -> None:
        scores = np.full(70, np.nan, np.float32)
        scores[[ZED38['nose'], ZED38['lknee']]] = 90, 35
        message.objects[0].skeleton_keypoint_confidence = scores
        message.objects[1].skeleton_keypoint_confidence = np.zeros(70, np.float32)  # as a version without scores

    scored, unscored = decode_frame(edit_message(ZED_OBJECTS, set_scores), ZED_OBJECTS, LIMITS, IMAGE_SIZE).people
    assert {j: s for j, s in zip(scored.joints, scored.score, strict=True) if s} == pytest.approx(
        {'nose': 0.9, 'lknee': 0.35}
    )
    assert set(unscored.score) == {0.0, 0.8}


@pytest.mark.parametrize(('frame_id', 'is_used'), [('camera', True), ('base_link', False)])
def test_points_in_3d_of_yolo_ros_are_depths_in_the_frame_of_the_image(frame_id: str, is_used: bool) -> None:
    def add_points(message: Any) -> None:
        points = message.detections[0].keypoints3d
        points.frame_id = frame_id
        for n, depth in ((1, 2.5), (6, 0.0), (99, 1.0)):
            place = create_message('geometry_msgs/msg/Point', x=0.0, y=0.0, z=depth)
            points.data.append(create_message('yolo_msgs/msg/KeyPoint3D', id=n, point=place, score=1.0))

    seen, other = decode_frame(
        edit_message(YOLO_DETECTIONS, add_points), YOLO_DETECTIONS, LIMITS, IMAGE_SIZE
    ).people
    assert other.depth is None
    found = [] if seen.depth is None else seen.depth[np.isfinite(seen.depth)].tolist()
    assert found == [2.5] * is_used


@pytest.mark.parametrize(
    ('frame_id', 'expected'),
    [('zed_left_camera_frame', 2.0), ('zed_left_camera_optical_frame', 4.0), ('map', None)],
)
def test_points_in_3d_of_the_zed_are_depths_in_the_frames_of_the_camera(
    frame_id: str, expected: float | None
) -> None:
    def add_points(message: Any) -> None:
        message.header.frame_id = frame_id
        message.objects[0].skeleton_3d.keypoints[ZED38['nose']].kp = np.array([2.0, 3.0, 4.0], 'f4')

    seen, _ = decode_frame(edit_message(ZED_OBJECTS, add_points), ZED_OBJECTS, LIMITS, IMAGE_SIZE).people
    found = None if seen.depth is None else seen.depth[seen.joints.index('nose')]
    assert found == expected


def test_normalised_coordinates_of_ros4hri_need_the_image_size() -> None:
    (person, _), header = make_people(0), make_header(0)
    with pytest.raises(InputError, match=r'^skeleton: .*node\.image_width'):
        decode_body(encode_body(person, header), person.id, (0, 0), LIMITS)


def mark_yolo(message: Any, x: float, y: float) -> None:
    keypoint = message.detections[0].keypoints.data[0]
    keypoint.id, keypoint.point.x, keypoint.point.y = 4, x, y  # the left ear, which is absent


# How a keypoint of the first person is set in a message of each type to x and y in px; its score stays.
SET_KEYPOINT: dict[str, Callable[[Any, float, float], None]] = {
    YOLO_DETECTIONS: mark_yolo,
    ZED_OBJECTS: lambda m, *p: setattr(m.objects[0].skeleton_2d.keypoints[ZED38['nose']], 'kp', np.array(p, 'f4')),
    OPENPOSE_POSES: lambda m, x, y: vars(m.pose_key_points_list[0].pose_key_points[0]).update(x=x, y=y),
    HRI_SKELETON: lambda m, x, y: vars(m.skeleton[0]).update(x=x, y=y),
}


@pytest.mark.parametrize('msgtype', SET_KEYPOINT)
@pytest.mark.parametrize('point', [(0, 0), (-1, -1), (np.nan, np.nan), (np.nan, 5)])
def test_what_marks_a_point_as_not_seen_is_the_same_in_all_types(msgtype: str, point: tuple[float, float]) -> None:
    def edit(message: Any) -> None:
        SET_KEYPOINT[msgtype](message, *point)

    if msgtype == HRI_SKELETON:
        raw = encode_body(make_people(0)[0], make_header(0))
        message = decode(raw, HRI_SKELETON)
        edit(message)
        _, person = decode_body(encode(message, HRI_SKELETON), 'b0', IMAGE_SIZE, LIMITS)
    else:
        person = decode_frame(edit_message(msgtype, edit), msgtype, LIMITS, IMAGE_SIZE).people[0]
    joint = person.joints.index('lear' if msgtype == YOLO_DETECTIONS else 'nose')
    assert person.score[joint] == 0
    assert np.isnan(person.points[joint]).all()
    assert (person.score > 0).sum() >= 14


def test_detections_that_are_no_people_are_counted() -> None:
    def edit(message: Any) -> None:
        message.detections[0].class_name = 'dog'
        message.detections[1].keypoints.data = []

    frame = decode_frame(edit_message(YOLO_DETECTIONS, edit), YOLO_DETECTIONS, LIMITS, IMAGE_SIZE)
    assert (frame.people, frame.without_keypoints) == ((), 2)  # a third one has none


@pytest.mark.parametrize(('first', 'count'), [(0, 1), (1, 0)])
def test_a_model_without_keypoints_is_known_by_many_images(first: int, count: int) -> None:
    pipeline, reasons = Pipeline(make_config(YOLO_DETECTIONS)), []
    for image in range(3 * MIN_BOX_IMAGES):
        message = decode(make_inputs(YOLO_DETECTIONS, image)[0][1], YOLO_DETECTIONS)
        message.header.stamp.sec += 1_700_000_000
        for detection in message.detections if image >= first else ():
            detection.keypoints.data = []
        reasons.append(pipeline.feed(Source.KEYPOINTS, encode(message, YOLO_DETECTIONS)).reason)
    assert sum('no keypoints' in reason for reason in reasons[MIN_BOX_IMAGES - 1 :]) == count
    assert not any('no keypoints' in reason for reason in reasons[: MIN_BOX_IMAGES - 1])


STEP_S = 0.2  # between the frames
CAMERA = Intrinsics.from_image_size(640, 480, 1.2)
COCO17 = keypoint_layout('coco17').joints
SPELT_OUT = tuple(
    {'l': 'left_', 'r': 'right_'}[j[0]] + j[1:] if j != 'nose' else j for j in COCO17
)  # as other packages name them


@pytest.fixture(scope='module')
def stream() -> list[bytes]:
    frames = encode_demo_frames(30)
    return [with_stamp(raw, round((1 + i * STEP_S) * 1e9)) for i, raw in enumerate(frames)]


def edit_people(raw: bytes, edit: Callable[[Any], None]) -> bytes:
    message = decode(raw, KEYPOINTS)
    for person in message.people:
        edit(person)
    return encode(message, KEYPOINTS)


def name_joints(skeleton: str, *joints: str) -> Callable[[Any], None]:
    return lambda person: vars(person).update(skeleton=skeleton, joint_names=[*joints])


def move(change: Callable[[Any, Any], Any]) -> Callable[[Any], None]:
    """Return an edit of the points (x, y) of a person."""
    return lambda person: vars(person).update(zip('xy', change(person.x, person.y), strict=True))


reverse_joints = name_joints('', *COCO17[::-1])
turn_around = move(lambda x, y: (640 - x, 480 - y))


def list_reasons(pipeline: Pipeline, frames: list[bytes]) -> list[str]:
    if pipeline.camera_info is None:  # which would be a problem of its own
        pipeline.set_camera_info(camera_info())
    reasons = []
    for raw in frames:
        reasons.append(pipeline.feed(Source.KEYPOINTS, raw).reason)
        for _ in range(20):  # the readings of a stretch, which are measured one after another
            assert not pipeline.run_deferred_work()
    return reasons


@pytest.mark.parametrize(
    ('edit', 'problem'),
    [
        (name_joints('h36m17'), 'people: these look like coco17, not h36m17: give layout coco17'),
        (reverse_joints, 'people: these look like coco17, not the given joints'),
        (move(lambda x, y: (y, x)), 'people: (x and y look exchanged|people lie)'),
        (move(lambda x, y: (x / 2, y / 2)), 'people: all points lie in the upper left quarter'),
        (move(lambda x, y: (3 * x, 3 * y)), r'people: \d+% of the seen keypoints lie outside 640'),
    ],
)
def test_a_mistake_is_kept_until_mended(stream: list[bytes], edit: Callable[[Any], None], problem: str) -> None:
    pipeline = Pipeline(FAST_CONFIG)
    wrong = [edit_people(raw, edit) for raw in stream]
    reasons = list_reasons(pipeline, wrong)
    (made,) = (r for r in reasons if r)
    assert re.match(problem, made)
    assert not any(reasons[: int(1.0 / STEP_S)]), 'not before a second'
    (kept,) = pipeline.checks.warnings
    assert re.match(problem, kept)
    assert pipeline.summary.summarise().grade in ('doubtful', 'wrong')
    later = [with_stamp(raw, round((10 + i * STEP_S) * 1e9)) for i, raw in enumerate(2 * stream)]
    assert [r for r in list_reasons(pipeline, later) if r] == []
    assert pipeline.checks.warnings == []
    pipeline.reset()
    assert sum(map(bool, list_reasons(pipeline, wrong))) == 1, 'a reset forgets what was reported'
    pipeline.reset()
    assert pipeline.checks.warnings == []


def test_other_names_or_another_order_of_the_same_joints_do_not_restart_the_judgement(stream: list[bytes]) -> None:
    def reverse_order(person: Any) -> None:
        reverse_joints(person)
        vars(person).update({name: getattr(person, name)[::-1].copy() for name in ('x', 'y', 'score')})

    edits, pipeline = (name_joints('coco17'), name_joints('', *SPELT_OUT), reverse_order), Pipeline(FAST_CONFIG)
    list_reasons(pipeline, [edit_people(raw, edits[i % 3]) for i, raw in enumerate(stream)])
    assert pipeline.summary.summarise().grade == 'good'


def test_a_half_body_is_named_live_and_whole(stream: list[bytes]) -> None:
    is_hidden = np.array([joint.endswith(('hip', 'knee', 'ankle')) for joint in COCO17])
    pipeline = Pipeline(FAST_CONFIG)
    hide = [edit_people(raw, lambda p: vars(p).update(score=np.where(is_hidden, 0, p.score))) for raw in stream]
    list_reasons(pipeline, hide)
    sequence = make_recording().sequence()
    keypoints = sequence.keypoints[:60].copy()
    keypoints[:, is_hidden] = np.nan, np.nan, 0
    cut = replace(sequence, keypoints=keypoints, timestamps=sequence.timestamps[:60], recorded_ns=(), truth=None)
    models = load_base_pose_models(FAST_CONFIG.tracker.model)
    whole = reconstruct([cut], ReconstructionOptions(FAST_CONFIG, models)).summary
    for summary in (pipeline.summary.summarise(), whole):
        assert '; hips and legs never seen; ' in str(summary)


def test_unusable_detections_are_described_when_they_last(stream: list[bytes]) -> None:
    faint = [edit_people(raw, lambda p: vars(p).update(score=np.full_like(p.score, 0.05))) for raw in 2 * stream]
    frames = [with_stamp(raw, round((1 + i * STEP_S) * 1e9)) for i, raw in enumerate([*stream, *faint])]
    (made,) = (i for i, r in enumerate(list_reasons(Pipeline(FAST_CONFIG), frames)) if 'tracker.min_score' in r)
    assert (made - len(stream)) * STEP_S > UNUSABLE_S


@pytest.mark.parametrize('is_reset', [True, False], ids=['reset', 'stamps go back'])
def test_a_summary_covers_the_run_across_restarts(tmp_path: Path, is_reset: bool) -> None:
    good, count = encode_demo_frames(140), 70
    wrong = [edit_people(raw, move(lambda x, y: (x, 480 - y))) for raw in good[:count]]
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        if is_reset:
            recorder.write('/mocap_node/journal', JOURNAL, encode_entry(Entry(RESET, count)), 1, 1)
        for number, raw in enumerate([*wrong, *good[count if is_reset else 0 :][:count]]):
            recorder.write('/keypoints', KEYPOINTS, raw, number * STEP_NS, number * STEP_NS)
    with Bag(tmp_path / 'bag') as bag:
        summary = replay(bag, tmp_path / 'out', ReplayOptions(FAST_CONFIG)).summary
    recording = load_recording(tmp_path / 'out', config=FAST_CONFIG)
    start = f'wrong: {summary.reason}; 1 person in {2 * count} frames; '
    assert [line[: len(start)] for line in (str(summary), str(recording.summary))] == [start] * 2, (
        'also when viewed'
    )


@pytest.mark.parametrize(
    ('edit', 'step_s', 'values', 'problem'),
    [
        (lambda _: None, STEP_S, {}, ''),
        (reverse_joints, 0.5, {}, 'people: the points do not fit'),  # too slow for the lifter
        (turn_around, STEP_S, {}, 'people: people lie or are upside down'),
        (turn_around, STEP_S, {'node.output_frame': 'map', 'node.camera_pose': '0 0 1 3.1416 0 0'}, ''),
    ],
)
def test_points_are_judged_at_any_rate_and_by_a_vertical_that_is_given(
    stream: list[bytes], edit: Callable[[Any], None], step_s: float, values: dict[str, object], problem: str
) -> None:
    frames = [with_stamp(edit_people(raw, edit), round((1 + i * step_s) * 1e9)) for i, raw in enumerate(stream)]
    reasons = filter(None, list_reasons(Pipeline(with_values(FAST_CONFIG, values)), frames))
    assert [reason.startswith(problem) for reason in reasons] == [True] * bool(problem)


@pytest.mark.parametrize(
    ('model', 'coefficients', 'focal_in_widths', 'is_unusable'),
    [
        ('plumb_bob', (-5.0, 3.0, 0.0, 0.0, -9.0), 1.2, True),
        ('plumb_bob', (-2.0, 0.0, 0.0, 0.0), 0.8, True),
        ('rational_polynomial', (1e6,) * 4 + (-1e6,) * 4, 1.2, True),
        ('plumb_bob', (), 0.5, False),
        ('plumb_bob', (-0.28, 0.07, 0.0002, 0.00002, 0.0), 0.35, False),
        ('rational_polynomial', (2.0, 1.5, 0.0004, -0.0003, 0.1, 2.3, 2.2, 0.5), 0.35, False),
        ('equidistant', (-0.01, 0.02, -0.02, 0.005), 0.34, False),  # 200 degrees across
        ('equidistant', (-0.01, 0.003, -0.002, 0.0003), 150 / 640, False),  # 180 degrees within the height
    ],
)
def test_a_bad_lens_is_told(
    model: str, coefficients: tuple[float, ...], focal_in_widths: float, *, is_unusable: bool
) -> None:
    lens = Distortion.from_coefficients(model, coefficients)
    camera = replace(CAMERA, focal=focal_in_widths * 640, is_focal_known=True, distortion=lens)
    pipeline = Pipeline(FAST_CONFIG)
    assert pipeline.feed(Source.CAMERA_INFO, encode_camera_info(Header(0, ''), CameraInfo((640, 480), camera)))
    reasons = list_reasons(pipeline, encode_demo_frames(3))
    assert ['distortion of the camera: it cannot be undone' in reason for reason in reasons] == [is_unusable, 0, 0]


@pytest.mark.parametrize(
    ('wrong', 'right', 'meant'),
    [
        ('left_sholder', 'left_shoulder', 'lshoulder'),
        ('LKnees', 'left_knee', 'lknee'),
        ('right ankel', 'right_ankle', 'rankle'),
        ('left_hand_thumb1', 'left_hip', ''),
        ('left_heel', 'left_knee', ''),  # another joint
        ('r', 'right_hip', ''),
        ('', 'right_hip', ''),
    ],
)
def test_misspelt_joints_that_are_missing_are_described(wrong: str, right: str, meant: str) -> None:
    names = tuple(wrong if j == right else j for j in SPELT_OUT)
    expected = f'joint_names: {wrong!r} is no known joint and is ignored; is it {meant!r}?' if meant else ''
    assert find_misspelt_joint(names).words == expected
    assert find_misspelt_joint((*names, right)) == SOUND, 'an extra joint beside the right one'


def test_no_layout_has_misspelt_joints() -> None:
    assert not any(find_misspelt_joint(layout.joints).words for layout in KEYPOINT_LAYOUTS.values())


PERIOD_S = 1 / 30
SKEW_S = 3.0  # by which the clocks of two cameras differ


def send(camera: InputCamera, name: str, seconds: float, size: tuple[int, int] = IMAGE_SIZE) -> str:
    """Offer an image; return 'used', 'replaced' (the camera before it) or 'refused'."""
    header = Header(round(seconds * 1e9), name)
    try:
        restart = camera.check(header, size)
    except InputError as error:
        return 'refused' if f'{name!r}, but the people of {camera.name!r}' in str(error) else str(error)
    camera.accept(header, size)
    return 'replaced' if restart else 'used'


def send_in_turn(camera: InputCamera, skews: dict[str, float], times: Iterable[float]) -> Counter[tuple[str, str]]:
    """Send an image of each camera at each time; return how often each of them had each result."""
    return Counter((name, send(camera, name, t + skew)) for t in times for name, skew in skews.items())


def make_times(start_s: float, count: int = 90) -> list[float]:
    return [start_s + n * PERIOD_S for n in range(count)]


@pytest.mark.parametrize('skews', [[0, 0.01], [0, -SKEW_S], [0, 1e9], [0, SKEW_S, 2 * SKEW_S]])
def test_of_cameras_that_send_in_turn_the_first_is_used_whatever_their_clocks_say(skews: list[float]) -> None:
    found = send_in_turn(InputCamera(), {str(i): skew for i, skew in enumerate(skews)}, make_times(10.0))
    assert found == {('0', 'used'): 90, **{(str(i), 'refused'): 90 for i in range(1, len(skews))}}


@pytest.mark.parametrize('first_s', [13.0, 2.0])
def test_another_camera_is_used_when_the_first_is_silent(first_s: float) -> None:
    camera = InputCamera()
    send_in_turn(camera, {'front': 0.0, 'back': SKEW_S}, make_times(10.0))
    results = [send(camera, 'back', first_s + n * PERIOD_S) for n in range(40)]
    assert results.index('replaced') == pytest.approx(SILENCE_S / PERIOD_S, abs=1)
    assert set(results[results.index('replaced') + 1 :]) == {'used'}


def test_images_without_a_name_are_of_the_camera_in_use() -> None:
    camera = InputCamera()
    assert [send(camera, name, 1.0) for name in ('', 'front', '')] == ['used'] * 3
    assert send(camera, 'back', 1.5) == 'refused'


def calibrate(name: str, focal: float) -> CameraInfo:
    return CameraInfo((640, 480), Intrinsics(focal, (320.0, 240.0), is_focal_known=True), name)


def test_each_camera_is_used_with_its_own_camera_info() -> None:
    camera = InputCamera()
    front, back = calibrate('front', 500.0), calibrate('back', 900.0)
    for calibration in (back, front):  # before the first image, any camera may be that of the images
        camera.add_calibration(calibration, '/info')
    send(camera, 'front', 1.0)
    with pytest.raises(InputError, match="'back', but the people of 'front' are being tracked"):
        camera.add_calibration(back, '/info')
    assert [send(camera, 'back', 5.0 + later) for later in (0.0, SILENCE_S)] == ['refused', 'replaced']
    assert camera.find_calibration('back') is None
    assert "'back', but the CameraInfo on /info is of 'front'" in camera.describe_other('back')
    for calibration in (calibrate('', 501.0), back):
        camera.add_calibration(calibration, '/info')
        assert camera.find_calibration('back') is calibration, 'what has no name may be of any camera'
    uncalibrated = Intrinsics(480.0, (320.0, 240.0), is_focal_known=False)
    camera.add_calibration(CameraInfo((640, 480), uncalibrated, 'back'), '/info')
    assert camera.find_calibration('back') is back


def test_sizes_and_camera_infos_of_one_name_that_come_in_turn_are_refused() -> None:
    camera, sizes = InputCamera(), {'large': (1280, 720), 'small': (640, 480)}
    turns = [send(camera, 'front', 10 + n * PERIOD_S, sizes['small' if n % 2 else 'large']) for n in range(90)]
    assert turns[:2] == ['used'] * 2
    assert turns[2].startswith('image_width, image_height: images of 1280 x 720 px and 640 x 480 px come in turn')
    assert turns[2:] == [turns[2], 'used'] * 44
    alone = [send(camera, 'front', 20 + n * PERIOD_S, sizes['large']) for n in range(3)]
    assert alone == ['used'] * 3, 'the camera was set to another size'
    near, far = calibrate('front', 500.0), calibrate('front', 600.0)
    for calibration in (near, calibrate('front', 510.0), near, far):  # a lens that is focused, and another camera
        camera.add_calibration(calibration, '/info')
    with pytest.raises(InputError, match=r'focal lengths of 500 px .* and 600 px .* come in turn'):
        camera.add_calibration(near, '/info')
    assert camera.find_calibration('front') is far
    send(camera, 'front', 30.0)
    camera.add_calibration(near, '/info')
    assert camera.find_calibration('front') is near
