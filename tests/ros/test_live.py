# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A live run without ROS: its queue, what it publishes, logs and records, and that a replay gives the same."""

import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocap_ros.bags.journal import JOURNAL, Acceptance, read_run
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.bags.rosbag2 import make_topic
from mocap_ros.bags.topics import Source
from mocap_ros.config import Config, with_settings
from mocap_ros.errors import RecordingError
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.cdr import Header, OutputMessage, decode, read_stamp_ns
from mocap_ros.messages.foreign_types import HRI_IDS
from mocap_ros.messages.keypoints import KEYPOINTS, decode_keypoints, encode_keypoints
from mocap_ros.messages.plain import encode_plain
from mocap_ros.messages.skeletons import SKELETONS
from mocap_ros.messages.transforms import TRANSFORMS
from mocap_ros.people import People, TrackedFrame
from mocap_ros.ros import input_queue
from mocap_ros.ros.input_queue import InputQueue, ReceivedMessage
from mocap_ros.ros.live import LiveRun
from mocap_ros.ros.live_recording import Recording
from mocap_ros.ros.message_types import MessageVersions
from mocap_ros.runtime.outputs import OUTPUTS
from mocap_ros.runtime.pipeline import Pipeline, ProcessingResult
from mocap_ros.runtime.replay import replay
from mocap_ros.tracking.tracker import PeopleTracker
from mocap_ros.units import NS_PER_S
from tests.support.camera_messages import camera_info, make_transforms
from tests.support.pipeline_inputs import (
    FAST_CONFIG,
    STEP_NS,
    LineLog,
    encode_demo_frames,
    read_messages,
    with_stamp,
)

FRAMES = 25
TIMEOUT_S = 60.0  # s; far above what anything here takes on a busy machine
START_NS = 1_700_000_000_000_000_000  # since the epoch
NAMES = {t: f'/{t}' for t in ('keypoints', 'camera_info', *OUTPUTS, 'skeleton_definition')}
NAMES['journal'] = '/mocap_node/journal'
TF_NAMES = NAMES | {'/tf': '/tf', '/tf_static': '/tf_static'}


@pytest.fixture(scope='module')
def stream() -> list[bytes]:
    return encode_demo_frames(FRAMES)


@pytest.fixture(autouse=True)
def stop_runs() -> Iterator[None]:
    """Stop the runs of a test that failed before it stopped them; their threads would keep pytest from ending."""
    CollectingRun.started.clear()
    yield
    for run in CollectingRun.started:
        if run._thread.is_alive():
            run.stop()


class CollectingRun:
    """A live run whose outputs and log lines are collected."""

    started: ClassVar[list[LiveRun]] = []  # in this test

    def __init__(self, config: Config, tracker: Any = PeopleTracker, names: dict[str, str] = NAMES) -> None:
        self.log = LineLog()
        self.published: list[OutputMessage] = []
        types = {Source.KEYPOINTS: KEYPOINTS, Source.CAMERA_INFO: CAMERA_INFO}
        types |= {s: TRANSFORMS for s in (Source.TRANSFORMS, Source.STATIC_TRANSFORMS) if s.value in names}
        pipeline = Pipeline(config, None, tracker)
        self.run = LiveRun(pipeline, types, names, self.published.append, self.log)
        self.run.start()
        self.started.append(self.run)

    @property
    def skeletons(self) -> list[OutputMessage]:
        return [o for o in self.published if o.topic == 'skeletons']

    def enqueue(self, *messages: bytes, sent_ns: int = 5) -> None:
        for raw in messages:
            self.run.enqueue(Source.KEYPOINTS, raw, sent_ns)

    def process(self, messages: list[bytes]) -> None:
        """Process as many images, each of which gives skeletons."""
        count = len(self.skeletons)
        self.enqueue(*messages)
        self.wait_for_frames(count + len(messages))

    def wait_for_frames(self, count: int) -> None:
        wait_until(lambda: len(self.skeletons) >= count)

    def count_lines(self, words: str) -> int:
        return sum(words in line for line in self.log.lines)

    def wait_for_lines(self, words: str, count: int = 1) -> None:
        wait_until(lambda: self.count_lines(words) >= count)


