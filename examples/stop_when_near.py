# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Stop a robot while a person will be nearer than DISTANCE_M within HORIZON_S, by the joints' velocities.

Run mocap_node with -p node.output_frame:=base_link, so that distances are from the robot. It reads `skeletons` and
publishes std_msgs/Bool on `stop`; it also says stop where nothing has been heard for SILENCE_S, and when it ends.
No safety device.
"""

import math
import signal
import threading
import time

DISTANCE_M = 1.0  # from the origin of the robot's frame, on the ground
HORIZON_S = 0.5
SILENCE_S = 0.5


def nearest_distance(skeletons, horizon_s=HORIZON_S):
    """Return the smallest distance in m of any joint of a person from now to the horizon; infinity for none."""
    nearest = math.inf
    for person in skeletons.people:
        if person.tentative:
            continue
        # what is known too little of counts as nearer: two standard deviations along the way to the robot
        x, y = person.root.x, person.root.y
        away = max(math.hypot(x, y), 1e-6)
        c = person.root_covariance
        variance = (c[0] * x * x + 2 * c[1] * x * y + c[4] * y * y) / away**2
        margin = 2 * math.sqrt(variance) if variance >= 0 else 0.0
        for joint, velocity in zip(person.joints, person.joint_velocity, strict=True):
            vx, vy = (0.0 if math.isnan(v) else v for v in (velocity.x, velocity.y))
            # the time at which a joint that goes straight on is nearest
            speed = vx * vx + vy * vy
            t = min(max(-(joint.x * vx + joint.y * vy) / speed, 0.0), horizon_s) if speed > 0 else 0.0
            nearest = min(nearest, math.hypot(joint.x + t * vx, joint.y + t * vy) - margin)
    return nearest


def must_stop(skeletons):
    """Return whether a person is or will be too near, or this is unknown, as people are in the camera's frame."""
    is_placed = skeletons.header.frame_id != skeletons.camera_frame_id
    return not is_placed or nearest_distance(skeletons) < DISTANCE_M


def main():
    """Run the node."""
    import rclpy
    from mocap_ros_msgs.msg import Skeleton3DArray
    from rclpy.signals import SignalHandlerOptions
    from std_msgs.msg import Bool

    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # a message in hand is finished first
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    node = rclpy.create_node('stop_when_near')
    publisher = node.create_publisher(Bool, 'stop', 10)
    heard = [-math.inf]

    def take(skeletons):
        heard[0] = time.monotonic()
        publisher.publish(Bool(data=must_stop(skeletons)))

    def watch():
        if time.monotonic() - heard[0] > SILENCE_S:
            publisher.publish(Bool(data=True))

    node.create_subscription(Skeleton3DArray, 'skeletons', take, 10)
    node.create_timer(SILENCE_S / 5, watch)
    while not ended.is_set():
        rclpy.spin_once(node, timeout_sec=0.1)
    publisher.publish(Bool(data=True))


if __name__ == '__main__':
    try:
        main()
    except ImportError as error:
        raise SystemExit(f"stop_when_near.py: {error}: run it with the node's Python, .venv/bin/python") from None
