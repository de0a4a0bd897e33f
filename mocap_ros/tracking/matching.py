"""Which tracked person each detection of a frame is: by the detector's id, else by position and size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mocap_ros.keypoints.association import ExpectedExtent, Extent, associate, compute_distance, compute_gate
from mocap_ros.tracking.detection import Detection
from mocap_ros.tracking.track import Track

ID_REUSE_GATE_FACTOR = 5.0  # gates; a detection with a known id that is farther away belongs to another person


@dataclass(frozen=True, eq=False)
class Matches:
    """The matches of a frame.

    Attributes:
        tracks: the track of each detection; None for a detection of nobody known.
        replaced_ids: ids of tracks whose id the detector has given to another person.
    """

    tracks: tuple[Track | None, ...]
    replaced_ids: frozenset[str]


def match_detections(stamp_ns: int, tracks: Sequence[Track], detections: Sequence[Detection]) -> Matches:
    """Match the detections of a frame with the known people.

    Args:
        stamp_ns: ns, time of the image.
        tracks: the known people.
        detections: the detections.
    """
    by_given_id = {t.seen.given_id: t for t in tracks if t.seen.given_id}
    replaced = set()
    for detection in detections:
        track = by_given_id.get(detection.given_id)
        if track is not None and _is_other_person(track.seen.expect_extent(stamp_ns), detection.extent):
            replaced.add(by_given_id.pop(detection.given_id).id)
    tracks_without_id = [t for t in tracks if not t.seen.given_id]
    nameless = [i for i, detection in enumerate(detections) if not detection.given_id]
    nearest = associate(
        [t.seen.expect_extent(stamp_ns) for t in tracks_without_id], [detections[i].extent for i in nameless]
    )
    associated = {
        i: tracks_without_id[index] for i, index in zip(nameless, nearest, strict=True) if index is not None
    }
    matched = tuple(
        by_given_id.pop(detection.given_id, None) if detection.given_id else associated.get(i)
        for i, detection in enumerate(detections)
    )
    return Matches(matched, frozenset(replaced))


def _is_other_person(expected: ExpectedExtent, detected: Extent) -> bool:
    """Return whether a detection with a known id is so far away that the detector has reused the id."""
    return compute_distance(expected, detected) > ID_REUSE_GATE_FACTOR * compute_gate(expected)