def wait_until(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + TIMEOUT_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.002)


def block_tracker(has_started: threading.Event, may_continue: threading.Event) -> type[PeopleTracker]:
    """Return a tracker that does not finish its first frame before it may."""

    class BlockedTracker(PeopleTracker):
        def update(self, *frame: Any) -> Any:
            has_started.set()
            assert may_continue.wait(TIMEOUT_S)
            return super().update(*frame)

    return BlockedTracker


def block_disk(monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """Let recorders write nothing before the event that is returned is set."""
    disk_is_ready, write = threading.Event(), Recorder.write
    monkeypatch.setattr(Recorder, 'write', lambda *a: disk_is_ready.wait(TIMEOUT_S) and write(*a))
    return disk_is_ready


def find_bag(folder: Path) -> Path:
    """Return the only bag of the run that recorded to the folder `live`."""
    (bag,) = (folder / 'live').iterdir()
    return bag


def recording_to(folder: Path, **values: object) -> Config:
    return with_settings(FAST_CONFIG, {'recorder.enabled': True, 'recorder.folder': str(folder), **values})


def assert_replay_gives_the_same(bag_folder: Path, out: Path) -> None:
    with Bag(bag_folder) as bag:
        replay(bag, out)
    for topic in ('/keypoints', '/camera_info', '/skeletons', '/cameras'):
        assert read_messages(out, topic) == read_messages(bag_folder, topic)


def test_a_replay_repeats_resets_parameters_and_bad_inputs(tmp_path: Path, stream: list[bytes]) -> None:
    live = CollectingRun(recording_to(tmp_path / 'live'))
    live.process(stream[:8])
    live.run.enqueue(Source.CAMERA_INFO, camera_info(), 5)
    live.enqueue(stream[3], stream[8][:60], stream[8])  # the late CameraInfo restarts tracking
    live.wait_for_frames(10)
    live.run.reset()
    live.process(stream[5:9])
    live.run.reconfigure(recording_to(tmp_path / 'live', **{'tracker.components': 5}))
    live.process(stream[9:13])
    live.run.stop()
    assert len(live.skeletons) == 18

    bag = find_bag(tmp_path)
    assert read_messages(bag, '/skeletons') == [o.data for o in live.skeletons]
    assert len(read_messages(bag, '/keypoints')) == 19
    assert_replay_gives_the_same(bag, tmp_path / 'again')
    first, *problems = [line for line in live.log.lines if '/keypoints' in line]
    assert first.startswith('info /keypoints: the first message was accepted')
    places = [line.split(': ')[:2] for line in problems]
    assert places == [['warning /keypoints', 'message 9'], ['error /keypoints', 'message 10']]
    assert live.run.statistics.reason.startswith('/keypoints: not a mocap_ros_msgs/msg/Keypoints2DArray')


def test_a_backlog_is_skipped_counted_and_left_out_of_a_replay(tmp_path: Path, stream: list[bytes]) -> None:
    has_started, may_continue = threading.Event(), threading.Event()
    tracker = block_tracker(has_started, may_continue)
    live = CollectingRun(recording_to(tmp_path / 'live', **{'node.queue': 2}), tracker)
    live.enqueue(stream[0], sent_ns=0)
    assert has_started.wait(TIMEOUT_S)
    live.enqueue(*stream[1:], sent_ns=0)
    may_continue.set()
    live.wait_for_frames(2)
    live.run.stop()
    stamps = [decode_keypoints(raw, FAST_CONFIG.node).header.stamp_ns for raw in (stream[0], stream[-1])]
    assert [o.stamp_ns for o in live.skeletons] == stamps
    skipped = [line for line in live.log.lines if 'newer messages were waiting' in line]
    assert [line.partition(': message ')[2].partition(':')[0] for line in skipped] == ['2', '11']  # 1st, 10th

    bag = find_bag(tmp_path)
    assert read_messages(bag, '/keypoints') == stream
    with Bag(bag) as opened:
        assert read_run(opened).skipped_inputs == set(range(2, FRAMES))
    assert_replay_gives_the_same(bag, tmp_path / 'again')


@pytest.mark.parametrize('remapped', [{}, {'/tf': '/robot/moving', '/tf_static': '/robot/fixed'}])
def test_people_of_a_driving_robot_replayed(tmp_path: Path, stream: list[bytes], remapped: dict[str, str]) -> None:
    values = {'node.output_frame': 'map', 'node.publish_tf': True, 'node.queue': 3, 'recorder.enabled': False}
    live = CollectingRun(recording_to(tmp_path / 'live', **values), names=TF_NAMES | remapped)
    live.run.enqueue(Source.CAMERA_INFO, camera_info(), 5)
    live.run.enqueue(Source.STATIC_TRANSFORMS, make_transforms(('base', 'camera', 0, (0.2, 0.0, 1.5))), 5)
    for frame, raw in enumerate(stream[:12]):
        if frame == 4:
            live.run.start_recording()  # the transforms that are known come first in the bag
        for part in range(-8, 8):  # more messages than the queue may hold of people
            stamp_ns = max(frame * STEP_NS + part * STEP_NS // 8, 0)
            moved = make_transforms(('map', 'base', stamp_ns, (2e-9 * stamp_ns, 0, 0)))
            live.run.enqueue(Source.TRANSFORMS, moved, 5)
        live.process([raw])
    live.run.stop()
    with Bag(find_bag(tmp_path)) as bag:
        result = replay(bag, tmp_path / 'again')
    assert (result.counters.accepted, result.unrecorded_inputs) == (8, 0)
    replayed = read_messages(tmp_path / 'again', '/skeletons')
    assert replayed == [o.data for o in live.skeletons[4:]]
    last = decode(replayed[-1], SKELETONS)
    assert last.header.frame_id == 'map'
    assert last.camera_pose.position.x == pytest.approx(2 * 11 / 30 + 0.2, abs=1e-6)


def test_a_stuck_disk_is_reported(tmp_path: Path, stream: list[bytes], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('mocap_ros.ros.live.MAX_PAUSE_SECONDS', 0.01)
    disk_is_ready = block_disk(monkeypatch)
    live = CollectingRun(recording_to(tmp_path / 'live'))
    live.process(stream[:1])
    live.wait_for_lines('the disk has taken nothing of the recording')
    assert 'the disk has taken nothing' in live.run.recorder_fault
    assert live.run.finish_recording() == find_bag(tmp_path)
    live.process(stream[1:3])
    assert live.count_lines('is finished') == 0
    disk_is_ready.set()
    live.run.stop()
    assert (live.run.recorder_fault, live.count_lines('is finished')) == ('', 1)
    assert read_messages(find_bag(tmp_path), '/keypoints') == stream[:1]


def test_lost_inputs_are_counted(tmp_path: Path, stream: list[bytes], monkeypatch: pytest.MonkeyPatch) -> None:
    disk_is_ready = block_disk(monkeypatch)
    live = CollectingRun(recording_to(tmp_path / 'live', **{'recorder.backlog': 3, 'node.queue': FRAMES}))
    live.process(stream[:8])
    with live.run._pipeline_lock:  # the last frame has been published, and now the recorder has refused it as well
        assert 'inputs missing' in live.run.recorder_state
    disk_is_ready.set()
    live.wait_for_lines('processed but not recorded')
    live.run.reset()
    live.process(stream[8:11])  # after the reset, at its place among the inputs that are in the bag
    live.run.stop()
    bag = find_bag(tmp_path)
    recorded = read_messages(bag, '/keypoints')
    missing = 11 - len(recorded)
    assert missing >= 4
    assert live.count_lines(f'is finished, but {missing} inputs are missing in it') == 1
    with Bag(bag) as opened:
        run = read_run(opened)
    assert run.lost_count == missing
    before = sum(raw in stream[:8] for raw in recorded)
    assert {number: [e.kind for e in events] for number, events in run.events.items()} == {before: ['reset']}


def fail(*_: object) -> Any:
    raise ZeroDivisionError('a fault of ours')


def test_a_fault_between_two_messages_costs_none(
    tmp_path: Path, stream: list[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    live = CollectingRun(recording_to(tmp_path / 'live'))
    with monkeypatch.context() as patch:
        patch.setattr(Recording, 'check', fail)
        live.process(stream[:3])
    live.run.stop()
    assert live.count_lines('ZeroDivisionError') == 1
    assert read_messages(find_bag(tmp_path), '/keypoints') == stream[:3]


def test_a_recording_that_cannot_begin_leaves_no_thread(tmp_path: Path) -> None:
    pipeline, threads = Pipeline(recording_to(tmp_path)), threading.enumerate()
    pipeline.set_camera_info(camera_info())
    with pytest.raises(ZeroDivisionError):
        Recording(pipeline, START_NS, NAMES, LineLog(), fail, MessageVersions())
    assert threading.enumerate() == threads
    assert not any(tmp_path.iterdir())


def test_a_stop_does_not_wait_for_ever_for_a_stuck_disk(
    tmp_path: Path, stream: list[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr('mocap_ros.bags.background.MAX_END_STALL_S', 0.05)
    disk_is_ready = block_disk(monkeypatch)
    live = CollectingRun(recording_to(tmp_path / 'live'))
    live.process(stream[:2])
    stopping = threading.Thread(target=live.run.stop)
    stopping.start()
    stopping.join(TIMEOUT_S)
    has_stopped = not stopping.is_alive()
    disk_is_ready.set()
    assert has_stopped
    assert live.count_lines('the disk takes nothing') == 1
    wait_until((find_bag(tmp_path) / 'metadata.yaml').is_file)  # what was not written yet is not lost
    assert read_messages(find_bag(tmp_path), '/keypoints') == stream[:2]


def test_people_keep_their_names_and_go_on_when_a_recording_starts(tmp_path: Path, stream: list[bytes]) -> None:
    """Two people before a camera that is not calibrated; one goes, after which the other would be the first."""
    values = {'recorder.enabled': False, 'node.camera_info_wait': 0.1, 'node.queue': 100}
    images = [decode_keypoints(raw, FAST_CONFIG.node) for raw in stream]
    together = [[p, replace(p, points=p.points + [250.0, 0.0])] for image in images for p in image.people]
    shown = [people if frame < 8 else people[1:] for frame, people in enumerate(together)]
    messages = [encode_keypoints(i.header, (640, 480), p) for i, p in zip(images, shown, strict=True)]
    live = CollectingRun(recording_to(tmp_path / 'live', **values))
    live.enqueue(*messages[:3])  # they wait for a CameraInfo
    live.process(messages[3:10])
    live.run.start_recording()
    live.process(messages[10:])
    live.run.stop()
    ids = [[p.id for p in decode(o.data, SKELETONS).people if not p.predicted] for o in live.skeletons]
    assert ids == [['person_1', 'person_2']] * 5 + [['person_2']] * (FRAMES - 8)
    with Bag(find_bag(tmp_path)) as bag:
        replay(bag, tmp_path / 'again')
    assert read_messages(tmp_path / 'again', '/skeletons') == [o.data for o in live.skeletons[7:]]


def test_a_change_of_parameters_makes_one_tracker_while_no_frame_is_processed() -> None:
    has_lock: list[bool] = []

    def make_tracker(*given: Any) -> PeopleTracker:
        has_lock.append(bool(CollectingRun.started) and live.run._pipeline_lock.locked())
        return PeopleTracker(*given)

    live = CollectingRun(FAST_CONFIG, make_tracker)
    for components in (5, 6):
        config = with_settings(FAST_CONFIG, {'tracker.components': components})
        live.run.check(config)
        live.run.reconfigure(config)
    live.run.stop()
    assert has_lock == [False, True, True]


def test_what_the_middleware_refuses_is_recorded_and_stops_nothing_else(
    tmp_path: Path, stream: list[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    live = CollectingRun(recording_to(tmp_path / 'live'))

    def publish(output: OutputMessage) -> None:
        if output.topic == 'skeletons':
            raise RuntimeError('not allowed')
        live.published.append(output)

    monkeypatch.setattr(live.run, '_publish', publish)
    live.enqueue(*stream[:3])
    wait_until(lambda: sum(o.topic == 'points' for o in live.published) == 3)
    live.run.stop()
    assert live.count_lines('skeletons: Traceback') == live.count_lines('RuntimeError: not allowed') == 1
    bag = find_bag(tmp_path)
    assert len(read_messages(bag, '/skeletons')) == 3
    assert read_messages(bag, '/keypoints') == stream[:3]


def test_why_nothing_is_recorded_is_shown_until_that_is_mended_or_not_wanted(tmp_path: Path) -> None:
    blocking = tmp_path / 'file'
    blocking.write_text('')
    live = CollectingRun(recording_to(blocking / 'bags'))
    assert live.run.recorder_state.startswith('not recording: ')
    assert live.run.recorder_fault.endswith('Not a directory')
    assert live.count_lines('Not a directory; nothing is recorded: ') == 1
    blocking.unlink()
    live.run.set_recording(True)
    assert live.run.recorder_state.startswith('recording to ')
    assert live.run.recorder_fault == ''

    live.run.set_recording(False)
    blocking.rename(tmp_path / 'bags')
    blocking.write_text('')
    live.run.set_recording(True)
    assert live.run.recorder_state.startswith('not recording: ')
    live.run.set_recording(False)
    live.run.reconfigure(with_settings(FAST_CONFIG, {'recorder.folder': str(blocking / 'bags')}))
    with pytest.raises(RecordingError):  # the caller of the service knows, and the parameter is not set
        live.run.start_recording()
    assert (live.run.recorder_state, live.run.recorder_fault) == ('off', '')
    live.run.stop()


class FaultyTracker(PeopleTracker):
    """A tracker that sees no people, and fails at every third frame, and at each from the ninth to its reset."""

    frames = 0

    def update(self, stamp_ns: int, *_: Any) -> TrackedFrame:
        self.frames += 1
        if self.frames % 3 == 0 or self.frames > 8:
            raise ZeroDivisionError('a fault of ours')
        return TrackedFrame(stamp_ns, People.none(), None)

    def reset(self) -> None:
        super().reset()
        self.frames = 0


def test_an_internal_error_costs_its_frame_and_is_logged_once(tmp_path: Path, stream: list[bytes]) -> None:
    live = CollectingRun(recording_to(tmp_path / 'live', **{'node.queue': 100}), FaultyTracker)
    for raw in stream[:14]:
        live.run.enqueue(Source.CAMERA_INFO, camera_info(), 5)  # ends no series of errors
        live.enqueue(raw)
    live.wait_for_frames(8)  # 1, 2, 4, 5, 7, 8 and after the reset two more
    live.run.stop()
    assert [line.count('Traceback') for line in live.log.lines].count(1) == 1
    dropped = [line for line in live.log.lines if 'internal error: ZeroDivisionError: a fault of ours' in line]
    assert len(dropped) == 1
    bag = find_bag(tmp_path)
    with Bag(bag) as opened:
        levels = [decode(m.raw, JOURNAL).level for m in opened.messages(['/mocap_node/journal'])]
    assert levels[2::2] == [0, 0, 1, 0, 0, 1, 0, 0, 1, 1, 1, 0, 0, 1]
    assert not any(levels[1::2])


@pytest.mark.parametrize(
    ('values', 'is_warned'), [({}, True), ({'node.output_frame': 'map', 'node.camera_pose': '0 0 1 0 0 0'}, False)]
)
def test_a_camera_without_a_name_is_logged(values: dict[str, str], is_warned: bool) -> None:
    live = CollectingRun(with_settings(FAST_CONFIG, values))
    live.process([encode_keypoints(Header(START_NS + i, ''), (640, 480), []) for i in range(2)])
    live.run.stop()
    assert live.count_lines('header.frame_id is empty') == is_warned


@pytest.mark.parametrize('latched', [(True,), (False, True)], ids=str)
def test_a_split_recording_is_read_by_file(tmp_path: Path, stream: list[bytes], latched: tuple[bool, ...]) -> None:
    """While an image is processed, inputs wait, which are recorded after its outputs with earlier times."""
    config = with_settings(FAST_CONFIG, {'recorder.folder': str(tmp_path), 'recorder.split_seconds': 1.0})
    offered = [make_topic('/', TRANSFORMS, latched=is_latched).qos[0] for is_latched in latched]
    qos = {'/tf_static': offered, '/camera_info': make_topic('/', CAMERA_INFO, latched=True).qos}
    others = LineLog(), lambda topic: qos.get(topic, ()), MessageVersions()
    recording = Recording(Pipeline(config), START_NS, TF_NAMES, *others)
    inputs: list[tuple[str, bytes]] = []

    def record(topic: str, msgtype: str, raw: bytes, delay_ms: int, result: ProcessingResult) -> None:
        now_ns = START_NS + delay_ms * 1_000_000
        inputs.append((topic, raw))
        source = next(s for s in Source if s.value.strip('/') == topic.strip('/'))
        message = ReceivedMessage(source, topic, 1, raw, (now_ns, now_ns))
        assert recording.write_input(message, msgtype, result, now_ns + 5_000_000)

    accepted, skipped = ProcessingResult(Acceptance.ACCEPTED), ProcessingResult(Acceptance.BACKLOG)
    static = [make_transforms((*frames, 0, (1, 0, 0))) for frames in (('map', 'base'), ('base', 'arm'))]
    record('/camera_info', CAMERA_INFO, camera_info(), 0, accepted)
    for raw in static:
        record('/tf_static', TRANSFORMS, raw, 0, accepted)
    record('/camera_info', CAMERA_INFO, b'', 0, ProcessingResult(Acceptance.INVALID))
    output = OutputMessage('skeletons', OUTPUTS['skeletons'], START_NS, b'')
    with_output = ProcessingResult(Acceptance.ACCEPTED, outputs=(output,))
    for i in range(90):
        raw = with_stamp(stream[0], START_NS + i)
        record('/keypoints', KEYPOINTS, raw, 33 * (i + 1), skipped if i == 80 else with_output)
        moving = make_transforms(('odom', 'map', i, (1, 0, 0)))
        record('/tf', TRANSFORMS, moving, 33 * (i + 1) + 3, accepted)
    recording.finish()

    files = sorted(recording.folder.glob('*.mcap'))
    assert len(files) == 3
    with Bag(recording.folder) as bag:
        run = read_run(bag)
        read = [(m.topic, m.raw) for m in run.leave_out_repeated(bag.messages({t for t, _ in inputs}))]
    assert read == inputs
    assert [read[number - 1][1] for number in run.skipped_inputs] == [with_stamp(stream[0], START_NS + 80)]
    raws = [raw for _, raw in inputs]
    for file in files[1:]:
        with Bag(file) as bag:
            alone = [m.raw for m in read_run(bag).leave_out_repeated(bag.messages({t for t, _ in inputs}))]
        assert sorted(alone[:3]) == sorted([camera_info(), *static])
        first = raws.index(alone[3])
        assert alone[3:] == raws[first : first + len(alone) - 3]


BODIES = range(12)
SOURCES = {'/keypoints': Source.KEYPOINTS, '/camera_info': Source.CAMERA_INFO, '/tf': Source.TRANSFORMS}


def put(queue: InputQueue, topic: str, count: int = 1, size: int = 1) -> None:
    for _ in range(count):
        queue.put(SOURCES[topic], topic, bytes(size), (1, 1))


def take_all(queue: InputQueue, limit: int = 10**6) -> list[tuple[str, int, bool]]:
    taken = []
    while popped := queue.pop(limit):
        taken.append((popped[0].topic, popped[0].number, popped[1]))
    return taken


def put_image(queue: InputQueue, stamp_s: int, bodies: range = BODIES) -> None:
    for body in bodies:
        raw = encode_plain((Header(stamp_s * NS_PER_S, 'camera'), ()), HRI_IDS)
        queue.put(Source.BODY, f'/humans/bodies/b{body}/skeleton2d', raw, (1, 1))


def take_images(queue: InputQueue, limit: int) -> Counter[int]:
    """Return the numbers of bodies that are not skipped, by their stamps in s."""
    taken: Counter[int] = Counter()
    while popped := queue.pop(limit):
        taken[read_stamp_ns(popped[0].raw) // NS_PER_S] += not popped[1]
    queue.wait(0.0)
    return +taken


def test_images_of_single_bodies_are_skipped_as_a_whole() -> None:
    queue = InputQueue()
    for stamp_s in range(1, 6):
        put_image(queue, stamp_s)
    put_image(queue, 6, range(5))  # the others are still on their way
    assert take_images(queue, limit=3) == {6: 5}
    put_image(queue, 6, range(5, 12))
    put_image(queue, 7)
    assert take_images(queue, limit=3) == {6: 7, 7: 12}
    for stamp_s in (8, 9, 10, 2):  # time goes back
        put_image(queue, stamp_s)
    put_image(queue, 3)
    assert take_images(queue, limit=3) == {8: 12, 9: 12, 10: 12, 3: 12}
    put_image(queue, 2)
    assert take_images(queue, limit=3) == {2: 12}, 'what comes later is not skipped'


def test_from_as_many_images_as_the_limit_on_the_newest_alone_is_not_skipped() -> None:
    queue = InputQueue()
    put(queue, '/keypoints', 2)
    assert [skipped for *_, skipped in take_all(queue, limit=3)] == [False, False]
    put(queue, '/camera_info')
    put(queue, '/keypoints', 3)
    skipped = [(topic, skipped) for topic, _, skipped in take_all(queue, limit=3)]
    assert skipped == [('/camera_info', False), *(('/keypoints', s) for s in (True, True, False))]


@given(st.lists(st.tuples(st.sampled_from([*SOURCES, 'pop']), st.integers(0, 60))), st.integers(1, 5))
def test_every_message_is_taken_in_order_or_counted_as_removed(steps: list[tuple[str, int]], most: int) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(input_queue, 'MAX_WAITING', most)
        patch.setattr(input_queue, 'MAX_WAITING_BYTES', 100)
        queue, sent, taken = InputQueue(), dict.fromkeys(SOURCES, 0), dict.fromkeys(SOURCES, 0)
        numbers = dict.fromkeys(SOURCES, 0)

        def note(topic: str, number: int) -> None:
            assert number > numbers[topic]
            numbers[topic] = number
            taken[topic] += 1

        for step, size in steps:
            if step != 'pop':
                put(queue, step, size=size)
                sent[step] += 1
                assert queue.count_received(step) == sent[step]
            elif popped := queue.pop(2):
                note(popped[0].topic, popped[0].number)
            assert len(queue) <= most * len(SOURCES)
            waiting = queue._waiting.values()
            assert sum(len(m.raw) for m in waiting) <= 100 + 60 * len(SOURCES)
        for topic, number, _ in take_all(queue):
            note(topic, number)
        removed = queue.pop_removed_counts()
    assert {topic: taken[topic] + removed[topic] for topic in SOURCES} == sent
    assert all(numbers[topic] == sent[topic] for topic in SOURCES), 'the newest is never removed'
