"""Journal of a run: entries and numbering of the inputs."""

from __future__ import annotations

from pathlib import Path

from mocap_ros.bags.journal import Entry, Journal, Verdict, decode_entry, encode_entry
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.config import RecorderConfig
from mocap_ros.config.defaults import Value
from mocap_ros.messages.keypoints import KEYPOINTS
from tests.support.bag_writing import START_NS, make_keypoints


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


def test_inputs_are_numbered_and_resets_refer_to_the_last_input(tmp_path: Path) -> None:
    journal = Journal('/mocap_node/journal')
    raw, late = make_keypoints(0), START_NS + 2
    records = [
        *journal.make_input_records('/keypoints', KEYPOINTS, raw, (START_NS, START_NS), Verdict.ACCEPTED),
        journal.make_reset_record(START_NS + 1),
        *journal.make_input_records('/keypoints', KEYPOINTS, b'bad', (late, START_NS), Verdict.INVALID, 'bad'),
    ]
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        for record in records:
            recorder.write(*record)
    with Bag(tmp_path / 'bag') as bag:
        entries = [decode_entry(m.raw) for m in bag.messages(['/mocap_node/journal'])]
    assert [(e.kind, e.number, e.verdict.name) for e in entries] == [
        ('input', 1, 'ACCEPTED'), ('reset', 1, 'ACCEPTED'), ('input', 2, 'INVALID'),
    ]  # fmt: skip
