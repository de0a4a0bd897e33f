"""The pipeline: bytes in, bytes out; live and replay agree; bad input is counted and changes nothing."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mocap_ros.bags.journal import JOURNAL, Verdict, read_run
from mocap_ros.bags.mcap_file import McapFile
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.topics import Source
from mocap_ros.config import Config, with_values
from mocap_ros.demo.scene import make_recording
from mocap_ros.errors import InputError, RecordingError
from mocap_ros.geometry.distortion import Distortion
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.person import Person2D
from mocap_ros.keypoints.validation import first_fault
from mocap_ros.messages.camera_info import CAMERA_INFO, decode_camera_info, image_size
from mocap_ros.messages.cdr import Header, OutputMessage, decode, encode, new_header
from mocap_ros.messages.keypoints import KEYPOINTS, decode_keypoints, encode_keypoints
from mocap_ros.messages.markers import MARKERS, MarkerMemory
from mocap_ros.messages.point_cloud import POINT, POINTS
from mocap_ros.messages.skeletons import SKELETONS
from mocap_ros.ros.live import Complaints, LiveRun
from mocap_ros.runtime.pipeline import OUTPUTS, Pipeline
from mocap_ros.runtime.replay import replay
from mocap_ros.runtime.sequence_messages import sequence_samples
from mocap_ros.skeleton import CMU15, layout
from mocap_ros.tracking.tracker import Tracker
from tests.support.camera_infos import camera_info

CONFIG = with_values(Config(), {'tracker.model': 'walk', 'tracker.components': 8, 'tracker.iterations': 1})
FRAMES = 25
NAMES = {t: f'/{t}' for t in ('keypoints', 'camera_info', *OUTPUTS, 'skeleton_definition')} | {
    'journal': '/mocap_node/journal'
}


@pytest.fixture(scope='module')
def stream() -> list[bytes]:
    return [s.raw for s in islice(sequence_samples(make_recording().sequence()), FRAMES)]


def processed(pipeline: Pipeline, raw: bytes) -> tuple[OutputMessage, ...]:
    outcome = pipeline.feed(Source.KEYPOINTS, raw)
    assert outcome.verdict is Verdict.ACCEPTED, outcome.reason
    return outcome.outputs


def refused(pipeline: Pipeline, raw: bytes, verdict: Verdict) -> str:
    """Why."""
    outcome = pipeline.feed(Source.KEYPOINTS, raw)
    assert (outcome.verdict, outcome.outputs, outcome.fault) == (verdict, (), '')
    return outcome.reason


def skeletons(outputs: tuple[OutputMessage, ...]) -> Any:
    return decode({o.topic: o for o in outputs}['skeletons'].data, SKELETONS)


def test_every_output_has_the_stamp_and_frame_of_its_input(stream: list[bytes]) -> None:
    pipeline = Pipeline(CONFIG)
    for raw in stream[:3]:
        header = decode_keypoints(raw, CONFIG.node).header
        outputs = processed(pipeline, raw)
        assert [o.topic for o in outputs] == ['skeletons', 'cameras', 'markers', 'points']
        assert {o.stamp_ns for o in outputs} == {header.stamp_ns}
        by_topic = {o.topic: decode(o.data, o.type) for o in outputs}
        markers = by_topic.pop('markers').markers
        headers = [m.header for m in (*by_topic.values(), *markers)]
        stamps = {h.stamp.sec * 10**9 + h.stamp.nanosec for h in headers}
        assert stamps == {header.stamp_ns}
        assert {h.frame_id for h in headers} == {'camera'}
        assert len(by_topic['skeletons'].people) == len(by_topic['cameras'].cameras) == 1
    assert pipeline.counters.accepted == 3


def test_nobody_is_published_as_nobody(stream: list[bytes]) -> None:
    pipeline = Pipeline(CONFIG)
    processed(pipeline, stream[0])
    outputs = processed(pipeline, encode_keypoints(Header(10**12, 'camera'), (640, 480), []))
    assert skeletons(outputs).people == []
    actions = [m.action for m in decode(outputs[2].data, MARKERS).markers]
    assert actions == [2, 2]


def test_bad_input_is_counted_and_changes_nothing(stream: list[bytes]) -> None:
    clean, dirty = Pipeline(CONFIG), Pipeline(CONFIG)
    for i, raw in enumerate(stream[:6]):
        outputs = processed(dirty, raw)
        assert [o.data for o in processed(clean, raw)] == [o.data for o in outputs]
        again = refused(dirty, raw, Verdict.DROPPED)
        assert ('repeats' if i else 'header.stamp is not set') in again
        assert 'not a mocap_ros_msgs' in refused(dirty, raw[:50], Verdict.INVALID)
        if i:
            assert 'older' in refused(dirty, stream[i - 1], Verdict.DROPPED)
    counters = dirty.counters
    assert (counters.accepted, counters.invalid, counters.dropped['stamp']) == (6, 6, 11)


def test_one_visible_joint_is_no_crash() -> None:
    joints = layout('coco17').joints
    points = np.full((17, 2), np.nan)
    points[3] = 100
    person = Person2D('', joints, points, np.where(np.arange(17) == 3, 1.0, 0.0))
    outputs = processed(Pipeline(CONFIG), encode_keypoints(Header(0, 'camera'), (640, 480), [person]))
    assert skeletons(outputs).people == []


def test_image_size_comes_from_message_then_camera_then_parameters(stream: list[bytes]) -> None:
    sizeless = decode(stream[0], KEYPOINTS)
    sizeless.image_width = 0
    raw = encode(sizeless, KEYPOINTS)
    assert 'node.image_width' in refused(Pipeline(CONFIG), raw, Verdict.INVALID)

    def depth(pipeline: Pipeline, keypoints: bytes, scale_source: int) -> float:
        (person,) = skeletons(processed(pipeline, keypoints)).people
        assert person.scale_source == scale_source
        return float(np.mean([j.z for j in person.joints]))

    own = depth(Pipeline(CONFIG), stream[0], scale_source=0)  # 640 px, the nominal focal length is a width
    wide = replace(CONFIG, node=replace(CONFIG.node, image_width=1280, image_height=960))
    assert depth(Pipeline(wide), stream[0], scale_source=0) == own
    assert depth(Pipeline(wide), raw, scale_source=0) == pytest.approx(2 * own, rel=0.03)
    known = Pipeline(wide)
    known.set_camera_info(camera_info(focal=320))
    assert depth(known, raw, scale_source=1) == pytest.approx(own / 2, rel=0.03)
    camera = decode_camera_info(camera_info())
    assert image_size(camera, wide.node) == (640, 480)
    assert image_size(None, wide.node) == (1280, 960)
    assert image_size(None, replace(wide.node, image_width=0)) == (0, 0)


def test_a_camera_info_that_does_not_fit_is_refused(stream: list[bytes]) -> None:
    pipeline = Pipeline(CONFIG)
    with pytest.raises(InputError, match='not calibrated'):
        pipeline.set_camera_info(camera_info(focal=0))
    assert pipeline.camera_info is None
    pipeline.set_camera_info(camera_info(width=1280))
    said = refused(pipeline, stream[0], Verdict.INVALID)
    assert '640 x 480 px, but CameraInfo is for 1280 x 480 px' in said


class Log:
    """Collects what is logged."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def info(self, message: str) -> None:
        self.lines.append(f'info {message}')

    def warning(self, message: str) -> None:
        self.lines.append(f'warning {message}')

    def error(self, message: str) -> None:
        self.lines.append(f'error {message}')


