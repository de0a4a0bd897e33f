"""Bags: real files, read back message for message by readers from other hands."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader

from mocap_ros.bags.background import BackgroundRecorder
from mocap_ros.bags.journal import Entry, Journal, Verdict, decode_entry, encode_entry, read_run
from mocap_ros.bags.mcap_file import Attachment
from mocap_ros.bags.mcap_scan import MAGIC
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder, new_bag_folder
from mocap_ros.bags.recovery import recover
from mocap_ros.bags.topics import Source, people_topics
from mocap_ros.config import RecorderConfig
from mocap_ros.errors import InputError, RecordingError
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.cdr import Header, decode, typestore
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from mocap_ros.messages.skeletons import SKELETON_DEFINITION, SKELETONS, encode_skeleton_definition
from mocap_ros.skeleton import CMU15, layout
from tests.support.paths import ROOT

START = 1_700_000_000_000_000_000
STEP = 33_000_000
FRAMES = 60
DEFINITION = encode_skeleton_definition(CMU15)

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
    types = {'/keypoints': KEYPOINTS, '/skeleton_definition': SKELETON_DEFINITION}
    with Recorder(folder, config) as recorder:
        recorder.announce('/skeleton_definition', SKELETON_DEFINITION, latched=True)
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
                assert repr(message) == repr(decode(bytes(raw), connection.msgtype))


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


@pytest.mark.skipif(shutil.which('rerun') is None, reason='rerun (pip install rerun-sdk) is not on the PATH')
def test_rerun_finds_nothing_to_complain_of(recorded: tuple[Path, list[Message]]) -> None:
    folder, _ = recorded
    command = ['rerun', 'mcap', 'check', '--full', folder / f'{folder.name}_0.mcap']
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.findall(r'^(\w+) +\d+ +\d+ +(/\S+)', done.stdout, re.MULTILINE) == [
        ('ok', '/skeleton_definition'),
        ('ok', '/keypoints'),
    ]


def test_mcap_ros2_decodes_it(recorded: tuple[Path, list[Message]]) -> None:
    folder, written = recorded
    with (folder / f'{folder.name}_0.mcap').open('rb') as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        read = [(m.log_time, decoded) for _, _, m, decoded in reader.iter_decoded_messages(['/keypoints'])]
    assert len(read) == FRAMES
    for (time_ns, got), (_, log_ns, _, data) in zip(read, written[1:], strict=True):
        expected = decode(data, KEYPOINTS)
        assert time_ns == log_ns
        assert got.header.stamp.nanosec == expected.header.stamp.nanosec
        np.testing.assert_array_equal(got.people[0].x, expected.people[0].x)


def test_a_bag_of_ours_is_read_back(recorded: tuple[Path, list[Message]]) -> None:
    folder, written = recorded
    with Bag(folder) as bag:
        (topic,) = people_topics(bag)
        read = list(bag.messages([topic]))
        assert bag.count([topic]) == FRAMES
    assert [(m.topic, m.time_ns, m.raw) for m in read] == [(t, log_ns, d) for t, log_ns, _, d in written[1:]]
    assert {m.type for m in read} == {KEYPOINTS}


def run_elsewhere(code: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    """In a process of its own, which has this module's names."""
    command = [sys.executable, '-c', 'from tests.bags.test_recorder import *\n' + code, *map(str, arguments)]
    root = ROOT
    return subprocess.run(command, cwd=root, check=False, capture_output=True, text=True)


