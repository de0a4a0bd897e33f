# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Text that the nodes print with `--help`: arguments, topics and services. This module does not import rclpy."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence

from mocap_ros.bags.topics import Source
from mocap_ros.bridges.bridge import CONSUMERS
from mocap_ros.detectors.load import MODEL_FORMATS
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.foreign_types import HRI_SKELETON
from mocap_ros.messages.images import IMAGE, IMAGE_TYPES
from mocap_ros.messages.input_types import KEYPOINT_TYPES
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.messages.skeletons import PREDICTIONS, SKELETONS
from mocap_ros.messages.transforms import TRANSFORMS
from mocap_ros.runtime.outputs import LATCHED_OUTPUTS, OUTPUTS, SWITCHED_OUTPUTS

MOCAP_NAME, BRIDGE_NAME, DETECTOR_NAME = 'mocap_node', 'mocap_bridge', 'detector_node'
# Type of each service of the node, by name.
SERVICES = {'~/reset': 'std_srvs/srv/Trigger', '~/record': 'std_srvs/srv/SetBool'}
# Message type of each input with the default parameters, by relative topic name.
INPUT_TYPES = {Source.KEYPOINTS.value: KEYPOINTS, Source.CAMERA_INFO.value: CAMERA_INFO}
# The further inputs with node.output_frame and without node.camera_pose.
TRANSFORM_INPUTS = {Source.TRANSFORMS.value: TRANSFORMS, Source.STATIC_TRANSFORMS.value: TRANSFORMS}
# Default and description of each parameter of `mocap_bridge`; all are fixed when the node starts.
BRIDGE_PARAMETERS: dict[str, tuple[str | bool, str]] = {
    'publish': ('', f'consumers, separated by blanks: some of {", ".join(CONSUMERS)}'),
    'autostart': (True, 'the node configures and activates itself'),
}
IMAGE_TOPIC, KEYPOINTS_TOPIC = 'image', 'keypoints'  # of `detector_node`, relative names
MAX_PEOPLE = 100  # people; far above what a detector finds
# Default and description of each parameter of `detector_node`, likewise.
DETECTOR_PARAMETERS: dict[str, tuple[str | int, str]] = {
    'model': ('', f'file of the model: {MODEL_FORMATS}; empty for the model that comes with MediaPipe 0.10.21'),
    'max_people': (1, 'largest number of people to find in an image, by models that find several'),
    'image_type': (IMAGE, f'type of the images: {" or ".join(IMAGE_TYPES)}'),
}


def build_parser(name: str) -> argparse.ArgumentParser:
    """Return the parser of a node's command line without the arguments that rclpy parses."""
    description, sections = {
        MOCAP_NAME: ('Estimate 3D people live from 2D keypoints.', _list_mocap_sections),
        BRIDGE_NAME: ('Publish what robots take in from the people that mocap_node finds.', _list_bridge_sections),
        DETECTOR_NAME: ('Find 2D keypoints in the images of a camera, for mocap_node.', _list_detector_sections),
    }[name]
    lines = []
    for title, entries in sections().items():
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
    remaining, is_for_ros = [], False
    for argument in arguments:
        if argument == '--ros-args' or (is_for_ros and argument == '--'):
            is_for_ros = argument == '--ros-args'
        elif not is_for_ros:
            remaining.append(argument)
    return remaining


def _list_mocap_sections() -> dict[str, Mapping[str, str]]:
    return {
        'after --ros-args': {
            '-p tracker.window:=2.0': 'set a parameter; may be repeated',
            '-p node.input_type:=TYPE': (
                f'accept another type of keypoint messages: {", ".join((*KEYPOINT_TYPES[1:], HRI_SKELETON))}'
            ),
            '--params-file FILE': 'read parameters from a file; `mocap-ros config > FILE` writes such a file',
            '-r keypoints:=/camera/keypoints': 'rename a topic; may be repeated',
            '--log-level warn': 'log only warnings and errors',
        },
        'subscribed topics': INPUT_TYPES,
        'published topics': OUTPUTS | LATCHED_OUTPUTS | {'/diagnostics': 'diagnostic_msgs/msg/DiagnosticArray'},
        'subscribed with -p node.output_frame:=FRAME': TRANSFORM_INPUTS,
        **{f'published with -p node.{field}:=true': {o.topic: o.type} for field, o in SWITCHED_OUTPUTS.items()},
        'services': SERVICES,
    }


def _list_bridge_sections() -> dict[str, Mapping[str, str]]:
    return {
        'parameters, after --ros-args -p': _list_parameters(BRIDGE_PARAMETERS),
        'subscribed topics': {'skeletons': SKELETONS, 'predictions': f'{PREDICTIONS}, for prediction_markers'},
        'published with -p publish:=CONSUMER': {name: f'{c.topic}, {c.type}' for name, c in CONSUMERS.items()},
    }


def _list_detector_sections() -> dict[str, Mapping[str, str]]:
    return {
        'parameters, after --ros-args -p': _list_parameters(DETECTOR_PARAMETERS),
        'subscribed topic': {IMAGE_TOPIC: ' or '.join(IMAGE_TYPES)},
        'published topic': {KEYPOINTS_TOPIC: KEYPOINTS},
    }


def _list_parameters(parameters: Mapping[str, tuple[object, str]]) -> dict[str, str]:
    return {f'{name}:={default!r}': text for name, (default, text) in parameters.items()}