class Live:
    """A live run whose outputs are collected."""

    def __init__(self, config: Config, tracker: Any = Tracker) -> None:
        self.log = Log()
        self.published: list[OutputMessage] = []
        types = {Source.KEYPOINTS: KEYPOINTS, Source.CAMERA_INFO: CAMERA_INFO}
        self.run = LiveRun(Pipeline(config, None, tracker), types, NAMES, self.published.append, self.log)
        self.run.start()

    def frames(self) -> int:
        return sum(o.topic == 'skeletons' for o in self.published)

    def wait_for_frames(self, count: int) -> None:
        end = time.monotonic() + 20
        while self.frames() < count:
            assert time.monotonic() < end
            time.sleep(0.002)


def recorded(bag: Path, topic: str) -> list[bytes]:
    with Bag(bag) as reader:
        return [m.raw for m in reader.messages([topic])]


def recording(folder: Path, **values: object) -> Config:
    return with_values(CONFIG, {'recorder.enabled': True, 'recorder.folder': str(folder), **values})


def assert_replay_gives_the_same(bag_folder: Path, out: Path) -> None:
    with Bag(bag_folder) as bag:
        replay(bag, out)
    for topic in ('/keypoints', '/camera_info', '/skeletons', '/cameras'):
        assert recorded(out, topic) == recorded(bag_folder, topic)


