r"""Launch the live node, and RViz if wanted.

For example:

ros2 launch mocap_ros mocap.launch.py keypoints:=/yolo/detections \
    input_type:=yolo_msgs/msg/DetectionArray rviz:=true
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
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
    'input_type': ('mocap_ros_msgs/msg/Keypoints2DArray', 'message type of the keypoints'),
    'keypoints': ('keypoints', 'topic of the keypoints'),
    'camera_info': ('camera_info', 'topic of the CameraInfo'),
    'record': ('false', 'whether to record a bag in mocap_recordings/'),
    'publish_tf': ('false', 'whether to publish the people as frames on /tf'),
    'frame_prefix': ('', 'prefix of the names of these frames; each camera needs its own'),
    'rviz': ('false', 'whether to start RViz'),
}


def generate_launch_description() -> LaunchDescription:
    """Return the launch description with the node and RViz."""
    configurations = {name: LaunchConfiguration(name) for name in ARGUMENTS}

    def typed_argument(name: str, kind: type) -> ParameterValue:
        return ParameterValue(configurations[name], value_type=kind)

    node = Node(
        package='mocap_ros',
        executable='mocap_node',
        name='mocap_node',
        namespace=configurations['namespace'],
        output='screen',
        parameters=[
            configurations['params_file'],
            {
                'node.input_type': typed_argument('input_type', str),
                'node.publish_tf': typed_argument('publish_tf', bool),
                'node.frame_prefix': typed_argument('frame_prefix', str),
                'recorder.enabled': typed_argument('record', bool),
            },
        ],
        remappings=[('keypoints', configurations['keypoints']), ('camera_info', configurations['camera_info'])],
    )
    rviz = Node(
        package='rviz2',
        executable='rviz2',
        namespace=configurations['namespace'],
        arguments=['-d', PathJoinSubstitution([SHARE, 'config', 'mocap_ros.rviz'])],
        condition=IfCondition(configurations['rviz']),
    )
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, node, rviz])
