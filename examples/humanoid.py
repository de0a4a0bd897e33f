# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Drive a humanoid by a person, live or from a result, by inverse kinematics: pip install mink daqp.

ROBOT.xml, an MJCF whose zero pose has hanging upper arms and elbows at 90 degrees, follows `skeletons` (z up) on
`joint_states` and `pelvis_pose`, or RESULT.npz in Unitree's MOTION.csv: x y z in m, qx qy qz qw, angles in rad.
"""

import signal
import sys

import numpy as np

try:
    import daqp  # noqa: F401, the solver of mink.solve_ik
    import mink
    import mujoco
except ImportError as error:
    sys.exit(f'humanoid.py: {error}: pip install mink daqp')

ARMS = ['lshoulder', 'lelbow', 'lwrist', 'rshoulder', 'relbow', 'rwrist']  # skeleton_definition's first joints
JOINTS = ['head', 'neck', *ARMS, 'pelvis', 'lhip', 'lknee', 'lankle', 'rhip', 'rknee', 'rankle']
LINKS = [('pelvis', 'pelvis', 2.0), ('neck', 'torso_link', 1.0)]  # segment, by its first joint; link; weight
PARTS = {'hip': 'hip_yaw', 'shoulder': 'shoulder_yaw', 'knee': 'knee', 'elbow': 'elbow', 'ankle': 'ankle_roll'}
LINKS += [(s[0] + j, f'{s}_{k}_link', 1 - (j == 'ankle') / 2) for s in ('left', 'right') for j, k in PARTS.items()]
BENT = mink.SO3(np.array([2**-0.5, 0, 2**-0.5, 0]))  # from the axes of a hanging forearm to those at 90 degrees


class Humanoid:
    """The robot in the pose of a person."""

    def __init__(self, path):
        self.robot, self.targets = mink.Configuration(mujoco.MjModel.from_xml_path(path)), {}
        self.joint_names = [self.robot.model.joint(j).name for j in range(1, self.robot.model.njnt)]
        at = {s: self.robot.get_transform_frame_to_world(link, 'body').translation() for s, link, _ in LINKS}
        self.leg = np.linalg.norm(at['lknee'] - at['lhip']) + np.linalg.norm(at['lankle'] - at['lknee'])
        self.hips = (at['lhip'] + at['rhip']) / 2 - at['pelvis']
        for segment, link, weight in LINKS:
            rest = self.robot.get_transform_frame_to_world(link, 'body').rotation()
            task = mink.FrameTask(link, 'body', 5.0 * (link == 'pelvis'), weight, lm_damping=0.1)
            self.targets[task] = JOINTS.index(segment), BENT @ rest if 'elbow' in segment else rest

    def follow(self, joints, turns, world):
        """Return a row of the CSV for joints (J, 3), orientations (J, 4) and a transform to a frame with z up."""
        lhip, *_, rhip = leg = [world.apply(joints[i]) for i in (9, 10, 11, 12)]
        hips = self.leg / np.linalg.norm(np.diff(leg[:3], axis=0), axis=1).sum() * (lhip + rhip) / 2
        for task, (index, rest) in self.targets.items():
            turn = world.rotation() @ mink.SO3(np.roll(turns[index], 1)) @ rest
            task.set_target(mink.SE3.from_rotation_and_translation(turn, hips - turn.apply(self.hips)))
        for _ in range(3):  # steps from the pose of the frame before
            self.robot.integrate_inplace(mink.solve_ik(self.robot, self.targets, 1.0, 'daqp', damping=1e-3), 1.0)
        q = self.robot.q
        if max(np.linalg.norm(task.compute_error(self.robot)[3:]) for task in self.targets) > 0.6:  # rad
            self.robot.update(np.r_[q[:7], 0 * q[7:]])  # begins at rest again, for its limits may have caught it
        return np.r_[q[[0, 1, 2, 4, 5, 6, 3]], q[7:]]


def convert(robot, result, fps=30.0, gap_s=0.5):
    """Return the rows of the CSV for the arrays of a result of one person; in longer gaps the robot stays."""
    world, seen = mink.SE3.from_matrix(result['world_from_camera']), np.isfinite(result['orientation']).all((1, 2))
    joints, turns, stamps = (result[name][seen] for name in ('joints3d', 'orientation', 'timestamps'))
    rows = np.array([robot.follow(*frame, world) for frame in zip(joints, turns, strict=True)])
    ends = np.flatnonzero(np.diff(stamps) > gap_s) + 1  # of gaps; the pose before stays until there
    stamps, rows = np.insert(stamps, ends, stamps[ends] - 1e-6), np.insert(rows, ends, rows[ends - 1], axis=0)
    times = stamps[0] + np.arange(round((stamps[-1] - stamps[0]) * fps) + 1) / fps
    rows = np.stack([np.interp(times, stamps, column) for column in rows.T], axis=1)
    rows[:, 3:7] /= np.linalg.norm(rows[:, 3:7], axis=1, keepdims=True)
    return rows


def run(robot):
    """Run the node, for the person who was there first."""
    try:
        import rclpy
        from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
        from mocap_ros_msgs.msg import Skeleton3DArray
        from sensor_msgs.msg import JointState
    except ImportError as error:
        sys.exit(f"humanoid.py: {error}: run it with the node's Python, .venv/bin/python")

    def take(skeletons):
        person = max((p for p in skeletons.people if not p.tentative), key=lambda p: p.age, default=None)
        if skeletons.header.frame_id == skeletons.camera_frame_id:
            node.get_logger().warning('people are in the frame of the camera: set node.output_frame', once=True)
        elif person:
            turns = [(q.x, q.y, q.z, q.w) for q in person.joint_orientation]
            row = robot.follow(np.array([(p.x, p.y, p.z) for p in person.joints]), turns, mink.SE3.identity())
            x, y, z, qx, qy, qz, qw, *angles = map(float, row)
            states.publish(JointState(header=skeletons.header, name=robot.joint_names, position=angles))
            pose = Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))
            poses.publish(PoseStamped(header=skeletons.header, pose=pose))

    rclpy.init()
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    node = rclpy.create_node('humanoid')
    states = node.create_publisher(JointState, 'joint_states', 10)
    poses = node.create_publisher(PoseStamped, 'pelvis_pose', 10)
    node.create_subscription(Skeleton3DArray, 'skeletons', take, 1)
    rclpy.spin(node)


if __name__ == '__main__':
    args = sys.argv[1 : sys.argv.index('--ros-args') if '--ros-args' in sys.argv else None]
    if len(args) not in (1, 3) or args[0].startswith('-'):
        sys.exit('usage: humanoid.py ROBOT.xml [RESULT.npz MOTION.csv]')
    humanoid = Humanoid(args[0])
    np.savetxt(args[2], convert(humanoid, np.load(args[1])), '%.6f', ',') if args[1:] else run(humanoid)
