# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Replays and playback of bags of every storage, version and origin, and what a replay records of its origin."""

import hashlib
import json
import platform
from importlib import metadata
from importlib.resources import files
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from mocap_ros.bags.journal import Acceptance, Journal, read_run
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.bags.rosbag2 import make_topic
from mocap_ros.bags.topics import Source
from mocap_ros.cli.main import main
from mocap_ros.config import Config, RecorderConfig, Value, from_yaml, values, with_values
from mocap_ros.demo.scene import make_recording
from mocap_ros.errors import ConfigError, InputError, RecordingError
from mocap_ros.formats.sequence_file import save_sequence
from mocap_ros.messages import cdr
from mocap_ros.messages.camera_info import CAMERA_INFO, decode_camera_info
from mocap_ros.messages.cdr import decode, typestore
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.messages.skeletons import SKELETON_DEFINITION, SKELETONS
from mocap_ros.messages.transforms import TRANSFORMS
from mocap_ros.models.model_file import load_base_poses
from mocap_ros.recordings.load_results import load_recording
from mocap_ros.recordings.playback import Playback, encode_sequence
from mocap_ros.runtime.pipeline import Pipeline
from mocap_ros.runtime.provenance import RECORDED_PACKAGES
from mocap_ros.runtime.replay import ReplayOptions, replay
from mocap_ros.skeleton import CORE_COUNT
from tests.support.camera_messages import camera_info, encode_ros1_camera_info, make_ros1_header, make_transforms
from tests.support.paths import ROOT
from tests.support.pipeline_inputs import (
    BAG_STEP_NS,
    DEFINITION,
    FAST_CONFIG,
    FAST_VALUES,
    START_NS,
    encode_demo_frames,
    read_messages,
    write_keypoints_bag,
)

OPTIONS = ReplayOptions(FAST_CONFIG)
FAST_ARGUMENTS = [word for name, value in FAST_VALUES.items() for word in ('--set', f'{name}={value}')]
FRAMES = 12
INFO = camera_info(d=(0.1, -0.2, 0.0, 0.0, 0.0))


@pytest.fixture(scope='module')
def stream() -> list[bytes]:
    return encode_demo_frames(FRAMES)


@pytest.fixture(scope='module')
def skeletons(stream: list[bytes], tmp_path_factory: pytest.TempPathFactory) -> list[bytes]:
    """Return the skeletons that the replay of a bag of this package gives."""
    folder = tmp_path_factory.mktemp('ours')
    write_keypoints_bag(folder / 'bag', stream, INFO, START_NS)
    return replay_skeletons(folder / 'bag', folder / 'out')


def replay_skeletons(path: Path, out: Path, options: ReplayOptions = OPTIONS) -> list[bytes]:
    with Bag(path) as bag:
        replay(bag, out, options)
    return read_messages(out, '/skeletons')


# Metadata version, storage plugin and compression of a bag.
BAG_KINDS: list[Any] = [
    (8, StoragePlugin.SQLITE3, CompressionMode.NONE),
    (9, StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
    (8, StoragePlugin.MCAP, CompressionMode.FILE),
    (9, StoragePlugin.MCAP, CompressionMode.STORAGE),
]


@pytest.mark.parametrize(('version', 'storage', 'compression'), BAG_KINDS)
def test_bags_of_every_storage_and_version_give_the_same_skeletons(
    tmp_path: Path, stream: list[bytes], skeletons: list[bytes], version: Any, storage: Any, compression: Any
) -> None:
    writer = Writer(tmp_path / 'bag', version=version, storage_plugin=storage)
    writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        camera = writer.add_connection('/camera_info', CAMERA_INFO, typestore=typestore())
        points = writer.add_connection('/people/keypoints', KEYPOINTS, typestore=typestore())
        writer.write(camera, START_NS, INFO)
        for i, raw in enumerate(stream):
            writer.write(points, START_NS + i * BAG_STEP_NS, raw)
    assert replay_skeletons(tmp_path / 'bag', tmp_path / 'out') == skeletons
    bare = [f for f in (tmp_path / 'bag').iterdir() if f.suffix in ('.db3', '.mcap')]
    if bare and compression in (CompressionMode.NONE, CompressionMode.STORAGE):
        assert replay_skeletons(bare[0], tmp_path / 'out2') == skeletons


OLD_TRANSFORMS = 'tf/msg/tfMessage'


def make_ros1_store() -> Typestore:
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg('geometry_msgs/TransformStamped[] transforms', OLD_TRANSFORMS))
    for file in (Path(cdr.__file__).parent / 'msg').glob('Keypoints*.msg'):
        store.register(get_types_from_msg(file.read_text(), f'mocap_ros_msgs/msg/{file.stem}'))
    return store