def test_a_killed_recording_loses_no_more_than_a_chunk(tmp_path: Path) -> None:
    run_elsewhere(
        'recorder = Recorder(Path(sys.argv[1]), RecorderConfig())\n'
        'for i in range(FRAMES):\n'
        "    recorder.write('/keypoints', KEYPOINTS, keypoints(i), START + i * STEP, START)\n"
        'os.kill(os.getpid(), 9)\n',
        tmp_path / 'bag',
    )
    bag, lost = tmp_path / 'bag', RecorderConfig().chunk_seconds * 1e9 / STEP + 1
    for path in (bag, bag / 'bag_0.mcap'):
        with pytest.raises(
            InputError, match=rf'{path.name}: the recording was cut off .*`mocap-ros recover {path}`'
        ):
            Bag(path)
        found = recover(path, tmp_path / f'{path.name}_whole')
        with Bag(tmp_path / f'{path.name}_whole') as whole:
            read = [m.raw for m in whole.messages(['/keypoints'])]
        assert FRAMES - lost <= len(read) == found.messages['/keypoints']
        assert read == [keypoints(i) for i in range(len(read))]


def test_a_bag_without_metadata_points_to_recover(tmp_path: Path) -> None:
    write_bag(tmp_path / 'bag', RecorderConfig())
    (tmp_path / 'bag' / 'metadata.yaml').unlink()
    with pytest.raises(InputError, match=r'not finished: no metadata\.yaml; `mocap-ros recover'):
        Bag(tmp_path / 'bag')
    with Bag(tmp_path / 'bag' / 'bag_0.mcap') as bag:
        assert bag.count(bag.topics) == FRAMES + 1


@pytest.mark.parametrize('limit', [20_000, 30_000, 30_500, 31_000])
def test_a_full_disk_is_one_clear_error_and_the_bag_is_whole(tmp_path: Path, limit: int) -> None:
    """What fits is read by everybody, even though there is no room for index and metadata.yaml."""
    bag = tmp_path / 'bag'
    done = run_elsewhere(
        'import resource, signal\n'
        'signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n'
        'resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), int(sys.argv[2])))\n'
        "recorder = Recorder(Path(sys.argv[1]), RecorderConfig(compression='none'))\n"
        'for attempt in range(2):\n'
        '    try:\n'
        '        for i in range(1000):\n'
        "            recorder.write('/keypoints', KEYPOINTS, keypoints(i), START + i * STEP, START)\n"
        '    except RecordingError as error:\n'
        '        print(error)\n'
        'recorder.close()\n',
        bag,
        limit,
    )
    assert done.stdout.splitlines() == [f'{bag}: File too large', f'{bag}: the recording is closed']
    assert done.stderr == ''
    if (bag / 'bag_0.mcap').read_bytes().endswith(MAGIC):
        with Bag(bag) as whole:
            read = [m.raw for m in whole.messages(['/keypoints'])]
        with (bag / 'bag_0.mcap').open('rb') as file:
            reader = make_reader(file, validate_crcs=True)
            assert [m.data for _, _, m in reader.iter_messages()] == read
    else:  # not even the index found room
        recover(bag, tmp_path / 'whole')
        with Bag(tmp_path / 'whole') as whole:
            read = [m.raw for m in whole.messages(['/keypoints'])]
    assert len(read) * 340 > limit - 5000
    assert read == [keypoints(i) for i in range(len(read))]


def record(recorder: Recorder, frames: int) -> None:
    for i in range(frames):
        recorder.write('/keypoints', KEYPOINTS, keypoints(i), START + i * STEP, START)


@pytest.mark.skipif(os.geteuid() != 0, reason='mounts a small disk')
def test_a_really_full_disk(tmp_path: Path) -> None:
    disk = tmp_path / 'disk'
    disk.mkdir()
    if subprocess.run(['mount', '-t', 'tmpfs', '-o', 'size=64k', 'tmpfs', disk], check=False).returncode:
        pytest.skip('cannot mount')
    try:
        recorder = Recorder(disk / 'bag', RecorderConfig(min_free_mb=0))
        with pytest.raises(RecordingError, match='bag: No space left on device'):
            record(recorder, 1000)
        recover(disk / 'bag', tmp_path / 'whole')
        with Bag(tmp_path / 'whole') as whole:
            read = [m.raw for m in whole.messages(['/keypoints'])]
        assert len(read) > 150
        assert read == [keypoints(i) for i in range(len(read))]
    finally:
        subprocess.run(['umount', '-l', disk], check=True)


