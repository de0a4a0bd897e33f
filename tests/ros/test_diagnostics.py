# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The diagnostic status: its level follows what happened since the last report."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mocap_ros.bags.topics import Source
from mocap_ros.config import with_values
from mocap_ros.messages.cdr import decode, encode
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.ros.diagnostics import DIAGNOSTICS, DiagnosticsReporter, Level, RunStatistics
from mocap_ros.runtime.pipeline import Pipeline
from tests.support.pipeline_inputs import FAST_CONFIG, encode_demo_frames, process, with_stamp
from tests.support.transforms import make_transforms


def report(reporter: DiagnosticsReporter, statistics: RunStatistics) -> Any:
    message = decode(reporter.encode_status(statistics, 'off', 10**9), DIAGNOSTICS)
    (status,) = message.status
    return status


def with_scores(raw: bytes, score: float) -> bytes:
    """Return a keypoints message in which every keypoint has this score."""
    message = decode(raw, KEYPOINTS)
    for person in message.people:
        person.score = np.full_like(person.score, score)
    return encode(message, KEYPOINTS)


def test_the_level_follows_what_happened_since_the_last_report() -> None:
    pipeline, statistics = Pipeline(FAST_CONFIG), RunStatistics()
    reporter = DiagnosticsReporter('mocap_node', pipeline)
    silent = report(reporter, statistics)
    assert (silent.level, silent.message, silent.name) == (Level.STALE, 'no input', 'mocap_node')

    statistics.record_receipt()
    first, second = encode_demo_frames(2)
    process(pipeline, first)
    good = report(reporter, statistics)
    assert (good.level, good.message) == (Level.OK, '1 people')

    pipeline.feed(Source.KEYPOINTS, second[:50])
    pipeline.note_backlog()
    process(pipeline, second)
    bad = report(reporter, statistics)
    assert bad.level == Level.WARN
    assert bad.message == '1 invalid, 1 skipped because of a backlog in the last second'

    statistics.record_removed(7)
    flooded = report(reporter, statistics)
    assert (flooded.level, flooded.message) == (Level.WARN, '7 removed from a full queue in the last second')
    assert {v.key: v.value for v in flooded.values}['dropped: queue full'] == '7'
    assert report(reporter, statistics).level == Level.OK

    pipeline.counters.dropped['internal error'] += 2
    failed = report(reporter, statistics)
    assert (failed.level, failed.message) == (Level.ERROR, '2 internal errors in the last second; see the log')
    assert report(reporter, statistics).level == Level.OK


def test_messages_that_are_dropped_for_their_stamps_are_a_warning_and_an_error_if_they_are_all() -> None:
    pipeline, statistics = Pipeline(FAST_CONFIG), RunStatistics()
    reporter = DiagnosticsReporter('mocap_node', pipeline)
    raw = encode_demo_frames(1)[0]
    for expected in (
        (Level.WARN, '2 dropped for their stamps in the last second'),
        (Level.ERROR, 'no message was accepted: 3 dropped for their stamps in the last second'),
    ):
        for _ in range(3):
            statistics.record_receipt()
            pipeline.feed(Source.KEYPOINTS, raw)
        status = report(reporter, statistics)
        assert (status.level, status.message) == expected
    assert report(reporter, statistics).level == Level.OK


def test_refused_camera_infos_are_a_warning_while_no_people_are_sent() -> None:
    pipeline, statistics = Pipeline(FAST_CONFIG), RunStatistics()
    reporter = DiagnosticsReporter('mocap_node', pipeline)
    statistics.record_receipt()
    process(pipeline, encode_demo_frames(1)[0])
    report(reporter, statistics)
    pipeline.feed(Source.CAMERA_INFO, b'')
    status = report(reporter, statistics)
    assert (status.level, status.message) == (Level.WARN, '1 invalid in the last second')


