# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Bags that cannot be read are refused with the cause, and everything readable in them is recovered."""

import os
import random
import re
import sqlite3
import subprocess
import sys
from itertools import product
from pathlib import Path

import pytest
import yaml
from mcap.reader import make_reader
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mocap_ros.bags.journal import Acceptance, Entry, decode_entry, encode_entry
from mocap_ros.bags.mcap_file import Attachment
from mocap_ros.bags.mcap_scan import MAGIC
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.bags.recovery import recover
from mocap_ros.bags.rosbag2 import BAG_INFORMATION, METADATA
from mocap_ros.bags.topics import Source, find_people_topics, list_input_types
from mocap_ros.cli.main import main
from mocap_ros.config import RecorderConfig
from mocap_ros.config.defaults import Value
from mocap_ros.errors import ConfigError, InputError, RecordingError
from mocap_ros.messages.cdr import Header, typestore
from mocap_ros.messages.foreign_types import HRI_IDS, HRI_SKELETON, YOLO_DETECTIONS
from mocap_ros.messages.input_types import decode_frame
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from mocap_ros.messages.skeletons import SKELETON_DEFINITION
from mocap_ros.messages.versions import make_converter
from mocap_ros.units import NS_PER_S
from tests.support.foreign_messages import (
    HRI_IDS_TOPIC,
    IMAGE_SIZE,
    LIMITS,
    encode_yolo,
    make_hri_inputs,
    make_inputs,
)
from tests.support.paths import ROOT
from tests.support.pipeline_inputs import BAG_STEP_NS, START_NS, make_keypoints, write_bag


@pytest.mark.parametrize(
    ('old', 'new', 'reason'),
    [
        (r'\n    message_count: \d+', r'\n    message_count: many', ''),
        (r'\n    message_count: \d+', '', 'message_count'),
        ('version: 9', 'version: 10', 'version 10'),
        ('identifier: mcap', 'identifier: [mcap]', ''),
        (r'bag_0\.mcap', 'other.mcap', r'other\.mcap'),
        ('depth: 10', 'width: 10', 'depth'),
        ('(?s).*', '', ''),
        ('(?s).*', '[' * 3000, 'nested too deep'),
        ('(?s).*', 'a: \udcff', ''),
    ],
)
def test_damaged_metadata_recommend_recover(tmp_path: Path, old: str, new: str, reason: str) -> None:
    write_bag(tmp_path / 'bag', RecorderConfig())
    metadata = tmp_path / 'bag' / METADATA
    text = metadata.read_text()
    changed = re.sub(old, new, text, count=1)
    assert changed != text
    metadata.write_bytes(changed.encode(errors='surrogateescape'))
    match = rf'bag: the bag cannot be read: .*{reason}.*; `mocap-ros recover {tmp_path / "bag"}`'
    with pytest.raises(InputError, match=match):
        Bag(tmp_path / 'bag')


# The first version of metadata.yaml that has a key, by key: of the bag, and of a topic.
BAG_KEYS = {'compression_format': 3, 'compression_mode': 3, 'files': 5, 'custom_data': 6, 'ros_distro': 8}
TOPIC_KEYS = {'offered_qos_profiles': 4, 'type_description_hash': 7}


@pytest.mark.parametrize('version', range(1, 9))
def test_all_versions_of_metadata_are_read(tmp_path: Path, version: int) -> None:
    """Below version 9, QoS profiles are a text, with numbers for the policies."""
    written = write_bag(tmp_path / 'bag', RecorderConfig())
    path = tmp_path / 'bag' / METADATA
    content = yaml.safe_load(path.read_text())
    bag = content[BAG_INFORMATION]
    bag['version'] = version
    if version < 4:
        bag['relative_file_paths'] = [f'bag/{name}' for name in bag['relative_file_paths']]
    topics = [topic['topic_metadata'] for topic in bag['topics_with_message_count']]
    for topic in topics:
        numbers = {'history': 1, 'reliability': 1, 'durability': 2, 'liveliness': 1}
        profiles = [{**profile, **numbers} for profile in topic['offered_qos_profiles']]
        topic['offered_qos_profiles'] = yaml.safe_dump(profiles)
    for keys, places in ((BAG_KEYS, [bag]), (TOPIC_KEYS, topics)):
        for place in places:
            for key in [key for key, first in keys.items() if version < first]:
                del place[key]
    path.write_text(yaml.safe_dump(content))
    with Bag(tmp_path / 'bag') as reader:
        assert reader.count(reader.topics) == len(written)
        depths = {topic: [profile.depth for profile in profiles] for topic, profiles in reader.qos.items()}
        assert depths == {'/skeleton_definition': [1] * (version >= 4), '/keypoints': [10] * (version >= 4)}