def test_a_replay_repeats_resets_parameters_and_bad_input(tmp_path: Path, stream: list[bytes]) -> None:
    live = Live(recording(tmp_path / 'live'))
    for raw in stream[:8]:
        live.run.put(Source.KEYPOINTS, raw, 5)
    live.wait_for_frames(8)
    live.run.put(Source.CAMERA_INFO, camera_info(), 5)
    live.run.put(Source.KEYPOINTS, stream[3], 5)
    live.run.put(Source.KEYPOINTS, stream[8][:60], 5)
    live.run.put(Source.KEYPOINTS, stream[8], 5)
    live.wait_for_frames(9)
    live.run.reset()
    for raw in stream[5:9]:
        live.run.put(Source.KEYPOINTS, raw, 5)
    live.wait_for_frames(13)
    live.run.reconfigure(recording(tmp_path / 'live', **{'tracker.components': 5}))
    for raw in stream[9:13]:
        live.run.put(Source.KEYPOINTS, raw, 5)
    live.wait_for_frames(17)
    live.run.stop()

    (bag,) = (tmp_path / 'live').iterdir()
    assert recorded(bag, '/skeletons') == [o.data for o in live.published if o.topic == 'skeletons']
    assert len(recorded(bag, '/keypoints')) == 19
    assert_replay_gives_the_same(bag, tmp_path / 'again')
    first, *complaints = [line for line in live.log.lines if '/keypoints' in line]
    assert first == 'info /keypoints: first message accepted'
    assert len(complaints) == 2
    assert complaints[0].startswith('warning /keypoints: message 9: stamp ')
    assert complaints[1].startswith('error /keypoints: message 10: not a mocap_ros_msgs/msg/Keypoints2DArray')


def stamped(raw: bytes, stamp_ns: int) -> bytes:
    message = decode(raw, KEYPOINTS)
    message.header = new_header(Header(stamp_ns, 'camera'))
    return encode(message, KEYPOINTS)


def test_a_looped_bag_and_a_message_from_the_future_start_afresh_live_and_replayed(
    tmp_path: Path, stream: list[bytes]
) -> None:
    live = Live(recording(tmp_path / 'live'))
    seconds = [5.0, 5.1, 900.0, 5.2, 5.3, 0.0, 0.1, 0.05]
    for i, second in enumerate(seconds):
        live.run.put(Source.KEYPOINTS, stamped(stream[i], round(second * 1e9)), 5)
    live.wait_for_frames(len(seconds) - 1)
    live.run.stop()
    assert [o.stamp_ns for o in live.published if o.topic == 'skeletons'] == [round(s * 1e9) for s in seconds[:-1]]
    told = [line for line in live.log.lines if 'time went back' in line]
    assert told == ['warning /keypoints: message 4: time went back by 894.8 s: started afresh']
    (bag,) = (tmp_path / 'live').iterdir()
    assert_replay_gives_the_same(bag, tmp_path / 'again')


