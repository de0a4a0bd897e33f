"""Everyone that a detector saw in the images of one camera, and the one of them who is reconstructed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count, pairwise
from math import gcd

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from mocap_ros.errors import InputError
from mocap_ros.formats import sequence_file
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.person import Person2D
from mocap_ros.keypoints.validation import first_fault, looks_normalised, tidied
from mocap_ros.skeleton import joint_map, layout

Array = NDArray[np.float64]

LAYOUTS = {
    17: 'coco17',
    18: 'coco18',
    25: 'body25',
    26: 'halpe26',
    33: 'mediapipe33',
    133: 'coco17',
    136: 'halpe26',
}
USUAL_SIZES = ((640, 480), (1280, 720), (1920, 1080), (2560, 1440), (3840, 2160), (7680, 4320))

MOST_FRAMES = 1_000_000
LONGEST_GAP_S = 3.0
FARTHEST_MATCH = 1.0  # body sizes (RMS radius)
GREATEST_SPEED = 3.0  # body sizes a second


@dataclass(frozen=True)
class Video:
    """What the files of a detector do not say of the video.

    Attributes:
        fps: frames a second.
        image_size: (width, height) px.
        layout: of the keypoints, as in `skeleton.LAYOUT_NAMES`; empty to tell it from their number.
    """

    fps: float | None = None
    image_size: tuple[int, int] | None = None
    layout: str = ''


@dataclass(frozen=True, eq=False)
class Detections:
    """Everyone in every frame.

    Attributes:
        people: (F,) those in each frame; an empty id: not known who.
        stamps_ns: (F,) ns, strictly increasing.
        image_size: (width, height) px, or None where unknown.
        intrinsics: of the camera, or None where unknown.
        frame_id: the camera's optical frame, or empty.
        remarks: what the reader left out, a line each.
    """

    people: Sequence[Sequence[Person2D]]
    stamps_ns: Sequence[int]
    image_size: tuple[int, int] | None = None
    intrinsics: Intrinsics | None = None
    frame_id: str = ''
    remarks: tuple[str, ...] = ()


@dataclass(eq=False)
class Track:
    """One person over time: what was seen of them, by frame."""

    id: str
    seen: dict[int, Person2D] = field(default_factory=dict)

    @property
    def last(self) -> int:
        """The last frame with them."""
        return next(reversed(self.seen))

    @property
    def newest(self) -> Person2D:
        """What was seen of them there."""
        return self.seen[self.last]


def person_of(raw: Array, layout_name: str = '', person_id: str = '', names: Sequence[str] = ()) -> Person2D:
    """A checked person.

    Args:
        raw: (J, 3) x, y in px and score; those beyond the joints of the layout are left out.
        layout_name: of the joints, or empty to tell it from their number.
        person_id: given by the detector, or empty.
        names: (J,) of the joints, where the file has them.

    Raises:
        InputError: unknown layout, too few joints, or a keypoint that cannot be used.
    """
    if not layout_name and not names and len(raw) not in LAYOUTS:
        raise InputError(f'{len(raw)} keypoints: no layout known; name it')
    joints = tuple(names) if names and not layout_name else layout(layout_name or LAYOUTS[len(raw)]).joints
    if len(raw) < len(joints):
        raise InputError(f'{len(raw)} keypoints, expected {len(joints)}')
    joint_map(joints)
    points, score = raw[: len(joints), :2], raw[: len(joints), 2]
    fault = first_fault(points, score)
    if fault:
        raise InputError(f'{fault.field} of {joints[fault.index[0]]} is {fault.what}')
    return Person2D(person_id, joints, *tidied(points, score))


def numbered(frames: Mapping[int, Sequence[Person2D]], video: Video) -> Detections:
    """Detections from frames by number; frames that are missing between them show nobody.

    Raises:
        InputError: no frames, no frame rate, or numbers too far apart for a video.
    """
    if not frames:
        raise InputError('no frames')
    if video.fps is None:
        raise InputError('says no times; give the frames a second (--fps)')
    numbers = sorted(frames)
    step = gcd(*(b - a for a, b in pairwise(numbers))) or 1
    every = range(numbers[0], numbers[-1] + 1, step)
    if len(every) > MOST_FRAMES:
        raise InputError(f'frames are numbered {numbers[0]} to {numbers[-1]}: not those of one video')
    stamps = [round((number - numbers[0]) / video.fps * sequence_file.NS) for number in every]
    return Detections([frames.get(number, ()) for number in every], stamps, video.image_size)


def tracks(detections: Detections) -> list[Track]:
    """Everyone over time: by the detector's ids, the nameless by position; in the order of appearance."""
    found: list[Track] = []
    by_id: dict[str, Track] = {}
    nameless: list[Track] = []
    taken = {person.id for people in detections.people for person in people}
    free_names = (name for name in (f'person_{n}' for n in count(1)) if name not in taken)

    def gap_s(track: Track, frame: int) -> float:
        return (detections.stamps_ns[frame] - detections.stamps_ns[track.last]) / sequence_file.NS

    alone = all(len(people) <= 1 for people in detections.people)
    for frame, people in enumerate(detections.people):
        for person in people:
            if person.id and (person.score > 0).any():
                if person.id not in by_id:
                    found.append(by_id.setdefault(person.id, Track(person.id)))
                by_id[person.id].seen[frame] = person
        new = [p for p in people if not p.id and (p.score > 0).any()]
        if not alone:
            nameless = [t for t in nameless if gap_s(t, frame) <= LONGEST_GAP_S]
        matches = _matches(new, nameless, [gap_s(t, frame) for t in nameless], alone)
        for i, person in enumerate(new):
            if i not in matches:
                matches[i] = Track(next(free_names))
                nameless.append(matches[i])
                found.append(matches[i])
            matches[i].seen[frame] = person
    return found


