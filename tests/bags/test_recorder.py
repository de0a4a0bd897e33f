# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Recorder: other libraries read its bags, which survive crashes, full disks and removed folders."""

import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.interfaces import ConnectionExtRosbag2
from rosbags.rosbag2 import Reader

from mocap_ros.bags.background import BackgroundRecorder, start_recorder
from mocap_ros.bags.mcap_file import Attachment
from mocap_ros.bags.mcap_scan import MAGIC
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import RecordedMessage, Recorder
from mocap_ros.bags.recovery import recover
from mocap_ros.config import RecorderConfig
from mocap_ros.errors import InputError, RecordingError
from mocap_ros.messages.cdr import decode, typestore
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.messages.skeletons import SKELETON_DEFINITION
from mocap_ros.units import NS_PER_S
from tests.support.paths import ROOT
from tests.support.pipeline_inputs import (
    BAG_FRAMES,
    BAG_STEP_NS,
    DEFINITION,
    START_NS,
    Message,
    make_keypoints,
    read_messages,
    write_bag,
)

# Imports of the code that `run_in_subprocess` runs.
PRELUDE = """
import os, resource, signal, sys
from pathlib import Path
from mocap_ros.bags.recorder import Recorder
from mocap_ros.config import RecorderConfig
from mocap_ros.errors import RecordingError
from tests.support.pipeline_inputs import BAG_FRAMES, record_keypoints
"""


