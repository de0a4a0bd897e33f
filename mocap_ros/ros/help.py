# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Names, parameters, topics and services of the nodes, and what `--help` prints; without rclpy."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence

from mocap_ros.bags.topics import Source
from mocap_ros.bridges.bridge import CONSUMERS
from mocap_ros.config import Parameter
from mocap_ros.detectors.detector import MAX_PEOPLE, MODEL_FORMATS
from mocap_ros.errors import tell_installation
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.foreign_types import HRI_SKELETON
from mocap_ros.messages.images import IMAGE, IMAGE_TYPES
from mocap_ros.messages.imu import IMU
from mocap_ros.messages.input_types import KEYPOINT_TYPES
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.messages.skeletons import PREDICTIONS, SKELETONS
from mocap_ros.messages.transforms import TRANSFORMS
from mocap_ros.runtime.outputs import LATCHED_OUTPUTS, OUTPUTS, SWITCHED_OUTPUTS

MOCAP_NAME, BRIDGE_NAME, DETECTOR_NAME = 'mocap_node', 'mocap_bridge', 'detector_node'
DEPTH_NAME, MERGE_NAME = 'depth_node', 'mocap_merge'
# Type of each service of the node, by name.
SERVICES = {'~/reset': 'std_srvs/srv/Trigger', '~/record': 'std_srvs/srv/SetBool'}
# Message type of each input with the default parameters, by relative topic name.
INPUT_TYPES = {Source.KEYPOINTS.value: KEYPOINTS, Source.CAMERA_INFO.value: CAMERA_INFO, Source.IMU.value: IMU}
BRIDGE_PARAMETERS = (
    Parameter(
        'publish', str, '', f'consumers, separated by blanks: some of {", ".join(CONSUMERS)}', read_only=True
    ),
    Parameter(
        'vmc',
        str,
        '',
        'HOST:PORT, to which the person who has been there longest is sent by the VMC protocol, such as '
        f'127.0.0.1:39539; needs python-osc: {tell_installation("vmc")}; empty: nothing',
        read_only=True,
    ),
    Parameter('autostart', bool, True, 'the node configures and activates itself', read_only=True),
)
IMAGE_TOPIC, KEYPOINTS_TOPIC = 'image', 'keypoints'  # of `detector_node`, relative names
DEPTH_TOPIC, KEYPOINTS_DEPTH_TOPIC = 'depth', 'keypoints_depth'  # of `depth_node`, likewise
# The largest number of people is far above what a detector finds.
DETECTOR_PARAMETERS = (
    Parameter(
        'model',
        str,
        '',
        f'file of the model: {MODEL_FORMATS}; empty for the MoveNet that comes with the package',
        read_only=True,
    ),
    Parameter(
        'max_people',
        int,
        0,
        f'largest number of people to find in an image; 0: {MAX_PEOPLE}, of MediaPipe 1',
        low=0,
        high=100,
        read_only=True,
    ),
    Parameter('image_type', str, IMAGE, 'type of the images', choices=IMAGE_TYPES, read_only=True),
)

DEPTH_PARAMETERS = (
    Parameter('input_type', str, KEYPOINTS, 'type of the keypoints', choices=KEYPOINT_TYPES, read_only=True),
    Parameter(
        'depth_type',
        str,
        IMAGE,
        'type of the depth images, 16UC1 in mm or 32FC1 in m; CompressedImage is of compressedDepth',
        choices=IMAGE_TYPES,
        read_only=True,
    ),
)

# The tolerance is longer than a camera at 10 Hz takes from image to image.
MERGE_PARAMETERS = (
    Parameter(
        'inputs',
        str,
        '',
        'topics of the skeletons of two cameras or more, separated by blanks, such as /left/skeletons '
        "/right/skeletons; the first that is alive leads; all in one frame, which is no camera's",
        read_only=True,
    ),
    Parameter(
        'tolerance',
        float,
        0.15,
        's, for which people of a camera that is behind or ahead are carried on by their velocities',
        low=0.0,
        high=1.0,
        read_only=True,
    ),
    Parameter('publish_tf', bool, False, 'publish people on /tf', read_only=True),
    Parameter('record', str, '', 'folder for a recording of inputs and outputs; empty: none', read_only=True),
    Parameter('autostart', bool, True, 'the node configures and activates itself', read_only=True),
)


