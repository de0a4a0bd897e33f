"""People are associated over time, and the person to reconstruct is selected."""

from __future__ import annotations

import numpy as np

from mocap_ros.formats.detections import Detections, associate_people, create_person, select_person
from mocap_ros.keypoints.person import Person2D
from mocap_ros.units import NS_PER_S


def make_standing_person(x: float, person_id: str = '') -> Person2D:
    """Return a person 100 px tall whose left edge is at x, in px."""
    points = np.stack([x + np.linspace(0, 30, 17), np.linspace(100, 200, 17), np.ones(17)], axis=1)
    return create_person(points, person_id=person_id)


def make_detections(people: list[list[Person2D]]) -> Detections:
    """Return frames at 25 Hz."""
    return Detections(people, [f * NS_PER_S // 25 for f in range(len(people))], (640, 480))


def test_people_without_ids_are_associated_by_position() -> None:
    on_left = [make_standing_person(100 + f) for f in range(30)]
    on_right = [make_standing_person(400 - f) for f in range(30)]
    people = [[a, b] if f % 2 else [b, a] for f, (a, b) in enumerate(zip(on_left, on_right, strict=True))]
    people[10:15] = [[a] for a in on_left[10:15]]
    left, right = sorted(
        associate_people(make_detections(people)), key=lambda t: t.detection_by_frame[0].points[0, 0]
    )
    assert (len(left.detection_by_frame), len(right.detection_by_frame)) == (30, 25)
    assert [p.points[0, 0] for p in left.detection_by_frame.values()] == list(range(100, 130))
    sequence, lines = select_person(make_detections(people))
    assert sequence.keypoints[0, 0, 0] == 100
    assert f'person {left.id!r}, seen in 30 of 30 frames; 1 more, choose by --person: ' in lines[0]
    assert f'{left.id} (30), {right.id} (25)' in lines[0]
    sequence, _ = select_person(make_detections(people), right.id)
    assert sequence.keypoints[0, 0, 0] == 400


def test_a_person_alone_stays_the_same_through_any_gap() -> None:
    people = [[make_standing_person(100)], *[[] for _ in range(200)], [make_standing_person(500)]]
    assert len(associate_people(make_detections(people))) == 1
    named = [[make_standing_person(100, 'a')], [make_standing_person(500, 'b')], [make_standing_person(100, 'a')]]
    assert [t.id for t in associate_people(make_detections(named))] == ['a', 'b']
