# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A bag that is cut where nobody was there for long gives the same messages as the whole."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from mocap_ros.bags.journal import JOURNAL, Entry, Journal, Verdict, encode_entry
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.config import Config, RecorderConfig, values, with_settings
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.cdr import Header, decode, encode
from mocap_ros.messages.keypoints import KEYPOINTS, encode_keypoints
from mocap_ros.messages.transforms import TRANSFORMS
from mocap_ros.runtime.parts import Part, find_parts
from mocap_ros.runtime.replay import JOURNAL_TOPIC, ReplayOptions, replay
from mocap_ros.skeleton import keypoint_layout
from tests.support.camera_infos import camera_info
from tests.support.pipeline_inputs import FAST_CONFIG, encode_demo_frames, with_stamp
from tests.support.transforms import make_transforms

COCO17 = keypoint_layout('coco17').joints
ABSENCE_S = 2.0  # s, tracker.forget_all_after in these tests
CONFIG = with_settings(FAST_CONFIG, {'tracker.forget_all_after': ABSENCE_S})
HZ, START_NS = 10, 1_700_000_000_000_000_000  # images per second; ns since the epoch
LATCHED = ('/skeleton_definition',)  # topics of which each file of a bag repeats the last message


def misspell(raw: bytes) -> bytes:
    """Return a keypoints message of which one joint has a name that is nearly right."""
    message = decode(raw, KEYPOINTS)
    for person in message.people:
        person.skeleton, person.joint_names = '', ['lsholder' if j == 'lshoulder' else j for j in COCO17]
    return encode(message, KEYPOINTS)


