"""people_msgs/People: name, place and velocity of each person, for the social layers of Nav2's costmaps."""

from __future__ import annotations

from collections.abc import Sequence

from mocap_ros.messages.cdr import Header, create_header, create_message, encode
from mocap_ros.messages.foreign.definitions import PEOPLE
from mocap_ros.messages.robots.shared import compute_reliability, create_point, known_velocity
from mocap_ros.people import Person3D

TAGS = ('predicted',)  # names of the tags of each person; their values are true or false


def encode_people(header: Header, people: Sequence[Person3D]) -> bytes:
    """Encode where people are, between their hips, and how they move.

    Args:
        header: time of the image, and the frame in which the people are.
        people: the people.
    """
    entries = [
        create_message(
            'people_msgs/msg/Person',
            name=person.id,
            position=create_point(person.root),
            velocity=create_point(known_velocity(person)),
            reliability=compute_reliability(person),
            tagnames=list(TAGS),
            tags=[str(person.predicted).lower()],
        )
        for person in people
    ]
    return encode(create_message(PEOPLE, header=create_header(header), people=entries), PEOPLE)
