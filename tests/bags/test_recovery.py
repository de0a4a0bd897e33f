"""Damaged bags: said in one line when they are opened, and made whole as far as it goes."""

from __future__ import annotations

import os
import random
import re
import sqlite3
from pathlib import Path

import pytest
from mcap.reader import make_reader
from rosbags.rosbag2 import StoragePlugin, Writer

from mocap_ros.bags.mcap_file import Attachment
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.bags.recovery import recover
from mocap_ros.cli.main import main
from mocap_ros.config import RecorderConfig
from mocap_ros.errors import InputError, RecordingError
from mocap_ros.messages.cdr import Header, typestore
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints

FRAMES = 120
STEP = 33_000_000
CHUNK = 9  # frames
FRAME = [encode_keypoints(Header(i * STEP, f'frame {i}'), (640, 480), []) for i in range(FRAMES)]


def written(folder: Path, compression: str = 'zstd') -> bytes:
    attachment = Attachment('a.txt', 'text/plain', b'kept')
    with Recorder(folder, RecorderConfig(compression=compression), [attachment]) as recorder:
        for i, raw in enumerate(FRAME):
            recorder.write('/keypoints', KEYPOINTS, raw, i * STEP + 1, i * STEP)
    return (folder / f'{folder.name}_0.mcap').read_bytes()


def frames_of(path: Path) -> list[int]:
    """Which frames a bag holds, every one unchanged."""
    with Bag(path) as bag:
        return [FRAME.index(m.raw) for m in bag.messages(['/keypoints'])]


def recovered(data: bytes, folder: Path) -> tuple[list[int], list[str]]:
    folder.mkdir()
    (folder / 'x.mcap').write_bytes(data)
    losses = recover(folder / 'x.mcap', folder / 'out').losses
    return frames_of(folder / 'out'), losses


@pytest.mark.parametrize('compression', ['zstd', 'lz4', 'none'])
def test_a_bag_cut_off_anywhere_gives_all_before_the_cut(tmp_path: Path, compression: str) -> None:
    data = written(tmp_path / 'bag', compression)
    draw = random.Random(0)
    known = 0
    for n, cut in enumerate(sorted(draw.randrange(3000, len(data)) for _ in range(15))):
        file = tmp_path / f'{n}.mcap'
        file.write_bytes(data[:cut])
        with pytest.raises(InputError, match=rf'{n}\.mcap: the recording was cut off .*`mocap-ros recover'):
            Bag(file)
        found, losses = recovered(data[:cut], tmp_path / str(n))
        assert found == list(range(len(found)))
        assert len(found) >= known
        assert losses or len(found) == FRAMES
        known = len(found)


def test_records_of_an_incomplete_chunk_are_had(tmp_path: Path) -> None:
    data = written(tmp_path / 'bag', 'none')
    at = data.index(FRAME[100])
    found, losses = recovered(data[: at + 5], tmp_path / 'cut')
    assert found == list(range(100))
    assert re.search(r'cut off at byte \d+: .* of which \d+ messages could be saved', losses[0])


@pytest.mark.parametrize('compression', ['zstd', 'none'])
def test_a_flipped_bit_costs_a_chunk_at_most_and_is_never_silent(tmp_path: Path, compression: str) -> None:
    data = written(tmp_path / 'bag', compression)
    draw = random.Random(1)
    for n in range(60):
        flipped = bytearray(data)
        flipped[draw.randrange(60, len(data))] ^= 1 << draw.randrange(8)
        file = tmp_path / f'{n}.mcap'
        file.write_bytes(flipped)
        try:
            assert frames_of(file) == list(range(FRAMES))
        except InputError as error:
            assert 'mocap-ros recover' in str(error)  # noqa: PT017
        found, losses = recovered(flipped, tmp_path / str(n))
        assert found == sorted(found)
        assert len(found) >= FRAMES - CHUNK
        assert losses or len(found) == FRAMES