def test_the_newest_reason_is_told_once_and_is_one_short_printable_line() -> None:
    pipeline, statistics = Pipeline(FAST_CONFIG), RunStatistics()
    reporter = DiagnosticsReporter('mocap_node', pipeline)
    for reason in ('an old reason', 'people[0].x:\n\x1b' + ' ' + 'looks normalised ' * 99):
        statistics.record_receipt()
        pipeline.feed(Source.KEYPOINTS, b'')
        statistics.record_reason('/keypoints', reason)
    message = report(reporter, statistics).message
    start = (
        'no message was accepted: 2 invalid in the last second; /keypoints: people[0].x: looks normalised looks'
    )
    assert message.startswith(start)
    assert len(message) < 500
    pipeline.feed(Source.KEYPOINTS, b'')
    assert report(reporter, statistics).message == '1 invalid in the last second'


def test_the_values_are_those_of_the_run() -> None:
    pipeline, statistics = Pipeline(FAST_CONFIG), RunStatistics()
    reporter = DiagnosticsReporter('mocap_node', pipeline)
    process(pipeline, encode_demo_frames(1)[0])
    for milliseconds in range(1, 101):
        statistics.record_receipt()
        statistics.record_solve(milliseconds / 1e3)
    statistics.record_lost(3)
    status = report(reporter, statistics)
    values = {v.key: v.value for v in status.values}
    assert values['input rate (Hz)'] == '50.0'  # 100 messages in the last 2 s
    assert float(values['solve time p50 (ms)']) == pytest.approx(50.5)
    assert float(values['solve time p99 (ms)']) == pytest.approx(99.0, abs=0.1)
    assert float(values['residual (px)']) == pytest.approx(pipeline.people[0].residual, abs=0.005)
    assert (values['people'], values['category'], values['recorder']) == ('1', 'walk', 'off')
    assert values['camera'] == 'nominal focal length'
    assert values['lost before the node'] == '3'


def test_people_of_an_earlier_second_are_not_counted_again() -> None:
    pipeline, statistics = Pipeline(FAST_CONFIG), RunStatistics()
    reporter = DiagnosticsReporter('mocap_node', pipeline)
    statistics.record_receipt()
    process(pipeline, encode_demo_frames(1)[0])
    messages, people = [], []
    for _ in range(2):
        status = report(reporter, statistics)
        values = {v.key: v.value for v in status.values}
        messages.append(status.message)
        people.append([values[key] for key in ('people', 'category', 'residual (px)')])
    assert messages == ['1 people', '0 people']
    assert people[0][:2] == ['1', 'walk']
    assert people[1] == ['0', '', 'nan']


def test_detections_of_which_none_is_a_person_are_a_warning() -> None:
    pipeline, statistics = Pipeline(FAST_CONFIG), RunStatistics()
    first, second, third = encode_demo_frames(3)
    process(pipeline, with_scores(first, 0.0))
    reporter = DiagnosticsReporter('mocap_node', pipeline)
    statistics.record_receipt()
    assert report(reporter, statistics).level == Level.OK  # that of an earlier run is none of this one
    process(pipeline, with_scores(second, 0.05))
    status = report(reporter, statistics)
    assert status.level == Level.WARN
    assert status.message == (
        '1 detections were no person in the last second: their scores are below tracker.min_score, '
        'or fewer than six joints are seen'
    )
    assert report(reporter, statistics).level == Level.OK
    process(pipeline, third)
    assert (report(reporter, statistics).level, len(pipeline.people)) == (Level.OK, 1)


def test_a_detection_that_is_no_person_beside_somebody_is_no_warning() -> None:
    pipeline, statistics = Pipeline(FAST_CONFIG), RunStatistics()
    reporter = DiagnosticsReporter('mocap_node', pipeline)
    statistics.record_receipt()
    message = decode(encode_demo_frames(1)[0], KEYPOINTS)
    message.people += decode(with_scores(encode_demo_frames(1)[0], 0.0), KEYPOINTS).people
    process(pipeline, encode(message, KEYPOINTS))
    assert pipeline.unusable_people == 1
    status = report(reporter, statistics)
    assert (status.level, status.message) == (Level.OK, '1 people')