def test_what_comes_too_fast_is_passed_over_counted_and_left_out_of_a_replay(
    tmp_path: Path, stream: list[bytes]
) -> None:
    begun, go_on = threading.Event(), threading.Event()

    class Busy(Tracker):
        """Is with its first frame until told otherwise."""

        def update(self, *frame: Any) -> Any:
            begun.set()
            assert go_on.wait(20)
            return super().update(*frame)

    live = Live(recording(tmp_path / 'live', **{'node.queue': 2}), Busy)
    live.run.put(Source.KEYPOINTS, stream[0], 0)
    assert begun.wait(20)
    for raw in stream[1:]:
        live.run.put(Source.KEYPOINTS, raw, 0)
    go_on.set()
    live.wait_for_frames(2)
    live.run.stop()
    stamps = [decode_keypoints(raw, CONFIG.node).header.stamp_ns for raw in (stream[0], stream[-1])]
    assert [o.stamp_ns for o in live.published if o.topic == 'skeletons'] == stamps
    passed_over = [line for line in live.log.lines if 'newer messages were waiting' in line]
    assert [line.partition(': message ')[2].partition(':')[0] for line in passed_over] == ['2', '11']  # 1st, 10th

    (bag,) = (tmp_path / 'live').iterdir()
    assert recorded(bag, '/keypoints') == stream
    with Bag(bag) as opened:
        assert read_run(opened).unseen == set(range(2, FRAMES))
    assert_replay_gives_the_same(bag, tmp_path / 'again')


def test_a_recording_that_fails_is_said_once_and_the_stream_goes_on(tmp_path: Path, stream: list[bytes]) -> None:
    (tmp_path / 'file').write_text('')
    live = Live(recording(tmp_path / 'file' / 'bags'))
    live.run.put(Source.KEYPOINTS, stream[0], 0)
    live.wait_for_frames(1)
    live.run.stop()
    errors = [line for line in live.log.lines if line.startswith('error')]
    assert len(errors) == 1
    assert errors[0].endswith('Not a directory; nothing is recorded')


def test_the_same_complaint_is_not_repeated_for_ever(stream: list[bytes]) -> None:
    live = Live(CONFIG)
    for _ in range(120):
        live.run.put(Source.KEYPOINTS, stream[0][:40], 0)
        time.sleep(0.001)
    live.run.put(Source.KEYPOINTS, stream[0], 0)
    live.wait_for_frames(1)
    live.run.stop()
    bad = [line for line in live.log.lines if 'not a mocap' in line]
    assert len(bad) == 3
    assert bad[-1].endswith('(for the 100th time)')


def test_strangers_cannot_flood_the_log() -> None:
    log = Log()
    complaints = Complaints(log)
    for i in range(1000):
        complaints.add('/keypoints', i, f"people[0].skeleton: unknown keypoint layout 'x{chr(500 + i)}'; known: a")
    assert len(log.lines) == 4
    for i in range(1000):
        complaints.add('/keypoints', i, f'nobody quotes {chr(500 + i)}')
    assert len(log.lines) < 40
    complaints.add('/camera_info', 1, 'something else')
    assert log.lines[-1].startswith('error /camera_info: message 1')


class Faulty:
    """A tracker with a fault: it fails at every third frame, and at all from the ninth to the next reset."""

    went_back = 0.0
    output_ns = 0

    def __init__(self, *_: object) -> None:
        self.frames = 0

    def update(self, *_: object) -> tuple[()]:
        self.frames += 1
        if self.frames % 3 == 0 or self.frames > 8:
            raise ZeroDivisionError('a fault of ours')
        return ()

    def examine(self) -> None: ...

    def reset(self) -> None:
        self.frames = 0


def test_a_fault_of_ours_costs_its_frame_and_is_told_once(tmp_path: Path, stream: list[bytes]) -> None:
    live = Live(recording(tmp_path / 'live', **{'node.queue': 100}), Faulty)
    for raw in stream[:14]:
        live.run.put(Source.KEYPOINTS, raw, 5)
    live.wait_for_frames(8)  # 1, 2, 4, 5, 7, 8 and after the reset two more
    live.run.stop()
    assert [line.count('Traceback') for line in live.log.lines].count(1) == 1
    dropped = [line for line in live.log.lines if 'internal error: ZeroDivisionError: a fault of ours' in line]
    assert len(dropped) == 1
    (bag,) = (tmp_path / 'live').iterdir()
    with Bag(bag) as opened:
        verdicts = [decode(m.raw, JOURNAL).level for m in opened.messages(['/mocap_node/journal'])]
    assert verdicts[1:] == [0, 0, 1, 0, 0, 1, 0, 0, 1, 1, 1, 0, 0, 1]


