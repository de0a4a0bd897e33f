# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Definitions of other packages' messages that are accepted as keypoints or published for robots.

With these definitions the messages are read and written although their packages are not installed. The definitions
of inputs are those of yolo_msgs (yolo_ros), hri_msgs (ROS4HRI, REP-155), zed_msgs (ZED wrapper) and
openpose_ros2_msgs; those of outputs of people_msgs, vision_msgs, nav2_dynamic_msgs, moveit_msgs and hri_msgs. A
message in another version of a type is converted to or from these fields by name, on live topics and in bags.

The definitions are not beside the readers, because `cdr` registers them and the readers import `cdr`.
"""

from __future__ import annotations

YOLO_DETECTIONS = 'yolo_msgs/msg/DetectionArray'
HRI_SKELETON = 'hri_msgs/msg/Skeleton2D'
HRI_IDS = 'hri_msgs/msg/IdsList'
HRI_POSTURE = 'hri_msgs/msg/BodyPosture'
ZED_OBJECTS = 'zed_msgs/msg/ObjectsStamped'
OPENPOSE_POSES = 'openpose_ros2_msgs/msg/PoseKeyPointsList'
PEOPLE = 'people_msgs/msg/People'
DETECTIONS_3D = 'vision_msgs/msg/Detection3DArray'
OBSTACLES = 'nav2_dynamic_msgs/msg/ObstacleArray'
COLLISION_OBJECT = 'moveit_msgs/msg/CollisionObject'

# Definitions of messages that are accepted as keypoints: the name of each type and its fields as in a .msg file.
INPUT_DEFINITIONS = {
    'yolo_msgs/msg/Point2D': 'float64 x\nfloat64 y',
    'yolo_msgs/msg/Vector2': 'float64 x\nfloat64 y',
    'yolo_msgs/msg/Pose2D': 'yolo_msgs/Point2D position\nfloat64 theta',
    'yolo_msgs/msg/BoundingBox2D': 'yolo_msgs/Pose2D center\nyolo_msgs/Vector2 size',
    'yolo_msgs/msg/BoundingBox3D': 'geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\nstring frame_id',
    'yolo_msgs/msg/Mask': 'int32 height\nint32 width\nyolo_msgs/Point2D[] data',
    'yolo_msgs/msg/KeyPoint2D': 'int32 id\nyolo_msgs/Point2D point\nfloat64 score',
    'yolo_msgs/msg/KeyPoint2DArray': 'yolo_msgs/KeyPoint2D[] data',
    'yolo_msgs/msg/KeyPoint3D': 'int32 id\ngeometry_msgs/Point point\nfloat64 score',
    'yolo_msgs/msg/KeyPoint3DArray': 'yolo_msgs/KeyPoint3D[] data\nstring frame_id',
    'yolo_msgs/msg/Detection': (
        'int32 class_id\nstring class_name\nfloat64 score\nstring id\nyolo_msgs/BoundingBox2D bbox\n'
        'yolo_msgs/BoundingBox3D bbox3d\nyolo_msgs/Mask mask\nyolo_msgs/KeyPoint2DArray keypoints\n'
        'yolo_msgs/KeyPoint3DArray keypoints3d'
    ),
    YOLO_DETECTIONS: 'std_msgs/Header header\nyolo_msgs/Detection[] detections',
    'hri_msgs/msg/NormalizedPointOfInterest2D': 'float32 x\nfloat32 y\nfloat32 c',
    HRI_SKELETON: 'std_msgs/Header header\nhri_msgs/NormalizedPointOfInterest2D[18] skeleton',
    HRI_IDS: 'std_msgs/Header header\nstring[] ids',
    'zed_msgs/msg/Keypoint2Di': 'uint32[2] kp',
    'zed_msgs/msg/Keypoint2Df': 'float32[2] kp',
    'zed_msgs/msg/Keypoint3D': 'float32[3] kp',
    'zed_msgs/msg/BoundingBox2Di': 'zed_msgs/Keypoint2Di[4] corners',
    'zed_msgs/msg/BoundingBox2Df': 'zed_msgs/Keypoint2Df[4] corners',
    'zed_msgs/msg/BoundingBox3D': 'zed_msgs/Keypoint3D[8] corners',
    'zed_msgs/msg/Skeleton2D': 'zed_msgs/Keypoint2Df[70] keypoints',
    'zed_msgs/msg/Skeleton3D': 'zed_msgs/Keypoint3D[70] keypoints',
    'zed_msgs/msg/Object': (
        'string label\nint16 label_id\nstring sublabel\nfloat32 confidence\nfloat32[3] position\n'
        'float32[6] position_covariance\nfloat32[3] velocity\nbool tracking_available\nint8 tracking_state\n'
        'int8 action_state\nzed_msgs/BoundingBox2Di bounding_box_2d\nzed_msgs/BoundingBox3D bounding_box_3d\n'
        'float32[3] dimensions_3d\nbool skeleton_available\nint8 body_format\n'
        'zed_msgs/BoundingBox2Df head_bounding_box_2d\nzed_msgs/BoundingBox3D head_bounding_box_3d\n'
        'float32[3] head_position\nzed_msgs/Skeleton2D skeleton_2d\nzed_msgs/Skeleton3D skeleton_3d\n'
        'float32[70] skeleton_keypoint_confidence'
    ),
    ZED_OBJECTS: 'std_msgs/Header header\nzed_msgs/Object[] objects',
    'openpose_ros2_msgs/msg/PoseKeyPoint': 'float32 x\nfloat32 y\nfloat32 score',
    'openpose_ros2_msgs/msg/PoseKeyPoints': 'openpose_ros2_msgs/PoseKeyPoint[] pose_key_points',
    OPENPOSE_POSES: 'std_msgs/Header header\nopenpose_ros2_msgs/PoseKeyPoints[] pose_key_points_list',
}
# Definitions of messages that are published for robots.
OUTPUT_DEFINITIONS = {
    HRI_POSTURE: 'std_msgs/Header header\nuint8 posture',
    'people_msgs/msg/Person': (
        'string name\ngeometry_msgs/Point position\ngeometry_msgs/Point velocity\nfloat64 reliability\n'
        'string[] tagnames\nstring[] tags'
    ),
    PEOPLE: 'std_msgs/Header header\npeople_msgs/Person[] people',
    'vision_msgs/msg/ObjectHypothesis': 'string class_id\nfloat64 score',
    'vision_msgs/msg/ObjectHypothesisWithPose': (
        'vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose'
    ),
    'vision_msgs/msg/BoundingBox3D': 'geometry_msgs/Pose center\ngeometry_msgs/Vector3 size',
    'vision_msgs/msg/Detection3D': (
        'std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\nvision_msgs/BoundingBox3D bbox\n'
        'string id'
    ),
    DETECTIONS_3D: 'std_msgs/Header header\nvision_msgs/Detection3D[] detections',
    'nav2_dynamic_msgs/msg/Obstacle': (
        'unique_identifier_msgs/UUID uuid\nfloat32 score\ngeometry_msgs/Point position\n'
        'geometry_msgs/Vector3 velocity\ngeometry_msgs/Vector3 size'
    ),
    OBSTACLES: 'std_msgs/Header header\nnav2_dynamic_msgs/Obstacle[] obstacles',
    'object_recognition_msgs/msg/ObjectType': 'string key\nstring db',
    COLLISION_OBJECT: (
        'std_msgs/Header header\ngeometry_msgs/Pose pose\nstring id\nobject_recognition_msgs/ObjectType type\n'
        'shape_msgs/SolidPrimitive[] primitives\ngeometry_msgs/Pose[] primitive_poses\n'
        'shape_msgs/Mesh[] meshes\ngeometry_msgs/Pose[] mesh_poses\nshape_msgs/Plane[] planes\n'
        'geometry_msgs/Pose[] plane_poses\nstring[] subframe_names\ngeometry_msgs/Pose[] subframe_poses\n'
        'byte operation'
    ),
}
DEFINITIONS = {**INPUT_DEFINITIONS, **OUTPUT_DEFINITIONS}

# Packages by their earlier names, whose messages have the same fields or some of them.
RENAMED_PACKAGES = {'yolov8_msgs': 'yolo_msgs', 'zed_interfaces': 'zed_msgs'}
RENAMED_TYPES = {'tf/msg/tfMessage': 'tf2_msgs/msg/TFMessage'}  # of ROS 1


def find_current_type(msgtype: str) -> str:
    """Return the name of a message type, and of its package, as it is called now."""
    package, _, name = RENAMED_TYPES.get(msgtype, msgtype).partition('/')
    return f'{RENAMED_PACKAGES.get(package, package)}/{name}'
