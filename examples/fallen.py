# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Say who has fallen: who lies for 2 s and stood before. Publishes std_msgs/Bool on `fallen`; no safety device."""

from contextlib import suppress

LYING_S = 2.0


class Falls:
    """Who stood, and who lies since when, over successive Skeleton3DArray messages."""

    def __init__(self):
        self.stood = set()  # ids
        self.lying_since = {}  # s, by id

    def update(self, skeletons):
        """Return whether anybody has fallen. A posture that is not known changes nothing."""
        now_s = skeletons.header.stamp.sec + 1e-9 * skeletons.header.stamp.nanosec
        for person in skeletons.people:
            if person.posture == person.LYING:
                if person.id in self.stood:
                    self.lying_since.setdefault(person.id, now_s)
            elif person.posture != person.POSTURE_UNKNOWN:
                self.lying_since.pop(person.id, None)
                if person.posture == person.STANDING:
                    self.stood.add(person.id)
        return any(now_s - since_s >= LYING_S for since_s in self.lying_since.values())


def main():
    """Run the node."""
    import rclpy
    from mocap_ros_msgs.msg import Skeleton3DArray
    from rclpy.executors import ExternalShutdownException
    from std_msgs.msg import Bool

    rclpy.init()
    node, falls = rclpy.create_node('fallen'), Falls()
    publisher = node.create_publisher(Bool, 'fallen', 10)
    node.create_subscription(
        Skeleton3DArray, 'skeletons', lambda message: publisher.publish(Bool(data=falls.update(message))), 10
    )
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


if __name__ == '__main__':
    main()
