"""Bags: real files, read back message for message by readers from other hands."""

from __future__ import annotations

import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader

from mocap_ros.config import RecorderConfig
from mocap_ros.errors import InputError, RecordingError
from mocap_ros.io import messages
from mocap_ros.io.bags import Bag
from mocap_ros.io.journal import Entry, Journal, Verdict, decode_entry, encode_entry
from mocap_ros.io.messages import Header, encode_keypoints, typestore
from mocap_ros.io.recorder import Recorder, new_bag_folder
from mocap_ros.people import Person2D
from mocap_ros.skeleton import CMU15, layout

START = 1_700_000_000_000_000_000
STEP = 33_000_000
FRAMES = 60
DEFINITION = messages.encode_skeleton_definition(CMU15)

Message = tuple[str, int, int, bytes]


def keypoints(frame: int) -> bytes:
    joints = layout('coco17').joints
    points = np.random.default_rng(frame).uniform(0, 640, (len(joints), 2))
    person = Person2D('anna', joints, points, np.ones(len(joints)))
    return encode_keypoints(Header(frame * STEP, 'camera'), (640, 480), [person])


def write_bag(folder: Path, config: RecorderConfig) -> list[Message]:
    """A bag of keypoints and one latched message; returns topic, log time, publish time and data of each."""
    written: list[Message] = [('/skeleton_definition', START, START, DEFINITION)]
    written += [('/keypoints', START + i * STEP, START + i * STEP - 7, keypoints(i)) for i in range(FRAMES)]
    types = {'/keypoints': messages.KEYPOINTS, '/skeleton_definition': messages.SKELETON_DEFINITION}
    with Recorder(folder, config) as recorder:
        recorder.announce('/skeleton_definition', messages.SKELETON_DEFINITION, latched=True)
        for topic, log_ns, publish_ns, data in written:
            recorder.write(topic, types[topic], data, log_ns, publish_ns)
    return written


@pytest.fixture(scope='module', params=['zstd', 'lz4', 'none'])
def recorded(request: Any, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Message]]:
    folder = tmp_path_factory.mktemp('bags') / request.param
    return folder, write_bag(folder, RecorderConfig(compression=request.param))


def test_rosbags_reads_the_folder_and_the_bare_file(recorded: tuple[Path, list[Message]]) -> None:
    folder, written = recorded
    expected = [(topic, log_ns, data) for topic, log_ns, _, data in written]
    for path in (folder, folder / f'{folder.name}_0.mcap'):
        with Reader(path) as reader:
            assert [(c.topic, t, bytes(raw)) for c, t, raw in reader.messages()] == expected
            assert reader.message_count == FRAMES + 1
            durability = {c.topic: c.ext.offered_qos_profiles[0].durability.name for c in reader.connections}
            assert durability == {'/keypoints': 'VOLATILE', '/skeleton_definition': 'TRANSIENT_LOCAL'}
        with AnyReader([path]) as any_reader:  # checks the type hashes of metadata.yaml against the definitions
            for connection, _, raw in any_reader.messages():
                message = any_reader.deserialize(raw, connection.msgtype)
                assert repr(message) == repr(messages.decode(bytes(raw), connection.msgtype))


def test_mcap_reads_it_by_index(recorded: tuple[Path, list[Message]]) -> None:
    folder, written = recorded
    with (folder / f'{folder.name}_0.mcap').open('rb') as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics.message_count == FRAMES + 1
        assert len(summary.chunk_indexes) >= FRAMES * STEP / 0.4e9
        read = [(c.topic, m.log_time, m.publish_time, m.data) for _, c, m in reader.iter_messages()]
        assert read == written
        assert reader.get_header().profile == 'ros2'
        for channel in summary.channels.values():
            schema = summary.schemas[channel.schema_id]
            assert (schema.encoding, channel.message_encoding) == ('ros2msg', 'cdr')
            assert channel.metadata['topic_type_hash'] == typestore().hash_rihs01(schema.name)
            assert yaml.safe_load(channel.metadata['offered_qos_profiles'])[0]['history'] == 'keep_last'
        (metadata,) = [m for m in reader.iter_metadata() if m.name == 'rosbag2']
        inside = yaml.safe_load(metadata.metadata['serialized_metadata'])
    beside = yaml.safe_load((folder / 'metadata.yaml').read_text())
    assert beside == {'rosbag2_bagfile_information': inside}
    assert inside['version'] == 9
    assert inside['storage_identifier'] == 'mcap'
    assert inside['relative_file_paths'] == [f'{folder.name}_0.mcap']
    assert inside['starting_time']['nanoseconds_since_epoch'] == START
    assert inside['duration']['nanoseconds'] == (FRAMES - 1) * STEP


