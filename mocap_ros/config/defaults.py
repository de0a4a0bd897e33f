# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Every parameter and every constant of the algorithms, which have no other home.

The fields that `define_parameter` makes are the parameters: users set them as ROS parameters, in a parameter file
or by `--set`, by the name `group.field`, for example `solver.prior`. All other fields are constants; the comment
before one gives its meaning, and only experiments change it (`with_settings`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

Value = bool | int | float | str  # the types that a parameter may have


def define_parameter(default: Value, description: str, **attributes: Any) -> Any:
    """Return a dataclass field that is a parameter; the attributes are those of `access.Parameter`."""
    return field(default=default, metadata={'description': description, **attributes})


@dataclass(frozen=True)
class SolverConfig:
    """Prior and method of the solvers, the weights of the objective's terms, and when they stop."""

    prior: str = define_parameter(
        'learned',
        'prior of non-periodic motion: learned (the shipped lifter together with the base poses), pca (the '
        'base poses alone, as in the paper), or the path of a trained lifter',
        read_only=True,
    )
    method: str = define_parameter(
        'joint',
        'joint: Levenberg-Marquardt over cameras and weights together; alternation: Algorithm 1 of the paper',
        choices=('joint', 'alternation'),
    )
    max_iterations: int = define_parameter(
        60, 'maximum number of solver iterations, in each round under another image noise', low=1, high=10_000
    )

    # Maximum number of base poses; a model that has fewer uses all of them
    components: int = 40
    # m^2, weight of the squared distance between a pose and the lifter's estimate of it (the lifted pose), in the
    # standard deviations that the lifter predicts
    lifter_weight: float = 2e-4
    # Standard deviations, distance from the lifted pose beyond which Cauchy's loss discounts a joint
    lifter_robust_scale: float = 3.0
    # Factor on prior_weight where there are lifted poses
    lifter_prior_factor: float = 0.3
    # Factor on flip_weight where there are lifted poses
    lifter_flip_factor: float = 0.25
    # Factor on smooth_weight where there are lifted poses
    lifter_smooth_factor: float = 5.0
    # Factor on pose_acceleration_weight where there are lifted poses
    lifter_acceleration_factor: float = 5.0
    # m^2, weight of the Gaussian prior of the base-pose weights, per squared standard deviation
    prior_weight: float = 1e-4
    # Factor on prior_weight for base poses that were aligned by heading: one category of motion varies less than
    # people do, so its prior has to be weaker
    heading_prior_factor: float = 0.25
    # Weight of the variance of the bone lengths over time (beta, eq. 20)
    bone_weight: float = 60.0
    # m^2 s, weight of the squared change of the camera between frames (gamma, eq. 12)
    flip_weight: float = 0.02
    # Factor on flip_weight for base poses that were aligned by heading: there the camera also takes up how the
    # body turns with every stride
    heading_flip_factor: float = 0.025
    # m^2 s, weight of the squared change between frames of the projected vertical axis, for base poses that were
    # aligned by heading; only a turn of the camera changes that projection
    tilt_weight: float = 1.0
    # m^2 s, weight of the squared change of the logarithm of the camera's scale between frames; a tenth of it in a
    # tracker with a lag of less than 0.15 s
    scale_weight: float = 0.2
    # m^2 s, weight of the squared change of the base-pose weights between frames, in standard deviations
    smooth_weight: float = 3e-6
    # s^3, weight of the squared acceleration of the base-pose weights, in whole sequences and in a tracker with a
    # lag of 0.15 s or more; 0 also leaves out that of the camera, except in the periodic model
    pose_acceleration_weight: float = 3e-5
    # m, reprojection error beyond which Cauchy's loss discounts a point; 0 selects least squares
    robust_scale: float = 0.05
    # Estimate the image noise from the residual and adapt all weights of this group to it: they are given for a
    # noise of 10 mm and are multiplied by (noise / 10 mm)^2; robust_scale is multiplied by noise / 10 mm where the
    # noise is above 10 mm. The alternation does not adapt
    adapt_noise: bool = True
    # m, lower limit of the estimated image noise
    noise_floor: float = 0.0005
    # Number of harmonics of the periodic model
    harmonics: int = 3
    # Factor on prior_weight for the coefficients of the periodic model, which occur once a window and not once a
    # frame
    periodic_prior_factor: float = 1.0
    # m^2 s, weight of the squared velocity of the camera in the periodic model
    camera_velocity_weight: float = 0.001
    # m^2 s^3, weight of the squared acceleration of the camera; see pose_acceleration_weight
    camera_acceleration_weight: float = 0.0003
    # Number of initial cameras that are tried: 1 is the closed-form one alone, 2 also its Necker reversal
    hypotheses: int = 2
    # s, span of the frames that share one closed-form initial camera
    start_window: float = 1.0
    # Number of initial cameras that are tried for base poses that were aligned by heading
    heading_hypotheses: int = 1
    # Relative decrease of the objective below which the solver stops
    tolerance: float = 3e-4


@dataclass(frozen=True)
class ClassifierConfig:
    """Thresholds between periodic and non-periodic motion.

    They were chosen on CMU walk, run and jump trials.
    """

    # s, length of the newest section of the window, which is classified
    section: float = 2.0
    # Largest unexplained RMS movement of a joint in the image of a walk, as a fraction of body height
    walk_residual: float = 0.0175
    # Largest unexplained RMS movement of a joint in the image of a run, as a fraction of body height
    run_residual: float = 0.021
    # Hz, smallest cadence of a walk (full cycles)
    walk_cadence: float = 0.5
    # Hz, smallest cadence of a run (full cycles)
    run_cadence: float = 1.0
    # Smallest RMS movement of a joint in a periodic motion, as a fraction of body height
    amplitude: float = 0.03
    # Maximum number of base poses of the periodic model
    components: int = 25
    # Factor by which a threshold must be passed before the classification changes
    hysteresis: float = 1.1


@dataclass(frozen=True)
class TrackerConfig:
    """The sliding window of each person."""

    model: str = define_parameter(
        'auto',
        'name of a shipped base-pose model, path of a trained one, or auto: the most likely shipped model of '
        'each person (with the learned prior: the model of all motions)',
        read_only=True,
    )
    window: float = define_parameter(2.0, 's, length of the sliding window', low=0.1, high=20.0)
    components: int = define_parameter(
        40, 'maximum number of base poses of the live tracker; fewer are faster', low=1, high=40
    )
    iterations: int = define_parameter(2, 'number of solver iterations at every frame', low=1, high=100)
    lag: float = define_parameter(
        0.0,
        's, delay of the output behind the newest frame; from 0.15 s on, later frames make the output steady',
        low=0.0,
        high=5.0,
        is_common=True,
    )
    skeleton: str = define_parameter(
        'body26',
        'joints that are published: body26, with face, feet and hands, or cmu15, without them',
        choices=('body26', 'cmu15'),
        read_only=True,
    )
    steady_output: bool = define_parameter(
        True, 'filter the joints that are published with a lag below 0.15 s, so that they jitter less'
    )
    vertical: str = define_parameter(
        'auto',
        'vertical of the camera, towards which lifted poses are turned: auto (from a node.output_frame whose z '
        'axis is up: map, odom, world or one with node.floor_height; else from accelerations on the topic imu; '
        'else from node.camera_pose alone; else found from how people stand and walk), '
        'none, the degrees by which a camera that is not rolled looks down, such as 10, or the direction upwards '
        'in its optical frame as three numbers, such as 0 -1 0 of a level camera',
        read_only=True,
        is_common=True,
        takes_numbers=True,
    )
    min_score: float = define_parameter(
        0.1, 'confidence score below which a keypoint counts as not seen', low=0.0, high=1.0, is_common=True
    )
    forget_after: float = define_parameter(
        1.0, 's, time without a detection after which a person is forgotten', low=0.0, high=60.0
    )
    predict_for: float = define_parameter(
        0.5,
        's, time without a detection during which a person is predicted, and flagged as predicted',
        low=0.0,
        high=10.0,
    )
    body_height: float = define_parameter(
        1.70, 'm, body height that is assumed of all people', low=0.3, high=2.6, is_common=True
    )
    body_height_std: float = define_parameter(
        0.12,
        'm, standard deviation of body heights about tracker.body_height: 0.12 of adults, about 0.02 where the '
        'height of those who come is known; part of the covariance of where people are',
        low=0.0,
        high=1.0,
    )
    camera_height: float = define_parameter(
        0.0,
        'm, height of the camera above the level floor on which people stand; with tracker.vertical it shows '
        'how large and how far away they are; needs a calibration; 0: not known',
        low=0.0,
        high=100.0,
        is_common=True,
    )
    body_heights: str = define_parameter(
        '',
        'm, body heights of single persons by the ids that the detector gives, such as 7=1.82, anna=1.65; of '
        'all others tracker.body_height is assumed',
    )
    nominal_focal_length: float = define_parameter(
        0.75,
        'longer sides of the image, focal length that is assumed where no calibration is known: 0.75 is that of '
        'webcams and telephones (67 degrees); distances from the camera are proportional to it',
        low=0.1,
        high=20.0,
        is_common=True,
    )

    # s, newest part of the window, which is solved again at every frame; with a longer tracker.lag, that part
    refine_seconds: float = 0.1
    # s, longest time between hypothesis checks of a person: the window is solved from scratch or with another
    # candidate model, whose solution replaces the current one if it is more likely; 0: 5 s with a lifter, 0.5 s
    # without
    hypothesis_check_interval: float = 0.0
    # Detect frames in which the detector exchanged left and right joints, and undo the exchange
    undo_swaps: bool = True
    # Smallest number of seen joints that makes a detection usable
    min_joints: int = 6
    # s, time without anybody (at least forget_after) after which also the names of earlier people are forgotten,
    # so that what follows does not depend on what came before
    forget_all_after: float = 60.0
    # s; tracking starts afresh if a stamp is older than the newest one by more than this, and the frame is dropped
    # if the stamp is older by less
    restart_after: float = 1.0
    # Use the true perspective projection where CameraInfo is known
    perspective: bool = True


@dataclass(frozen=True)
class NodeConfig:
    """Topics and limits of the live node."""

    autostart: bool = define_parameter(True, 'the node configures and activates itself', read_only=True)
    input_type: str = define_parameter(
        'mocap_ros_msgs/msg/Keypoints2DArray',
        'message type of the keypoints: mocap_ros_msgs/msg/Keypoints2DArray, yolo_msgs/msg/DetectionArray, '
        'hri_msgs/msg/Skeleton2D (one topic for each body that /humans/bodies/tracked lists), '
        'zed_msgs/msg/ObjectsStamped or openpose_ros2_msgs/msg/PoseKeyPointsList',
        read_only=True,
        is_common=True,
    )
    rectified_input: bool = define_parameter(
        False,
        'the keypoints belong to the rectified image, so the distortion of CameraInfo is not undone',
        read_only=True,
        is_common=True,
    )
    hfov: float = define_parameter(
        0.0,
        'degrees, horizontal field of view of a camera without CameraInfo; 0: tracker.nominal_focal_length',
        low=0.0,
        high=170.0,
        is_common=True,
    )
    focal: float = define_parameter(
        0.0,
        'px, focal length of a camera without CameraInfo, in place of node.hfov; 0: unknown',
        low=0.0,
        high=1e6,
    )
    camera_info_wait: float = define_parameter(
        1.0,
        's, from the first image, in which people wait for the first CameraInfo, so that their distances do not '
        'change when it comes; 0: do not wait',
        low=0.0,
        high=60.0,
    )
    image_width: int = define_parameter(
        0,
        'px, image width where neither the message nor CameraInfo gives it; 0: unknown',
        low=0,
        high=100_000,
        is_common=True,
    )
    image_height: int = define_parameter(
        0,
        'px, image height where neither the message nor CameraInfo gives it; 0: unknown',
        low=0,
        high=100_000,
        is_common=True,
    )
    queue: int = define_parameter(
        10,
        'maximum number of waiting images of people; if there are more, all but the newest are dropped',
        low=1,
        high=1000,
    )
    max_people: int = define_parameter(
        60, 'maximum number of people in a message; a message with more is refused', low=1, high=1000
    )
    silence_warning: float = define_parameter(5.0, 's, time without keypoints after which the node warns', low=0.1)
    publish_tf: bool = define_parameter(
        False,
        'publish people as frames on /tf, where CameraInfo gives a true scale',
        read_only=True,
        is_common=True,
    )
    publish_predictions: bool = define_parameter(
        False,
        'publish where people will be, mocap_ros_msgs/Predictions, on the topic predictions; not with tracker.lag',
        read_only=True,
    )
    prediction_times: str = define_parameter(
        '0.2 0.4 0.6 1.0',
        's, up to 1, times after the image for which people are predicted, separated by blanks',
        read_only=True,
        takes_numbers=True,
    )
    frame_prefix: str = define_parameter(
        '',
        'prefix of the names of the frames on /tf, which distinguishes the people of several cameras',
        read_only=True,
    )
    output_frame: str = define_parameter(
        '',
        'coordinate frame of the outputs, such as map or base_link; where the camera is in it comes from '
        "node.camera_pose, else from /tf and /tf_static; empty: the camera's optical frame",
        read_only=True,
        is_common=True,
    )
    camera_pose: str = define_parameter(
        '',
        'x y z in m and roll pitch yaw in rad of a camera that stands still in node.output_frame; with angles of '
        '0 it looks along x with z up, and a positive pitch lowers its view; empty: from /tf',
        read_only=True,
        is_common=True,
    )
    imu_pose: str = define_parameter(
        '',
        'x y z in m and roll pitch yaw in rad of the IMU on the camera, whose accelerations on the topic imu show '
        'which way is up; with angles of 0 its x axis is where the camera looks, and z is up; empty: from /tf',
        read_only=True,
    )
    floor_height: str = define_parameter(
        '',
        'm, height of the floor in node.output_frame, whose z axis must be up, such as 0: the feet of people who '
        'stand on it show how tall they are and how far away; empty: not known',
        read_only=True,
        takes_numbers=True,
        is_common=True,
    )
    transform_tolerance: float = define_parameter(
        0.1,
        's, time by which an image may be later than the newest transform of the camera, which then holds',
        low=0.0,
        high=5.0,
    )
    marker_lifetime: float = define_parameter(
        0.5, 's, time for which a marker stays after the last message that holds it', low=0.0, high=60.0
    )

    # Maximum number of joints of a person; a message with more is refused
    max_joints: int = 200
    # Maximum number of characters of an id or a joint name; a message with a longer one is refused
    max_text: int = 100


@dataclass(frozen=True)
class RecorderConfig:
    """Recording to MCAP."""

    enabled: bool = define_parameter(
        False, 'record while the node is active; may be changed at any time', is_common=True
    )
    folder: str = define_parameter(
        'mocap_recordings', 'folder that bags are written into', read_only=True, is_common=True
    )
    compression: str = define_parameter(
        'zstd', 'compression of the chunks', choices=('zstd', 'lz4', 'none'), read_only=True
    )
    split_mb: int = define_parameter(
        0, 'MB, size at which a bag continues in a new file; 0: never', low=0, high=1_000_000
    )
    split_seconds: float = define_parameter(
        3600.0, 's, time after which a bag continues in a new file; 0: never', low=0.0
    )
    min_free_mb: int = define_parameter(
        200, 'MB, free disk space below which a recording is finished and none is started', low=0, high=1_000_000
    )

    # bytes, size at which a chunk is closed
    chunk_bytes: int = 1_048_576
    # s, time after which a chunk is closed
    chunk_seconds: float = 1.0
    # Maximum number of inputs that wait for the disk; further inputs are counted, but not recorded
    backlog: int = 1000


@dataclass(frozen=True)
class KeyframesConfig:
    """Reconstruction of long sequences by keyframes (Loy et al., ECCV 2004)."""

    alpha: float = define_parameter(
        0.95,
        'share (alpha) of the frames that a keyframe represents or that can be interpolated',
        low=0.0,
        high=1.0,
    )
    gap: float = define_parameter(
        0.2,
        's, time (T) between two well-represented frames below which the frames between them can be interpolated',
        low=0.0,
        high=1e6,
    )
    beta: float = define_parameter(
        0.18, 'torso lengths, distance (beta) below which two poses count as the same', low=0.01, high=10.0
    )
    poses: str = define_parameter(
        'solver',
        'source of the 3D key poses: solver (as for whole sequences) or lifter (the lifter alone, which is '
        'faster)',
        choices=('solver', 'lifter'),
    )

    # Maximum number of frames of one distance matrix; a longer sequence is processed in sections
    max_matrix_frames: int = 3600
    # Share of a control frame's own pose estimate in its pose; the rest is the key pose's, and 0 takes the key
    # pose alone
    frame_pose_share: float = 0.8
    # Step of the gradient descent on the reprojection error (lambda)
    step: float = 0.2
    # s, standard deviation of the low-pass filter after each step
    smoothing: float = 0.04
    # Maximum number of steps of the gradient descent
    iterations: int = 40


@dataclass(frozen=True)
class Config:
    """All parameters and constants by group."""

    solver: SolverConfig = SolverConfig()
    classifier: ClassifierConfig = ClassifierConfig()
    tracker: TrackerConfig = TrackerConfig()
    node: NodeConfig = NodeConfig()
    recorder: RecorderConfig = RecorderConfig()
    keyframes: KeyframesConfig = KeyframesConfig()
