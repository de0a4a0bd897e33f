# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Bags that the node records: what is in them, how recordings start and end, and their replay."""

import re
import shutil
import signal
import sys
import time
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from mocap_ros.bags.journal import INPUT, Verdict, decode_entry
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.cli.main import main
from mocap_ros.config import RecorderConfig
from mocap_ros.demo.scene import make_recording
from mocap_ros.messages.cdr import decode
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.messages.skeletons import SKELETON_DEFINITION
from mocap_ros.runtime.outputs import OUTPUTS
from mocap_ros.runtime.playback import encode_sequence
from tests.support.pipeline_inputs import read_messages
from tests.support.ros_node import TIMEOUT_S, Peer, StartNode, StartProgram, keypoints_at, stack_joints, stop_node

pytestmark = pytest.mark.ros

FRAMES = 40


def test_a_live_run_is_received_recorded_and_replayed(
    start: StartProgram, peer: Peer, start_node: StartNode, tmp_path: Path
) -> None:
    sequence = make_recording().sequence()
    frames = list(islice(encode_sequence(sequence), FRAMES))
    with Recorder(tmp_path / 'played', RecorderConfig()) as recorder:
        for frame in frames:
            recorder.write('/detections', KEYPOINTS, frame.raw, frame.stamp_ns, frame.stamp_ns)

    # The machine may be busy, so that many messages wait.
    patient = ('node.queue:=100', 'qos_overrides./keypoints.subscription.depth:=100')
    node = start_node('recorder.enabled:=true', f'recorder.folder:={tmp_path}/bags', *patient)
    peer.wait_for_node()
    started, started_ns = time.monotonic(), time.time_ns()
    player = start(sys.executable, '-m', 'mocap_ros.cli.main', 'play', tmp_path / 'played')
    peer.wait_until(lambda: all(len(peer.received[t]) >= FRAMES for t in OUTPUTS))
    assert time.monotonic() - started > (FRAMES - 1) / 30
    out, _ = player.communicate(timeout=TIMEOUT_S)
    assert out.splitlines()[-1] == f'{tmp_path}/played: {FRAMES} messages published on keypoints'
    assert stop_node(node) == []
    peer.wait_until(peer.are_markers_deleted)
    for topic in OUTPUTS:
        assert peer.received_stamps(topic) == sequence.stamps_ns[:FRAMES]
    (definition,) = peer.received['skeleton_definition']
    assert decode(definition, SKELETON_DEFINITION).name == 'body26'

    (bag_folder,) = (tmp_path / 'bags').iterdir()
    with Bag(bag_folder) as bag:
        recorded = {t: [m.raw for m in bag.messages(['/' + t])] for t in (*peer.received, 'keypoints')}
        times = [m.time_ns for m in bag.messages(bag.topics)]
    assert recorded.pop('keypoints') == [frame.raw for frame in frames]
    markers = peer.received['markers']
    del markers[: len(markers) - FRAMES - 1]  # the recording starts after all markers were deleted
    assert recorded == peer.received
    assert times == sorted(times)
    assert started_ns < times[-1] < time.time_ns()
    assert main(['replay', str(bag_folder), '-o', str(tmp_path / 'again')]) == 0
    replayed = read_messages(tmp_path / 'again', '/skeletons')
    assert len(replayed) == FRAMES
    np.testing.assert_allclose(stack_joints(replayed), stack_joints(recorded['skeletons']), atol=1e-9, rtol=0)


def test_a_recording_switched_by_parameter_ends_when_its_folder_is_removed(
    peer: Peer, start_node: StartNode, tmp_path: Path
) -> None:
    node = start_node(f'recorder.folder:={tmp_path}/bags')
    peer.wait_for_node()
    peer.wait_for_keypoints_subscription()
    assert peer.set_parameter('recorder.enabled', True).successful
    peer.keypoints.publish(keypoints_at(1))
    peer.wait_for_frames(1)
    assert peer.set_parameter('recorder.enabled', False).successful
    (first,) = (tmp_path / 'bags').iterdir()
    with Bag(first) as bag:
        assert bag.count(['/keypoints']) == 1
        assert [q.history.name for q in bag.qos['/keypoints']] == ['UNKNOWN']  # discovery does not give it

    assert not peer.record(False).success
    assert peer.set_parameter('recorder.enabled', True).successful
    peer.wait_until(lambda: len(list((tmp_path / 'bags').glob('*/*.mcap'))) == 2)
    (second,) = set((tmp_path / 'bags').glob('*/*.mcap')) - set(first.iterdir())
    peer.wait_for_diagnostics('recorder', f'recording to {second.parent}')
    shutil.rmtree(second.parent)
    reason = f'{second}: the file was removed or moved while it was written'
    peer.wait_for_diagnostics('recorder', f'not recording: {reason}')
    assert not peer.record(False).success
    peer.wait_for_diagnostics('recorder', 'off')
    peer.keypoints.publish(keypoints_at(2))
    peer.wait_for_frames(2)
    (line,) = stop_node(node)
    assert re.search(r'removed or moved while it was written; the recording has ended, and the node', line)


def test_a_bag_is_complete_when_the_node_is_interrupted_among_images(
    peer: Peer, start_node: StartNode, tmp_path: Path
) -> None:
    node = start_node('recorder.enabled:=true', f'recorder.folder:={tmp_path}/bags')
    peer.wait_for_node()
    peer.wait_for_keypoints_subscription()
    for frame in range(60):
        peer.keypoints.publish(keypoints_at(frame / 30))
        time.sleep(0.01)
        if frame == 50:
            node.send_signal(signal.SIGINT)
    assert node.wait(TIMEOUT_S) == 0
    peer.wait_for_end()
    skeletons, markers = peer.received['skeletons'], peer.received['markers']
    (bag_folder,) = (tmp_path / 'bags').iterdir()
    with Bag(bag_folder) as bag:
        assert [m.raw for m in bag.messages(['/skeletons'])] == skeletons
        later_markers = markers[-len(skeletons) - 1 :]  # the recording starts after a first deletion
        assert [m.raw for m in bag.messages(['/markers'])] == later_markers
        entries = [decode_entry(m.raw) for m in bag.messages(['/mocap_node/journal'])]
        verdicts = [entry.verdict for entry in entries if entry.kind == INPUT]
        assert len(verdicts) == bag.count(['/keypoints']) <= 60
    assert len(skeletons) == verdicts.count(Verdict.ACCEPTED)
    assert {*verdicts} <= {Verdict.ACCEPTED, Verdict.BACKLOG}
