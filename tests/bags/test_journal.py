# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Journal of a run: entries and numbering of the inputs."""

from __future__ import annotations

from pathlib import Path

from mocap_ros.bags.journal import Entry, Journal, Verdict, decode_entry, encode_entry, read_run
from mocap_ros.bags.reader import Bag, BagMessage
from mocap_ros.bags.recorder import Recorder
from mocap_ros.bags.rosbag2 import make_topic
from mocap_ros.config import RecorderConfig
from mocap_ros.config.defaults import Value
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.keypoints import KEYPOINTS
from tests.support.bag_writing import START_NS, STEP_NS, make_keypoints
from tests.support.camera_infos import camera_info

INPUTS = ('/camera_info', '/keypoints')
FRAMES, SKIPPED, RESET_AFTER = 30, 14, 24  # images, and the images that are skipped and before a reset
FRAMES_A_FILE = 10  # of the bag that `record_split_run` writes
PARAMETERS: dict[str, Value] = {'tracker.components': 8}


def test_journal_entries_round_trip() -> None:
    parameters: dict[str, Value] = {
        'solver.components': 20,
        'tracker.model': 'all',
        'solver.tolerance': 1e-05,
        'x': True,
    }
    for entry in (
        Entry('input', 3, Verdict.BACKLOG, 'late', '/keypoints'),
        Entry('parameters', 0, parameters=parameters),
    ):
        assert decode_entry(encode_entry(entry)) == entry


def record_split_run(folder: Path) -> Path:
    """Record a run of three files, whose CameraInfo is latched, so that each further file repeats it."""
    journal, seconds = Journal('/mocap_node/journal'), FRAMES_A_FILE * STEP_NS / 1e9
    with Recorder(folder, RecorderConfig(min_free_mb=0, split_seconds=seconds)) as recorder:
        recorder.add_topic(
            make_topic('/camera_info', CAMERA_INFO, qos=make_topic('/', CAMERA_INFO, latched=True).qos)
        )
        recorder.write(*journal.make_parameters_record(PARAMETERS, START_NS))
        for i in range(-1, FRAMES):
            topic, msgtype, raw = '/keypoints', KEYPOINTS, make_keypoints(i + 1)
            if i < 0:
                topic, msgtype, raw = '/camera_info', CAMERA_INFO, camera_info()
            verdict = Verdict.BACKLOG if i == SKIPPED else Verdict.ACCEPTED
            times_ns = (START_NS + max(i, 0) * STEP_NS, START_NS)
            for record in journal.make_input_records(topic, msgtype, raw, times_ns, verdict):
                recorder.write(*record)
            if i == RESET_AFTER:
                recorder.write(*journal.make_reset_record(times_ns[0]))
    assert len(list(folder.glob('*.mcap'))) == FRAMES // FRAMES_A_FILE
    return folder


def number_inputs(bag: Bag) -> dict[int, BagMessage]:
    return dict(enumerate(read_run(bag).leave_out_repeated(bag.messages(INPUTS)), 1))


def test_a_split_bag_has_the_inputs_and_events_of_the_run(tmp_path: Path) -> None:
    with Bag(record_split_run(tmp_path / 'bag')) as bag:
        run, inputs = read_run(bag), number_inputs(bag)
    assert [m.topic for m in inputs.values()] == ['/camera_info'] + ['/keypoints'] * FRAMES
    assert run.parameters == PARAMETERS
    assert run.skipped_inputs == {1 + SKIPPED + 1}
    assert {n: [e.kind for e in events] for n, events in run.events.items()} == {1 + RESET_AFTER + 1: ['reset']}


def test_a_further_file_alone_has_its_inputs_after_the_repeated_ones(tmp_path: Path) -> None:
    folder = record_split_run(tmp_path / 'bag')
    with Bag(folder / 'bag_1.mcap') as bag:
        run, inputs = read_run(bag), number_inputs(bag)
    assert [m.topic for m in inputs.values()] == ['/camera_info'] + ['/keypoints'] * FRAMES_A_FILE
    (skipped,) = run.skipped_inputs
    assert inputs[skipped].raw == make_keypoints(SKIPPED + 1)
    assert (run.parameters, run.events) == (PARAMETERS, {})
    with Bag(folder / 'bag_2.mcap') as bag:
        run, inputs = read_run(bag), number_inputs(bag)
    ((last_before_reset, (event,)),) = run.events.items()
    assert (event.kind, inputs[last_before_reset].raw) == ('reset', make_keypoints(RESET_AFTER + 1))
