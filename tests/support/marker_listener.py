# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Listens to markers with the installed version of their type; run as a program, for tests only.

Prints a line for each message: its bytes in hexadecimal digits, and x of every point in it. Ends when its standard
input is closed and no more messages wait.
"""

import sys
import threading
import time

import rclpy
from rclpy.serialization import deserialize_message
from visualization_msgs.msg import MarkerArray

QUIET_S = 2.0  # s; messages that were sent before the input was closed arrive sooner
received: list[bytes] = []


def report(raw: bytes) -> None:
    received.append(raw)
    message = deserialize_message(raw, MarkerArray)
    print(raw.hex(), *(point.x for marker in message.markers for point in marker.points), flush=True)


def stop_at_end_of_input() -> None:
    sys.stdin.read()
    stop.set()


rclpy.init()
node = rclpy.create_node('marker_listener')
node.create_subscription(MarkerArray, 'markers', report, 1000, raw=True)
stop = threading.Event()
threading.Thread(target=stop_at_end_of_input, daemon=True).start()
last = time.monotonic()
while not stop.is_set() or time.monotonic() - last < QUIET_S:
    count = len(received)
    rclpy.spin_once(node, timeout_sec=0.05)
    if not stop.is_set() or len(received) > count:
        last = time.monotonic()