def test_mcap_ros2_decodes_it(recorded: tuple[Path, list[Message]]) -> None:
    folder, written = recorded
    with (folder / f'{folder.name}_0.mcap').open('rb') as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        read = [(m.log_time, decoded) for _, _, m, decoded in reader.iter_decoded_messages(['/keypoints'])]
    assert len(read) == FRAMES
    for (time_ns, got), (_, log_ns, _, data) in zip(read, written[1:], strict=True):
        expected = messages.decode(data, messages.KEYPOINTS)
        assert time_ns == log_ns
        assert got.header.stamp.nanosec == expected.header.stamp.nanosec
        np.testing.assert_array_equal(got.people[0].x, expected.people[0].x)


def test_a_bag_of_ours_is_read_back(recorded: tuple[Path, list[Message]]) -> None:
    folder, written = recorded
    with Bag(folder) as bag:
        topic = bag.keypoints_topic()
        read = list(bag.messages([topic]))
        assert bag.count([topic]) == FRAMES
    assert [(m.topic, m.time_ns, m.raw) for m in read] == [(t, log_ns, d) for t, log_ns, _, d in written[1:]]
    assert {m.type for m in read} == {messages.KEYPOINTS}


def test_a_killed_recording_loses_no_more_than_a_chunk(tmp_path: Path) -> None:
    code = (
        'import os, sys; from pathlib import Path; from tests.test_recorder import *\n'
        'recorder = Recorder(Path(sys.argv[1]), RecorderConfig())\n'
        'for i in range(FRAMES):\n'
        "    recorder.write('/keypoints', messages.KEYPOINTS, keypoints(i), START + i * STEP, START)\n"
        'os.kill(os.getpid(), 9)\n'
    )
    root = Path(__file__).parents[1]
    subprocess.run([sys.executable, '-c', code, str(tmp_path / 'bag')], cwd=root, check=False)
    with (tmp_path / 'bag' / 'bag_0.mcap').open('rb') as file:
        reader = NonSeekingReader(file)
        read = []
        with suppress(McapError):  # the end is missing
            read.extend(m.data for _, _, m in reader.iter_messages(log_time_order=False))
    lost = RecorderConfig().chunk_seconds * 1e9 / STEP + 1
    assert len(read) >= FRAMES - lost
    assert read == [keypoints(i) for i in range(len(read))]
    for path in (tmp_path / 'bag', tmp_path / 'bag' / 'bag_0.mcap'):
        cut_off = f'{path.name}: the recording was cut off, {len(read)} messages are left; not finished'
        with pytest.raises(InputError, match=cut_off):
            Bag(path)


def test_a_bag_without_metadata_points_to_its_file(tmp_path: Path) -> None:
    write_bag(tmp_path / 'bag', RecorderConfig())
    (tmp_path / 'bag' / 'metadata.yaml').unlink()
    with pytest.raises(InputError, match=r'not finished: no metadata\.yaml; give bag_0\.mcap instead'):
        Bag(tmp_path / 'bag')
    with Bag(tmp_path / 'bag' / 'bag_0.mcap') as bag:
        assert bag.count(bag.topics) == FRAMES + 1


def test_a_full_disk_is_one_clear_error_and_keeps_what_was_written(tmp_path: Path) -> None:
    code = (
        'import resource, signal, sys; from pathlib import Path; from tests.test_recorder import *\n'
        'signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n'
        'resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, 30_000))\n'
        "recorder = Recorder(Path(sys.argv[1]), RecorderConfig(compression='none'))\n"
        'try:\n'
        '    for i in range(1000):\n'
        "        recorder.write('/keypoints', messages.KEYPOINTS, keypoints(i), START + i * STEP, START)\n"
        'except RecordingError as error:\n'
        '    print(error)\n'
        'recorder.close()\n'
        'try:\n'
        "    recorder.write('/keypoints', messages.KEYPOINTS, b'', START, START)\n"
        'except RecordingError as error:\n'
        '    print(error)\n'
    )
    bag = tmp_path / 'bag'
    done = subprocess.run(
        [sys.executable, '-c', code, str(bag)],
        cwd=Path(__file__).parents[1],
        check=True,
        capture_output=True,
        text=True,
    )
    assert done.stdout.splitlines() == [
        f'{bag}/bag_0.mcap: File too large',
        f'{bag}/bag_0.mcap: the recording is closed',
    ]
    assert done.stderr == ''
    assert (bag / 'bag_0.mcap').stat().st_size > 20_000


