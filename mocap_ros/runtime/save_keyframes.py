# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The YAML file of keyframes, which `reconstruct --choices` reads."""

from __future__ import annotations

from typing import Any

import yaml

from mocap_ros.offline.keyframes.keyframe_set import KeyframeSet
from mocap_ros.solvers.observed_window import ObservedWindow

# The comment above the keyframes in the YAML file.
HEADER = """\
# Keyframes of {name}. start_ns: stamp of the first frame of the person, ns; time: s from then on; represents:
# number of frames that the keyframe represents; spans: first and last time of every run of these frames, s.
# To compute the 3D pose of a keyframe by Taylor's method, add to it the outer joints of the limbs that point
# towards the camera (the other limbs point away), and optionally the scale in px per m, for example:
#     forward: [lelbow, lwrist]
#     scale: 250
# Then run: mocap-ros reconstruct --method keyframes --choices THIS_FILE
"""


def list_keyframe_entries(
    observed: ObservedWindow, keyframes: tuple[KeyframeSet, KeyframeSet]
) -> list[dict[str, Any]]:
    """Return the entry of every keyframe in the YAML file, upper body first, sorted by time.

    Returns:
        Mappings with the keys `half` (upper or lower), `time` (s from the beginning), `represents` (number of
        frames) and `spans` (pairs of times in s).
    """
    times = observed.times - observed.times[0]
    return [
        {
            'half': half.body_half.name,
            'time': round(float(times[half.frames[key]]), 6),
            'represents': int((half.assignment == key).sum()),
            'spans': [
                [round(float(times[first]), 3), round(float(times[last]), 3)]
                for first, last in half.find_runs(int(key))
            ],
        }
        for half in keyframes
        for key in half.chronological_order
    ]


def format_yaml(
    observed: ObservedWindow, keyframes: tuple[KeyframeSet, KeyframeSet], name: str, start_ns: int
) -> str:
    """Return the text of the YAML file of keyframes, which `reconstruct --choices` and `view --keyframes` read.

    Args:
        observed: The keypoints in which the keyframes were found.
        keyframes: Keyframes of the upper and the lower half of the body.
        name: Name of the recording, for the comment.
        start_ns: Stamp of the first frame in ns, from which on the times of the keyframes count.
    """
    tree = {'start_ns': start_ns, 'keyframes': list_keyframe_entries(observed, keyframes)}
    content = yaml.safe_dump(tree, sort_keys=False, default_flow_style=None)
    return HEADER.format(name=' '.join(name.split())) + content