def test_a_fault_outside_the_tracker_does_not_silence_the_node(
    stream: list[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    live = Live(CONFIG)
    publish = live.published.append

    def fail_once(_: OutputMessage) -> None:
        monkeypatch.setattr(live.run, '_publish', publish)
        raise RuntimeError('no middleware')

    monkeypatch.setattr(live.run, '_publish', fail_once)
    for raw in stream[:3]:
        live.run.put(Source.KEYPOINTS, raw, 5)
    live.wait_for_frames(2)
    live.run.stop()
    assert sum('RuntimeError: no middleware' in line for line in live.log.lines) == 1


def test_a_recording_that_cannot_be_finished_is_no_success(
    tmp_path: Path, stream: list[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    live = Live(recording(tmp_path / 'live'))
    live.run.put(Source.KEYPOINTS, stream[0], 5)
    live.wait_for_frames(1)

    def fail(*_: object) -> None:
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr(McapFile, 'finish', fail)
    with pytest.raises(RecordingError, match='No space left'):
        live.run.end_recording()
    assert live.run.end_recording() is None
    live.run.stop()
    assert sum('No space left' in line for line in live.log.lines) == 1


@pytest.mark.parametrize('entry', [(0, 0, 1e200), (0, 0, 1e-200), (0, 2, 1e308), (1, 2, float('nan'))])
def test_cameras_that_cannot_be_are_refused(entry: tuple[int, int, float]) -> None:
    matrix = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    matrix[entry[0], entry[1]] = entry[2]
    with pytest.raises(InputError, match=r'focal lengths|principal point'):
        Intrinsics.from_matrix(matrix)


def test_a_point_far_outside_any_image_is_a_fault() -> None:
    points = np.full((5, 2), 100.0)
    assert first_fault(points, np.ones(5)) is None
    points[3, 1] = 1e10
    fault = first_fault(points, np.ones(5))
    assert fault is not None
    assert (fault.field, fault.index) == ('y', (3,))


LENSES = {
    'plumb_bob': (-0.28, 0.07, 0.001, -0.002, 0.0),
    'equidistant': (-0.02, 0.004, -0.001, 0.0002),
}


@pytest.mark.parametrize('model', LENSES)
def test_the_lens_of_camera_info_is_undone(model: str, stream: list[bytes]) -> None:
    focal, lens = 600.0, LENSES[model]
    raw = camera_info(focal=focal, model=model, d=lens)
    camera = decode_camera_info(raw).intrinsics
    assert camera.distortion == Distortion(model, lens)
    pinhole = Intrinsics(focal, (320.0, 240.0), known=True)
    bent, straight = [], []
    for message in stream[:5]:
        frame = decode_keypoints(message, CONFIG.node)
        (person,) = frame.people
        seen = camera.distortion.distort(pinhole.rays(person.points)) * focal + np.array(pinhole.center)
        distorted = replace(person, points=seen)
        bent.append(encode_keypoints(frame.header, (640, 480), [distorted]))
        straight.append(encode_keypoints(frame.header, (640, 480), [person]))

    def joints(inputs: list[bytes], info: bytes, **values: object) -> np.ndarray:
        pipeline = Pipeline(with_values(CONFIG, values))
        pipeline.set_camera_info(info)
        people = [skeletons(processed(pipeline, raw)).people for raw in inputs]
        return np.array([[p.x, p.y, p.z] for frame in people for person in frame for p in person.joints])

    expected = joints(straight, camera_info(focal=focal))
    np.testing.assert_allclose(joints(bent, raw), expected, atol=2e-3)
    rectified = {'node.rectified_input': True}
    np.testing.assert_array_equal(joints(straight, raw, **rectified), expected)
    projection = (300.0, 0, 320.0, 0, 0, 300.0, 240.0, 0, 0, 0, 1.0, 0)
    other = joints(straight, camera_info(model=model, d=lens, p=projection), **rectified)
    assert other[0, 2] == pytest.approx(expected[0, 2] / 2, rel=0.05)


def test_a_lens_that_is_not_known_is_said() -> None:
    pipeline = Pipeline(CONFIG)
    outcome = pipeline.feed(Source.CAMERA_INFO, camera_info(model='fov', d=(0.9,)))
    assert (outcome.verdict.name, outcome.reason.startswith("distortion model 'fov': expected plumb_bob")) == (
        'INVALID',
        True,
    )


def test_points_hold_every_joint(stream: list[bytes]) -> None:
    pipeline = Pipeline(CONFIG)
    outputs = {o.topic: o for o in processed(pipeline, stream[0])}
    cloud = decode(outputs['points'].data, POINTS)
    read = np.frombuffer(cloud.data.tobytes(), POINT)
    (person,) = skeletons(tuple(outputs.values())).people
    assert (cloud.width, cloud.height, cloud.header.frame_id) == (15, 1, 'camera')
    assert [(f.name, f.offset) for f in cloud.fields] == [(n, POINT.fields[n][1]) for n in POINT.names]
    np.testing.assert_allclose(read['x'], [j.x for j in person.joints], rtol=1e-6)
    np.testing.assert_array_equal(read['joint'], np.arange(15))
    np.testing.assert_array_equal(read['inferred'], person.inferred)


def test_frames_need_a_true_scale_and_are_those_of_rep_155(stream: list[bytes]) -> None:
    pipeline = Pipeline(with_values(CONFIG, {'node.publish_tf': True, 'node.frame_prefix': 'cam1_'}))

    def transforms(raw: bytes) -> dict[str, Any]:
        (tf,) = (o for o in processed(pipeline, raw) if o.topic == '/tf')
        return {t.child_frame_id: t for t in decode(tf.data, tf.type).transforms}

    assert transforms(stream[0]) == {}
    pipeline.set_camera_info(camera_info())
    found = transforms(stream[1])
    person = pipeline.people[0]
    assert len(found) == 15
    body = found[f'cam1_body_{person.id}']
    assert body.header.frame_id == 'camera'
    q, t = body.transform.rotation, body.transform.translation
    turn = Rotation.from_quat([q.x, q.y, q.z, q.w])
    joints = dict(zip(CMU15.joints, person.joints, strict=True))
    hips, shoulders = ((joints[f'l{j}'] + joints[f'r{j}']) / 2 for j in ('hip', 'shoulder'))
    limbs = [f'{side}_{j}' for side in 'lr' for j in ('shoulder', 'elbow', 'wrist', 'hip', 'knee', 'ankle')]
    places = {'torso': shoulders, 'head': joints['head']} | {name: joints[name.replace('_', '')] for name in limbs}
    assert found.keys() == {f'cam1_{name}_{person.id}' for name in ('body', *places)}
    np.testing.assert_allclose([t.x, t.y, t.z], hips, atol=1e-9)
    for name, expected in places.items():
        frame = found[f'cam1_{name}_{person.id}']
        assert frame.header.frame_id == f'cam1_body_{person.id}'
        inside = frame.transform.translation
        place = turn.apply([inside.x, inside.y, inside.z]) + [t.x, t.y, t.z]
        np.testing.assert_allclose(place, expected, atol=1e-9)
    assert found[f'cam1_head_{person.id}'].transform.translation.z > 0.4  # up
    assert found[f'cam1_l_hip_{person.id}'].transform.translation.y > 0.04  # left
    up = (shoulders - hips) / np.linalg.norm(shoulders - hips)
    np.testing.assert_allclose(turn.apply([0, 0, 1]), up, atol=1e-9)


def test_the_predicted_are_drawn_unlike_the_filled_in(stream: list[bytes]) -> None:
    memory = MarkerMemory()
    pipeline = Pipeline(CONFIG)
    processed(pipeline, stream[0])
    (person,) = pipeline.people
    looks = {}
    for name, change in {
        'seen': {'inferred': np.zeros(15, bool)},
        'inferred': {'inferred': np.ones(15, bool)},
        'predicted': {'inferred': np.ones(15, bool), 'predicted': True},
    }.items():
        raw = memory.update(Header(1, 'camera'), [replace(person, **change)], 0.5)
        looks[name] = repr(decode(raw, MARKERS).markers[0].colors[0])
    assert len(set(looks.values())) == 3
