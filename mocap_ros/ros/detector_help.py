# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Text that `detector_node --help` prints: parameters and topics. This module does not import rclpy."""

from __future__ import annotations

import argparse

from mocap_ros.detectors.load import MODEL_FORMATS
from mocap_ros.messages.images import IMAGE, IMAGE_TYPES
from mocap_ros.messages.keypoints import KEYPOINTS

NODE_NAME = 'detector_node'
IMAGE_TOPIC, KEYPOINTS_TOPIC = 'image', 'keypoints'  # relative names
MAX_PEOPLE = 100  # people; far above what a detector finds
# Default and description of each parameter; all are fixed when the node starts.
PARAMETERS: dict[str, tuple[str | int, str]] = {
    'model': ('', f'file of the model: {MODEL_FORMATS}; empty for the model that comes with MediaPipe 0.10.21'),
    'max_people': (1, 'largest number of people to find in an image, by models that find several'),
    'image_type': (IMAGE, f'type of the images: {" or ".join(IMAGE_TYPES)}'),
}


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of the node's command line without the arguments that rclpy parses."""
    sections = {
        'parameters, after --ros-args -p': {
            f'{name}:={default!r}': text for name, (default, text) in PARAMETERS.items()
        },
        'subscribed topic': {IMAGE_TOPIC: ' or '.join(IMAGE_TYPES)},
        'published topic': {KEYPOINTS_TOPIC: KEYPOINTS},
    }
    lines = []
    for title, entries in sections.items():
        width = max(map(len, entries))
        lines += [f'{title}:', *(f'  {name:<{width}}  {text}' for name, text in entries.items()), '']
    return argparse.ArgumentParser(
        prog=NODE_NAME,
        usage=f'{NODE_NAME} [-h] [--ros-args [-p NAME:=VALUE] [-r FROM:=TO] ...]',
        description='Find 2D keypoints in the images of a camera, for mocap_node.',
        epilog='\n'.join(lines),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