def test_unwritable_and_existing_folders_are_refused(tmp_path: Path) -> None:
    (tmp_path / 'file').write_text('')
    with pytest.raises(RecordingError, match=r'file/bag: Not a directory'):
        Recorder(tmp_path / 'file' / 'bag', RecorderConfig())
    (tmp_path / 'bag').mkdir()
    with pytest.raises(RecordingError, match=r'bag: File exists'):
        Recorder(tmp_path / 'bag', RecorderConfig())


def test_closing_twice_is_fine_and_an_empty_bag_is_a_bag(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / 'bag', RecorderConfig())
    recorder.announce('/keypoints', messages.KEYPOINTS)
    recorder.close()
    recorder.close()
    with Bag(tmp_path / 'bag') as bag:
        assert list(bag.messages(bag.topics)) == []
        with pytest.raises(InputError, match=r'no topic of .*; the bag has /keypoints'):
            bag.keypoints_topic()


def test_a_topic_has_one_known_type(tmp_path: Path) -> None:
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        recorder.announce('/keypoints', messages.KEYPOINTS)
        with pytest.raises(RecordingError, match='topic /keypoints is'):
            recorder.write('/keypoints', messages.SKELETONS, b'', 0, 0)
        with pytest.raises(RecordingError, match='no_msgs/msg/No is not known'):
            recorder.write('/other', 'no_msgs/msg/No', b'', 0, 0)


def test_bags_are_named_by_time_and_never_twice(tmp_path: Path) -> None:
    names = []
    for _ in range(3):
        folder = new_bag_folder(tmp_path, START)
        folder.mkdir()
        names.append(folder.name)
    assert names == ['mocap_20231114T221320Z', 'mocap_20231114T221320Z_1', 'mocap_20231114T221320Z_2']


def test_missing_and_foreign_bags_are_refused(tmp_path: Path) -> None:
    (tmp_path / 'x.mcap').write_bytes(b'no bag')
    (tmp_path / 'x.txt').write_bytes(b'no bag')
    for name, reason in {'none': '', 'x.mcap': 'magic', 'x.txt': 'storage', '.': 'metadata'}.items():
        with pytest.raises(InputError, match=f'{name if name != "." else ""}.*{reason}'):
            Bag(tmp_path / name)


def test_a_bag_with_several_keypoint_topics_asks_which(tmp_path: Path) -> None:
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        for topic in ('/left', '/right'):
            recorder.write(topic, messages.KEYPOINTS, keypoints(0), START, START)
    with Bag(tmp_path / 'bag') as bag:
        with pytest.raises(InputError, match='choose one: /left, /right'):
            bag.keypoints_topic()
        assert bag.keypoints_topic('/right') == '/right'


def test_journal_entries_round_trip(tmp_path: Path) -> None:
    parameters = {'solver.components': 20, 'tracker.model': 'all', 'solver.tolerance': 1e-05, 'x': True}
    for entry in (
        Entry('input', 3, Verdict.OVERTAKEN, 'late', '/keypoints'),
        Entry('parameters', 0, parameters=parameters),
    ):
        assert decode_entry(encode_entry(entry)) == entry
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        journal = Journal(recorder, '/mocap_node/journal')
        journal.input('/keypoints', messages.KEYPOINTS, keypoints(0), (START, START), Verdict.ACCEPTED)
        journal.reset(START + 1)
        journal.input('/keypoints', messages.KEYPOINTS, b'bad', (START + 2, START), Verdict.INVALID, 'bad')
    with Bag(tmp_path / 'bag') as bag:
        lines = [decode_entry(m.raw) for m in bag.messages(['/mocap_node/journal'])]
    assert [(e.kind, e.number, e.verdict.name) for e in lines] == [
        ('input', 1, 'ACCEPTED'), ('reset', 1, 'ACCEPTED'), ('input', 2, 'INVALID'),
    ]  # fmt: skip
