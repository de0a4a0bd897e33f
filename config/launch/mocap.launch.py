# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

r"""Launch the live node, and if wanted the node with messages for robots, and RViz.

For example:

ros2 launch mocap_ros mocap.launch.py keypoints:=/yolo/detections \
    input_type:=yolo_msgs/msg/DetectionArray rviz:=true

An argument that sets a parameter and is not given leaves it as the parameter file has it.
"""

from __future__ import annotations

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

SHARE = FindPackageShare('mocap_ros')  # the installed folder of parameter file and RViz configuration
# Default and description of each launch argument.
ARGUMENTS = {
    'namespace': ('', 'namespace of the node; each camera needs its own'),
    'params_file': (PathJoinSubstitution([SHARE, 'config', 'mocap_ros.yaml']), 'parameter file'),
    'input_type': ('', 'message type of the keypoints'),
    'keypoints': ('keypoints', 'topic of the keypoints'),
    'camera_info': ('camera_info', 'topic of the CameraInfo'),
    'imu': ('imu', 'topic of the Imu of the camera or its robot, which shows which way is up'),
    'depth': ('', 'topic of depth images that are registered to the colour image; starts depth_node'),
    'output_frame': ('', 'frame of the outputs, such as base_link or map; empty: that of the camera'),
    'camera_pose': ('', 'x y z roll pitch yaw in m and rad of a camera that stands still in it; empty: from /tf'),
    'floor_height': ('', 'm, height of the floor in it'),
    'hfov': ('', 'degrees, horizontal field of view of a camera without CameraInfo'),
    'vertical': ('', 'degrees by which the camera looks down, such as 10, or the direction upwards in its frame'),
    'record': ('', 'whether to record a bag in mocap_recordings/'),
    'publish_tf': ('', 'whether to publish the people as frames on /tf'),
    'frame_prefix': ('', 'prefix of the names of these frames; each camera needs its own'),
    'bridge': ('', 'consumers for which a second node publishes, such as "people capsules"'),
    'rviz': ('false', 'whether to start RViz'),
}
# The parameter that an argument sets, and its type.
PARAMETERS = {
    'input_type': ('node.input_type', str),
    'output_frame': ('node.output_frame', str),
    'camera_pose': ('node.camera_pose', str),
    'floor_height': ('node.floor_height', str),
    'hfov': ('node.hfov', float),
    'vertical': ('tracker.vertical', str),
    'publish_tf': ('node.publish_tf', bool),
    'frame_prefix': ('node.frame_prefix', str),
    'record': ('recorder.enabled', bool),
}
SWITCHES = {'rviz', *(name for name, (_, kind) in PARAMETERS.items() if kind is bool)}
SWITCH_VALUES = 'true', 'false', 'True', 'False'


def create_nodes(context: LaunchContext) -> list[Node]:
    """Return the node with the parameters of the file and of those arguments that were given, and the bridge."""
    configurations = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    given = {
        parameter: ParameterValue(configurations[name], value_type=kind)
        for name, (parameter, kind) in PARAMETERS.items()
        if configurations[name].perform(context)
    }
    consumers, depth = (configurations[name].perform(context) for name in ('bridge', 'depth'))
    if 'prediction_markers' in consumers:
        given['node.publish_predictions'] = True
    input_type = given.pop('node.input_type', None) if depth else None  # depth_node's; it gives the default
    node = Node(
        package='mocap_ros',
        executable='mocap_node',
        name='mocap_node',
        namespace=configurations['namespace'],
        output='screen',
        parameters=[configurations['params_file'], *([given] if given else [])],
        remappings=[
            ('keypoints', 'keypoints_depth' if depth else configurations['keypoints']),
            ('camera_info', configurations['camera_info']),
            ('imu', configurations['imu']),
        ],
    )
    nodes = [node]
    if depth:
        nodes.append(_create_depth_node(configurations, input_type))
    if not consumers:
        return nodes
    bridge = Node(
        package='mocap_ros',
        executable='mocap_bridge',
        name='mocap_bridge',
        namespace=configurations['namespace'],
        output='screen',
        parameters=[{'publish': ParameterValue(consumers, value_type=str)}],
    )
    return [*nodes, bridge]


def _create_depth_node(configurations: dict[str, LaunchConfiguration], input_type: ParameterValue | None) -> Node:
    return Node(
        package='mocap_ros',
        executable='depth_node',
        name='depth_node',
        namespace=configurations['namespace'],
        output='screen',
        parameters=[{'input_type': input_type}] if input_type else [],
        remappings=[('keypoints', configurations['keypoints']), ('depth', configurations['depth'])],
    )


def generate_launch_description() -> LaunchDescription:
    """Return the launch description with RViz and the nodes.

    RViz comes first: where it is not installed, the launch ends before the node has started.
    """
    rviz = Node(
        package='rviz2',
        executable='rviz2',
        namespace=LaunchConfiguration('namespace'),
        arguments=['-d', PathJoinSubstitution([SHARE, 'config', 'mocap_ros.rviz'])],
        condition=IfCondition(LaunchConfiguration('rviz')),
    )
    arguments = [
        DeclareLaunchArgument(
            name,
            default_value=default,
            description=text,
            choices=[*([] if default else ['']), *SWITCH_VALUES] if name in SWITCHES else None,
        )
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, rviz, OpaqueFunction(function=create_nodes)])