def test_garbage_in_the_middle_is_passed_over(tmp_path: Path) -> None:
    data = written(tmp_path / 'bag')
    middle = len(data) // 3
    garbage = random.Random(2).randbytes(2000)
    found, losses = recovered(data[:middle] + garbage + data[middle + 500 :], tmp_path / 'x')
    assert len(found) > FRAMES - 40
    assert found[0] == 0
    assert found[-1] == FRAMES - 1
    assert any('damaged at byte' in loss for loss in losses)


def test_a_split_bag_whose_last_file_was_cut_off_keeps_attachments_and_qos(tmp_path: Path) -> None:
    bag = tmp_path / 'bag'
    with Recorder(
        bag, RecorderConfig(split_seconds=1.0), [Attachment('a.txt', 'text/plain', b'kept')]
    ) as recorder:
        recorder.announce('/keypoints', KEYPOINTS, latched=True)
        for i, raw in enumerate(FRAME):
            recorder.write('/keypoints', KEYPOINTS, raw, i * STEP + 1, i * STEP)
    (bag / 'metadata.yaml').unlink()
    last = bag / 'bag_3.mcap'
    last.write_bytes(last.read_bytes()[:-500])
    with pytest.raises(InputError, match=rf'{bag}: the recording was cut off \(bag_3\.mcap\)'):
        Bag(bag)
    assert main(['recover', str(bag)]) == 0
    whole = tmp_path / 'bag_recovered'
    assert sorted(set(frames_of(whole))) == list(range(FRAMES))
    with Bag(whole) as opened:
        assert opened.qos['/keypoints'][0].durability.name == 'TRANSIENT_LOCAL'
    with (whole / 'bag_recovered_0.mcap').open('rb') as file:
        attachments = list(make_reader(file).iter_attachments())
    assert {a.data for a in attachments} == {b'kept'}


