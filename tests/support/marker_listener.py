"""Listens to markers with the installed version of their type; run as a program, for tests only.

Prints a line for each message: its bytes in hexadecimal digits, and x of every point in it. Ends when its standard
input is closed and no more messages arrive.
"""

import sys
import threading
import time

import rclpy
from rclpy.serialization import deserialize_message
from visualization_msgs.msg import MarkerArray

QUIET_S = 0.5  # s; messages that were sent before the input was closed arrive sooner
arrivals_s = [0.0]  # steady clock


def report(raw: bytes) -> None:
    arrivals_s.append(time.monotonic())
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
while not stop.is_set() or time.monotonic() - arrivals_s[-1] < QUIET_S:
    rclpy.spin_once(node, timeout_sec=0.05)
