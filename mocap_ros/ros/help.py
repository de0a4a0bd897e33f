# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Text that `mocap_node --help` prints: arguments, topics and services. This module does not import rclpy."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from mocap_ros.bags.topics import Source
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.foreign.definitions import HRI_SKELETON
from mocap_ros.messages.input_types import KEYPOINT_TYPES
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.messages.transforms import TRANSFORMS
from mocap_ros.runtime.outputs import LATCHED_OUTPUTS, OUTPUTS, SWITCHED_OUTPUTS

# Type of each service of the node, by name.
SERVICES = {'~/reset': 'std_srvs/srv/Trigger', '~/record': 'std_srvs/srv/SetBool'}
# Message type of each input with the default parameters, by relative topic name.
INPUT_TYPES = {Source.KEYPOINTS.value: KEYPOINTS, Source.CAMERA_INFO.value: CAMERA_INFO}
# The further inputs with node.output_frame and without node.camera_pose.
TRANSFORM_INPUTS = {Source.TRANSFORMS.value: TRANSFORMS, Source.STATIC_TRANSFORMS.value: TRANSFORMS}


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of the node's command line without the arguments that rclpy parses."""
    return argparse.ArgumentParser(
        prog='mocap_node',
        usage='mocap_node [-h] [--ros-args [-p NAME:=VALUE] [--params-file FILE] [-r FROM:=TO] ...]',
        description='Estimate 3D people live from 2D keypoints.',
        epilog=_describe_interface(),
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


def _describe_interface() -> str:
    input_types = ', '.join((*KEYPOINT_TYPES[1:], HRI_SKELETON))
    sections = {
        'after --ros-args': {
            '-p tracker.window:=2.0': 'set a parameter; may be repeated',
            '-p node.input_type:=TYPE': f'accept another type of keypoint messages: {input_types}',
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
    lines = []
    for title, entries in sections.items():
        width = max(map(len, entries))
        lines += [f'{title}:', *(f'  {name:<{width}}  {text}' for name, text in entries.items()), '']
    return '\n'.join(lines)