def _matches(
    new: Sequence[Person2D], old: Sequence[Track], gaps: Sequence[float], alone: bool
) -> dict[int, Track]:
    """Which of the known tracks, last seen so many s ago, each of the new people continues."""
    if not new or not old:
        return {}
    if alone:
        return {0: old[0]}
    excess = np.array(
        [
            [
                _apart(p, t.newest) / (FARTHEST_MATCH + GREATEST_SPEED * gap)
                for t, gap in zip(old, gaps, strict=True)
            ]
            for p in new
        ]
    )
    rows, columns = linear_sum_assignment(np.minimum(excess, 1e6))
    return {int(r): old[c] for r, c in zip(rows, columns, strict=True) if excess[r, c] < 1}


def _apart(a: Person2D, b: Person2D) -> float:
    """Distance of two detections, in body sizes (RMS radius)."""
    both = (a.score > 0) & (b.score > 0) if a.joints == b.joints else np.zeros(0, bool)
    size = max(_radius(a), _radius(b), 1.0)
    if both.any():
        return float(np.median(np.linalg.norm(a.points[both] - b.points[both], axis=1))) / size
    return float(np.linalg.norm(np.nanmean(a.points, axis=0) - np.nanmean(b.points, axis=0))) / size


def _radius(person: Person2D) -> float:
    seen = person.points[person.score > 0]
    return float(np.sqrt(((seen - seen.mean(axis=0)) ** 2).sum(axis=1).mean()))


def sequence_of(detections: Detections, wanted: str | None = None) -> tuple[sequence_file.Sequence, list[str]]:
    """The keypoints of one person.

    Args:
        detections: everyone.
        wanted: whom; the one seen in most frames by default.

    Returns:
        The sequence, from the first frame with that person to the last, and lines that say who and what was
        left out or assumed.

    Raises:
        InputError: nobody is there, or not the one who is wanted.
    """
    everyone = tracks(detections)
    if not everyone:
        raise InputError('nobody is seen in any frame')
    chosen = _chosen(everyone, wanted)
    frames = range(min(chosen.seen), max(chosen.seen) + 1)
    names = tuple(dict.fromkeys(name for person in chosen.seen.values() for name in person.joints))
    column = {name: i for i, name in enumerate(names)}
    keypoints = np.full((len(frames), len(names), 3), [np.nan, np.nan, 0.0])
    for frame, person in chosen.seen.items():
        at = [column[name] for name in person.joints]
        keypoints[frame - frames[0], at] = np.column_stack([person.points, person.score])
    lines = [
        f'person {chosen.id!r}, seen in {len(chosen.seen)} of {len(detections.people)} frames'
        + (f'; {len(everyone) - 1} more, choose by --person: {_listed(everyone)}' if len(everyone) > 1 else ''),
        *detections.remarks,
    ]
    size = detections.image_size
    if size is None:
        size = _usual_size(keypoints)
        lines.append(f'image size not known, taken as {size[0]}x{size[1]} px; --image-size says it')
    if looks_normalised(keypoints[..., :2], keypoints[..., 2], size[0]):
        raise InputError('keypoints look normalised; px expected')
    stamps = tuple(detections.stamps_ns[frame] for frame in frames)
    sequence = sequence_file.Sequence(
        keypoints=keypoints,
        joint_names=names,
        timestamps=np.array(stamps) / sequence_file.NS,
        image_size=size,
        person_id=chosen.id,
        frame_id=detections.frame_id,
        recorded_ns=stamps,
        calibration=detections.intrinsics,
    )
    return sequence, lines


def _chosen(everyone: Sequence[Track], wanted: str | None) -> Track:
    if wanted is None:
        return max(everyone, key=lambda track: len(track.seen))
    by_id = {track.id: track for track in everyone}
    if wanted not in by_id:
        raise InputError(f'no person {wanted!r}; there are {_listed(everyone)}')
    return by_id[wanted]


def _listed(everyone: Sequence[Track], most: int = 5) -> str:
    """The people seen most, with the number of frames."""
    often = Counter({track.id: len(track.seen) for track in everyone}).most_common(most)
    return ', '.join(f'{name} ({n})' for name, n in often) + (', ...' if len(everyone) > most else '')


def _usual_size(keypoints: Array) -> tuple[int, int]:
    """The smallest usual image (px) that holds nearly every seen point; `keypoints` (F, J, 3)."""
    seen = keypoints[keypoints[..., 2] > 0][:, :2]
    extent = np.percentile(seen, 99, axis=0) if len(seen) else np.zeros(2)
    return next((size for size in USUAL_SIZES if (extent <= size).all()), USUAL_SIZES[-1])