def write_bag(folder: Path, visits: str, *events: Entry) -> Path:
    """Write a bag of which each second shows somebody (x, or m with a misspelt joint) or nobody (.).

    Others have images of another camera, whose size (?) or name (!) tells it.
    """
    seen = encode_demo_frames(60)
    with Recorder(folder, RecorderConfig(min_free_mb=0)) as recorder:
        recorder.write('/camera_info', CAMERA_INFO, camera_info(), START_NS, START_NS)
        for event in events:
            recorder.write('/node/journal', JOURNAL, encode_entry(event), START_NS, START_NS)
        for frame in range(len(visits) * HZ):
            stamp_ns = START_NS + frame * (1_000_000_000 // HZ)
            if visits[frame // HZ] in 'xm':
                raw = with_stamp(seen[3 * frame % 60], stamp_ns)
                raw = misspell(raw) if visits[frame // HZ] == 'm' else raw
            else:
                size = (1280, 960) if visits[frame // HZ] == '?' else (640, 480)
                name = 'other' if visits[frame // HZ] == '!' else 'camera'
                raw = encode_keypoints(Header(stamp_ns, name), size, [])
            recorder.write('/keypoints', KEYPOINTS, raw, stamp_ns + 1, stamp_ns)
    return folder


def find(bag_path: Path, min_seconds: float = 1.0, config: Config = CONFIG) -> list[Part]:
    with Bag(bag_path) as bag:
        return find_parts(bag, config, min_seconds=min_seconds)


def run(bag_path: Path, out: Path, part: Part | None = None) -> tuple[list[Any], tuple[Any, ...]]:
    """Replay a bag or a part of it; return the messages by topic and time, and the appearances."""
    with Bag(bag_path) as bag:
        result = replay(bag, out, ReplayOptions(CONFIG, part=part))
    return list(read_messages(out, is_first=part is None or part.number == 0)), result.appearances


def read_messages(path: Path, *, is_first: bool) -> Iterator[Any]:
    """Yield the messages; those that each file of a split bag repeats only of the first part."""
    with Bag(path) as bag:
        for number, message in enumerate(bag.messages(bag.topics)):
            if is_first or not (message.topic in LATCHED or (message.topic == JOURNAL_TOPIC and number < 2)):
                yield message


def test_the_parts_of_a_bag_give_the_messages_of_the_whole(tmp_path: Path) -> None:
    """People come back after short and long absences; after long ones their names begin again."""
    bag = write_bag(tmp_path / 'bag', 'xx.xx...x....xx.....x')
    parts = find(bag)
    assert [p.inputs_before for p in parts] == [0, 1 + 71, 1 + 111, 1 + 171]  # the CameraInfo, and images
    whole, appearances = run(bag, tmp_path / 'whole')
    found = [run(bag, tmp_path / f'part{p.number}', p) for p in parts]
    assert [message for messages, _ in found for message in messages] == whole
    assert tuple(a for _, each in found for a in each) == appearances
    assert [each[0].person for _, each in found] == ['person_1'] * 4
    assert any(a.person == 'person_2' for a in appearances), 'a short absence does not end the names'


def test_the_parts_of_a_bag_remark_on_its_input_as_the_whole_does(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / 'bag', 'mmm....mm......x.m')
    parts = find(bag)
    assert len(parts) == 3
    whole, _ = run(bag, tmp_path / 'whole')
    found = [run(bag, tmp_path / f'part{p.number}', p)[0] for p in parts]
    assert [message for messages in found for message in messages] == whole
    reasons = [decode(m.raw, JOURNAL).message for m in whole if m.topic == JOURNAL_TOPIC]
    assert sum('lsholder' in reason for reason in reasons) == 3, 'once in each part'


@pytest.mark.parametrize(
    ('visits', 'cuts'),
    [
        ('xx.....xx', 1),
        ('xx..xx..xx', 0),  # nobody is there, but too shortly
        ('......xx', 0),  # nobody was there before
        ('xx.......', 1),
        ('xxxxxx', 0),
        ('xx.....!', 0),  # which camera's images are used depends on those before
        ('xx?????xx', 0),  # the tracker gets none of these images and does not know that nobody is there
    ],
)
def test_cuts_fall_where_nobody_was_there_for_long(tmp_path: Path, visits: str, cuts: int) -> None:
    bag = write_bag(tmp_path / 'bag', visits)
    assert len(find(bag)) == 1 + cuts
    assert len(find(bag, min_seconds=60)) == 1
    assert len(find(bag, config=with_settings(CONFIG, {'tracker.forget_all_after': 30.0}))) == 1


@pytest.mark.parametrize(
    ('event', 'cuts'),
    [
        (Entry('reset', 7), 0),
        (Entry('parameters', 7, parameters=values(with_settings(CONFIG, {'tracker.min_score': 0.3}))), 0),
        (Entry('parameters', 7, parameters=values(with_settings(CONFIG, {'recorder.enabled': True}))), 1),
        (Entry('lost', 7, parameters={'lost': 2}), 0),
    ],
)
def test_a_bag_is_cut_if_only_parameters_of_the_recorder_changed_and_no_input_was_lost(
    tmp_path: Path, event: Entry, cuts: int
) -> None:
    """The service ~/record sets `recorder.enabled` in the recording that it has started."""
    bag = write_bag(tmp_path / 'bag', 'xx.....xx', Entry('parameters', 0, parameters=values(CONFIG)), event)
    assert len(find(bag)) == 1 + cuts


@pytest.mark.parametrize(('output_frame', 'cuts'), [('', 1), ('map', 0)])
def test_a_bag_is_not_cut_where_transforms_are_used(tmp_path: Path, output_frame: str, cuts: int) -> None:
    bag = write_bag(tmp_path / 'bag', 'xx.....xx')
    with Bag(bag) as opened:
        messages = list(opened.messages(opened.topics))
    with Recorder(tmp_path / 'moving', RecorderConfig(min_free_mb=0)) as recorder:
        recorder.write('/tf_static', TRANSFORMS, make_transforms(), START_NS, START_NS)
        for topic, msgtype, time_ns, raw in messages:
            recorder.write(topic, msgtype, raw, time_ns, time_ns)
    config = with_settings(CONFIG, {'node.output_frame': output_frame})
    assert len(find(tmp_path / 'moving', config=config)) == 1 + cuts
    assert len(find(bag, config=config)) == 2


def test_a_recorded_run_in_several_files_is_cut(tmp_path: Path) -> None:
    """Each file repeats the parameters, which have not changed."""
    journal, folder = Journal(JOURNAL_TOPIC), write_bag(tmp_path / 'plain', 'xx.....xx')
    with Bag(folder) as bag:
        messages = list(bag.messages(bag.topics))
    with Recorder(tmp_path / 'bag', RecorderConfig(min_free_mb=0, split_seconds=2.0)) as recorder:
        recorder.write(*journal.make_parameters_record(values(CONFIG), START_NS))
        for topic, msgtype, time_ns, raw in messages:
            for record in journal.make_input_records(topic, msgtype, raw, (time_ns, time_ns), Verdict.ACCEPTED):
                recorder.write(*record)
    assert len(list((tmp_path / 'bag').glob('*.mcap'))) > 1
    assert [p.inputs_before for p in find(tmp_path / 'bag')] == [p.inputs_before for p in find(folder)]
    assert len(find(folder)) == 2
