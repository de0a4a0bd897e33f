# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""visualization_msgs/MarkerArray: where people will be, for RViz and Foxglove.

A predicted person is a LINE_LIST along the bones for each time ahead, the paler the later; its namespace is that
time, such as `0.4 s`, so that a viewer can hide it. The colour is that of the person in the other markers.
"""

from __future__ import annotations

import numpy as np

from mocap_ros.bridges.seen import Predictions
from mocap_ros.messages.markers import LINE_LIST, Marker, MarkerStyle, choose_color, show_markers
from mocap_ros.skeleton import CMU15

# All chosen for the look.
GHOST_SCALE = 0.02, 0.0, 0.0  # m; width of lines: thinner than the bones of people
GHOST_SATURATION = 0.4
GHOST_OPACITY = 0.2, 0.7  # of the latest, and what the earliest have more
_BONE_ENDS = np.array(CMU15.bone_ends).T.ravel()


def convert_prediction_markers(predictions: Predictions, before: Predictions) -> bytes:
    """Return the markers of predicted people, which delete those of the message before."""
    return show_markers(predictions.header, _list_markers(predictions), _list_markers(before))


def _list_markers(predictions: Predictions) -> list[Marker]:
    last, markers = max((then.ahead for then in predictions.times), default=0.0), []
    for ahead, numbers, joints in predictions.times:
        style = MarkerStyle(GHOST_SATURATION, GHOST_OPACITY[0] + GHOST_OPACITY[1] * (1 - ahead / last))
        for number, ends in zip(numbers, joints[:, _BONE_ENDS], strict=True):
            color = choose_color(number, style)
            markers.append(Marker(f'{ahead:g} s', number, LINE_LIST, GHOST_SCALE, color, ends))
    return markers