def test_a_bag_of_ros_1_gives_the_same(tmp_path: Path, stream: list[bytes], skeletons: list[bytes]) -> None:
    """The bag has the header and the CameraInfo of ROS 1, which differ from those of ROS 2, and its first /tf.

    The type of this is of a package that is gone, and the name of its topic has no slash.
    """
    store = make_ros1_store()
    with Ros1Writer(tmp_path / 'old.bag') as writer, Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        types = {'/camera_info': CAMERA_INFO, 'tf': OLD_TRANSFORMS, '/keypoints': KEYPOINTS}
        topics = {name: writer.add_connection(name, t, typestore=store) for name, t in types.items()}
        writer.write(topics['/camera_info'], START_NS, encode_ros1_camera_info(store, INFO))
        recorder.write('/camera_info', CAMERA_INFO, INFO, START_NS, START_NS)
        for i, raw in enumerate(stream):
            time_ns, message = START_NS + i * BAG_STEP_NS, decode(raw, KEYPOINTS)
            stamp = message.header.stamp
            move = make_transforms(('map', 'camera', stamp.sec * 10**9 + stamp.nanosec, (i, 0, 1)))
            recorder.write('/tf', TRANSFORMS, move, time_ns, time_ns)
            recorder.write('/keypoints', KEYPOINTS, raw, time_ns, time_ns)
            (place,) = decode(move, TRANSFORMS).transforms
            for stamped in (place, message):
                stamped.header = make_ros1_header(store, stamped.header)
            tf = store.types[OLD_TRANSFORMS](transforms=[place])
            writer.write(topics['tf'], time_ns, store.serialize_ros1(tf, OLD_TRANSFORMS))
            writer.write(topics['/keypoints'], time_ns, store.serialize_ros1(message, KEYPOINTS))
    assert replay_skeletons(tmp_path / 'old.bag', tmp_path / 'out') == skeletons
    assert read_messages(tmp_path / 'out', '/camera_info') == [INFO]
    options = ReplayOptions(with_values(FAST_CONFIG, {'node.output_frame': 'map'}))
    expected = replay_skeletons(tmp_path / 'bag', tmp_path / 'new', options)
    assert {decode(raw, SKELETONS).header.frame_id for raw in expected} == {'map'}
    assert replay_skeletons(tmp_path / 'old.bag', tmp_path / 'moved', options) == expected


def test_a_split_bag_and_its_files_replay(tmp_path: Path, stream: list[bytes], skeletons: list[bytes]) -> None:
    write_keypoints_bag(tmp_path / 'bag', stream, INFO, START_NS)
    config = with_values(FAST_CONFIG, {'recorder.split_seconds': 0.1})
    assert replay_skeletons(tmp_path / 'bag', tmp_path / 'split', ReplayOptions(config)) == skeletons
    files = sorted((tmp_path / 'split').glob('*.mcap'))
    assert len(files) > 2
    assert replay_skeletons(tmp_path / 'split', tmp_path / 'again', ReplayOptions()) == skeletons
    for file in files:
        assert replay_skeletons(file, tmp_path / f'{file.stem}.out', ReplayOptions())