def run_in_subprocess(code: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run Python code after the imports of `PRELUDE` in a process of its own."""
    command = [sys.executable, '-c', PRELUDE + code, *map(str, arguments)]
    # Without coverage, which cannot write its data where the code limits the size of files.
    env = {name: value for name, value in os.environ.items() if not name.startswith('COVERAGE_')}
    return subprocess.run(command, cwd=ROOT, env=env, check=False, capture_output=True, text=True, timeout=60)


def test_a_killed_recording_loses_no_more_than_a_chunk(tmp_path: Path) -> None:
    run_in_subprocess(
        'recorder = Recorder(Path(sys.argv[1]), RecorderConfig())\n'
        'record_keypoints(recorder, BAG_FRAMES)\n'
        'os.kill(os.getpid(), 9)\n',
        tmp_path / 'bag',
    )
    bag = tmp_path / 'bag'
    max_lost = RecorderConfig().chunk_seconds * 1e9 / BAG_STEP_NS + 1
    for path in (bag, bag / 'bag_0.mcap'):
        message = rf'{path.name}: the recording was cut off .*`mocap-ros recover {path}`'
        with pytest.raises(InputError, match=message):
            Bag(path)
        report = recover(path, tmp_path / f'{path.name}_whole')
        read = read_messages(tmp_path / f'{path.name}_whole', '/keypoints')
        assert BAG_FRAMES - max_lost <= len(read) == report.messages['/keypoints']
        assert read == [make_keypoints(i) for i in range(len(read))]


@pytest.mark.parametrize('limit', [20_000, 30_000, 30_500, 31_000])
def test_a_full_disk_is_one_error_and_the_bag_is_readable(tmp_path: Path, limit: int) -> None:
    """The written messages can be read, even though the disk has no space for the index and metadata.yaml."""
    bag = tmp_path / 'bag'
    completed = run_in_subprocess(
        'signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n'
        'resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), int(sys.argv[2])))\n'
        "recorder = Recorder(Path(sys.argv[1]), RecorderConfig(compression='none', chunk_seconds=0.25))\n"
        'for attempt in range(2):\n'
        '    try:\n'
        '        record_keypoints(recorder, 1000)\n'
        '    except RecordingError as error:\n'
        '        print(error)\n'
        'recorder.close()\n',
        bag,
        limit,
    )
    is_finished = (bag / 'bag_0.mcap').read_bytes().endswith(MAGIC)
    advice = '' if is_finished else f'; `mocap-ros recover {bag}` restores what was written'
    lines = completed.stdout.splitlines()
    assert lines == [f'{bag}: File too large{advice}', f'{bag}: the recording is closed']
    assert completed.stderr == ''
    if is_finished:
        read = read_messages(bag, '/keypoints')
        with (bag / 'bag_0.mcap').open('rb') as file:
            reader = make_reader(file, validate_crcs=True)
            assert [m.data for _, _, m in reader.iter_messages()] == read
    else:  # the disk has no space for the index
        recover(bag, tmp_path / 'whole')
        read = read_messages(tmp_path / 'whole', '/keypoints')
    assert len(read) * 340 > limit - 5000
    assert read == [make_keypoints(i) for i in range(len(read))]


def test_recording_ends_before_the_disk_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    free_bytes = iter([300_000_000, 250_000_000, 199_000_000])
    monkeypatch.setattr('shutil.disk_usage', lambda _: SimpleNamespace(free=next(free_bytes)))
    recorder = Recorder(tmp_path / 'bag', RecorderConfig())
    recorder.write('/keypoints', KEYPOINTS, make_keypoints(0), START_NS, START_NS)
    recorder.flush()
    recorder.write('/keypoints', KEYPOINTS, make_keypoints(1), START_NS, START_NS)
    message = r'bag: the disk has 199 MB left, less than recorder\.min_free_mb \(200\)'
    with pytest.raises(RecordingError, match=message):
        recorder.flush()
    with Bag(tmp_path / 'bag') as bag:
        assert bag.count(['/keypoints']) == 2
    free_bytes = iter([1])
    with pytest.raises(RecordingError, match='the disk has 0 MB left'):
        Recorder(tmp_path / 'other', RecorderConfig())
    assert not (tmp_path / 'other').exists()


@pytest.mark.parametrize('limit', [{'split_seconds': 0.5}, {'split_mb': 1, 'compression': 'none'}])
def test_a_bag_continues_in_further_files(tmp_path: Path, limit: dict[str, Any]) -> None:
    data = [make_keypoints(i) + bytes(40_000 if 'split_mb' in limit else 0) for i in range(BAG_FRAMES)]
    attachment = Attachment('mocap_ros.yaml', 'application/yaml', b'a: 1')
    with Recorder(tmp_path / 'bag', RecorderConfig(**limit), [attachment]) as recorder:
        recorder.declare_topic('/skeleton_definition', SKELETON_DEFINITION, latched=True)
        recorder.write('/skeleton_definition', SKELETON_DEFINITION, DEFINITION, START_NS, START_NS)
        for i, raw in enumerate(data):
            recorder.write('/keypoints', KEYPOINTS, raw, START_NS + i * BAG_STEP_NS, START_NS)

    files = sorted((tmp_path / 'bag').glob('*.mcap'))
    assert [f.name for f in files] == [f'bag_{n}.mcap' for n in range(len(files))]
    assert len(files) in (3, 4)
    with Reader(tmp_path / 'bag') as reader:
        read = [(c.topic, bytes(raw)) for c, _, raw in reader.messages()]
        assert [raw for topic, raw in read if topic == '/keypoints'] == data
        assert reader.message_count == len(read) == BAG_FRAMES + len(files)
    described = yaml.safe_load((tmp_path / 'bag' / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
    assert described['relative_file_paths'] == [f.name for f in files]
    for file in files:
        with file.open('rb') as stream:
            mcap_reader = make_reader(stream, validate_crcs=True)
            first = next(iter(mcap_reader.iter_messages()))
            assert (first[1].topic, first[2].data) == ('/skeleton_definition', DEFINITION)
            assert [a.data for a in mcap_reader.iter_attachments()] == [b'a: 1']


@pytest.mark.parametrize('end', ['flush', 'close', 'split'])
@pytest.mark.parametrize('removed', ['bag', 'bag/bag_0.mcap'])
def test_a_removed_recording_is_an_error(tmp_path: Path, removed: str, end: str) -> None:
    recorder = Recorder(tmp_path / 'bag', RecorderConfig(split_seconds=1.0))
    recorder.write('/keypoints', KEYPOINTS, make_keypoints(0), START_NS, START_NS)
    message = ('/keypoints', KEYPOINTS, make_keypoints(1), START_NS + 10**9, START_NS)
    ends: dict[str, Callable[[], None]] = {'flush': recorder.flush, 'close': recorder.close}
    ends['split'] = lambda: recorder.write(*message)
    shutil.move(tmp_path / removed, tmp_path / 'moved')
    with pytest.raises(RecordingError, match=r'bag_0\.mcap: the file was removed or moved while it was written$'):
        ends[end]()
    recorder.close()
    assert not (tmp_path / removed).exists()


def test_unwritable_and_existing_folders_are_refused(tmp_path: Path) -> None:
    (tmp_path / 'file').write_text('')
    with pytest.raises(RecordingError, match=r'file: is no folder'):
        Recorder(tmp_path / 'file' / 'bag', RecorderConfig())
    (tmp_path / 'bag').mkdir()
    with pytest.raises(RecordingError, match=r'bag: File exists'):
        Recorder(tmp_path / 'bag', RecorderConfig())


def test_a_further_file_repeats_what_nothing_replaces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A message replaces those of which it has all keys, and a refused one none. Each topic has its own limit."""
    monkeypatch.setattr('mocap_ros.bags.recorder.MAX_REPEATED', 2)
    with Recorder(tmp_path / 'bag', RecorderConfig(split_seconds=1.0)) as recorder:
        recorder.declare_topic('/once', SKELETON_DEFINITION, latched=True)
        recorder.declare_topic('/growing', SKELETON_DEFINITION, latched=True)
        recorder.write('/once', SKELETON_DEFINITION, b'once', START_NS, START_NS)
        recorder.write('/once', SKELETON_DEFINITION, b'refused', START_NS, START_NS, None)
        for keys in ('a', 'x', 'ab', 'abc'):
            recorder.write('/growing', SKELETON_DEFINITION, keys.encode(), START_NS, START_NS, frozenset(keys))
        recorder.write('/keypoints', KEYPOINTS, make_keypoints(0), START_NS + 2 * NS_PER_S, START_NS)
    with Bag(tmp_path / 'bag' / 'bag_1.mcap') as bag:
        assert [m.raw for m in bag.messages(['/once', '/growing'])] == [b'once', b'x', b'abc']


def test_a_file_begins_only_with_a_message_that_may_begin_it(tmp_path: Path) -> None:
    with Recorder(tmp_path / 'bag', RecorderConfig(split_seconds=1.0)) as recorder:
        for i, may_begin in enumerate((True, False, False, True, False)):
            raw, time_ns = make_keypoints(i), START_NS + i * NS_PER_S
            recorder.write('/keypoints', KEYPOINTS, raw, time_ns, time_ns, may_begin_file=may_begin)
    with Bag(tmp_path / 'bag' / 'bag_1.mcap') as bag:
        assert [m.raw for m in bag.messages(bag.topics)] == [make_keypoints(3), make_keypoints(4)]
    assert not (tmp_path / 'bag' / 'bag_2.mcap').exists()


@pytest.fixture(scope='module', params=['zstd', 'lz4', 'none'])
def recorded(request: Any, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Message]]:
    """Return the folder and the messages of a bag, for each compression."""
    folder = tmp_path_factory.mktemp('bags') / request.param
    return folder, write_bag(folder, RecorderConfig(compression=request.param))


