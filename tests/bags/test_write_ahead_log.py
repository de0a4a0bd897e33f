# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The write-ahead log: what a killed recorder has written is recovered, each message once."""

from __future__ import annotations

import random
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from mocap_ros.bags.mcap_file import Attachment
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.bags.recovery import recover
from mocap_ros.bags.write_ahead_log import find_log
from mocap_ros.config import RecorderConfig
from mocap_ros.errors import RecordingError
from tests.support.bag_writing import make_keypoints, record_keypoints
from tests.support.paths import ROOT

CHUNK_FRAMES = 20  # frames in the first chunk
OPEN_FRAMES = 15  # further frames, in the open chunk
FRAMES = CHUNK_FRAMES + OPEN_FRAMES
IN_ONE_CHUNK = RecorderConfig(chunk_seconds=10.0)
UNFINISHED = 'the file was not closed; every message that was written to it was recovered'


def recover_frames(bag: Path) -> tuple[list[bytes], list[str]]:
    """Recover a bag of the name `bag`; return its keypoints and the losses without the names of files."""
    report = recover(bag, bag.with_name(f'{bag.name}_whole'))
    with Bag(bag.with_name(f'{bag.name}_whole')) as whole:
        found = [m.raw for m in whole.messages(['/keypoints'])]
    return found, [loss.partition('bag_0.mcap: ')[2] for loss in report.losses]


def leave_open(folder: Path, config: RecorderConfig) -> Path:
    """Make a bag of one complete chunk and an open one, as a killed recorder leaves it, called `bag`."""
    recorder = Recorder(folder / 'live' / 'bag', config, has_log=True)
    record_keypoints(recorder, CHUNK_FRAMES)
    recorder.flush()
    record_keypoints(recorder, OPEN_FRAMES, CHUNK_FRAMES)
    recorder.write_ahead()
    bag = shutil.copytree(folder / 'live' / 'bag', folder / 'bag')
    recorder.close()
    return bag


@pytest.mark.parametrize('content', [b'', bytes(100)])
def test_the_log_of_a_file_that_never_reached_the_disk_is_recovered(tmp_path: Path, content: bytes) -> None:
    """As a power failure may leave it."""
    recorder = Recorder(tmp_path / 'bag', IN_ONE_CHUNK, has_log=True)
    record_keypoints(recorder, OPEN_FRAMES)
    recorder.write_ahead()
    file, records = tmp_path / 'bag' / 'bag_0.mcap', find_log(tmp_path / 'bag' / 'bag_0.mcap').read_bytes()
    recorder.close()
    file.write_bytes(content)
    find_log(file).write_bytes(records)
    frames, losses = recover_frames(tmp_path / 'bag')
    assert frames == [make_keypoints(i) for i in range(OPEN_FRAMES)]
    assert losses == ['its first 8 bytes are not those of an MCAP file', UNFINISHED]


@pytest.fixture
def open_bag(tmp_path: Path) -> Path:
    """The bag of `leave_open` with chunks of the usual compression."""
    bag = leave_open(tmp_path, IN_ONE_CHUNK)
    assert [p.name for p in sorted((tmp_path / 'live' / 'bag').iterdir())] == ['bag_0.mcap', 'metadata.yaml']
    return bag


def test_a_killed_recorder_loses_nothing_that_it_has_written_ahead(tmp_path: Path) -> None:
    code = (
        'import os, sys\n'
        'from pathlib import Path\n'
        'from mocap_ros.bags.background import BackgroundRecorder\n'
        'from mocap_ros.bags.recorder import RecordedMessage\n'
        'from mocap_ros.config import RecorderConfig\n'
        'from mocap_ros.messages.keypoints import KEYPOINTS\n'
        'from tests.support.bag_writing import make_keypoints\n'
        'folder = Path(sys.argv[1])\n'
        'recorder = BackgroundRecorder(folder, RecorderConfig(chunk_seconds=10.0))\n'
        'messages = [make_keypoints(i) for i in range(10)]\n'
        'for i, raw in enumerate(messages):\n'
        "    recorder.put([RecordedMessage('/keypoints', KEYPOINTS, raw, i + 1, i + 1)])\n"
        "files = [folder / 'bag_0.mcap', folder / 'bag_0.mcap-wal']\n"
        'while messages[-1] not in files[0].read_bytes() + files[1].read_bytes():\n'
        '    pass\n'
        'os.kill(os.getpid(), 9)\n'
    )
    bag = tmp_path / 'bag'
    completed = subprocess.run([sys.executable, '-c', code, bag], cwd=ROOT, check=False, timeout=60)
    assert completed.returncode == -signal.SIGKILL
    assert recover_frames(bag) == ([make_keypoints(i) for i in range(10)], [UNFINISHED])