def test_an_interrupted_replay_is_resumed(tmp_path: Path, stream: list[bytes], skeletons: list[bytes]) -> None:
    write_keypoints_bag(tmp_path / 'bag', stream, INFO, START_NS)

    def interrupted(found: Any, _: int) -> Any:
        yield from islice(found, 5)
        raise KeyboardInterrupt

    with Bag(tmp_path / 'bag') as bag, pytest.raises(KeyboardInterrupt):
        replay(bag, tmp_path / 'out', OPTIONS, interrupted)
    assert read_messages(tmp_path / 'out.partial', '/skeletons') == skeletons[:4]
    with pytest.raises(RecordingError, match=r'out\.partial: an interrupted replay left this bag; --resume'):
        replay_skeletons(tmp_path / 'bag', tmp_path / 'out')
    command = ['replay', str(tmp_path / 'bag'), '-o', str(tmp_path / 'out'), '--resume', *FAST_ARGUMENTS]
    assert main(command) == 0
    assert read_messages(tmp_path / 'out', '/skeletons') == skeletons
    assert not (tmp_path / 'out.partial').exists()
    assert main(command) == 0  # the bag is complete already


def test_a_bag_that_fails_does_not_stop_the_others(
    tmp_path: Path, stream: list[bytes], skeletons: list[bytes], capfd: pytest.CaptureFixture[str]
) -> None:
    for name in ('a', 'b', 'c'):
        write_keypoints_bag(tmp_path / name, stream, INFO, START_NS)
    (tmp_path / 'b' / 'b_0.mcap').write_bytes(b'')
    bags = [str(tmp_path / name) for name in ('a', 'b', 'c')]
    assert main(['replay', *bags, '-o', str(tmp_path / 'out'), *FAST_ARGUMENTS]) == 1
    out, err = capfd.readouterr()
    assert len(out.splitlines()) == 4, 'counters and summary of two bags'
    (line,) = err.splitlines()
    assert line.startswith(f'mocap-ros: {tmp_path}/b: ')
    for name in ('a', 'c'):
        assert read_messages(tmp_path / 'out' / name, '/skeletons') == skeletons


@pytest.mark.parametrize(
    ('accepted', 'refused', 'grade', 'count'),
    [(FRAMES, 1, 'not judged', ''), (FRAMES, 3, 'doubtful', f'3 of {FRAMES + 3}'), (0, 3, 'wrong', '3 of 3')],
)
def test_many_refused_messages_make_an_input_doubtful(
    tmp_path: Path, stream: list[bytes], accepted: int, refused: int, grade: str, count: str
) -> None:
    messages = [*stream[:accepted], *[stream[-1][:50]] * refused]
    write_keypoints_bag(tmp_path / 'bag', messages, camera_info(), START_NS)
    with Bag(tmp_path / 'bag') as bag:
        summary = replay(bag, tmp_path / 'out', OPTIONS).summary
    assert (summary.grade, summary.is_wrong) == (grade, grade == 'wrong')
    assert summary.reason.startswith(count)
    if accepted:
        recording = load_recording(tmp_path / 'out', config=FAST_CONFIG)
        assert str(recording.summary).partition(';')[0] == str(summary).partition(';')[0], (
            'likewise when it is viewed'
        )


# Parameters of a recorded run.
RECORDED = {**FAST_VALUES, 'tracker.window': 1.2, 'tracker.lag': 0.1, 'node.hfov': 60.0}
CHANGED_AFTER = 6  # inputs after which it was given others
CHANGED = {**RECORDED, 'tracker.lag': 0.0, 'tracker.min_score': 0.2}


def write_started_run(
    folder: Path, stream: list[bytes], parameters: dict[str, Value], kept: dict[str, object] | None = None
) -> None:
    """Write a bag of a run that began with these parameters, or of none where there are none."""
    journal = Journal('/mocap_node/journal')
    with Recorder(folder, RecorderConfig()) as recorder:
        if parameters:
            recorder.write(*journal.make_parameters_record(parameters, START_NS))
        if kept:
            recorder.write(*journal.make_reset_record(START_NS, kept))
        for number, raw in enumerate(stream):
            recorder.write('/keypoints', KEYPOINTS, raw, START_NS + number, START_NS + number)