def test_a_database_keeps_what_its_journal_holds(tmp_path: Path) -> None:
    bag = tmp_path / 'bag'
    with Writer(bag, version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection('/keypoints', KEYPOINTS, typestore=typestore())
        for i, raw in enumerate(FRAME[:50]):
            writer.write(connection, i * STEP, raw)
    base = sqlite3.connect(bag / 'bag.db3')
    base.execute('PRAGMA journal_mode=WAL')
    base.executemany(
        'INSERT INTO messages (topic_id, timestamp, data) VALUES (1, ?, ?)',
        [(i * STEP, FRAME[i]) for i in range(50, FRAMES)],
    )
    base.commit()
    for name in ('bag.db3', 'bag.db3-wal'):  # as they are when the recorder is killed
        (tmp_path / name).write_bytes((bag / name).read_bytes())
    base.close()
    with pytest.raises(InputError, match=r'cut off: bag\.db3-wal holds messages .* `mocap-ros recover'):
        Bag(tmp_path / 'bag.db3')
    assert recover(tmp_path / 'bag.db3', tmp_path / 'whole').losses == []
    assert frames_of(tmp_path / 'whole') == list(range(FRAMES))


def test_a_damaged_database_gives_what_can_be_read(tmp_path: Path) -> None:
    bag = tmp_path / 'bag'
    with Writer(bag, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection('/keypoints', KEYPOINTS, typestore=typestore())
        for i, raw in enumerate(FRAME):
            writer.write(connection, i * STEP, raw)
    data = bytearray((bag / 'bag.db3').read_bytes())
    page = data.index(FRAME[60]) // 4096 * 4096
    data[page : page + 4096] = bytes(4096)
    (tmp_path / 'x.db3').write_bytes(data)
    with pytest.raises(InputError, match=r'x\.db3: .*`mocap-ros recover'):
        frames_of(tmp_path / 'x.db3')
    found = recover(tmp_path / 'x.db3', tmp_path / 'whole')
    assert re.search(r'about \d+ messages cannot be read', found.losses[0])
    assert 30 < len(frames_of(tmp_path / 'whole')) < FRAMES


def test_a_database_cut_off_or_with_empty_pages_gives_what_is_left_and_says_how_much(tmp_path: Path) -> None:
    with Writer(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection('/keypoints', KEYPOINTS, typestore=typestore())
        for i, raw in enumerate(FRAME):
            writer.write(connection, i * STEP, raw)
    data = (tmp_path / 'bag' / 'bag.db3').read_bytes()
    most = 0
    for cut in range(1, len(data) // 4096 + 1):  # whole pages, and some of the next
        for name, left in (
            ('cut', data[: cut * 4096 + 77]),
            ('empty', data[: cut * 4096].ljust(len(data), b'\0')),
        ):
            file, out = tmp_path / f'{name}{cut}.db3', tmp_path / f'{name}{cut}'
            file.write_bytes(left)
            try:
                losses, found = recover(file, out).losses, frames_of(out)
            except InputError as error:
                losses, found = [str(error)], []
            assert losses or len(found) == FRAMES
            assert set(found) <= set(range(FRAMES))
            if about := re.search(r'about (\d+) messages', losses[0] if losses else ''):
                assert int(about[1]) >= FRAMES - len(found)
            most = max(most, len(found) % FRAMES)
    assert most > FRAMES / 2


def test_messages_of_a_topic_that_is_lost_are_counted(tmp_path: Path) -> None:
    with Writer(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        for topic in ('/keypoints', '/other', '/third'):
            connection = writer.add_connection(topic, KEYPOINTS, typestore=typestore())
            for i, raw in enumerate(FRAME[:5]):
                writer.write(connection, i * STEP, raw)
    with sqlite3.connect(tmp_path / 'bag' / 'bag.db3') as base:
        base.execute("DELETE FROM topics WHERE name = '/other'")
        base.execute("UPDATE topics SET type = x'00' WHERE name = '/third'")
    found = recover(tmp_path / 'bag', tmp_path / 'out')
    assert found.messages == {'/keypoints': 5}
    assert [loss.partition('bag.db3: ')[2] for loss in found.losses] == [
        'topic 3 has no name or no type',
        '5 messages of topic number 2, whose description is lost',
        '5 messages of topic number 3, whose description is lost',
    ]


def test_an_interrupted_recovery_leaves_nothing_that_looks_whole(tmp_path: Path) -> None:
    written(tmp_path / 'bag')

    def interrupted(done: int, size: int) -> None:
        assert (tmp_path / 'out.partial').is_dir()
        if done > size / 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        recover(tmp_path / 'bag', tmp_path / 'out', interrupted)
    assert [p.name for p in tmp_path.iterdir()] == ['bag']
    recover(tmp_path / 'bag', tmp_path / 'out')
    assert frames_of(tmp_path / 'out') == list(range(FRAMES))
    assert [p.name for p in sorted((tmp_path / 'out').iterdir())] == ['metadata.yaml', 'out_0.mcap']
    with pytest.raises(RecordingError, match='out: exists already'):
        recover(tmp_path / 'bag', tmp_path / 'out')


def test_what_holds_nothing_is_refused_and_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / 'empty').mkdir()
    os.mkfifo(tmp_path / 'pipe.mcap')
    (tmp_path / 'x.mcap').write_bytes(b'')
    (tmp_path / 'y.mcap').write_bytes(b'\x89MCAP0\r\n' + bytes(500))
    for name, reason in {
        'empty': 'no bag folder',
        'none.mcap': 'No such file',
        'x.mcap': 'no MCAP',
        'y.mcap': '',
        'pipe.mcap': 'not a file',
    }.items():
        with pytest.raises(InputError, match=f'{name}.*{reason}'):
            recover(tmp_path / name, tmp_path / 'out')
        assert not list(tmp_path.glob('out*'))
