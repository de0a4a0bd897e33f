# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""visualization_msgs/MarkerArray: the capsules of bodies, and where people will be, for RViz and Foxglove.

A capsule is a CYLINDER and a SPHERE_LIST with a ball at each end (namespaces `cylinders` and `ends`). A predicted
person is a LINE_LIST along the bones for each time ahead, the paler the later; its namespace is that time, such as
`0.4 s`, so that a viewer can hide it. Both have the colour of the person in the other markers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from mocap_ros.messages.camera_placement import CameraPlacement
from mocap_ros.messages.cdr import Header
from mocap_ros.messages.marker_writer import (
    CYLINDER,
    LINE_LIST,
    SPHERE_LIST,
    AlikeMarkers,
    Colors,
    MarkerSeries,
    MarkerStyle,
    choose_color,
)
from mocap_ros.messages.robots.capsules import MAX_PARTS, compute_all_capsules
from mocap_ros.messages.robots.collision_objects import find_capsule_poses
from mocap_ros.messages.robots.predictions import PredictedFrame
from mocap_ros.messages.stacked_people import stack_people
from mocap_ros.people import Person3D
from mocap_ros.skeleton import CMU15

CAPSULE_STYLE = MarkerStyle(0.75, 0.3)  # chosen for the look: the bones within can be seen
GHOST_SCALE = np.array(
    [0.02, 0.0, 0.0]
)  # m; width of lines, chosen for the look: thinner than the bones of people
GHOST_SATURATION = 0.4  # chosen for the look
GHOST_OPACITY = 0.2, 0.7  # chosen for the look: of the latest, and what the earliest have more
NO_POSE = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])  # of points that are in the frame of the header
_BONE_ENDS = np.array(CMU15.bone_ends).T.ravel()


def encode_capsule_markers(
    series: MarkerSeries, header: Header, people: Sequence[Person3D], numbers: Mapping[str, int], lifetime_s: float
) -> bytes:
    """Encode the capsules of people as markers.

    Args:
        series: encoder of the topic.
        header: time of the image, and the frame in which the people are.
        people: the people.
        numbers: number of each person's markers and colour, by id.
        lifetime_s: s after which a viewer removes the markers by itself, 0 for never.
    """
    if not people:
        return series.encode_update(header, [], lifetime_s)
    stacked = stack_people(people)
    capsules, (length, poses) = stacked.share(compute_all_capsules), stacked.share(find_capsule_poses)
    own, parts = [numbers[i] for i in stacked.ids], capsules.radius.shape[1]
    number = (np.array(own)[:, None] * MAX_PARTS + np.arange(parts)).ravel()
    colors = np.repeat([choose_color(n, CAPSULE_STYLE) for n in own], parts, axis=0)
    balls = np.repeat(2 * capsules.radius.reshape(-1, 1), 3, axis=1)
    rods = np.column_stack([balls[:, :2], length.ravel()])
    ends = np.stack([capsules.start, capsules.end], axis=2).reshape(-1, 2, 3)
    resting = np.broadcast_to(NO_POSE, (len(ends), len(NO_POSE)))
    groups = [
        AlikeMarkers(
            'cylinders', CYLINDER, number, poses.reshape(-1, 7), rods, colors, np.zeros((len(ends), 0, 3))
        ),
        AlikeMarkers('ends', SPHERE_LIST, number, resting, balls, colors, ends),
    ]
    return series.encode_update(header, groups, lifetime_s)


def encode_prediction_markers(
    series: MarkerSeries,
    header: Header,
    frames: Sequence[PredictedFrame],
    camera: CameraPlacement,
    numbers: Mapping[str, int],
    lifetime_s: float,
) -> bytes:
    """Encode predicted people as markers.

    Args:
        series: encoder of the topic.
        header: time of the image, and the frame in which the people are put out.
        frames: the people at each time, in the frame from which `camera` places them.
        camera: the camera in the frame of the header.
        numbers: number of each person's markers and colour, by id.
        lifetime_s: s after which a viewer removes the markers by itself, 0 for never.
    """
    last, groups = max((ahead for ahead, _ in frames), default=0.0), []
    for ahead, predicted in frames:
        people = camera.place_predicted(predicted, ahead)
        if not people:
            continue
        own = np.array([numbers[p.id] for p in people])
        opacity = GHOST_OPACITY[0] + GHOST_OPACITY[1] * (1 - ahead / last)
        style = MarkerStyle(GHOST_SATURATION, opacity)
        colors: Colors = np.array([choose_color(n, style) for n in own.tolist()])
        points = np.array([p.joints[_BONE_ENDS] for p in people])
        scales = np.broadcast_to(GHOST_SCALE, (len(people), 3))
        resting = np.broadcast_to(NO_POSE, (len(people), len(NO_POSE)))
        groups.append(AlikeMarkers(f'{ahead:g} s', LINE_LIST, own, resting, scales, colors, points))
    return series.encode_update(header, groups, lifetime_s)