def write_recorded_run(folder: Path, stream: list[bytes], recorded: dict[str, object]) -> Path:
    """Write a bag with the journal of a run that began with some parameters and went on with `CHANGED`."""
    journal = Journal('/mocap_node/journal')
    with Recorder(folder, RecorderConfig()) as recorder:
        recorder.write(*journal.make_parameters_record(values(with_values(Config(), recorded)), START_NS))
        for number, raw in enumerate(stream, 1):
            times_ns = (START_NS + number * BAG_STEP_NS,) * 2
            for record in journal.make_input_records('/keypoints', KEYPOINTS, raw, times_ns, Acceptance.ACCEPTED):
                recorder.write(*record)
            if number == CHANGED_AFTER:
                changed = values(with_values(Config(), {**recorded, **CHANGED}))
                recorder.write(*journal.make_parameters_record(changed, times_ns[0]))
    return folder


def read_parameters(path: Path) -> list[dict[str, Value]]:
    with Bag(path) as bag:
        recorded_run = read_run(bag)
    return [recorded_run.parameters, *(dict(e.parameters) for e in recorded_run.events.get(CHANGED_AFTER, ()))]


@pytest.mark.parametrize('with_file', [False, True])
def test_set_changes_parameters_of_the_recorded_run(tmp_path: Path, stream: list[bytes], with_file: bool) -> None:
    """They stay where the run changed its parameters; a file replaces all; --focal replaces node.hfov."""
    write_recorded_run(tmp_path / 'bag', stream, RECORDED)
    arguments = ['--set', 'tracker.lag=0.3', '--set', 'recorder.split_seconds=0.1', '--focal', '800']
    given = {'tracker.lag': 0.3, 'node.hfov': 0.0, 'node.focal': 800.0}
    expected = [{**RECORDED, **given}, {**CHANGED, **given}]
    if with_file:
        text = 'tracker: {model: walk, components: 8, iterations: 2, lag: 0.2}\nnode: {hfov: 50}'
        (tmp_path / 'file.yaml').write_text(text)
        arguments += ['--config', str(tmp_path / 'file.yaml')]
        expected = [{**FAST_VALUES, 'tracker.iterations': 2, **given}]
    assert main(['replay', str(tmp_path / 'bag'), '-o', str(tmp_path / 'out'), *arguments]) == 0
    found = read_parameters(tmp_path / 'out')
    split = {'recorder.split_seconds': 0.1}
    assert found == [values(with_values(Config(), {**each, **split})) for each in expected]
    assert len(list((tmp_path / 'out').glob('*.mcap'))) > 1


def test_parameters_that_no_longer_exist_are_named_once(tmp_path: Path, stream: list[bytes]) -> None:
    gone: dict[str, Value] = {'tracker.refine': 0.2, 'solver.norm': 'squared'}
    parameters = values(with_values(Config(), RECORDED))
    write_started_run(tmp_path / 'bag', stream[:5], {**parameters, **gone})
    with Bag(tmp_path / 'bag') as bag:
        result = replay(bag, tmp_path / 'out')
    assert sum('solver.norm = squared, tracker.refine = 0.2' in line for line in result.notes) == 1
    assert read_parameters(tmp_path / 'out') == [parameters]


@pytest.mark.parametrize('version', ['this', 'older', 'unrecorded'])
def test_a_replay_waits_for_a_calibration_as_live(tmp_path: Path, stream: list[bytes], version: str) -> None:
    config, wait = with_values(FAST_CONFIG, {'node.camera_info_wait': 0.1}), 'node.camera_info_wait'
    live = Pipeline(config if version == 'this' else FAST_CONFIG)
    results = [live.feed(Source.KEYPOINTS, raw) for raw in stream]
    expected = [o.data for result in results for o in result.outputs if o.topic == 'skeletons']
    parameters = {k: v for k, v in values(config).items() if version == 'this' or k != wait}
    write_started_run(tmp_path / 'bag', stream, {} if version == 'unrecorded' else parameters)
    options = ReplayOptions(config if version == 'unrecorded' else None)
    assert len(expected) == FRAMES - 3 * (version == 'this')
    assert replay_skeletons(tmp_path / 'bag', tmp_path / 'out', options) == expected