def test_paths_that_are_no_bags_are_refused(tmp_path: Path) -> None:
    for name in ('x.mcap', 'x.txt'):
        (tmp_path / name).write_bytes(b'no bag')
    os.mkfifo(tmp_path / 'pipe.mcap')
    reasons = {
        'none': 'does not exist',
        'pipe.mcap': 'neither a file',
        'x.mcap': 'first 8 bytes',
        'x.txt': 'no file of a bag',
    }
    for name, reason in {**reasons, '.': 'metadata'}.items():
        with pytest.raises(InputError, match=f'{name if name != "." else ""}.*{reason}'):
            Bag(tmp_path / name)


@pytest.mark.parametrize('storage', [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize('identifier', ['', "''", 'sqlite3', 'mcap'])
def test_the_files_say_how_a_bag_is_stored(tmp_path: Path, storage: StoragePlugin, identifier: str) -> None:
    write_foreign(tmp_path / 'bag', 'yolo_msgs', storage)
    metadata = tmp_path / 'bag' / METADATA
    text = re.sub(r'storage_identifier: .*', f'storage_identifier: {identifier}', metadata.read_text())
    metadata.write_text(text)
    with Bag(tmp_path / 'bag') as bag:
        assert len(list(bag.messages(bag.topics))) == 3


def write_foreign(
    folder: Path, package: str, storage: StoragePlugin = StoragePlugin.MCAP, edit: tuple[str, str] = ('', '')
) -> None:
    """Write messages of yolo_ros under another name of their package, whose definition may be edited."""
    store = get_typestore(Stores.ROS2_JAZZY)
    msgtype = YOLO_DETECTIONS.replace('yolo_msgs', package)
    text = typestore().generate_msgdef(YOLO_DETECTIONS)[0].replace('yolo_msgs', package).replace(*edit)
    store.register(get_types_from_msg(text, msgtype))
    with Writer(folder, version=9, storage_plugin=storage) as writer:
        connection = writer.add_connection('/yolo/tracking', msgtype, typestore=store)
        for frame in range(3):
            raw = make_converter(typestore(), store, YOLO_DETECTIONS, msgtype)(encode_yolo(frame))
            writer.write(connection, frame + 1, raw)


@pytest.mark.parametrize(
    ('package', 'edit', 'is_read'),
    [
        ('yolo_msgs', ('', ''), True),
        ('yolov8_msgs', ('', ''), True),
        ('yolov8_msgs', ('string class_name', 'int64 more\nstring class_name'), True),
        ('yolo_of_mine_msgs', ('', ''), True),
        ('yolo_of_mine_msgs', ('string class_name', 'int64 more\nstring class_name'), False),
    ],
)
def test_renamed_packages_are_read(tmp_path: Path, package: str, edit: tuple[str, str], is_read: bool) -> None:
    write_foreign(tmp_path / 'bag', package, edit=edit)
    with Bag(tmp_path / 'bag') as bag:
        found = bag.topics_of_type([YOLO_DETECTIONS])
        assert found == (['/yolo/tracking'] if is_read else [])
        raws = [message.raw for message in bag.messages(found)]
    frames = [decode_frame(raw, YOLO_DETECTIONS, LIMITS, IMAGE_SIZE) for raw in raws]
    assert [len(frame.people) for frame in frames] == [2] * len(raws)


EMPTY_IDS = bytes([0, 1, 0, 0]) + bytes(24)  # an hri_msgs/IdsList with nobody in it


def test_a_bag_of_several_detectors_requires_a_choice(tmp_path: Path) -> None:
    other_topic = '/other/bodies/tracked'
    other_inputs = [(source, raw, topic.replace('/humans', '/other')) for source, raw, topic in make_hri_inputs(0)]
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        yolo = make_inputs(YOLO_DETECTIONS, 0)
        for msgtype, inputs in ((YOLO_DETECTIONS, yolo), (HRI_SKELETON, make_hri_inputs(0) + other_inputs)):
            for source, raw, topic in inputs:
                recorder.write(topic, list_input_types(msgtype)[source], raw, 1, 1)
    with Bag(tmp_path / 'bag') as bag:
        with pytest.raises(InputError, match=f'choose one: /keypoints, {HRI_IDS_TOPIC}, {other_topic}$'):
            find_people_topics(bag)
        assert find_people_topics(bag, '/keypoints') == {'/keypoints': Source.KEYPOINTS}
        assert find_people_topics(bag, other_topic) == {topic: source for source, _, topic in other_inputs}
        reason = r'no topic /yolo of .*hri_msgs/msg/Skeleton2D; the bag has /keypoints'
        with pytest.raises(InputError, match=reason):
            find_people_topics(bag, '/yolo')


def test_bodies_that_the_package_published_itself_are_no_input(tmp_path: Path) -> None:
    """`mocap_bridge` publishes a list of bodies, but no keypoints of theirs."""
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        recorder.write('/keypoints', KEYPOINTS, make_keypoints(0), START_NS, START_NS)
        recorder.write('/humans/bodies/tracked', HRI_IDS, EMPTY_IDS, START_NS, START_NS)
    with Bag(tmp_path / 'bag') as bag:
        assert find_people_topics(bag) == {'/keypoints': Source.KEYPOINTS}
        tracked = '/humans/bodies/tracked'
        assert find_people_topics(bag, tracked) == {tracked: Source.TRACKED_BODIES}


def test_an_unknown_type_is_refused() -> None:
    with pytest.raises(ConfigError, match='yolo_msgs/msg/DetectionArray'):
        list_input_types('std_msgs/msg/String')


def test_journal_entries_round_trip() -> None:
    parameters: dict[str, Value] = {'a.components': 20, 'tracker.model': 'all', 'a.tolerance': 1e-05, 'x': True}
    backlog = Entry('input', 3, Acceptance.BACKLOG, 'late', '/keypoints')
    for entry in (backlog, Entry('parameters', 0, parameters=parameters)):
        assert decode_entry(encode_entry(entry)) == entry


FRAMES = 120  # enough for several chunks and, with a limit of 1 s, several files
CHUNK_SECONDS = 0.25  # s, time after which a chunk is closed
MAX_FRAMES_PER_CHUNK = 9  # frames in `CHUNK_SECONDS`
MESSAGES = [encode_keypoints(Header(i * BAG_STEP_NS, f'frame {i}'), (640, 480), []) for i in range(FRAMES)]
ATTACHMENT = Attachment('a.txt', 'text/plain', b'kept')


def write_chunks(folder: Path, compression: str = 'zstd') -> bytes:
    """Write a bag with all messages and an attachment; return the content of its file."""
    config = RecorderConfig(compression=compression, chunk_seconds=CHUNK_SECONDS)
    with Recorder(folder, config, [ATTACHMENT]) as recorder:
        for i, raw in enumerate(MESSAGES):
            recorder.write('/keypoints', KEYPOINTS, raw, i * BAG_STEP_NS + 1, i * BAG_STEP_NS)
    return (folder / f'{folder.name}_0.mcap').read_bytes()


def read_frames(path: Path) -> list[int]:
    """Return the numbers of the frames in a bag; every message must be unchanged."""
    with Bag(path) as bag:
        return [MESSAGES.index(m.raw) for m in bag.messages(['/keypoints'])]


def find_chunks(bag: Path) -> list[tuple[int, int, int]]:
    """Return start and end of each chunk in a bag's file, in bytes, and the number of messages up to its end."""
    with (bag / f'{bag.name}_0.mcap').open('rb') as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    return [
        (c.chunk_start_offset, c.chunk_start_offset + c.chunk_length, (c.message_end_time - 1) // BAG_STEP_NS + 1)
        for c in summary.chunk_indexes
    ]


def recover_frames(data: bytes, folder: Path) -> tuple[list[int], list[str]]:
    """Recover a damaged MCAP file; return the numbers of the recovered frames and the reported losses."""
    folder.mkdir()
    (folder / 'x.mcap').write_bytes(data)
    losses = recover(folder / 'x.mcap', folder / 'out').losses
    return read_frames(folder / 'out'), losses


@pytest.mark.parametrize('compression', ['zstd', 'lz4', 'none'])
def test_everything_before_a_cut_is_recovered(tmp_path: Path, compression: str) -> None:
    data = write_chunks(tmp_path / 'bag', compression)
    chunks = find_chunks(tmp_path / 'bag')
    assert [count for *_, count in chunks] == [*range(9, FRAMES, MAX_FRAMES_PER_CHUNK), FRAMES]
    rng = random.Random(0)
    for n, cut in enumerate(sorted(rng.randrange(3000, len(data)) for _ in range(15))):
        file = tmp_path / f'{n}.mcap'
        file.write_bytes(data[:cut])
        with pytest.raises(InputError, match=rf'{n}\.mcap: the recording was cut off .*`mocap-ros recover'):
            Bag(file)
        frames, losses = recover_frames(data[:cut], tmp_path / str(n))
        in_whole_chunks = max((count for _, end, count in chunks if end <= cut), default=0)
        assert frames == list(range(len(frames)))
        assert in_whole_chunks <= len(frames) < in_whole_chunks + MAX_FRAMES_PER_CHUNK
        assert compression == 'none' or len(frames) == in_whole_chunks
        # A cut behind the last message is a loss only where it is within a record.
        assert len(losses) == 1 if cut < chunks[-1][1] else len(losses) <= 1
        assert all('the file is cut off at byte' in loss for loss in losses)


@pytest.mark.parametrize('compression', ['zstd', 'none'])
def test_a_flipped_bit_loses_at_most_a_chunk_and_is_always_reported(tmp_path: Path, compression: str) -> None:
    data = write_chunks(tmp_path / 'bag', compression)
    rng = random.Random(1)
    for n in range(25):
        flipped = bytearray(data)
        flipped[rng.randrange(60, len(data))] ^= 1 << rng.randrange(8)
        file = tmp_path / f'{n}.mcap'
        file.write_bytes(flipped)
        try:
            assert read_frames(file) == list(range(FRAMES))
        except InputError as error:
            assert 'mocap-ros recover' in str(error)  # noqa: PT017
        frames, losses = recover_frames(bytes(flipped), tmp_path / str(n))
        assert frames == sorted(frames)
        missing = sorted(set(range(FRAMES)) - set(frames))
        assert len(missing) <= MAX_FRAMES_PER_CHUNK
        assert missing == list(range(missing[0], missing[-1] + 1) if missing else [])
        counted = [loss for loss in losses if loss.endswith('messages are missing')]
        expected = [f'{len(missing)} of {FRAMES} messages are missing'] if missing else []
        assert [loss.rpartition(': ')[2] for loss in counted] == expected


def test_attachments_and_qos_are_recovered(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = tmp_path / 'bag'
    with Recorder(bag, RecorderConfig(split_seconds=1.0), [ATTACHMENT]) as recorder:
        recorder.declare_topic('/keypoints', KEYPOINTS, latched=True)
        for i, raw in enumerate(MESSAGES):
            recorder.write('/keypoints', KEYPOINTS, raw, i * BAG_STEP_NS + 1, i * BAG_STEP_NS)
    (bag / 'metadata.yaml').unlink()
    last = bag / 'bag_3.mcap'
    last.write_bytes(last.read_bytes()[:-500])
    with pytest.raises(InputError, match=rf'{bag}: the recording was cut off \(bag_3\.mcap\)'):
        Bag(bag)
    assert main(['recover', str(bag)]) == 0
    recovered = tmp_path / 'bag_recovered'
    out, err = capsys.readouterr()
    count = FRAMES + 3  # three further files repeat the latched message
    assert (out, err) == (f'{recovered}: {count} messages on 1 topics\n', '')
    assert sorted(set(read_frames(recovered))) == list(range(FRAMES))
    with Bag(recovered) as opened:
        assert opened.qos['/keypoints'][0].durability.name == 'TRANSIENT_LOCAL'
    assert "ros_distro: ''" in (recovered / 'metadata.yaml').read_text()
    with (recovered / 'bag_recovered_0.mcap').open('rb') as file:
        attachments = list(make_reader(file).iter_attachments())
    assert {a.data for a in attachments} == {b'kept'}


def read_files(bag: Path) -> list[tuple[list[tuple[str, int, int, bytes]], list[tuple[str, bytes]]]]:
    """Return the messages (topic, log time and publish time in ns, data) and attachments of each file of a bag."""
    content = []
    for file in sorted(bag.glob('*.mcap')):
        with file.open('rb') as stream:
            reader = make_reader(stream)
            messages = [
                (channel.topic, message.log_time, message.publish_time, message.data)
                for _, channel, message in reader.iter_messages(log_time_order=False)
            ]
            content.append((messages, [(a.name, a.data) for a in reader.iter_attachments()]))
    return content


@pytest.mark.parametrize('split_seconds', [0.0, 1800.0])
def test_a_recovered_bag_has_the_files_and_messages_of_the_other(tmp_path: Path, split_seconds: float) -> None:
    """Also of a long recording, and with messages of a latched topic that further files repeat by their keys."""
    with Recorder(tmp_path / 'bag', RecorderConfig(split_seconds=split_seconds), [ATTACHMENT]) as recorder:
        recorder.declare_topic('/latched', SKELETON_DEFINITION, latched=True)
        for key in 'ab':
            recorder.write('/latched', SKELETON_DEFINITION, key.encode(), 0, 0, frozenset(key))
        for i, raw in enumerate(MESSAGES):
            recorder.write('/keypoints', KEYPOINTS, raw, i * 60 * NS_PER_S, i)
    report = recover(tmp_path / 'bag', tmp_path / 'out')
    assert read_files(tmp_path / 'out') == read_files(tmp_path / 'bag')
    number_of_files = 4 if split_seconds else 1
    assert len(list((tmp_path / 'out').glob('*.mcap'))) == number_of_files
    assert report.messages == {'/keypoints': FRAMES, '/latched': 2 * number_of_files}


@pytest.mark.parametrize('is_cut', [False, True])
def test_every_chunk_behind_a_damaged_start_is_recovered(tmp_path: Path, is_cut: bool) -> None:
    data = write_chunks(tmp_path / 'bag')
    first_chunk = find_chunks(tmp_path / 'bag')[0][0]
    if is_cut:
        data = data[: find_chunks(tmp_path / 'bag')[-1][1]]
    flipped, zeroed = bytes([data[0], data[1] ^ 1]) + data[2:], bytes(first_chunk) + data[first_chunk:]
    for number, damaged in enumerate((flipped, zeroed, data[first_chunk:], data[first_chunk - 4 :])):
        frames, losses = recover_frames(damaged, tmp_path / str(number))
        assert frames == list(range(FRAMES))
        assert any(loss.endswith(': its first 8 bytes are not those of an MCAP file') for loss in losses)


def test_messages_of_the_write_ahead_log_are_recovered(tmp_path: Path) -> None:
    bag = tmp_path / 'bag'
    with Writer(bag, version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection('/keypoints', KEYPOINTS, typestore=typestore())
        for i, raw in enumerate(MESSAGES[:50]):
            writer.write(connection, i * BAG_STEP_NS, raw)
    database = sqlite3.connect(bag / 'bag.db3')
    database.execute('PRAGMA journal_mode=WAL')
    database.executemany(
        'INSERT INTO messages (topic_id, timestamp, data) VALUES (1, ?, ?)',
        [(i * BAG_STEP_NS, MESSAGES[i]) for i in range(50, FRAMES)],
    )
    database.commit()
    killed, names = tmp_path / 'killed', ['bag.db3', 'bag.db3-wal']  # as a killed recorder leaves them
    killed.mkdir()
    for name in names:
        (killed / name).write_bytes((bag / name).read_bytes())
    database.close()
    with pytest.raises(InputError, match=r'cut off: bag\.db3-wal holds messages .* `mocap-ros recover'):
        Bag(killed / 'bag.db3')
    listings = set()

    def list_files(*_: int) -> None:
        listings.add(tuple(sorted(f.name for f in killed.iterdir())))

    assert recover(killed / 'bag.db3', tmp_path / 'whole', list_files).losses == []
    list_files()
    assert listings == {tuple(names)}  # SQLite would write an index of the log, bag.db3-shm
    assert read_frames(tmp_path / 'whole') == list(range(FRAMES))
    assert sorted(f.name for f in tmp_path.iterdir()) == ['bag', 'killed', 'whole']


def test_an_interrupted_recovery_leaves_no_bag(tmp_path: Path) -> None:
    write_chunks(tmp_path / 'bag')

    def interrupt(done: int, size: int) -> None:
        assert (tmp_path / 'out.partial').is_dir()
        if done > size / 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        recover(tmp_path / 'bag', tmp_path / 'out', interrupt)
    assert [p.name for p in tmp_path.iterdir()] == ['bag']
    (tmp_path / 'out.partial').mkdir()  # as a recovery that was killed leaves it
    (tmp_path / 'out.partial' / 'out_0.mcap').write_bytes(b'half')
    recover(tmp_path / 'bag', tmp_path / 'out')
    assert read_frames(tmp_path / 'out') == list(range(FRAMES))
    assert [p.name for p in sorted((tmp_path / 'out').iterdir())] == ['metadata.yaml', 'out_0.mcap']
    with pytest.raises(RecordingError, match='out: exists already'):
        recover(tmp_path / 'bag', tmp_path / 'out')


@pytest.mark.parametrize('has_metadata', [True, False])
def test_nothing_is_recovered_into_the_damaged_bag(tmp_path: Path, *, has_metadata: bool) -> None:
    write_chunks(tmp_path / 'bag')
    if not has_metadata:
        (tmp_path / 'bag' / 'metadata.yaml').unlink()
    before = sorted((tmp_path / 'bag').iterdir())
    with pytest.raises(RecordingError, match=r'new: .*bag is a bag; write beside it'):
        recover(tmp_path / 'bag', tmp_path / 'bag' / 'new')
    assert sorted((tmp_path / 'bag').iterdir()) == before


def test_paths_without_messages_are_refused_and_leave_no_bag(tmp_path: Path) -> None:
    (tmp_path / 'empty').mkdir()
    os.mkfifo(tmp_path / 'pipe.mcap')
    contents = {'x': b'', 'y': MAGIC + bytes(500), 'z': random.Random(4).randbytes(1_000_000)}
    for name, content in contents.items():
        (tmp_path / f'{name}.mcap').write_bytes(content)
    reasons = {'empty': 'no bag folder', 'none.mcap': 'No such file', 'pipe.mcap': 'not a file'}
    reasons |= {'y.mcap': 'cut off at byte 8: 500 bytes are no complete record', 'z.mcap': 'no MCAP file'}
    reasons['x.mcap'] = 'no MCAP'
    for name, reason in reasons.items():
        with pytest.raises(InputError, match=f'{name}.*{reason}'):
            recover(tmp_path / name, tmp_path / 'out')
        assert not list(tmp_path.glob('out*'))


@pytest.mark.parametrize('storage', [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize('mode', [CompressionMode.MESSAGE, CompressionMode.FILE])
@pytest.mark.parametrize('is_killed', [False, True])
def test_compressed_bags(tmp_path: Path, storage: StoragePlugin, mode: CompressionMode, is_killed: bool) -> None:
    writer = Writer(tmp_path / 'bag', version=9, storage_plugin=storage)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection('/keypoints', KEYPOINTS, typestore=typestore())
        for i, raw in enumerate(MESSAGES):
            writer.write(connection, i + 1, raw)
    if is_killed:
        (tmp_path / 'bag' / 'metadata.yaml').unlink()
    assert recover(tmp_path / 'bag', tmp_path / 'out').losses == []
    assert read_frames(tmp_path / 'out') == list(range(FRAMES))
    assert {f.name for f in tmp_path.iterdir()} == {'bag', 'out'}


UNCHANGED = """
import importlib
modules = [importlib.import_module(f'rosbags.{m}') for m in (
    'rosbag1.reader', 'rosbag2.reader', 'rosbag2.metadata', 'rosbag2.storage_mcap', 'rosbag2.storage_sqlite3')]
classes = [c for m in modules for c in vars(m).values() if isinstance(c, type)]
before = [dict(vars(place)) for place in (*modules, *classes)]
import mocap_ros.bags.recovery
assert [dict(vars(place)) for place in (*modules, *classes)] == before
"""


def test_rosbags_stays_as_it_is() -> None:
    subprocess.run([sys.executable, '-c', UNCHANGED], cwd=ROOT, check=True)


def test_large_chunks_are_recovered_in_little_memory_and_what_is_larger_is_lost(tmp_path: Path) -> None:
    """Four images of 4K in a chunk of 100 MB, and a few bytes that unpack to more than any message has."""
    images = [random.Random(i).randbytes(25_000_000) for i in range(4)]
    with (tmp_path / 'x.mcap').open('wb') as file:
        writer = McapWriter(file, chunk_size=1 << 40)
        writer.start('ros2', 'test')
        channel = writer.register_channel('/a', 'cdr', writer.register_schema(KEYPOINTS, 'ros2msg', b''))
        for messages in ([bytes(150_000_000)], images, [bytes(600_000_000)]):
            for data in messages:
                writer.add_message(channel, 1, data, 1)
            writer.flush()  # type: ignore[no-untyped-call]
        writer.finish()  # type: ignore[no-untyped-call]
    done = subprocess.run(
        ['bash', '-c', f'ulimit -v 2000000; exec {sys.executable} -m mocap_ros.cli.main recover x.mcap'],
        cwd=tmp_path, env=os.environ | {'PYTHONPATH': str(ROOT), 'OPENBLAS_NUM_THREADS': '1'},
        check=False, capture_output=True, text=True,
    )  # fmt: skip
    lost = [line for line in done.stderr.splitlines() if 'x.mcap: the chunk record' in line]
    assert (done.returncode, len(lost)) == (3, 2), done.stderr
    with Bag(tmp_path / 'x_recovered') as bag:
        assert [m.raw for m in bag.messages(['/a'])] == images


STORAGES = StoragePlugin.MCAP, StoragePlugin.SQLITE3
PLACES = 'recovery.RecordedMessage', 'reader.BagMessage', 'storages.Connection'


@pytest.mark.parametrize(
    ('storage', 'place'), [*product(STORAGES, PLACES), (StoragePlugin.MCAP, 'mcap_scan.ScannedMessage')]
)
def test_a_fault_of_the_program_is_not_taken_for_damage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, storage: StoragePlugin, place: str
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise KeyError('fault')

    def read_and_recover() -> None:
        with Bag(tmp_path / 'bag') as bag:
            list(bag.messages(bag.topics))
        recover(tmp_path / 'bag', tmp_path / 'out')

    write_foreign(tmp_path / 'bag', 'yolo_msgs', storage)
    monkeypatch.setattr(f'mocap_ros.bags.{place}', fail)
    with pytest.raises(KeyError):
        read_and_recover()
    assert not list(tmp_path.glob('out*'))
