# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Damaged bags: opening them is an error of one line, and everything readable is recovered."""

import os
import random
import sqlite3
from pathlib import Path

import pytest
from mcap.reader import make_reader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from mocap_ros.bags.mcap_file import Attachment
from mocap_ros.bags.mcap_scan import MAGIC
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.bags.recovery import recover
from mocap_ros.cli.main import main
from mocap_ros.config import RecorderConfig
from mocap_ros.errors import InputError, RecordingError
from mocap_ros.messages.cdr import Header, typestore
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from mocap_ros.messages.skeletons import SKELETON_DEFINITION
from mocap_ros.units import NS_PER_S

FRAMES = 120  # enough for several chunks and, with a limit of 1 s, several files
STEP_NS = 33_000_000  # between two frames; about 30 Hz
CHUNK_SECONDS = 0.25  # s, time after which a chunk is closed
MAX_FRAMES_PER_CHUNK = 9  # frames in `CHUNK_SECONDS`
MESSAGES = [  # one message for each frame
    encode_keypoints(Header(i * STEP_NS, f'frame {i}'), (640, 480), []) for i in range(FRAMES)
]


def write_bag(folder: Path, compression: str = 'zstd') -> bytes:
    """Write a bag with all messages and an attachment; return the content of its file."""
    attachment = Attachment('a.txt', 'text/plain', b'kept')
    config = RecorderConfig(compression=compression, chunk_seconds=CHUNK_SECONDS)
    with Recorder(folder, config, [attachment]) as recorder:
        for i, raw in enumerate(MESSAGES):
            recorder.write('/keypoints', KEYPOINTS, raw, i * STEP_NS + 1, i * STEP_NS)
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
        (c.chunk_start_offset, c.chunk_start_offset + c.chunk_length, (c.message_end_time - 1) // STEP_NS + 1)
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
    data = write_bag(tmp_path / 'bag', compression)
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
    data = write_bag(tmp_path / 'bag', compression)
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
        assert [loss.rpartition(': ')[2] for loss in counted] == (
            [f'{len(missing)} of {FRAMES} messages are missing'] if missing else []
        )


def test_attachments_and_qos_are_recovered(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = tmp_path / 'bag'
    with Recorder(
        bag, RecorderConfig(split_seconds=1.0), [Attachment('a.txt', 'text/plain', b'kept')]
    ) as recorder:
        recorder.declare_topic('/keypoints', KEYPOINTS, latched=True)
        for i, raw in enumerate(MESSAGES):
            recorder.write('/keypoints', KEYPOINTS, raw, i * STEP_NS + 1, i * STEP_NS)
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
    attachment = Attachment('a.txt', 'text/plain', b'kept')
    with Recorder(tmp_path / 'bag', RecorderConfig(split_seconds=split_seconds), [attachment]) as recorder:
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
    data = write_bag(tmp_path / 'bag')
    first_chunk = find_chunks(tmp_path / 'bag')[0][0]
    if is_cut:
        data = data[: find_chunks(tmp_path / 'bag')[-1][1]]
    for number, damaged in enumerate(
        (
            bytes([data[0], data[1] ^ 1]) + data[2:],
            bytes(first_chunk) + data[first_chunk:],
            data[first_chunk:],
            data[first_chunk - 4 :],
        )
    ):
        frames, losses = recover_frames(damaged, tmp_path / str(number))
        assert frames == list(range(FRAMES))
        assert any(loss.endswith(': its first 8 bytes are not those of an MCAP file') for loss in losses)


def test_messages_of_the_write_ahead_log_are_recovered(tmp_path: Path) -> None:
    bag = tmp_path / 'bag'
    with Writer(bag, version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection('/keypoints', KEYPOINTS, typestore=typestore())
        for i, raw in enumerate(MESSAGES[:50]):
            writer.write(connection, i * STEP_NS, raw)
    database = sqlite3.connect(bag / 'bag.db3')
    database.execute('PRAGMA journal_mode=WAL')
    database.executemany(
        'INSERT INTO messages (topic_id, timestamp, data) VALUES (1, ?, ?)',
        [(i * STEP_NS, MESSAGES[i]) for i in range(50, FRAMES)],
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
    write_bag(tmp_path / 'bag')

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
    write_bag(tmp_path / 'bag')
    if not has_metadata:
        (tmp_path / 'bag' / 'metadata.yaml').unlink()
    before = sorted((tmp_path / 'bag').iterdir())
    with pytest.raises(RecordingError, match=r'new: .*bag is a bag; write beside it'):
        recover(tmp_path / 'bag', tmp_path / 'bag' / 'new')
    assert sorted((tmp_path / 'bag').iterdir()) == before


def test_paths_without_messages_are_refused_and_leave_no_bag(tmp_path: Path) -> None:
    (tmp_path / 'empty').mkdir()
    os.mkfifo(tmp_path / 'pipe.mcap')
    (tmp_path / 'x.mcap').write_bytes(b'')
    (tmp_path / 'y.mcap').write_bytes(MAGIC + bytes(500))
    (tmp_path / 'z.mcap').write_bytes(random.Random(4).randbytes(1_000_000))
    for name, reason in {
        'empty': 'no bag folder',
        'none.mcap': 'No such file',
        'x.mcap': 'no MCAP',
        'y.mcap': 'cut off at byte 8: 500 bytes are no complete record',
        'z.mcap': 'no MCAP file',
        'pipe.mcap': 'not a file',
    }.items():
        with pytest.raises(InputError, match=f'{name}.*{reason}'):
            recover(tmp_path / name, tmp_path / 'out')
        assert not list(tmp_path.glob('out*'))


@pytest.mark.parametrize('storage', [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize('mode', [CompressionMode.MESSAGE, CompressionMode.FILE])
@pytest.mark.parametrize('is_killed', [False, True])
def test_bags_that_rosbag2_compressed_are_recovered(
    tmp_path: Path, storage: StoragePlugin, mode: CompressionMode, is_killed: bool
) -> None:
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
