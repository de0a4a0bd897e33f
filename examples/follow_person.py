# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Follow the person who was there first at DISTANCE_M: geometry_msgs/Twist on `cmd_vel`.

Run mocap_node with -p node.output_frame:=base_link (x ahead, y to the left). Without the person the robot stands,
and so it does where people are in the camera's frame, nothing has been heard for LOST_S, or the example ends. No
safety device.
"""

import math
import signal
import threading
import time

DISTANCE_M = 1.5
GAIN_PER_S = 0.8  # 1/s, of the distance and of the direction
MAX_SPEED_M_S = 0.6
MAX_TURN_RAD_S = 1.0
LOST_S = 0.3  # s; a person who was not seen for longer is not followed


def choose_person(skeletons, followed=''):
    """Return the person with this id, or else the one who was first seen longest ago; None where there is none.

    People in the camera's frame, which the node publishes where it knows no transform, are not followed.
    """
    if skeletons.header.frame_id == skeletons.camera_frame_id:
        return None
    people = [p for p in skeletons.people if not p.tentative and p.unseen_for <= LOST_S]
    same = [p for p in people if p.id == followed]
    return same[0] if same else max(people, key=lambda p: p.age, default=None)


def choose_command(person):
    """Return speed in m/s and turn in rad/s towards the place at the distance from the person."""
    if person is None:
        return 0.0, 0.0
    x, y = person.root.x, person.root.y
    direction, distance = math.atan2(y, x), math.hypot(x, y)
    away = 0.0 if math.isnan(person.root_velocity.x) else person.root_velocity.x  # goes with the person
    speed = (GAIN_PER_S * (distance - DISTANCE_M) + away) * max(math.cos(direction), 0.0)
    turn = GAIN_PER_S * direction
    return min(max(speed, 0.0), MAX_SPEED_M_S), min(max(turn, -MAX_TURN_RAD_S), MAX_TURN_RAD_S)


def main():
    """Run the node."""
    import rclpy
    from geometry_msgs.msg import Twist
    from mocap_ros_msgs.msg import Skeleton3DArray
    from rclpy.signals import SignalHandlerOptions

    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # a message in hand is finished first
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    node = rclpy.create_node('follow_person')
    publisher = node.create_publisher(Twist, 'cmd_vel', 10)
    followed, heard = [''], [-math.inf]

    def take(skeletons):
        heard[0] = time.monotonic()
        person = choose_person(skeletons, followed[0])
        followed[0] = person.id if person else ''
        command = Twist()
        command.linear.x, command.angular.z = choose_command(person)
        publisher.publish(command)

    def watch():
        if time.monotonic() - heard[0] > LOST_S:
            publisher.publish(Twist())

    node.create_subscription(Skeleton3DArray, 'skeletons', take, 10)
    node.create_timer(LOST_S / 3, watch)
    while not ended.is_set():
        rclpy.spin_once(node, timeout_sec=0.1)
    publisher.publish(Twist())


if __name__ == '__main__':
    try:
        main()
    except ImportError as error:
        raise SystemExit(f"follow_person.py: {error}: run it with the node's Python, .venv/bin/python") from None
