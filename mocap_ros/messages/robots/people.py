# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""people_msgs/People: name, place and velocity of each person, for the social layers of Nav2's costmaps."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from mocap_ros.messages.cdr import Header
from mocap_ros.messages.robots.shared import compute_reliability
from mocap_ros.messages.stacked_people import stack_people
from mocap_ros.messages.template import DOUBLE, KEPT_TEMPLATES, MessageTemplate, TemplateWriter
from mocap_ros.people import Person3D

TAGS = ('predicted',)  # names of the tags of each person; their values are true or false
POSITION_VELOCITY_RELIABILITY = 3 + 3 + 1  # numbers of a person


def encode_people(header: Header, people: Sequence[Person3D]) -> bytes:
    """Encode where people are, between their hips, and how they move.

    Args:
        header: time of the image, and the frame in which the people are.
        people: the people.
    """
    stacked = stack_people(people)
    template = _lay_out(header.frame_id, tuple([(p.id, p.predicted) for p in stacked]))
    reliability = np.array([compute_reliability(p) for p in stacked])
    numbers = np.column_stack([stacked.roots, stacked.known_velocities, reliability])
    return template.fill(header.stamp_ns, numbers=numbers)


@lru_cache(maxsize=KEPT_TEMPLATES)
def _lay_out(frame_id: str, people: tuple[tuple[str, bool], ...]) -> MessageTemplate:
    """Return the template for people of whom id and `predicted` are given."""
    writer = TemplateWriter()
    writer.add_stamped(frame_id)
    writer.add_count(len(people))
    for person_id, is_predicted in people:
        writer.add_text(person_id)
        writer.add_numbers('numbers', DOUBLE, POSITION_VELOCITY_RELIABILITY)
        for texts in (TAGS, (str(is_predicted).lower(),)):
            writer.add_count(len(texts))
            for text in texts:
                writer.add_text(text)
    return writer.finish_template()