def build_parser(name: str) -> argparse.ArgumentParser:
    """Return the parser of a node's command line without the arguments that rclpy parses."""
    description, sections = _describe_nodes()[name]
    lines = []
    for title, entries in sections.items():
        width = max(map(len, entries))
        lines += [f'{title}:', *(f'  {key:<{width}}  {text}' for key, text in entries.items()), '']
    return argparse.ArgumentParser(
        prog=name,
        usage=f'{name} [-h] [--ros-args [-p NAME:=VALUE] [--params-file FILE] [-r FROM:=TO] ...]',
        description=description,
        epilog='\n'.join(lines),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def remove_ros_arguments(arguments: Sequence[str]) -> list[str]:
    """Return the arguments that are not between `--ros-args` and `--`."""
    remaining = []
    is_for_ros = False
    for argument in arguments:
        if argument == '--ros-args' or (is_for_ros and argument == '--'):
            is_for_ros = argument == '--ros-args'
        elif not is_for_ros:
            remaining.append(argument)
    return remaining


def _describe(parameter: Parameter) -> str:
    return ': '.join([parameter.description, *filter(None, [' or '.join(parameter.choices)])])


def _describe_nodes() -> dict[str, tuple[str, dict[str, Mapping[str, str]]]]:
    others = ', '.join((*KEYPOINT_TYPES[1:], HRI_SKELETON))
    mocap: dict[str, Mapping[str, str]] = {
        'after --ros-args': {
            '-p tracker.window:=2.0': 'set a parameter; may be repeated',
            '-p node.input_type:=TYPE': f'accept another type of keypoint messages: {others}',
            '--params-file FILE': 'read parameters from a file; `mocap-ros config > FILE` writes such a file',
            '-r keypoints:=/camera/keypoints': 'rename a topic; may be repeated',
            '--log-level warn': 'log only warnings and errors',
        },
        'subscribed topics': {**INPUT_TYPES, '/tf_static': TRANSFORMS},
        'published topics': OUTPUTS | LATCHED_OUTPUTS | {'/diagnostics': 'diagnostic_msgs/msg/DiagnosticArray'},
        'subscribed with -p node.output_frame:=FRAME': {'/tf': TRANSFORMS},
        **{f'published with -p node.{field}:=true': {t: kind} for field, (t, kind) in SWITCHED_OUTPUTS.items()},
        'services': SERVICES,
    }
    bridge, detector, depth, merge = (
        {'parameters, after --ros-args -p': {f'{p.name}:={p.default!r}': _describe(p) for p in given}}
        for given in (BRIDGE_PARAMETERS, DETECTOR_PARAMETERS, DEPTH_PARAMETERS, MERGE_PARAMETERS)
    )
    return {
        MOCAP_NAME: ('Estimate 3D people live from 2D keypoints.', mocap),
        BRIDGE_NAME: (
            'Publish what robots take in from the people that mocap_node finds.',
            {
                **bridge,
                'subscribed topics': {
                    'skeletons': SKELETONS,
                    'predictions': f'{PREDICTIONS}, for prediction_markers',
                },
                'published with -p publish:=CONSUMER': {n: f'{c.topic}, {c.type}' for n, c in CONSUMERS.items()},
            },
        ),
        DETECTOR_NAME: (
            'Find 2D keypoints in the images of a camera, for mocap_node.',
            {
                **detector,
                'subscribed topic': {IMAGE_TOPIC: ' or '.join(IMAGE_TYPES)},
                'published topic': {KEYPOINTS_TOPIC: KEYPOINTS},
            },
        ),
        DEPTH_NAME: (
            'Give 2D keypoints the depths of a depth image that is registered to theirs, for mocap_node.',
            {
                **depth,
                'subscribed topics': {
                    KEYPOINTS_TOPIC: ' or '.join(KEYPOINT_TYPES),
                    DEPTH_TOPIC: ' or '.join(IMAGE_TYPES),
                },
                'published topic': {KEYPOINTS_DEPTH_TOPIC: KEYPOINTS},
            },
        ),
        MERGE_NAME: (
            'Merge the people whom the mocap_nodes of several cameras find.',
            {
                **merge,
                'subscribed topics': {'those of inputs': SKELETONS},
                'published topics': OUTPUTS
                | LATCHED_OUTPUTS
                | {'/diagnostics': 'diagnostic_msgs/msg/DiagnosticArray', '/tf': 'with -p publish_tf:=true'},
            },
        ),
    }
