# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Messages of skeletons of several cameras: which leads, what is refused, and a recorded run that is repeated."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.cli.main import main
from mocap_ros.config import RecorderConfig
from mocap_ros.errors import ConfigError, FrameDropped, InputError
from mocap_ros.messages.cdr import Header, decode
from mocap_ros.messages.skeletons import ReceivedSkeletons, decode_skeletons, encode_skeletons
from mocap_ros.messages.transforms import TRANSFORMS
from mocap_ros.people import People
from mocap_ros.recordings.load_results import load_recording, load_result
from mocap_ros.runtime.outputs import LATCHED_OUTPUTS, OUTPUTS
from mocap_ros.runtime.skeleton_merging import MergedRun, SkeletonMerger
from mocap_ros.skeleton import find_roots
from tests.support.several_cameras import CENTRES, FPS, make_truth, place_camera, see

TOPICS = ('/left/skeletons', '/right/skeletons')
STEP_NS = round(1e9 / FPS)
FRAMES = 60


def encode(people: People, stamp_ns: int, camera: int, frame_id: str = 'map', **changes: Any) -> bytes:
    return encode_skeletons(
        Header(stamp_ns, frame_id), replace(people, **changes), None, place_camera(CENTRES[camera])
    )


def list_messages(late_ns: int = 0) -> Iterator[tuple[str, bytes]]:
    """Yield the messages of two cameras in turn; the second sees at other times."""
    rng = np.random.default_rng(0)
    cameras = [see(make_truth(FRAMES), centre, 1.03, rng, 'abc') for centre in CENTRES[:2]]
    for frame in range(FRAMES):
        for camera, topic in enumerate(TOPICS):
            yield topic, encode(cameras[camera][frame], 10**9 + frame * STEP_NS + camera * late_ns, camera)


def read(outputs: Any) -> list[ReceivedSkeletons]:
    return [decode_skeletons(o.data, is_in_camera=False) for o in outputs if o.topic == 'skeletons']


def test_the_first_camera_leads_and_the_second_takes_over_when_it_is_silent() -> None:
    merger, received = SkeletonMerger(TOPICS, 0.15), list[ReceivedSkeletons]()
    for number, (topic, raw) in enumerate(list_messages(late_ns=7_000_000)):
        if topic != TOPICS[0] or not 40 <= number < 80:  # the first is silent for 0.7 s
            received += read(merger.feed(topic, raw))
    stamps = np.array([message.header.stamp_ns for message in received]) - 10**9
    is_first = stamps % STEP_NS == 0
    assert (np.diff(stamps) > 0).all()
    assert is_first[:20].all()
    assert not is_first[20:-20].any()
    assert is_first[-20:].all()
    assert {message.people.ids for message in received} == {('1',)}
    roots = np.array([message.people.roots[0] for message in received])
    off = np.linalg.norm(roots - find_roots(make_truth(FRAMES))[np.round(stamps / STEP_NS).astype(int)], axis=1)
    assert off[5:].max() < 0.15
    cameras = {message.camera.frame_id for message in received}
    assert cameras == {place_camera(centre).frame_id for centre in CENTRES[:2]}


@pytest.mark.parametrize(
    ('changes', 'error', 'place'),
    [
        ({'frame_id': place_camera(CENTRES[0]).frame_id}, InputError, 'header.frame_id'),
        ({'frame_id': 'odom'}, InputError, 'header.frame_id'),
        ({'joints': np.full((1, 15, 3), np.nan)}, InputError, 'people: joints'),
        ({'joint_std': np.zeros((1, 15))}, InputError, 'people: joints, joint_std'),
        ({'root_covariance': np.zeros((1, 3, 3))}, InputError, 'people: joints, joint_std'),
        ({'stamp_ns': 10**9}, FrameDropped, 'stamp'),
    ],
)
def test_what_cannot_be_merged_is_refused_and_the_rest_goes_on(
    changes: dict[str, Any], error: type[Exception], place: str
) -> None:
    merger = SkeletonMerger(TOPICS, 0.15)
    (person,) = see(make_truth(1), CENTRES[0], 1.0, np.random.default_rng(0))
    assert read(merger.feed(TOPICS[0], encode(person, 10**9, 0)))
    merger.feed(TOPICS[1], encode(person, 10**9, 1))
    given = {'stamp_ns': 2 * 10**9, 'camera': 0, **changes}
    with pytest.raises(error, match=f'^{place}'):
        merger.feed(TOPICS[0], encode(person, **given))
    assert read(merger.feed(TOPICS[0], encode(person, 3 * 10**9, 0)))
    assert read(merger.feed(TOPICS[0], encode(person, 10**9, 0)))  # the clock was set


