# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Find the keyframes of a sequence, list them in a YAML file, and draw them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import yaml
from matplotlib.figure import Figure

from mocap_ros.config import Config
from mocap_ros.keypoints.keypoint_sequence import KeypointSequence
from mocap_ros.offline.keyframes.keyframe_method import find_keyframes, observe_plausible_points
from mocap_ros.offline.keyframes.keyframe_set import KeyframeSet
from mocap_ros.solvers.observed_window import ObservedWindow
from mocap_ros.viewing import plots
from mocap_ros.viewing.keyframe_plots import draw_distances_figure, draw_keyframes_figure

# The comment above the keyframes in the YAML file.
KEYFRAMES_HEADER = """\
# Keyframes of {name}. start_ns: stamp of the first frame of the person, ns; time: s from then on; represents:
# number of frames that the keyframe represents; spans: first and last time of every run of these frames, s.
# To compute the 3D pose of a keyframe by Taylor's method, add to it the outer joints of the limbs that point
# towards the camera (the other limbs point away), and optionally the scale in px per m, for example:
#     forward: [lelbow, lwrist]
#     scale: 250
# Then run: mocap-ros reconstruct --method keyframes --choices THIS_FILE
"""


class FoundKeyframes(NamedTuple):
    """The keyframes of a sequence as a YAML file and as pictures."""

    observed: ObservedWindow
    keyframes: tuple[KeyframeSet, KeyframeSet]  # of the upper and the lower half of the body
    listed: str  # text of the YAML file, which `reconstruct --choices` reads
    poses: Figure  # the keyframes
    distances: Figure  # the distances of all frames


def describe_keyframes(
    sequence: KeypointSequence, name: str, config: Config, progress: Callable[[str], None] = lambda _: None
) -> FoundKeyframes:
    """Find the keyframes of a sequence, of a recording with this name, and draw them.

    `progress` is called with the name of each stage before it begins.
    """
    progress('keypoints')
    observed = observe_plausible_points(sequence, config.tracker)
    keyframes = find_keyframes(observed, config.keyframes, progress)
    progress('pictures')
    return FoundKeyframes(
        observed,
        keyframes,
        format_yaml(observed, keyframes, plots.make_printable(name), sequence.stamps_ns[0]),
        draw_keyframes_figure(observed, keyframes, name),
        draw_distances_figure(observed, keyframes, config.keyframes.beta, name),
    )


def list_keyframe_entries(
    observed: ObservedWindow, keyframes: tuple[KeyframeSet, KeyframeSet]
) -> list[dict[str, Any]]:
    """Return the entry of every keyframe in the YAML file, upper body first, sorted by time.

    The keys are `half` (upper or lower), `time` (s from the beginning), `represents` (number of frames) and
    `spans` (pairs of times in s).
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
    """Return the text of the YAML file of keyframes, which `reconstruct --choices` reads.

    The name of the recording is for the comment; times count from `start_ns`, the stamp of the first frame.
    """
    tree = {'start_ns': start_ns, 'keyframes': list_keyframe_entries(observed, keyframes)}
    content = yaml.safe_dump(tree, sort_keys=False, default_flow_style=None)
    return KEYFRAMES_HEADER.format(name=' '.join(name.split())) + content
