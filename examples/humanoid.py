# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Drive a humanoid by a person, live or from a result, by inverse kinematics: pip install mink daqp.

`humanoid.py ROBOT.xml` turns `skeletons` into sensor_msgs/JointState on `joint_states` and the pelvis' pose on
`pelvis_pose`; z of `node.output_frame` must be up. `humanoid.py ROBOT.xml RESULT.npz MOTION.csv` writes the CSV of
Unitree: x y z in m, qx qy qz qw, joint angles in rad, 30 frames/s. ROBOT.xml is an MJCF with a free pelvis, as
g1_29dof.xml; in its zero pose the robot stands with hanging upper arms and elbows at 90 degrees.
"""

import signal
import sys

import mink
import mujoco
import numpy as np

# The first joints of skeleton_definition. A segment has the name of the joint about which it turns.
ARMS = ['lshoulder', 'lelbow', 'lwrist', 'rshoulder', 'relbow', 'rwrist']
JOINTS = ['head', 'neck', *ARMS, 'pelvis', 'lhip', 'lknee', 'lankle', 'rhip', 'rknee', 'rankle']
LEG = ['left_hip_yaw_link', 'left_knee_link', 'left_ankle_roll_link', 'right_hip_yaw_link']
LINKS = [('pelvis', 'pelvis', 2.0), ('neck', 'torso_link', 1.0)]  # segment, link of the robot, weight
for side in ('left', 'right'):
    LINKS += [(side[0] + joint, f'{side}_{joint}_yaw_link', 1.0) for joint in ('hip', 'shoulder')]
    LINKS += [(side[0] + joint, f'{side}_{joint}_link', 1.0) for joint in ('knee', 'elbow')]
    LINKS += [(side[0] + 'ankle', f'{side}_ankle_roll_link', 0.5)]
BENT = mink.SO3(np.array([2**-0.5, 0, 2**-0.5, 0]))  # from the axes of a hanging forearm to those at 90 degrees
STEPS, FPS = 3, 30.0  # steps of the solver a frame, which starts from the frame before; frames/s of the CSV


class Humanoid:
    """The robot in the pose of a person."""

    def __init__(self, path):
        self.robot, self.targets = mink.Configuration(mujoco.MjModel.from_xml_path(path)), []
        self.joint_names = [self.robot.model.joint(j).name for j in range(1, self.robot.model.njnt)]
        links = [self.robot.get_transform_frame_to_world(name, 'body').translation() for name in (*LEG, 'pelvis')]
        self.leg = np.linalg.norm(np.diff(links[:3], axis=0), axis=1).sum()
        self.hips = (links[0] + links[3]) / 2 - links[4]
        for segment, link, weight in LINKS:
            rest = self.robot.get_transform_frame_to_world(link, 'body').rotation()
            task = mink.FrameTask(link, 'body', 5.0 * (link == 'pelvis'), weight, lm_damping=0.01)
            self.targets.append((JOINTS.index(segment), BENT @ rest if 'elbow' in segment else rest, task))

    def follow(self, joints, turns, world):
        """Return a row of the CSV for joints (J, 3), orientations (J, 4) and a transform to a frame with z up."""
        lhip, *_, rhip = leg = [world.apply(joints[i]) for i in (9, 10, 11, 12)]
        hips = self.leg / np.linalg.norm(np.diff(leg[:3], axis=0), axis=1).sum() * (lhip + rhip) / 2
        for index, rest, task in self.targets:
            turn = world.rotation() @ mink.SO3(np.roll(turns[index], 1)) @ rest
            task.set_target(mink.SE3.from_rotation_and_translation(turn, hips - turn.apply(self.hips)))
        for _ in range(STEPS):
            step = mink.solve_ik(self.robot, [task for *_, task in self.targets], 1.0, 'daqp', damping=1e-3)
            self.robot.integrate_inplace(step, 1.0)
        return np.concatenate([self.robot.q[[0, 1, 2, 4, 5, 6, 3]], self.robot.q[7:]])


def convert(robot, result):
    """Return the rows of the CSV for the arrays of a result of one person."""
    world, seen = mink.SE3.from_matrix(result['world_from_camera']), np.isfinite(result['orientation']).all((1, 2))
    frames = zip(result['joints3d'][seen], result['orientation'][seen], strict=True)
    rows = np.array([robot.follow(joints, turns, world) for joints, turns in frames])
    stamps = result['timestamps'][seen]
    times = np.arange(stamps[0], stamps[-1], 1 / FPS)
    return np.stack([np.interp(times, stamps, column) for column in rows.T], axis=1)


def run(robot):
    """Run the node, for the person who was there first."""
    import rclpy
    from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
    from mocap_ros_msgs.msg import Skeleton3DArray
    from sensor_msgs.msg import JointState

    def take(skeletons):
        person = max((p for p in skeletons.people if not p.tentative), key=lambda p: p.age, default=None)
        if person and skeletons.header.frame_id != skeletons.camera_frame_id:
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
