# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The node on a ROS whose markers have other fields: those of ROS 2 Foxy, built as a package of their own."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import yaml
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from mocap_ros.bags.reader import Bag
from mocap_ros.messages.cdr import decode
from mocap_ros.messages.markers import ADD, MARKERS
from mocap_ros.messages.skeletons import SKELETONS
from mocap_ros.skeleton import BODY26
from tests.support import foreign_packages
from tests.support.paths import ROOT
from tests.support.ros_node import TIMEOUT_S, Peer, StartNode, keypoints_at, run_cli, stop_node

pytest.importorskip('rclpy')
pytest.importorskip('mocap_ros_msgs')

pytestmark = [pytest.mark.ros, pytest.mark.slow]

FRAMES = 6
FOXY = get_typestore(Stores.ROS2_FOXY)
LISTENER = ROOT / 'tests' / 'support' / 'marker_listener.py'

Markers = list[tuple[bytes, list[float]]]  # the bytes of a message, and x of its points in m, as rclpy read it


@contextmanager
def listen_to_markers(env: dict[str, str], peer: Peer) -> Iterator[Markers]:
    """Collect the markers that are published in the block while the listener is connected; wait for the last."""
    listener = subprocess.Popen(
        [sys.executable, LISTENER], env=env, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert listener.stdin is not None
    received: Markers = []

    def read_lines() -> None:
        for line in listener.stdout or ():
            raw, *x = line.split()
            received.append((bytes.fromhex(raw), [float(value) for value in x]))

    reader = threading.Thread(target=read_lines)
    reader.start()
    try:
        peer.wait_until(lambda: 'marker_listener' in peer.node.get_node_names())
        yield received
        listener.stdin.close()
        listener.wait(TIMEOUT_S)
    finally:
        listener.kill()
        reader.join()


def select_people(messages: list[bytes]) -> list[bytes]:
    """Return the markers of Foxy that show people, without those that delete all."""
    return [raw for raw in messages if FOXY.deserialize_cdr(raw, MARKERS).markers[0].action == ADD]  # type: ignore[attr-defined]


def test_markers_are_published_recorded_and_played_as_the_installed_version(
    env: dict[str, str], peer: Peer, start_node: StartNode, tmp_path: Path
) -> None:
    foreign_packages.build_foxy_markers()
    env.update(foreign_packages.environment(env, foreign_packages.FOXY_PREFIX), ROS_DISTRO='foxy')
    with listen_to_markers(env, peer) as received:
        node = start_node('recorder.enabled:=true', f'recorder.folder:={tmp_path}/bags')
        peer.wait_until(lambda: peer.received['skeleton_definition'])
        peer.wait_for_keypoints_subscription()
        frame = 0
        while len([x for _, x in received if x]) < FRAMES:  # the listener misses the first ones
            peer.keypoints.publish(keypoints_at(1 + frame / 30))
            frame += 1
            peer.wait_until(lambda count=frame: len(peer.received['skeletons']) == count)  # type: ignore[misc]
        (warning,) = stop_node(node)
    assert f'markers: the installed version of {MARKERS} has no field visualization_msgs/msg/Marker.' in warning

    (folder,) = (tmp_path / 'bags').iterdir()
    with Bag(folder) as bag:
        own = [decode(m.raw, MARKERS) for m in bag.messages(['/markers'])][:frame]  # the last deletes all markers
        skeletons = [decode(m.raw, SKELETONS) for m in bag.messages(['/skeletons'])]
    published = select_people([raw for raw, _ in received])
    seen_x = [x for _, x in received if x]
    seen = len(seen_x)
    assert seen_x == [[p.x for marker in m.markers for p in marker.points] for m in own[-seen:]]
    assert [x[: len(BODY26.joints)] for x in seen_x] == [
        [p.x for p in m.people[0].joints] for m in skeletons[-seen:]
    ]
    with Reader(folder) as reader:
        (connection,) = [c for c in reader.connections if c.topic == '/markers']
        assert connection.digest == FOXY.hash_rihs01(MARKERS)
        recorded = [bytes(raw) for _, _, raw in reader.messages([connection])]
    assert select_people(recorded)[-seen:] == published
    metadata = yaml.safe_load((folder / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
    assert metadata['ros_distro'] == 'foxy'

    with listen_to_markers(env, peer) as received:
        # Slowly: on a busy machine the player and the listener may need seconds to discover each other.
        done = run_cli(env, 'play', folder, '--all', '--rate', 0.05)
        assert done.returncode == 0, done.stderr
    played = [raw for raw, _ in received]
    assert played
    assert played == recorded[-len(played) :]