def test_people_in_the_frame_of_the_camera_instead_of_the_output_frame_are_a_warning() -> None:
    pipeline, statistics = Pipeline(with_values(FAST_CONFIG, {'node.output_frame': 'map'})), RunStatistics()
    reporter = DiagnosticsReporter('mocap_node', pipeline)
    statistics.record_receipt()
    assert report(reporter, statistics).level == Level.OK  # before the first image
    first, second = encode_demo_frames(3)[1:]
    process(pipeline, first)
    status = report(reporter, statistics)
    assert status.level == Level.WARN
    assert status.message == (
        "people are published in the frame of the camera, 'camera', as the transform to node.output_frame, 'map', "
        'is unknown; see the log'
    )
    assert {v.key: v.value for v in status.values}['frame of people'] == 'camera'

    pipeline.feed(Source.STATIC_TRANSFORMS, make_transforms(('map', 'camera', 0, (1, 0, 0))))
    process(pipeline, second)
    status = report(reporter, statistics)
    assert (status.level, status.message) == (Level.OK, '1 people')
    assert {v.key: v.value for v in status.values}['frame of people'] == 'map'


def test_doubts_about_the_input_are_a_warning() -> None:
    pipeline, statistics = Pipeline(FAST_CONFIG), RunStatistics()
    reporter = DiagnosticsReporter('mocap_node', pipeline)
    statistics.record_receipt()
    process(pipeline, encode_demo_frames(1)[0])
    pipeline.checks.warnings = ('people: most points lie outside the image',)
    status = report(reporter, statistics)
    assert (status.level, status.message) == (Level.WARN, 'people: most points lie outside the image')
    assert report(reporter, statistics).message == '0 people', 'of an earlier second'


def test_a_disk_that_takes_nothing_is_a_warning() -> None:
    pipeline, statistics = Pipeline(FAST_CONFIG), RunStatistics()
    statistics.record_receipt()
    reporter = DiagnosticsReporter('mocap_node', pipeline)
    raw = reporter.encode_status(statistics, 'recording to bag', 10**9, 'the disk takes nothing')
    (status,) = decode(raw, DIAGNOSTICS).status
    assert (status.level, status.message) == (Level.WARN, 'the disk takes nothing')


def test_faults_of_an_earlier_run_are_none_of_this_one() -> None:
    """A pipeline outlives the runs between activation and deactivation."""
    pipeline, statistics = Pipeline(FAST_CONFIG), RunStatistics()
    pipeline.feed(Source.KEYPOINTS, b'')
    statistics.record_receipt()
    status = report(DiagnosticsReporter('mocap_node', pipeline), statistics)
    assert (status.level, status.message) == (Level.OK, '0 people')


def test_the_age_of_the_newest_frame_is_unknown_until_there_is_one_since_a_reset() -> None:
    pipeline, statistics = Pipeline(FAST_CONFIG), RunStatistics()
    reporter = DiagnosticsReporter('mocap_node', pipeline)

    def find_age() -> str:
        return {v.key: v.value for v in report(reporter, statistics).values}['age of newest frame (s)']

    assert find_age() == 'nan'
    process(pipeline, with_stamp(encode_demo_frames(1)[0], 400_000_000))
    assert find_age() == '0.600'
    pipeline.reset()
    assert find_age() == 'nan'


def test_the_silence_that_makes_the_status_stale_may_change_at_any_time(monkeypatch: pytest.MonkeyPatch) -> None:
    pipeline, statistics = Pipeline(with_values(FAST_CONFIG, {'node.silence_warning': 60.0})), RunStatistics()
    reporter = DiagnosticsReporter('mocap_node', pipeline)
    statistics.record_receipt()
    monkeypatch.setattr(statistics, 'seconds_since_input', lambda: 10.0)
    assert report(reporter, statistics).level == Level.OK
    pipeline.reconfigure(with_values(pipeline.config, {'node.silence_warning': 5.0}))
    assert report(reporter, statistics).level == Level.STALE
