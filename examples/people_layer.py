# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""People for Nav2's own obstacle layer, which needs no plugin: discs of points where people are and will be.

Run mocap_node with -p node.output_frame:=map (or odom). It reads `skeletons` and publishes sensor_msgs/PointCloud2
on `people_points`; name that topic in observation_sources of the obstacle layer (data_type: PointCloud2).
"""

import math
import signal
import struct
import threading

RADIUS_M = 0.35  # of a person who stands
AHEAD_S = (0.0, 0.25, 0.5, 0.75, 1.0)  # times at which a person leaves a disc
POINTS_PER_DISC = 16
HEIGHT_M = 0.5  # above the ground of the frame; inside min_obstacle_height and max_obstacle_height


def list_points(skeletons):
    """Return the points (x, y, z) in m of all people but tentative ones; none in the camera's frame."""
    points = []
    if skeletons.header.frame_id == skeletons.camera_frame_id:
        return points
    for person in skeletons.people:
        if person.tentative:
            continue
        vx, vy = (0.0 if math.isnan(v) else v for v in (person.root_velocity.x, person.root_velocity.y))
        for t in AHEAD_S:
            for n in range(POINTS_PER_DISC):
                angle = 2 * math.pi * n / POINTS_PER_DISC
                x = person.root.x + t * vx + RADIUS_M * math.cos(angle)
                y = person.root.y + t * vy + RADIUS_M * math.sin(angle)
                points.append((x, y, HEIGHT_M))
    return points


def main():
    """Run the node."""
    import rclpy
    from mocap_ros_msgs.msg import Skeleton3DArray
    from rclpy.signals import SignalHandlerOptions
    from sensor_msgs.msg import PointCloud2, PointField

    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # a message in hand is finished first
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    node = rclpy.create_node('people_layer')
    publisher = node.create_publisher(PointCloud2, 'people_points', 10)

    def take(skeletons):
        points = list_points(skeletons)
        cloud = PointCloud2(header=skeletons.header, height=1, width=len(points), point_step=12, is_dense=True)
        cloud.row_step = 12 * len(points)
        cloud.fields = [
            PointField(name=name, offset=4 * i, datatype=PointField.FLOAT32, count=1)
            for i, name in enumerate('xyz')
        ]
        cloud.data = b''.join(struct.pack('<fff', *p) for p in points)
        publisher.publish(cloud)

    node.create_subscription(Skeleton3DArray, 'skeletons', take, 10)
    while not ended.is_set():
        rclpy.spin_once(node, timeout_sec=0.1)


if __name__ == '__main__':
    try:
        main()
    except ImportError as error:
        raise SystemExit(f"people_layer.py: {error}: run it with the node's Python, .venv/bin/python") from None
