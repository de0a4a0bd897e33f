# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Stream a person to SONIC, GR00T-WholeBodyControl's `deploy.sh --input-type zmq`: pip install pyzmq.

A message is the topic, a JSON header of 1280 bytes and the fields of protocol v3, of one frame: joints of SMPL in
the axes of the pelvis, their rotations from SMPL's T, and no place. z of `node.output_frame` must be up.
"""

import json
from contextlib import suppress

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

ARMS = ['lshoulder', 'lelbow', 'lwrist', 'rshoulder', 'relbow', 'rwrist']
JOINTS = ['head', 'neck', *ARMS, 'pelvis', 'lhip', 'lknee', 'lankle', 'rhip', 'rknee', 'rankle', 'ltoe', 'rtoe']
SMPL_LEGS = ['lhip', 'rhip', 'spine', 'lknee', 'rknee', 'spine', 'lankle', 'rankle', 'spine', 'ltoe', 'rtoe']
SMPL_ARMS = ['lshoulder', 'rshoulder', 'lelbow', 'relbow', 'lwrist', 'rwrist', 'lwrist', 'rwrist']
# Joints of the skeleton for those of SMPL
SMPL = ['pelvis', *SMPL_LEGS, 'neck', 'neck', 'neck', 'head', *SMPL_ARMS]
PARENTS = [0, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19]
SPINE = [3, 6, 9]  # of SMPL; they share the turn of the torso against the pelvis
REST = {
    'l': Rotation.from_euler('x', -90, degrees=True),
    'r': Rotation.from_euler('x', 90, degrees=True),
}  # of arms


def convert(joints, turns):
    """Return the fields of a frame for joints (J, 3) in m and orientations (J, 4) as x y z w; z is up."""
    points, turned = (
        np.asarray(joints)[[JOINTS.index(n) if n != 'spine' else 8 for n in SMPL]],
        Rotation.from_quat(turns),
    )
    pelvis, neck = points[0], points[12]
    points[SPINE] = pelvis + np.array([[0.2], [0.45], [0.55]]) * (neck - pelvis)
    points[13:15] += 0.3 * (points[16:18] - neck)
    trunk = Slerp([0, 1], turned[[JOINTS.index('pelvis'), JOINTS.index('neck')]])([1 / 3, 2 / 3, 1])
    rotations = [
        turned[JOINTS.index(n)] if n != 'spine' else trunk[SPINE.index(j)] for j, n in enumerate(SMPL[:22])
    ]
    for j in range(16, 22):
        rotations[j] *= REST[SMPL[j][0]]
    pose = [(rotations[PARENTS[j]].inv() * rotations[j]).as_rotvec()[[1, 2, 0]] for j in range(1, 22)]
    return {
        'joint_pos': np.zeros((1, 29), '<f4'),  # of the wrists alone, which are not known
        'joint_vel': np.zeros((1, 29), '<f4'),
        'smpl_joints': rotations[0].inv().apply(points - pelvis)[None].astype('<f4'),
        'smpl_pose': np.array(pose, '<f4')[None],
        'body_quat': np.roll(rotations[0].as_quat(), 1)[None].astype('<f4'),
    }


def pack(fields):
    """Return the message of some fields."""
    kinds = {'<f4': 'f32', '<i8': 'i64'}
    names = [{'name': n, 'dtype': kinds[v.dtype.str], 'shape': list(v.shape)} for n, v in fields.items()]
    header = json.dumps({'v': 3, 'endian': 'le', 'count': 1, 'fields': names}, separators=(',', ':')).encode()
    return b'pose' + header.ljust(1280, b'\0') + b''.join(v.tobytes() for v in fields.values())


def main():
    """Run the node, for the person who was there first."""
    import rclpy
    import zmq
    from mocap_ros_msgs.msg import Skeleton3DArray
    from rclpy.signals import SignalHandlerOptions

    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # KeyboardInterrupt ends the loop
    node, socket, frames = rclpy.create_node('sonic'), zmq.Context().socket(zmq.PUB), iter(range(2**62))
    socket.bind('tcp://127.0.0.1:5556')

    def take(skeletons):
        person = max((p for p in skeletons.people if not p.tentative), key=lambda p: p.age, default=None)
        if skeletons.header.frame_id == skeletons.camera_frame_id:
            node.get_logger().warning('people are in the frame of the camera: set node.output_frame', once=True)
        elif person:
            fields = convert(
                [(p.x, p.y, p.z) for p in person.joints], [(q.x, q.y, q.z, q.w) for q in person.joint_orientation]
            )
            socket.send(pack(fields | {'frame_index': np.array([next(frames)], '<i8')}))

    node.create_subscription(Skeleton3DArray, 'skeletons', take, 1)
    with suppress(KeyboardInterrupt):
        while True:
            rclpy.spin_once(node, timeout_sec=0.1)


if __name__ == '__main__':
    main()
