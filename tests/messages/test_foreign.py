"""Other people's detectors: their traps, live, in bags, and garbage among good messages."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mocap_ros.bags.journal import Verdict
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.bags.topics import Source, body_topic, input_types, people_topics
from mocap_ros.config import Config, RecorderConfig, with_values
from mocap_ros.demo.scene import make_recording
from mocap_ros.errors import ConfigError, FrameDropped, InputError, RecordingError
from mocap_ros.formats.detections import Video
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.accepted import decode_frame
from mocap_ros.messages.cdr import Header, decode, encode, new, new_header, typestore
from mocap_ros.messages.foreign.definitions import BODY, BODY_IDS, OPENPOSE, YOLO, ZED
from mocap_ros.messages.foreign.hri import HRI18
from mocap_ros.messages.foreign.yolo import COCO17
from mocap_ros.messages.foreign.zed import ZED38
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from mocap_ros.ros import message_types
from mocap_ros.runtime.load_keypoints import load_bag, load_input
from mocap_ros.runtime.pipeline import Outcome, Pipeline
from mocap_ros.runtime.replay import ReplayOptions, replay
from mocap_ros.skeleton import joint_map
from mocap_ros.tracking.tracker import Tracker

SIZE = 640, 480
FRAMES = 10
STEP_NS = 33_333_333
TRACKED = '/humans/bodies/tracked'
BASE = with_values(
    Config(),
    {
        'tracker.model': 'walk',
        'tracker.components': 8,
        'tracker.iterations': 1,
        'node.image_width': SIZE[0],
        'node.image_height': SIZE[1],
    },
)
LIMITS = BASE.node
Fed = tuple[Source, bytes, str]


def configured(kind: str, **values: object) -> Config:
    return with_values(BASE, {'node.input_type': kind, **values})


def people(frame: int) -> list[Person2D]:
    """Two people side by side; a few joints of each are missing."""
    keypoints = make_recording().keypoints[frame].astype(float)
    found = []
    for number, shift in enumerate((0.0, 120.0)):
        score = np.where(np.arange(len(keypoints)) == 3 + number, 0.0, keypoints[:, 2])
        points = np.where(score[:, None] > 0, keypoints[:, :2] + [shift, 0], np.nan)
        found.append(Person2D(f'b{number}', COCO17, points, score))
    return found


def header(frame: int) -> Header:
    return Header((frame + 1) * STEP_NS, 'camera')


def yolo(frame: int) -> bytes:
    """Ids from 1, what is not seen is not there, order reversed."""
    detections = []
    for person in people(frame):
        data = [
            new(
                'yolo_msgs/msg/KeyPoint2D',
                id=int(j) + 1,
                point=new('yolo_msgs/msg/Point2D', x=float(person.points[j, 0]), y=float(person.points[j, 1])),
                score=float(person.score[j]),
            )
            for j in np.flatnonzero(person.score)[::-1]
        ]
        one = blank('yolo_msgs/msg/Detection')
        one.id, one.class_name = person.id, 'person'
        one.keypoints.data = data
        detections.append(one)
    detections.append(blank('yolo_msgs/msg/Detection'))  # a thing without keypoints
    return encode(new(YOLO, header=new_header(header(frame)), detections=detections), YOLO)


def zed(frame: int) -> bytes:
    objects = []
    for number, person in enumerate(people(frame)):
        one = blank('zed_msgs/msg/Object')
        one.skeleton_available, one.body_format, one.confidence = True, 2, 80.0
        one.tracking_available, one.label_id = True, number
        for place in one.skeleton_2d.keypoints:
            place.kp = np.full(2, np.nan, 'f4')
        one.skeleton_keypoint_confidence = np.full(70, np.nan, np.float32)
        for joint, place in ZED38.items():
            one.skeleton_keypoint_confidence[place] = 100 * person.score[COCO17.index(joint)]
            one.skeleton_2d.keypoints[place].kp = person.points[COCO17.index(joint)].astype('f4')
        objects.append(one)
    return encode(new(ZED, header=new_header(header(frame)), objects=objects), ZED)


def openpose(frame: int) -> bytes:
    kinds = [
        new(
            'openpose_ros2_msgs/msg/PoseKeyPoints',
            pose_key_points=[
                new('openpose_ros2_msgs/msg/PoseKeyPoint', x=float(x), y=float(y), score=float(s))
                for (x, y), s in zip(np.nan_to_num(p.points), p.score, strict=True)
            ],
        )
        for p in people(frame)
    ]
    return encode(new(OPENPOSE, header=new_header(header(frame)), pose_key_points_list=kinds), OPENPOSE)


def body(person: Person2D, stamp: Header) -> bytes:
    """As ROS4HRI: shares of the image, the neck between the shoulders, its own order of eyes and ears."""
    at = {j: (p, s) for j, p, s in zip(person.joints, person.points, person.score, strict=True)}
    shoulders = [at['lshoulder'], at['rshoulder']]
    at['neck'] = (np.mean([s[0] for s in shoulders], axis=0), min(s[1] for s in shoulders))
    skeleton = []
    for joint in HRI18:
        point, score = at[joint]
        x, y = np.nan_to_num(point) / SIZE
        skeleton.append(new('hri_msgs/msg/NormalizedPointOfInterest2D', x=x, y=y, c=float(score)))
    return encode(new(BODY, header=new_header(stamp), skeleton=skeleton), BODY)


def ids(frame: int, *names: str) -> bytes:
    return encode(new(BODY_IDS, header=new_header(header(frame)), ids=list(names)), BODY_IDS)


def hri(frame: int) -> list[Fed]:
    """Everybody of a frame, the second one first, after who is tracked."""
    found = people(frame)
    fed: list[Fed] = [(Source.TRACKED, ids(frame, *(p.id for p in found)), TRACKED)]
    return fed + [(Source.BODY, body(p, header(frame)), body_topic(TRACKED, p.id)) for p in found[::-1]]


def own(frame: int) -> bytes:
    return encode_keypoints(header(frame), SIZE, people(frame))


def blank(kind: str) -> Any:
    """A message of zeros."""
    _, fields = typestore().fielddefs[kind]
    return typestore().types[kind](**{name: zero(node) for name, node in fields})


def zero(node: Any) -> Any:
    kind, inside = int(node[0]), node[1]
    if kind == 1:
        return {'string': '', 'bool': False}.get(inside[0], 0.0 if 'float' in inside[0] else 0)
    if kind == 2:
        return blank(inside)
    of, count = inside
    numbers = int(of[0]) == 1 and of[1][0] != 'string'
    if kind == 4:
        return np.zeros(0, of[1][0]) if numbers else []
    return np.zeros(count, of[1][0]) if numbers else [zero(of) for _ in range(count)]


def one_by_one(kind: str, frame: int) -> list[Fed]:
    whole = {YOLO: yolo, ZED: zed, OPENPOSE: openpose, KEYPOINTS: own}
    return hri(frame) if kind == BODY else [(Source.KEYPOINTS, whole[kind](frame), '/keypoints')]


def fed(pipeline: Pipeline, inputs: list[Fed]) -> list[Outcome]:
    return [pipeline.feed(*i) for i in inputs]


def skeletons(outcomes: list[Outcome]) -> list[Any]:
    outputs = [o for outcome in outcomes for o in outcome.outputs if o.topic == 'skeletons']
    return [decode(o.data, o.type) for o in outputs]


KINDS = (YOLO, BODY, ZED, OPENPOSE, KEYPOINTS)


@pytest.mark.parametrize('kind', [YOLO, ZED, OPENPOSE])
def test_every_detector_says_the_same(kind: str) -> None:
    _, raw, _ = one_by_one(kind, 0)[0]
    frame = decode_frame(raw, kind, LIMITS, SIZE)
    assert (frame.header, frame.image_width, frame.image_height) == (header(0), *SIZE)
    assert len(frame.people) == 2
    for found, true in zip(frame.people, people(0), strict=True):
        ours, _ = joint_map(true.joints).apply(true.points, true.score)
        theirs, score = joint_map(found.joints).apply(found.points, found.score)
        np.testing.assert_allclose(theirs, ours, atol=1e-3)
        assert ((score > 0) == np.isfinite(ours[:, 0])).all()
    expected = {YOLO: ['b0', 'b1'], ZED: ['0', '1'], OPENPOSE: ['', '']}
    assert [p.id for p in frame.people] == expected[kind]


@pytest.mark.parametrize('kind', KINDS)
def test_every_input_type_gives_the_same_people_live_and_from_a_bag(kind: str, tmp_path: Path) -> None:
    pipeline, reference = Pipeline(configured(kind)), Pipeline(configured(KEYPOINTS))
    inputs = [i for frame in range(FRAMES) for i in one_by_one(kind, frame)]
    outcomes = fed(pipeline, inputs)
    assert [o.reason for o in outcomes if o.verdict is not Verdict.ACCEPTED] == []
    found = skeletons(outcomes)
    true = skeletons(fed(reference, [i for f in range(FRAMES) for i in one_by_one(KEYPOINTS, f)]))
    assert [len(s.people) for s in found] == [2] * FRAMES
    for ours, theirs in zip(found, true, strict=True):
        assert ours.header == theirs.header
        for one, other in zip(ours.people, theirs.people, strict=True):
            xyz = np.array([[[j.x, j.y, j.z] for j in p.joints] for p in (one, other)])
            assert np.linalg.norm(xyz[0] - xyz[1], axis=-1).max() < (1e-9 if kind == KEYPOINTS else 0.08)

    types = input_types(kind)
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        for number, (source, raw, topic) in enumerate(inputs):
            recorder.write(topic, types[source], raw, number + 1, number + 1)
    with Bag(tmp_path / 'bag') as bag:
        replay(bag, tmp_path / 'out')
    with Bag(tmp_path / 'bag') as bag, pytest.raises(RecordingError, match='exists already'):
        replay(bag, tmp_path / 'out')
    with Bag(tmp_path / 'bag') as bag:
        replay(bag, tmp_path / 'same', ReplayOptions(config=BASE))
    with Bag(tmp_path / 'same') as out:
        raws = [m.raw for m in out.messages(['/skeletons'])]
    assert raws == [o.data for c in outcomes for o in c.outputs if o.topic == 'skeletons']


@pytest.mark.parametrize('kind', KINDS)
def test_a_bag_of_any_detector_is_a_sequence(kind: str, tmp_path: Path) -> None:
    inputs = [i for frame in range(FRAMES) for i in one_by_one(kind, frame)]
    last = hri(FRAMES)[::2] if kind == BODY else one_by_one(kind, FRAMES)  # b1, who is tracked, does not come
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        for number, (source, raw, topic) in enumerate([*inputs, *last, inputs[-1]], 1):
            recorder.write(topic, input_types(kind)[source], raw, number, number)
    found = load_bag(tmp_path / 'bag', LIMITS)
    assert list(found.stamps_ns) == [header(frame).stamp_ns for frame in range(FRAMES + 1)]
    assert [len(p) for p in found.people] == [2] * FRAMES + [1 if kind == BODY else 2]
    (left_out,) = found.remarks
    assert re.match(r'1 messages left out; /\S+: message \d\d: (its )?stamp ', left_out)
    sequence, _ = load_input(tmp_path / 'bag', Video(), LIMITS)
    assert (len(sequence), sequence.image_size, sequence.frame_id) == (FRAMES + 1, SIZE, 'camera')
    for frame in (0, FRAMES - 1):
        ours, theirs = (
            joint_map(p.joints).apply(p.points, p.score)[0] for p in (people(frame)[0], sequence.person(frame))
        )
        np.testing.assert_allclose(theirs, ours, atol=1e-3)


def test_which_of_several_detectors_in_a_bag_must_be_said(tmp_path: Path) -> None:
    other = '/other/bodies/tracked'
    moved = [(source, raw, topic.replace('/humans', '/other')) for source, raw, topic in hri(0)]
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        for kind, inputs in ((YOLO, one_by_one(YOLO, 0)), (BODY, hri(0)), (BODY, moved)):
            for source, raw, topic in inputs:
                recorder.write(topic, input_types(kind)[source], raw, 1, 1)
    with Bag(tmp_path / 'bag') as bag:
        with pytest.raises(InputError, match=f'choose one: /keypoints, {TRACKED}, {other}$'):
            people_topics(bag)
        assert people_topics(bag, '/keypoints') == {'/keypoints': Source.KEYPOINTS}
        assert people_topics(bag, other) == {topic: source for source, _, topic in moved}
        with pytest.raises(
            InputError, match=r'no topic /yolo of .*hri_msgs/msg/Skeleton2D; the bag has /keypoints'
        ):
            people_topics(bag, '/yolo')


def test_of_two_images_that_a_message_completes_each_is_put_out_or_refused() -> None:
    """A frame that is refused takes neither the one before nor the one behind it along."""
    first, second = people(0)

    def come(person: Person2D, frame: int) -> Fed:
        return Source.BODY, body(person, header(frame)), body_topic(TRACKED, person.id)

    class Refusing(Tracker):
        """Does not take images in which nobody but the second person is."""

        def update(self, stamp_ns: int, people: tuple[Person2D, ...], intrinsics: Intrinsics) -> Any:
            if [p.id for p in people] == [second.id]:
                raise FrameDropped('refused')
            return super().update(stamp_ns, people, intrinsics)

    pipeline = Pipeline(configured(BODY), None, Refusing)
    fed(pipeline, [(Source.TRACKED, ids(0, 'b0', 'b1'), TRACKED), come(first, 0)])
    fed(pipeline, [(Source.TRACKED, ids(1, 'b1'), TRACKED)])
    both = pipeline.feed(*come(second, 1))  # ends image 0, in which b1 is missing, and is image 1
    assert [o.stamp_ns for o in both.outputs if o.topic == 'skeletons'] == [header(0).stamp_ns]
    assert (both.verdict, both.reason) == (Verdict.DROPPED, 'refused')

    fed(pipeline, [(Source.TRACKED, ids(2, 'b0', 'b1'), TRACKED), come(second, 2)])
    both = pipeline.feed(Source.TRACKED, ids(3), TRACKED)  # ends image 2, and is image 3, with nobody
    assert [o.stamp_ns for o in both.outputs if o.topic == 'skeletons'] == [header(3).stamp_ns]
    assert (both.verdict, both.reason) == (Verdict.DROPPED, 'refused')
    assert pipeline.counters.dropped == {'stamp': 2}


def test_scores_of_zed_are_taken_where_its_version_has_them() -> None:
    def scored(message: Any) -> None:
        scores = np.full(70, np.nan, np.float32)
        scores[[ZED38['nose'], ZED38['lknee']]] = 90, 35
        message.objects[0].skeleton_keypoint_confidence = scores
        message.objects[1].skeleton_keypoint_confidence = np.zeros(70, np.float32)  # as from a version without

    one, other = decode_frame(change(ZED, scored), ZED, LIMITS, SIZE).people
    assert {j: s for j, s in zip(one.joints, one.score, strict=True) if s} == pytest.approx(
        {'nose': 0.9, 'lknee': 0.35}
    )
    assert set(other.score) == {0.0, 0.8}


def test_bodies_come_and_go_and_late_ones_are_counted() -> None:
    pipeline = Pipeline(configured(BODY))
    first, second = people(0)

    def come(person: Person2D, frame: int) -> Outcome:
        return pipeline.feed(Source.BODY, body(person, header(frame)), body_topic(TRACKED, person.id))

    assert pipeline.feed(Source.TRACKED, ids(0, 'b0', 'b1'), TRACKED).outputs == ()
    assert come(first, 0).outputs == ()
    assert come(first, 0).verdict is Verdict.DROPPED  # twice in an image
    assert come(first, 1).outputs[0].stamp_ns == header(0).stamp_ns  # b1 is missing: the next image ends it
    assert come(second, 0).verdict is Verdict.DROPPED  # its image is over
    assert come(second, 1).outputs[0].stamp_ns == header(1).stamp_ns  # complete at once
    assert pipeline.feed(Source.TRACKED, ids(2, 'b1'), TRACKED).outputs == ()
    assert come(second, 2).outputs[0].stamp_ns == header(2).stamp_ns
    (nobody,) = skeletons([pipeline.feed(Source.TRACKED, ids(3), TRACKED)])
    assert [p.predicted for p in nobody.people] == [True, True]
    assert pipeline.counters.dropped['stamp'] == 2


def test_shares_of_an_image_need_its_size() -> None:
    pipeline = Pipeline(with_values(configured(BODY), {'node.image_width': 0}))
    outcome = fed(pipeline, hri(0))[1]
    assert outcome.verdict is Verdict.INVALID
    assert 'node.image_width' in outcome.reason


def change(kind: str, edit: Any) -> bytes:
    message = decode(one_by_one(kind, 0)[0][1], kind)
    edit(message)
    return encode(message, kind)


def set_id(value: int) -> Any:
    return lambda m: setattr(m.detections[1].keypoints.data[2], 'id', value)


BAD = {
    'id 0': (YOLO, set_id(0), r'detections\[1\].keypoints.data\[2\].id: 0, expected 1 to 17'),
    'id 18': (YOLO, set_id(18), r'detections\[1\].keypoints.data\[2\].id: 18, expected'),
    'id twice': (YOLO, set_id(17), r'detections\[1\].keypoints.data\[2\].id: 17 twice'),
    'name twice': (YOLO, lambda m: setattr(m.detections[1], 'id', 'b0'), "detections: id 'b0' twice"),
    'score': (
        YOLO,
        lambda m: setattr(m.detections[0].keypoints.data[0], 'score', 7.0),
        r'detections\[0\].keypoints: score\[16\]: 7, expected',
    ),
    'format': (ZED, lambda m: setattr(m.objects[0], 'body_format', 4), r'objects\[0\].body_format: 4, expected'),
    'count': (
        OPENPOSE,
        lambda m: m.pose_key_points_list[1].pose_key_points.pop(),
        r'pose_key_points_list\[1\].pose_key_points: 16 joints, expected 17, 18, 25',
    ),
    'stamp': (ZED, lambda m: setattr(m.header.stamp, 'sec', -1), 'header.stamp: -1 s'),
}


@pytest.mark.parametrize('case', BAD)
def test_bad_foreign_messages_are_refused_by_field(case: str) -> None:
    kind, edit, said = BAD[case]
    with pytest.raises(InputError, match=f'^{said}'):
        decode_frame(change(kind, edit), kind, LIMITS, SIZE)


def test_a_type_that_is_not_known_is_refused() -> None:
    with pytest.raises(ConfigError, match='yolo_msgs/msg/DetectionArray'):
        input_types('std_msgs/msg/String')


CLEAN: dict[str, list[bytes]] = {}


def clean(kind: str) -> list[bytes]:
    """Skeletons without any garbage."""
    if kind not in CLEAN:
        inputs = [i for frame in range(3) for i in one_by_one(kind, frame)]
        outcomes = fed(Pipeline(configured(kind)), inputs)
        CLEAN[kind] = [o.data for c in outcomes for o in c.outputs if o.topic == 'skeletons']
    return CLEAN[kind]


@settings(deadline=None, max_examples=15)
@given(st.data())
@pytest.mark.parametrize('kind', KINDS)
def test_garbage_among_good_messages_is_counted_and_changes_nothing(kind: str, data: st.DataObject) -> None:
    pipeline, outputs, bad = Pipeline(configured(kind)), [], 0
    for frame in range(3):
        for source, raw, topic in one_by_one(kind, frame):
            for garbage in data.draw(st.lists(garbled(raw), max_size=3)):
                try:
                    Pipeline.feed(Pipeline(configured(kind)), source, garbage, topic)
                finally:
                    bad += 1
                outcome = pipeline.feed(source, garbage, topic)
                assert outcome.verdict is Verdict.INVALID, outcome.reason
                assert not outcome.fault
            outputs += [o.data for o in pipeline.feed(source, raw, topic).outputs if o.topic == 'skeletons']
    assert outputs == clean(kind)
    assert pipeline.counters.invalid == bad


def garbled(raw: bytes) -> st.SearchStrategy[bytes]:
    """Bytes that are no such message for certain: cut short, or rubbish."""
    cut = st.integers(0, len(raw) - 9).map(lambda n: raw[:n])
    return st.one_of(cut, st.binary(max_size=60))


@settings(deadline=None, max_examples=60)
@given(st.data())
@pytest.mark.parametrize('kind', KINDS)
def test_any_damage_is_accepted_or_counted(kind: str, data: st.DataObject) -> None:
    pipeline = Pipeline(configured(kind))
    for source, raw, topic in one_by_one(kind, 0):
        damaged = bytearray(raw)
        for at, value in data.draw(st.lists(st.tuples(st.integers(0, len(raw) - 1), st.integers(0, 255)))):
            damaged[at] = value
        outcome = pipeline.feed(source, bytes(damaged), topic)
        assert not outcome.fault, outcome.fault
    counters = pipeline.counters
    assert counters.accepted + counters.invalid + counters.dropped.total() == len(one_by_one(kind, 0))


def test_a_late_body_is_a_drop() -> None:
    from mocap_ros.runtime.frame_assembly import BodyGroups

    groups = BodyGroups()
    groups.track(header(0), ['a'], SIZE)
    person = Person2D('a', COCO17, people(0)[0].points, people(0)[0].score)
    assert len(groups.add(header(1), person, SIZE, 1.0)) == 1
    with pytest.raises(FrameDropped, match='after its image was complete'):
        groups.add(header(1), person, SIZE, 1.0)
    assert groups.add(Header(10 * 10**9, ''), person, SIZE, 1.0)
    assert len(groups.add(header(1), person, SIZE, 1.0)) == 1  # a bag that loops


def test_the_installed_version_of_a_type_is_made_ours(monkeypatch: pytest.MonkeyPatch) -> None:

    fields = {
        'std_msgs/msg/Header': {'stamp': 'builtin_interfaces/Time', 'frame_id': 'string'},
        'builtin_interfaces/msg/Time': {'sec': 'int32', 'nanosec': 'uint32'},
        OPENPOSE: {
            'header': 'std_msgs/Header',
            'model': 'string<8>',
            'pose_key_points_list': 'sequence<openpose_ros2_msgs/PoseKeyPoints, 30>',
        },
        'openpose_ros2_msgs/msg/PoseKeyPoints': {'pose_key_points': 'openpose_ros2_msgs/PoseKeyPoint[17]'},
        'openpose_ros2_msgs/msg/PoseKeyPoint': {'score': 'float', 'x': 'double', 'y': 'double'},
    }

    def installed(kind: str) -> Any:
        return type('Installed', (), {'get_fields_and_field_types': staticmethod(lambda: fields[kind])})

    monkeypatch.setattr(message_types, 'interface_class', installed)
    convert = message_types.converter(OPENPOSE)
    assert convert is not None
    store = get_typestore(Stores.EMPTY)
    for kind, text in message_types._definitions(OPENPOSE, set()):
        store.register(get_types_from_msg(text, kind))
    ours = decode(openpose(0), OPENPOSE)
    theirs = store.types[OPENPOSE](
        header=ours.header,
        model='body17',
        pose_key_points_list=[
            store.types['openpose_ros2_msgs/msg/PoseKeyPoints'](pose_key_points=p.pose_key_points)
            for p in ours.pose_key_points_list
        ],
    )
    raw = bytes(store.serialize_cdr(theirs, OPENPOSE))
    assert decode(convert(raw), OPENPOSE) == ours
    with pytest.raises(InputError, match='not a openpose'):
        convert(raw[:40])
    fields[OPENPOSE]['header'] = 'wstring?'
    with pytest.raises(ConfigError, match='cannot be read'):
        message_types.converter(OPENPOSE)
