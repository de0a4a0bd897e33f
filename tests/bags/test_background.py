# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Recording in the background: the caller never waits for the disk."""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path

import pytest

from mocap_ros.bags.background import BackgroundRecorder, start_recorder
from mocap_ros.bags.journal import RESET, Journal, Verdict, read_run
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import RecordedMessage, Recorder
from mocap_ros.config import RecorderConfig
from mocap_ros.messages.keypoints import KEYPOINTS
from tests.support.bag_writing import START_NS, make_keypoints


def test_a_slow_disk_loses_inputs_without_delaying_the_caller(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk_is_ready = threading.Event()
    write = Recorder.write
    monkeypatch.setattr(Recorder, 'write', lambda *a: disk_is_ready.wait() and write(*a))
    background = BackgroundRecorder(tmp_path / 'bag', RecorderConfig(backlog=5))
    journal = Journal('/mocap_node/journal')
    queued = 0

    def make_records(i: int) -> list[RecordedMessage]:
        times_ns = (START_NS + i, START_NS)
        return journal.make_input_records('/keypoints', KEYPOINTS, make_keypoints(i), times_ns, Verdict.ACCEPTED)

    for i in range(20):  # none of these returns if the caller waits for the disk
        if background.put(make_records(i)):
            queued += 1
        else:
            journal.mark_last_input_lost()
    assert queued in (5, 6)
    assert background.put([journal.make_reset_record(START_NS + 20)], even_if_full=True)
    disk_is_ready.set()
    while not background.put([]):
        time.sleep(0.01)
    assert background.put(make_records(20))
    background.close()
    with Bag(tmp_path / 'bag') as bag:
        assert read_run(bag).lost_count == 20 - queued
        assert [entry.kind for entry in read_run(bag).events[queued]] == [RESET], 'an event is never lost'
        assert bag.count(['/keypoints']) == queued + 1


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


def test_what_comes_while_the_disk_is_checked_is_written_before_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The thread has just seen that nothing waits, when the last message and the end come."""
    is_checking, may_continue = threading.Event(), threading.Event()
    check_disk = Recorder.flush

    def wait_and_check(recorder: Recorder) -> None:
        is_checking.set()
        assert may_continue.wait(10)
        check_disk(recorder)

    monkeypatch.setattr(Recorder, 'flush', wait_and_check)
    background = BackgroundRecorder(tmp_path / 'bag', RecorderConfig())
    assert is_checking.wait(10)
    background.put([RecordedMessage('/a', KEYPOINTS, make_keypoints(1), START_NS, START_NS)])
    closing = threading.Thread(target=background.close)
    closing.start()
    closing.join(0.01)
    assert closing.is_alive()
    may_continue.set()
    closing.join(10)
    with Bag(tmp_path / 'bag') as bag:
        assert bag.count(['/a']) == 1