def test_a_log_that_is_cut_off_anywhere_loses_only_its_last_messages(open_bag: Path) -> None:
    log = find_log(open_bag / 'bag_0.mcap')
    content, rng = log.read_bytes(), random.Random(0)
    lengths = [content.index(make_keypoints(i)) + len(make_keypoints(i)) for i in range(CHUNK_FRAMES, FRAMES)]
    for cut in [*range(10), *(rng.randrange(len(content)) for _ in range(20)), len(content)]:
        log.write_bytes(content[:cut])
        found, losses = recover_frames(open_bag)
        assert found == [make_keypoints(i) for i in range(CHUNK_FRAMES + sum(end <= cut for end in lengths))]
        assert losses[0].startswith('the file was not closed')
        is_whole = cut <= 8 or cut in lengths
        assert is_whole or 'bytes of its write-ahead log are no complete record' in losses[1]
        shutil.rmtree(open_bag.with_name('bag_whole'))


def test_a_file_that_is_cut_before_its_log_gives_what_is_left_of_both(tmp_path: Path) -> None:
    open_bag = leave_open(tmp_path, replace(IN_ONE_CHUNK, compression='none'))
    file = open_bag / 'bag_0.mcap'
    log, content = find_log(file).read_bytes(), file.read_bytes()
    file.write_bytes(content[: 3 * len(content) // 4])  # within the only chunk
    find_log(file).unlink()
    salvaged = recover_frames(open_bag)[0]
    assert salvaged
    shutil.rmtree(open_bag.with_name('bag_whole'))
    find_log(file).write_bytes(log)
    found, losses = recover_frames(open_bag)
    assert found == [*salvaged, *map(make_keypoints, range(CHUNK_FRAMES, FRAMES))]
    assert losses[-1] == 'chunks before its write-ahead log that the file does not hold completely: 1'


@pytest.mark.parametrize('written_bytes', [0, 5, 60, 900, None])
def test_a_chunk_that_is_also_in_the_log_is_recovered_once(tmp_path: Path, written_bytes: int | None) -> None:
    """The recorder is killed while it writes a chunk, or before it empties the log."""
    recorder = Recorder(tmp_path / 'bag', IN_ONE_CHUNK, has_log=True)
    file = tmp_path / 'bag' / 'bag_0.mcap'
    record_keypoints(recorder, CHUNK_FRAMES)
    recorder.write_ahead()
    log, size = find_log(file).read_bytes(), file.stat().st_size
    recorder.flush()
    assert find_log(file).read_bytes() == b''
    recorder.close()
    cut = file.stat().st_size if written_bytes is None else size + written_bytes
    file.write_bytes(file.read_bytes()[:cut])
    find_log(file).write_bytes(log)
    assert recover_frames(tmp_path / 'bag')[0] == [make_keypoints(i) for i in range(CHUNK_FRAMES)]


def test_without_its_log_a_bag_has_its_complete_chunks(open_bag: Path) -> None:
    find_log(open_bag / 'bag_0.mcap').unlink()
    assert recover_frames(open_bag)[0] == [make_keypoints(i) for i in range(CHUNK_FRAMES)]


@pytest.mark.parametrize('failing', ['write', 'flush'])
def test_the_open_chunk_is_saved_when_the_disk_fails_for_a_moment(
    tmp_path: Path, failing: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder = Recorder(tmp_path / 'bag', IN_ONE_CHUNK, [Attachment('a', 'text/plain', b'')], has_log=True)
    record_keypoints(recorder, FRAMES)
    recorder.write_ahead()

    def fail(*_: object) -> None:
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr(f'mcap.writer.Writer.{"add_message" if failing == "write" else "flush"}', fail)
    with pytest.raises(RecordingError, match=r'bag: No space left on device\Z'):
        recorder.flush() if failing == 'flush' else record_keypoints(recorder, 1, FRAMES)
    assert [p.name for p in sorted((tmp_path / 'bag').iterdir())] == ['bag_0.mcap', 'metadata.yaml']
    with Bag(tmp_path / 'bag') as bag:
        assert [m.raw for m in bag.messages(['/keypoints'])] == [make_keypoints(i) for i in range(FRAMES)]
