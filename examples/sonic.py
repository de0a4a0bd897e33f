# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Stream a person to SONIC, GR00T-WholeBodyControl's `deploy.sh --input-type zmq`: pip install pyzmq.

Joints of SMPL are in the axes of the pelvis, rotations from SMPL's T. z of `node.output_frame` must be up.
"""

import json
import signal
import sys

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

SMPL = [8, 9, 12, 8, 10, 13, 8, 11, 14, 8, 15, 16, 1, 1, 1, 0, 2, 5, 3, 6, 4, 7, 4, 7]  # by `skeleton_definition`
PARENTS = [0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19]  # of joints 1 to 21 of SMPL
PELVIS, SPINE, NECK, COLLARS, SHOULDERS, ARMS = 0, [3, 6, 9], 12, [13, 14], [16, 17], range(16, 22)  # of SMPL


def convert(joints, turns):
    """Return the fields of a frame for joints (J, 3) in m and orientations (J, 4) as x y z w; z is up."""
    points, turned = np.array(joints)[SMPL], Rotation.from_quat(turns)[SMPL]
    points[SPINE] += np.array([[0.2], [0.45], [0.55]]) * (points[NECK] - points[PELVIS])
    points[COLLARS] += 0.3 * (points[SHOULDERS] - points[NECK])
    turned[SPINE] = Slerp([0, 1], turned[[PELVIS, NECK]])([1 / 3, 2 / 3, 1])
    turned[ARMS] = turned[ARMS] * Rotation.from_euler('x', [[-90], [90]] * 3, degrees=True)  # from stretched arms
    fields = {name: np.zeros((1, 29)) for name in ('joint_pos', 'joint_vel')}  # of unknown wrists
    fields['smpl_joints'] = turned[PELVIS].inv().apply(points - points[PELVIS])[None]
    fields['smpl_pose'] = (turned[PARENTS].inv() * turned[1:22]).as_rotvec()[None, :, [1, 2, 0]]
    fields['body_quat'] = np.roll(turned[PELVIS].as_quat(), 1)[None]  # w x y z
    return {name: values.astype('<f4') for name, values in fields.items()}


def pack(fields):
    """Return a message of protocol v3: the topic, a JSON header of 1280 bytes, and the fields of one frame."""
    names = [{'name': n, 'dtype': f'{v.dtype.kind}{8 * v.itemsize}', 'shape': v.shape} for n, v in fields.items()]
    header = json.dumps({'v': 3, 'endian': 'le', 'count': 1, 'fields': names}, separators=(',', ':')).encode()
    return b'pose' + header.ljust(1280, b'\0') + b''.join(v.tobytes() for v in fields.values())


if __name__ == '__main__':
    try:
        import rclpy
        import zmq
        from mocap_ros_msgs.msg import Skeleton3DArray
    except ImportError as error:
        sys.exit(f"sonic.py: {error}: pip install pyzmq for the node's Python, .venv/bin/python")

    def _take(skeletons):
        person = max((p for p in skeletons.people if not p.tentative), key=lambda p: p.age, default=None)
        turns = [(q.x, q.y, q.z, q.w) for q in person.joint_orientation] if person else []
        if skeletons.header.frame_id == skeletons.camera_frame_id:
            node.get_logger().warning('people are in the frame of the camera: set node.output_frame', once=True)
        elif len(turns) > max(SMPL) and np.isfinite(np.array(turns)[SMPL]).all():
            fields = convert([(p.x, p.y, p.z) for p in person.joints], turns)
            socket.send(pack(fields | {'frame_index': np.array([next(frames)], '<i8')}))

    rclpy.init()
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    node, socket, frames = rclpy.create_node('sonic'), zmq.Context().socket(zmq.PUB), iter(range(2**62))
    socket.bind('tcp://127.0.0.1:5556')
    node.create_subscription(Skeleton3DArray, 'skeletons', _take, 1)
    rclpy.spin(node)