def test_a_recorded_run_is_repeated_byte_by_byte(tmp_path: Path) -> None:
    run = MergedRun({'inputs': ' '.join(TOPICS), 'tolerance': 0.15, 'publish_tf': True, 'prefix': '/robot/'})
    with Recorder(tmp_path / 'run', RecorderConfig(min_free_mb=0)) as recorder:
        records = run.start(1)
        for time_ns, (topic, raw) in enumerate([*list_messages(), (TOPICS[0], b'no message')], 2):
            records += run.feed(topic, raw, (time_ns, time_ns)).records
        recorder.write_all(records)
    assert main(['replay', str(tmp_path / 'run'), '-o', str(tmp_path / 'again')]) == 0
    bags = []
    for name in ('run', 'again'):
        with Bag(tmp_path / name) as bag:
            bags.append([(message.topic, message.raw) for message in bag.messages(bag.topics)])
    assert bags[0] == bags[1]
    outputs = {f'/robot/{name}' for name in (*OUTPUTS, *LATCHED_OUTPUTS)}
    assert {*outputs, '/tf'} <= dict(bags[0]).keys()
    placed = [decode(raw, TRANSFORMS).transforms for topic, raw in bags[0] if topic == '/tf']
    assert {'body_p1'} <= {transform.child_frame_id for transform in placed[-1]}
    (merged,) = load_recording(tmp_path / 'again').people
    assert merged.id == load_result(tmp_path / 'again').id == '1'
    assert merged.is_scale_known


@pytest.mark.parametrize('inputs', ['', '/a', '/a /a', '/a /skeletons'])
def test_two_topics_are_needed(inputs: str) -> None:
    with pytest.raises(ConfigError, match=r'^inputs'):
        MergedRun({'inputs': inputs, 'tolerance': 0.1, 'publish_tf': False, 'prefix': '/'})


def test_people_are_carried_to_the_stamp_of_the_leader_within_the_tolerance() -> None:
    """A person walks at 1 m/s; the node of one camera is slower than the other's."""
    rng, merger, far = np.random.default_rng(0), SkeletonMerger(TOPICS, 0.15), SkeletonMerger(TOPICS, 0.01)
    truth = make_truth(1) + 0.02 * np.arange(50)[:, None, None] * [1, 0, 0]
    cameras = [see(truth, centre, 1.0, rng) for centre in CENTRES[:2]]
    velocity = np.tile([0.6, 0, 0], (1, 15, 1))
    seconds = []
    for frame in range(50):
        stamp_ns = 10**9 + frame * STEP_NS
        for camera, at in ((1, stamp_ns + 20_000_000), (0, stamp_ns - 6 * STEP_NS)):
            index = frame if camera else frame - 6
            if index >= 0:
                raw = encode(cameras[camera][index], at, camera, joint_velocity=velocity)
                seconds += read(merger.feed(TOPICS[camera], raw))
                late = read(far.feed(TOPICS[camera], raw))
    assert merger.find_late_topics() == []
    assert far.find_late_topics() == [TOPICS[1]]
    roots = np.array([message.people.roots[0] for message in seconds])[10:]
    expected = find_roots(truth)[10 : 10 + len(roots)]
    assert np.linalg.norm(roots - expected, axis=1).mean() < 0.06
    assert late[0].people.root_covariance[0].trace() > 4 * seconds[-1].people.root_covariance[0].trace()
