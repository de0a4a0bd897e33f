"""What `mocap_node --help` says, and the services it tells of; needs no ROS."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from mocap_ros.bags.topics import Source
from mocap_ros.messages.accepted import KEYPOINT_TYPES
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.foreign.definitions import BODY
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.runtime.pipeline import LATCHED_OUTPUTS, OUTPUTS, TF_OUTPUT

SERVICES = {'~/reset': 'std_srvs/srv/Trigger', '~/record': 'std_srvs/srv/SetBool'}
INPUTS = {Source.KEYPOINTS.value: KEYPOINTS, Source.CAMERA_INFO.value: CAMERA_INFO}


def parser() -> argparse.ArgumentParser:
    """The command line of the node, apart from what rclpy takes."""
    return argparse.ArgumentParser(
        prog='mocap_node',
        usage='mocap_node [-h] [--ros-args [-p NAME:=VALUE] [--params-file FILE] [-r FROM:=TO] ...]',
        description='2D keypoints in, 3D people out, live.',
        epilog=_epilog(),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def without_ros_arguments(arguments: Sequence[str]) -> list[str]:
    """What is not between `--ros-args` and `--`."""
    plain, theirs = [], False
    for argument in arguments:
        if argument == '--ros-args' or (theirs and argument == '--'):
            theirs = argument == '--ros-args'
        elif not theirs:
            plain.append(argument)
    return plain


def _epilog() -> str:
    sections = {
        'after --ros-args': {
            '-p tracker.window:=2.0': 'a parameter; may be repeated',
            '-p node.input_type:=TYPE': f'another type of keypoints: {", ".join((*KEYPOINT_TYPES[1:], BODY))}',
            '--params-file FILE': 'parameters from a file; `mocap-ros config > FILE` makes one with all of them',
            '-r keypoints:=/camera/keypoints': 'another name for a topic; may be repeated',
            '--log-level warn': 'say less',
        },
        'topics taken': INPUTS,
        'topics published': OUTPUTS | LATCHED_OUTPUTS | {'/diagnostics': 'diagnostic_msgs/msg/DiagnosticArray'},
        'with -p node.publish_tf:=true': TF_OUTPUT,
        'services': SERVICES,
    }
    lines = []
    for title, entries in sections.items():
        width = max(map(len, entries))
        lines += [f'{title}:', *(f'  {name:<{width}}  {text}' for name, text in entries.items()), '']
    return '\n'.join(lines)