def test_rosbags_reads_the_folder_and_the_bare_file(recorded: tuple[Path, list[Message]]) -> None:
    folder, written = recorded
    expected = [(topic, log_time_ns, data) for topic, log_time_ns, _, data in written]
    for path in (folder, folder / f'{folder.name}_0.mcap'):
        with Reader(path) as reader:
            assert [(c.topic, t, bytes(raw)) for c, t, raw in reader.messages()] == expected
            assert reader.message_count == BAG_FRAMES + 1
            durability = {}
            for connection in reader.connections:
                assert isinstance(connection.ext, ConnectionExtRosbag2)
                durability[connection.topic] = connection.ext.offered_qos_profiles[0].durability.name
            assert durability == {'/keypoints': 'VOLATILE', '/skeleton_definition': 'TRANSIENT_LOCAL'}
        with AnyReader([path]) as any_reader:  # checks the type hashes of metadata.yaml against the definitions
            for connection, _, raw in any_reader.messages():
                message = any_reader.deserialize(raw, connection.msgtype)
                assert repr(message) == repr(decode(bytes(raw), connection.msgtype))


def test_mcap_reads_the_file_by_its_index(recorded: tuple[Path, list[Message]]) -> None:
    folder, written = recorded
    with (folder / f'{folder.name}_0.mcap').open('rb') as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == BAG_FRAMES + 1
        assert len(summary.chunk_indexes) >= BAG_FRAMES * BAG_STEP_NS / 1.1e9
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
    assert inside['starting_time']['nanoseconds_since_epoch'] == START_NS
    assert inside['duration']['nanoseconds'] == (BAG_FRAMES - 1) * BAG_STEP_NS


def test_recorders_that_start_at_once_have_folders_of_their_own(tmp_path: Path) -> None:
    config, together = RecorderConfig(folder=str(tmp_path)), threading.Barrier(8)

    def start(_: int) -> str:
        together.wait()
        with closing(start_recorder(START_NS, config)) as recorder:
            return recorder.folder.name

    with ThreadPoolExecutor(8) as pool:
        names = list(pool.map(start, range(8)))
    assert sorted(names) == sorted(folder.name for folder in tmp_path.iterdir())
    assert len(set(names)) == 8


def test_what_comes_while_the_disk_is_checked_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The thread has just seen that nothing waits, when the last message and the end come."""
    is_checking, may_continue = threading.Event(), threading.Event()
    check_disk = Recorder.flush

    def wait_and_check(recorder: Recorder) -> None:
        is_checking.set()
        assert may_continue.wait(60)
        check_disk(recorder)

    monkeypatch.setattr(Recorder, 'flush', wait_and_check)
    background = BackgroundRecorder(tmp_path / 'bag', RecorderConfig())
    assert is_checking.wait(60)
    background.put([RecordedMessage('/a', KEYPOINTS, make_keypoints(1), START_NS, START_NS)])
    closing = threading.Thread(target=background.close)
    closing.start()
    closing.join(0.01)
    assert closing.is_alive()
    may_continue.set()
    closing.join(60)
    with Bag(tmp_path / 'bag') as bag:
        assert bag.count(['/a']) == 1


STUCK_DISK = """
import threading
from mocap_ros.bags import background

recorder = background.BackgroundRecorder(Path(sys.argv[1]), RecorderConfig())
os.fsync = os.fdatasync = lambda _: threading.Event().wait()
background.MAX_END_STALL_S = 0.1
try:
    recorder.close()
except RecordingError as error:
    print(error)
"""


def test_a_process_ends_though_the_disk_is_stuck(tmp_path: Path) -> None:
    done = run_in_subprocess(STUCK_DISK, tmp_path / 'bag')
    assert done.stdout.startswith(f'{tmp_path}/bag: the disk takes nothing')
    assert (done.returncode, done.stderr) == (0, '')