def test_recording_ends_before_the_disk_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    left = iter([300_000_000, 250_000_000, 199_000_000])
    monkeypatch.setattr('shutil.disk_usage', lambda _: SimpleNamespace(free=next(left)))
    recorder = Recorder(tmp_path / 'bag', RecorderConfig())
    recorder.write('/keypoints', KEYPOINTS, keypoints(0), START, START)
    recorder.flush()
    recorder.write('/keypoints', KEYPOINTS, keypoints(1), START, START)
    with pytest.raises(
        RecordingError, match=r'bag: 199 MB left on the disk, less than recorder\.min_free_mb \(200\)'
    ):
        recorder.flush()
    with Bag(tmp_path / 'bag') as bag:
        assert bag.count(['/keypoints']) == 2
    left = iter([1])
    with pytest.raises(RecordingError, match='0 MB left'):
        Recorder(tmp_path / 'other', RecorderConfig())
    assert not (tmp_path / 'other').exists()


@pytest.mark.parametrize('by', [{'split_seconds': 0.5}, {'split_mb': 1, 'compression': 'none'}])
def test_a_bag_goes_on_in_further_files(tmp_path: Path, by: dict[str, Any]) -> None:
    data = [keypoints(i) + bytes(40_000 if 'split_mb' in by else 0) for i in range(FRAMES)]
    attachment = Attachment('mocap_ros.yaml', 'application/yaml', b'a: 1')
    with Recorder(tmp_path / 'bag', RecorderConfig(**by), [attachment]) as recorder:
        recorder.announce('/skeleton_definition', SKELETON_DEFINITION, latched=True)
        recorder.write('/skeleton_definition', SKELETON_DEFINITION, DEFINITION, START, START)
        for i, one in enumerate(data):
            recorder.write('/keypoints', KEYPOINTS, one, START + i * STEP, START)

    files = sorted((tmp_path / 'bag').glob('*.mcap'))
    assert [f.name for f in files] == [f'bag_{n}.mcap' for n in range(len(files))]
    assert len(files) in (3, 4)
    with Reader(tmp_path / 'bag') as reader:
        read = [(c.topic, bytes(raw)) for c, _, raw in reader.messages()]
        assert [raw for topic, raw in read if topic == '/keypoints'] == data
        assert reader.message_count == len(read) == FRAMES + len(files)
    described = yaml.safe_load((tmp_path / 'bag' / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
    assert described['relative_file_paths'] == [f.name for f in files]
    for file, said in zip(files, described['files'], strict=True):
        with file.open('rb') as stream:
            reader = make_reader(stream, validate_crcs=True)
            first = next(iter(reader.iter_messages()))
            assert (first[1].topic, first[2].data) == ('/skeleton_definition', DEFINITION)
            assert [a.data for a in reader.iter_attachments()] == [b'a: 1']
            statistics = reader.get_summary().statistics
        assert statistics.message_count == said['message_count']
        assert statistics.message_start_time == said['starting_time']['nanoseconds_since_epoch']
        duration = statistics.message_end_time - statistics.message_start_time
        assert duration == said['duration']['nanoseconds']


def test_a_removed_folder_is_noticed(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / 'bag', RecorderConfig())
    recorder.write('/keypoints', KEYPOINTS, keypoints(0), START, START)
    shutil.rmtree(tmp_path / 'bag')
    with pytest.raises(RecordingError, match=r'bag_0\.mcap: removed or moved while it was written'):
        recorder.flush()
    recorder.close()
    assert not (tmp_path / 'bag').exists()


def test_a_slow_disk_holds_nobody_up_and_is_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    go_on = threading.Event()
    write = Recorder.write
    monkeypatch.setattr(Recorder, 'write', lambda *a: go_on.wait() and write(*a))
    background = BackgroundRecorder(tmp_path / 'bag', RecorderConfig(backlog=5))
    journal = Journal('/mocap_node/journal')
    begun, taken = time.monotonic(), 0
    for i in range(20):
        records = journal.input('/keypoints', KEYPOINTS, keypoints(i), (START + i, START), Verdict.ACCEPTED)
        if background.put(records):
            taken += 1
        else:
            journal.take_back()
    assert time.monotonic() - begun < 1
    assert taken in (5, 6)
    go_on.set()
    while not background.put([]):
        time.sleep(0.01)
    records = journal.input('/keypoints', KEYPOINTS, keypoints(20), (START + 20, START), Verdict.ACCEPTED)
    assert background.put(records)
    background.close()
    with Bag(tmp_path / 'bag') as bag:
        assert read_run(bag).lost == 20 - taken
        assert bag.count(['/keypoints']) == taken + 1


def test_unwritable_and_existing_folders_are_refused(tmp_path: Path) -> None:
    (tmp_path / 'file').write_text('')
    with pytest.raises(RecordingError, match=r'file/bag: Not a directory'):
        Recorder(tmp_path / 'file' / 'bag', RecorderConfig())
    (tmp_path / 'bag').mkdir()
    with pytest.raises(RecordingError, match=r'bag: File exists'):
        Recorder(tmp_path / 'bag', RecorderConfig())


def test_closing_twice_is_fine_and_an_empty_bag_is_a_bag(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / 'bag', RecorderConfig())
    recorder.announce('/keypoints', KEYPOINTS)
    recorder.close()
    recorder.close()
    with Bag(tmp_path / 'bag') as bag:
        assert list(bag.messages(bag.topics)) == []
        with pytest.raises(InputError, match=r'no topic of .*; the bag has /keypoints'):
            people_topics(bag)


def test_a_topic_has_one_known_type(tmp_path: Path) -> None:
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        recorder.announce('/keypoints', KEYPOINTS)
        with pytest.raises(RecordingError, match='topic /keypoints is'):
            recorder.write('/keypoints', SKELETONS, b'', 0, 0)
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
    os.mkfifo(tmp_path / 'pipe.mcap')
    for name, reason in {
        'none': '',
        'pipe.mcap': 'neither a file',
        'x.mcap': 'magic',
        'x.txt': 'storage',
        '.': 'metadata',
    }.items():
        with pytest.raises(InputError, match=f'{name if name != "." else ""}.*{reason}'):
            Bag(tmp_path / name)


def test_a_bag_with_several_keypoint_topics_asks_which(tmp_path: Path) -> None:
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        for topic in ('/left', '/right'):
            recorder.write(topic, KEYPOINTS, keypoints(0), START, START)
    with Bag(tmp_path / 'bag') as bag:
        with pytest.raises(InputError, match='choose one: /left, /right'):
            people_topics(bag)
        assert people_topics(bag, '/right') == {'/right': Source.KEYPOINTS}


def test_journal_entries_round_trip(tmp_path: Path) -> None:
    parameters = {'solver.components': 20, 'tracker.model': 'all', 'solver.tolerance': 1e-05, 'x': True}
    for entry in (
        Entry('input', 3, Verdict.BACKLOG, 'late', '/keypoints'),
        Entry('parameters', 0, parameters=parameters),
    ):
        assert decode_entry(encode_entry(entry)) == entry
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        journal = Journal('/mocap_node/journal')
        for record in (
            *journal.input('/keypoints', KEYPOINTS, keypoints(0), (START, START), Verdict.ACCEPTED),
            journal.reset(START + 1),
            *journal.input('/keypoints', KEYPOINTS, b'bad', (START + 2, START), Verdict.INVALID, 'bad'),
        ):
            recorder.write(*record)
    with Bag(tmp_path / 'bag') as bag:
        lines = [decode_entry(m.raw) for m in bag.messages(['/mocap_node/journal'])]
    assert [(e.kind, e.number, e.verdict.name) for e in lines] == [
        ('input', 1, 'ACCEPTED'), ('reset', 1, 'ACCEPTED'), ('input', 2, 'INVALID'),
    ]  # fmt: skip
