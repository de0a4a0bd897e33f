r"""The live node, with RViz beside it if wanted.

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

SHARE = FindPackageShare('mocap_ros')
ARGUMENTS = {
    'namespace': ('', 'of the node: one for each camera'),
    'params_file': (PathJoinSubstitution([SHARE, 'config', 'mocap_ros.yaml']), 'parameters'),
    'input_type': ('mocap_ros_msgs/msg/Keypoints2DArray', 'message type of the keypoints'),
    'keypoints': ('keypoints', 'topic of the keypoints'),
    'camera_info': ('camera_info', 'topic of the CameraInfo'),
    'record': ('false', 'record to mocap_recordings/'),
    'publish_tf': ('false', 'people as frames on /tf'),
    'frame_prefix': ('', 'before the names of these frames'),
    'rviz': ('false', 'start RViz'),
}


def generate_launch_description() -> LaunchDescription:
    """The node and RViz."""
    given = {name: LaunchConfiguration(name) for name in ARGUMENTS}

    def typed(name: str, kind: type) -> ParameterValue:
        return ParameterValue(given[name], value_type=kind)

    node = Node(
        package='mocap_ros',
        executable='mocap_node',
        name='mocap_node',
        namespace=given['namespace'],
        output='screen',
        parameters=[
            given['params_file'],
            {
                'node.input_type': typed('input_type', str),
                'node.publish_tf': typed('publish_tf', bool),
                'node.frame_prefix': typed('frame_prefix', str),
                'recorder.enabled': typed('record', bool),
            },
        ],
        remappings=[('keypoints', given['keypoints']), ('camera_info', given['camera_info'])],
    )
    rviz = Node(
        package='rviz2',
        executable='rviz2',
        namespace=given['namespace'],
        arguments=['-d', PathJoinSubstitution([SHARE, 'config', 'mocap_ros.rviz'])],
        condition=IfCondition(given['rviz']),
    )
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, node, rviz])
