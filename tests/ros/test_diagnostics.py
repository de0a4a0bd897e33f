# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What the node reports: its diagnostic status, and a log that is not flooded."""

from itertools import islice
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mocap_ros.bags.topics import Source
from mocap_ros.config import with_values
from mocap_ros.messages.cdr import decode
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.ros.diagnostics import DIAGNOSTICS, DiagnosticsReporter, Level, RunStatistics
from mocap_ros.ros.throttled_log import MAX_KINDS, MAX_REASONS, ThrottledLog
from mocap_ros.runtime.pipeline import Pipeline
from tests.support.camera_messages import make_transforms
from tests.support.message_objects import encode
from tests.support.pipeline_inputs import FAST_CONFIG, LineLog, encode_demo_frames, process, with_stamp

GOOD, NO_PEOPLE = (Level.OK, '1 people'), (Level.OK, '0 people')


@pytest.fixture(autouse=True)
def _time_stands_still(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('mocap_ros.ros.diagnostics.time', SimpleNamespace(monotonic=lambda: 100.0))


class Run:
    """A pipeline and its statistics, in which one message was received and none was processed."""

    def __init__(self, **values: object) -> None:
        config = with_values(FAST_CONFIG, {name.replace('__', '.'): value for name, value in values.items()})
        self.pipeline, self.statistics = Pipeline(config), RunStatistics()
        self.reporter = DiagnosticsReporter('mocap_node', self.pipeline, self.statistics)
        self.values: dict[str, str] = {}  # of the newest report
        self.frames = iter(encode_demo_frames(9))
        self.statistics.record_receipt()

    def feed(self, *messages: bytes) -> None:
        for raw in messages:
            self.pipeline.feed(Source.KEYPOINTS, raw)

    def process(self) -> None:
        process(self.pipeline, next(self.frames))

    def report(self, fault: str = '') -> tuple[int, str]:
        (status,) = decode(self.reporter.encode_status('off', 10**9, fault), DIAGNOSTICS).status
        self.values = {v.key: v.value for v in status.values}
        assert status.name == 'mocap_node'
        return status.level, status.message


def refuse(run: Run) -> None:
    run.feed(next(run.frames)[:50])
    run.pipeline.note_backlog()
    run.process()


def refuse_camera_info(run: Run) -> None:
    run.pipeline.feed(Source.CAMERA_INFO, b'')


def repeat_a_stamp(run: Run) -> None:
    run.statistics.record_receipt()
    run.feed(*[next(run.frames)] * 3)


def refuse_all(run: Run) -> None:
    for _ in range(3):
        run.statistics.record_receipt()
        run.feed(b'')


def see_too_little(run: Run) -> None:
    message = decode(next(run.frames), KEYPOINTS)
    message.people[0].score = np.full_like(message.people[0].score, 0.05)
    run.feed(encode(message, KEYPOINTS))


def warn_of_input(run: Run) -> None:
    run.process()
    run.pipeline.checks.warnings = ('people: most points lie outside the image',)


PROBLEMS = [
    (lambda run: vars(run.statistics).update(removed=7), Level.WARN, '7 removed from a full queue'),
    (refuse, Level.WARN, '1 invalid, 1 skipped because of a backlog in the last second'),
    (lambda run: run.pipeline.counters.dropped.update({'internal error': 2}), Level.ERROR, '2 internal errors'),
    (refuse_camera_info, Level.WARN, '1 invalid in the last second'),
    (repeat_a_stamp, Level.WARN, '2 dropped for their stamps in the last second'),
    (refuse_all, Level.ERROR, 'no message was accepted: 3 invalid in the last second'),
    (see_too_little, Level.WARN, '1 detections were no person in the last second: '),
    (warn_of_input, Level.WARN, 'people: most points lie outside the image'),
]


@pytest.mark.parametrize(('cause', 'level', 'message'), PROBLEMS, ids=lambda p: getattr(p, '__name__', ''))
def test_a_problem_is_reported_in_the_second_in_which_it_occurs(cause: Any, level: Level, message: str) -> None:
    run = Run()
    run.process()
    assert run.report() == GOOD
    cause(run)
    found, text = run.report()
    assert (found, text.startswith(message)) == (level, True), text
    assert run.report() == NO_PEOPLE, 'of an earlier second'
    again = Run()
    cause(again)
    again.reporter = DiagnosticsReporter('mocap_node', again.pipeline, again.statistics)
    assert again.report() == NO_PEOPLE, 'of an earlier run'


def test_no_input_makes_the_status_stale_and_the_time_may_change(monkeypatch: pytest.MonkeyPatch) -> None:
    run = Run(node__silence_warning=60.0)
    assert RunStatistics().seconds_since_input() == np.inf
    monkeypatch.setattr(run.statistics, 'seconds_since_input', lambda: 10.0)
    assert run.report()[0] == Level.OK
    run.pipeline.reconfigure(with_values(run.pipeline.config, {'node.silence_warning': 5.0}))
    assert run.report() == (Level.STALE, 'no input')


def test_the_newest_reason_is_reported_once_and_is_one_short_printable_line() -> None:
    run = Run()
    refuse_camera_info(run)
    run.statistics.reason = '/keypoints: people[0].x:\n\x1b' + ' ' + 'looks normalised ' * 99
    _, message = run.report()
    assert '1 invalid in the last second; /keypoints: people[0].x: \\x1b looks normalised looks' in message
    assert len(message) < 500
    refuse_camera_info(run)
    assert run.report() == (Level.WARN, '1 invalid in the last second')


def test_the_values_are_those_of_the_run() -> None:
    run = Run()
    assert run.report() == NO_PEOPLE
    assert run.values['age of newest frame (s)'] == 'nan'
    process(run.pipeline, with_stamp(next(run.frames), 400_000_000))
    run.statistics.removed += 7
    for milliseconds in range(1, 101):
        run.statistics.record_receipt()
        run.statistics.solve_seconds.append(milliseconds / 1e3)
    run.statistics.lost += 3
    run.report()
    found = {key: float(value) for key, value in run.values.items() if key[-1] == ')'}
    expected = {
        'input rate (Hz)': 50.5,  # 101 messages in the last 2 s
        'solve time p50 (ms)': 50.5,
        'solve time p99 (ms)': 99.0,
        'residual (px)': run.pipeline.people[0].residual,
        'age of newest frame (s)': 0.6,
    }
    assert found == pytest.approx(expected, abs=0.1, nan_ok=True)
    names = 'people', 'category', 'focal length', 'recorder', 'lost before the node', 'dropped: queue full'
    assert [run.values[name] for name in names] == ['1', 'walk', 'nominal', 'off', '3', '7']
    run.pipeline.reset()
    run.report()
    emptied = 'people', 'category', 'residual (px)', 'age of newest frame (s)'
    assert [run.values[key] for key in emptied] == ['0', '', 'nan', 'nan']


def test_the_summary_says_what_is_going_on_now() -> None:
    run = Run()
    run.feed(*islice(run.frames, 8), *[b''] * 40)
    run.report()
    assert run.values['summary'].startswith('doubtful: the last 40 messages were refused; ')
    run.process()
    run.report()
    assert run.values['summary'].startswith('doubtful: 40 of 49 messages were refused; ')


def test_people_in_the_frame_of_the_camera_instead_of_the_output_frame_are_a_warning() -> None:
    run = Run(node__output_frame='map')
    next(run.frames)  # its stamp is 0, as if there was none
    assert run.report() == NO_PEOPLE  # before the first image
    run.process()
    level, message = run.report()
    assert level == Level.WARN
    assert "the frame of the camera, 'camera', as the transform to node.output_frame, 'map', is unknown" in message
    assert run.values['frame of people'] == 'camera'
    run.pipeline.feed(Source.STATIC_TRANSFORMS, make_transforms(('map', 'camera', 0, (1, 0, 0))))
    run.process()
    assert run.report() == GOOD
    assert run.values['frame of people'] == 'map'


@pytest.mark.parametrize(
    ('topic', 'reason', 'count'),
    [
        ('/keypoints', 'people[0].x[3]: {1}', MAX_REASONS + 3),  # 1st to 5th, 10th, 100th, 1000th
        ('/keypoints', "people[0].skeleton: unknown keypoint layout 'x{0}'; known: a", MAX_REASONS + 3),
        ('/humans/bodies/b{1}/skeleton2d', 'the same of every body', 4),
        ('/keypoints', 'a kind of its own: {0}', MAX_KINDS + MAX_REASONS + 2),
    ],
)
def test_the_log_is_not_flooded(topic: str, reason: str, count: int) -> None:
    log = LineLog()
    throttled = ThrottledLog(log)
    for i in range(1000):
        throttled.report(topic.format(chr(500 + i), i), i, reason.format(chr(500 + i), i))
    assert len(log.lines) == count
    throttled.report('/camera_info', 1, 'another topic')
    assert log.lines[-1] == 'error /camera_info: message 1: another topic'