@pytest.mark.parametrize(
    'kept',
    [
        {'numbered': 'two'},
        {'people': 3},
        {'people': [['anna', 1]]},
        {'people': [['anna', 1, [[0.0, 0.0, 1.0]]]]},
        {'people': [['anna', 1, [[0.0, float('inf'), 1.0]] * CORE_COUNT]]},
    ],
    ids=str,
)
def test_what_a_reset_keeps_is_checked(tmp_path: Path, stream: list[bytes], kept: dict[str, object]) -> None:
    write_started_run(tmp_path / 'bag', stream[:2], values(FAST_CONFIG), kept)
    with (
        Bag(tmp_path / 'bag') as bag,
        pytest.raises(InputError, match=f'{bag.path}: reset after input 0: people: '),
    ):
        replay(bag, tmp_path / 'out')


def test_only_the_user_chooses_files_of_models(tmp_path: Path, stream: list[bytes]) -> None:
    model = str(ROOT / 'mocap_ros' / 'models' / 'shipped' / 'walk.npz')
    write_recorded_run(tmp_path / 'bag', stream, {**RECORDED, 'tracker.model': model})
    with Bag(tmp_path / 'bag') as bag:
        no_model: tuple[dict[str, Value], ...] = ({}, {'tracker.lag': 0.0})
        for changes in no_model:
            with pytest.raises(InputError, match=r'recorded with tracker.model .* --set tracker.model=VALUE'):
                replay(bag, tmp_path / 'out', ReplayOptions(changes=changes))
        replay(bag, tmp_path / 'out', ReplayOptions(changes={'tracker.model': model}))
        with pytest.raises(ConfigError, match=r'tracker\.windo'):
            replay(bag, tmp_path / 'wrong', ReplayOptions(changes={'tracker.windo': 1.0}))
    start, changed = read_parameters(tmp_path / 'out')
    assert start['tracker.model'] == changed['tracker.model'] == model


def test_inputs_keep_their_qos_in_a_replay(stream: list[bytes], tmp_path: Path) -> None:
    """A player then offers it; static transforms are kept for late subscribers, whatever the bag says."""
    transforms = make_transforms(('map', 'camera', 0, (0, 0, 1)))
    best_effort = {**make_topic('/keypoints', KEYPOINTS).qos[0], 'reliability': 'best_effort', 'depth': 5}
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        recorder.add_topic(make_topic('/keypoints', KEYPOINTS, qos=[best_effort]))
        recorder.declare_topic('/camera_info', CAMERA_INFO, latched=True)
        recorder.write('/camera_info', CAMERA_INFO, INFO, START_NS, START_NS)
        recorder.write('/tf_static', TRANSFORMS, transforms, START_NS, START_NS)
        for i, raw in enumerate(stream[:4]):
            recorder.write('/keypoints', KEYPOINTS, raw, START_NS + i, START_NS)
    config = with_values(FAST_CONFIG, {'node.output_frame': 'map'})
    with Bag(tmp_path / 'bag') as bag:
        replay(bag, tmp_path / 'out', ReplayOptions(config))
        recorded = bag.qos
    with Bag(tmp_path / 'out') as bag:
        assert bag.latched_topics == {'/camera_info', '/tf_static', '/skeleton_definition'}
        assert all(bag.qos[topic] == recorded[topic] for topic in ('/keypoints', '/camera_info'))
        replay(bag, tmp_path / 'again')
    assert read_all(tmp_path / 'again') == read_all(tmp_path / 'out')


def read_all(path: Path) -> list[tuple[str, int, bytes]]:
    with Bag(path) as bag:
        return [(m.topic, m.time_ns, m.raw) for m in bag.messages(bag.topics)]


def test_a_bag_names_versions_models_and_parameters(tmp_path: Path) -> None:
    config = with_values(FAST_CONFIG, {'solver.max_iterations': 7, 'solver.prior': 'learned'})
    with Bag(write_keypoints_bag(tmp_path / 'bag', encode_demo_frames(2))) as bag:
        replay(bag, tmp_path / 'out', ReplayOptions(config))
    with (tmp_path / 'out' / 'out_0.mcap').open('rb') as file:
        attachments = {a.name: a for a in make_reader(file).iter_attachments()}
    kinds = {name: a.media_type for name, a in attachments.items()}
    assert kinds == {'mocap_ros.yaml': 'application/yaml', 'provenance.json': 'application/json'}
    assert from_yaml(attachments['mocap_ros.yaml'].data.decode(), 'mocap_ros.yaml') == config

    provenance = json.loads(attachments['provenance.json'].data)
    versions = provenance['versions']
    assert versions.keys() >= {'python', *RECORDED_PACKAGES}
    assert versions['python'] == platform.python_version()
    for package in ('mocap_ros', 'numpy', 'scipy', 'mcap', 'rosbags'):
        assert versions[package] == metadata.version(package)
    walk, model = provenance['models']['walk'], load_base_poses('walk')
    with np.load(str(files('mocap_ros') / 'models' / 'shipped' / 'walk.npz')) as archive:
        arrays = b''.join(archive[name].astype(float).tobytes() for name in ('mean', 'components', 'std'))
    assert (walk['sha256'], walk['stature']) == (hashlib.sha256(arrays).hexdigest(), model.stature)
    assert walk['provenance'] == json.loads(json.dumps(dict(model.provenance)))
    assert 'mocap.cs.cmu.edu' in provenance['lifter']['provenance']['acknowledgement']
    assert len(bytes.fromhex(provenance['lifter']['sha256'])) == hashlib.sha256().digest_size


def test_keypoints_and_their_camera_are_played_on_the_topics_of_the_node(tmp_path: Path, stream: Any) -> None:
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        recorder.declare_topic('/unused', KEYPOINTS)
        recorder.write('/left/camera_info', CAMERA_INFO, INFO, 1, 1)
        recorder.write('/skeleton_definition', SKELETON_DEFINITION, DEFINITION, 2, 2)
        for frame, raw in enumerate(stream):
            recorder.write('/left/keypoints', KEYPOINTS, raw, 10 + frame, 10)
    for to, beside in (('/front/people', '/front/camera_info'), ('people', 'camera_info')):
        playback = Playback(tmp_path / 'bag', to=to)
        assert {t.recorded: (t.name, t.type) for t in playback.topics} == {
            '/left/keypoints': (to, KEYPOINTS),
            '/left/camera_info': (beside, CAMERA_INFO),
        }
    assert playback.count == FRAMES + 1
    expected = [(1, '/left/camera_info', INFO)]
    expected += [(10 + i, '/left/keypoints', raw) for i, raw in enumerate(stream)]
    for _ in range(2):  # a playback can be repeated
        assert [(m.due_ns, playback.topics[m.topic].recorded, m.raw) for m in playback] == expected


@pytest.mark.parametrize('is_calibrated', [False, True])
def test_a_sequence_file_is_played_at_its_stamps(tmp_path: Path, is_calibrated: bool) -> None:
    sequence = make_recording().sequence(is_calibrated=is_calibrated)
    save_sequence(tmp_path / 'demo.npz', sequence)
    playback = Playback(tmp_path / 'demo.npz')
    topics = [('keypoints', KEYPOINTS), ('camera_info', CAMERA_INFO)][: 1 + is_calibrated]
    assert [(t.name, t.type) for t in playback.topics] == topics
    messages = [*playback]
    assert playback.count == len(messages) == len(sequence) * len(topics)
    keypoints = [(m.due_ns, m.raw) for m in messages if m.topic == 0]
    assert keypoints == [(f.due_ns, f.raw) for f in encode_sequence(sequence)]
    for message in messages[:is_calibrated]:  # before the first keypoints
        assert decode_camera_info(message.raw).intrinsics.focal_lengths == pytest.approx([600.0, 600.0])
