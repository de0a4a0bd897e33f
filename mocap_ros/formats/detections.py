# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""All people that a detector saw in the images of one camera, and the choice of the person to reconstruct.

People are who the live tracker takes them for (`keypoints.identities`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from math import gcd
from operator import itemgetter
from typing import Any

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.config import TrackerConfig
from mocap_ros.errors import InputError
from mocap_ros.formats.image_names import ImageOrder, order_images
from mocap_ros.formats.reading_options import ReadingOptions
from mocap_ros.formats.sequence_file import MAX_TIMESTAMP_S
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.identities import FollowedPerson, Identities
from mocap_ros.keypoints.image_size import UNKNOWN_SIZE, ImageSize, resolve_image_size
from mocap_ros.keypoints.joint_map import build_joint_map
from mocap_ros.keypoints.keypoint_sequence import KeypointSequence
from mocap_ros.keypoints.matching import DetectedBody
from mocap_ros.keypoints.person import Person2D, choose_depth
from mocap_ros.keypoints.validation import describe_other_unit, describe_rate, mark_unseen
from mocap_ros.skeleton import keypoint_layout
from mocap_ros.units import NS_PER_S

# The layout that a detector's file means by its number of keypoints. The 133 keypoints of COCO-WholeBody begin
# with the 17 of COCO, the 136 of Halpe-FullBody with the 26 of the body, and the 543 or 553 of MediaPipe's body,
# hands and face with the 33 of the body.
LAYOUT_BY_KEYPOINT_COUNT = {
    17: 'coco17', 18: 'coco18', 25: 'body25', 26: 'halpe26', 33: 'mediapipe33', 133: 'coco17', 136: 'halpe26',
    543: 'mediapipe33', 553: 'mediapipe33',
}  # fmt: skip

# Seconds in the unit of a time, by the key or the column that states it
SECONDS_BY_KEY = {
    'timestamp': 1.0, 'timestamp_s': 1.0, 'timestamp_ms': 1e-3, 'timestamp_us': 1e-6, 'timestamp_ns': 1e-9,
}  # fmt: skip

MAX_FRAME_RATE_HZ = 10_000.0  # far above that of any video of people; keeps times that are rounded to 1 us apart
MAX_FRAMES = 1_000_000  # guards the memory against frame numbers that are not of one video; 9 h at 30 Hz
MAX_KEYPOINTS = 50_000_000  # of a person over time; guards the memory; 9 h of body25 have half of it
DEFAULTS = TrackerConfig()
MAX_LISTED_PEOPLE = 5  # people named in a line of output


@dataclass(frozen=True, eq=False)
class Detections:
    """All people in all frames."""

    people: Sequence[Sequence[Person2D]]
    stamps_ns: Sequence[int]  # (F,) ns, strictly increasing
    image_size: ImageSize = UNKNOWN_SIZE  # (width, height) in px, (0, 0) where unknown
    intrinsics: Intrinsics | None = None  # intrinsics of the camera, or None where unknown
    frame_id: str = ''
    notes: tuple[str, ...] = ()  # lines that say what the reader left out


@dataclass(eq=False)
class PersonTrack:
    """The detections of one person over time: the name, and the keypoints by frame, in the order of the frames."""

    id: str
    detection_by_frame: dict[int, Person2D] = field(default_factory=dict)


def create_person(
    keypoints: Array, layout_name: str = '', person_id: str = '', joint_names: Sequence[str] = ()
) -> Person2D:
    """Validate the keypoints (J, 3) of a person from a file: x and y in px, and the score.

    Those beyond the joints of the layout are left out. Without the name of a layout it follows from the names of
    the joints (J,), and without these from the number of keypoints.
    """
    if not layout_name and not joint_names and len(keypoints) not in LAYOUT_BY_KEYPOINT_COUNT:
        raise InputError(
            f'{len(keypoints)} keypoints: no layout known; name them (keypoint_names) in the file or give --layout'
        )
    if not layout_name and 0 < len(joint_names) != len(keypoints):
        raise InputError(f'{len(keypoints)} keypoints, but names of {len(joint_names)}')
    joints = tuple(joint_names)
    if layout_name or not joints:
        joints = keypoint_layout(layout_name or LAYOUT_BY_KEYPOINT_COUNT[len(keypoints)]).joints
    if len(keypoints) < len(joints):
        raise InputError(f'{len(keypoints)} keypoints, expected {len(joints)}')
    build_joint_map(joints)
    points, score, fault = mark_unseen(keypoints[: len(joints), :2], keypoints[: len(joints), 2])
    if fault:
        raise InputError(f'{fault.field} of {joints[fault.index[0]]} is {fault.what}')
    return Person2D(person_id, joints, points, score)


def arrange_frames(
    people_by_image: Mapping[Any, Sequence[Person2D]],
    options: ReadingOptions,
    times_s: Mapping[Any, float] | None = None,
) -> Detections:
    """Arrange images in time, by their `ImageName`; frames whose number is missing show no people.

    If `times_s` has the time in s of every image, these count, unless they can be those of no video and the frame
    rate is given.

    An id that two people of one frame have identifies neither, as the 0 that AlphaPose gives to all people if it
    does not track. It is left out wherever it occurs, and a line of `notes` says so.
    """
    if not people_by_image:
        raise InputError('no frames')
    order = _order_by_times(people_by_image, options, times_s or {}) or order_images(people_by_image)
    notes = [order.note] if order.note else []
    if order.stamps_ns:
        stamps = list(order.stamps_ns.values())
        images = [people_by_image[name] for name in order.stamps_ns]
        if options.fps is not None:
            notes.append('the images have times; --fps is not used')
    else:
        people_by_number = {number: people_by_image[name] for name, number in order.numbers.items()}
        all_numbers, stamps = _number_frames(list(people_by_number), options)
        images = [people_by_number.get(number, ()) for number in all_numbers]
    counts = (Counter(person.id for person in people if person.id) for people in images)
    repeated = {person_id for count_by_id in counts for person_id, n in count_by_id.items() if n > 1}
    people = [[replace(p, id='') if p.id in repeated else p for p in image] for image in images]
    if repeated:
        ids = list_some(sorted(repeated))
        notes.append(f'ids left out, because two people of one frame have the same: {ids}')
    size = resolve_image_size(configured=options.image_size)
    return Detections(people, stamps, size, notes=tuple(notes))


def _order_by_times(
    images: Iterable[Any], options: ReadingOptions, times_s: Mapping[Any, float]
) -> ImageOrder | None:
    stamps = {
        image: round(times_s[image] * NS_PER_S)
        for image in images
        if 0 <= times_s.get(image, -1) < MAX_TIMESTAMP_S
    }
    is_whole = len(stamps) == len(set(stamps.values())) == len(list(images))
    ordered = dict(sorted(stamps.items(), key=itemgetter(1)))
    is_of_video = not describe_rate(np.array([*ordered.values()]) / NS_PER_S)
    return ImageOrder({}, ordered) if is_whole and (is_of_video or options.fps is None) else None


def _number_frames(numbers: Sequence[int], options: ReadingOptions) -> tuple[range, list[int]]:
    """Return the numbers of all frames, also of those that sorted numbers lack, and their times in ns.

    Times count from frame 0; from the first frame where that is 1, or where numbers reach `MAX_FRAMES`.
    """
    fps, times_s, first, last = options.fps, options.facts.times_s, numbers[0], numbers[-1]
    start = 0 if first > 1 and last < MAX_FRAMES else first
    step = gcd(*(b - a for a, b in pairwise(numbers))) or 1
    every = range(first, last + 1, step)
    if fps is None and times_s:
        if last - start >= len(times_s):
            count = f'{len(times_s)} images of {options.video}'
            raise InputError(f'frames are numbered {first} to {last}, beyond the {count}; is it that video?')
        return every, [round(times_s[number - start] * NS_PER_S) for number in every]
    if fps is None:
        raise InputError('the file has no timestamps; give the frame rate (--fps) or the video (--video)')
    if fps > MAX_FRAME_RATE_HZ:
        raise InputError(f'--fps: {fps:.10g} Hz, at most {MAX_FRAME_RATE_HZ:g} Hz expected')
    if len(every) > MAX_FRAMES or (last - first) / fps >= MAX_TIMESTAMP_S:
        raise InputError(f'frames are numbered {first} to {last}: not one video of {fps:g} Hz')
    return every, [round((number - start) / fps * NS_PER_S) for number in every]


def associate_people(
    detections: Detections, settings: TrackerConfig = DEFAULTS
) -> tuple[list[PersonTrack], tuple[str, ...]]:
    """Associate the detections of each person over time, as the live tracker does.

    Detections with fewer than `min_joints` joints are left out, and parts of a person are joined. Returns the
    tracks in the order of their first frame, and lines on what was left out.
    """
    who = Identities[FollowedPerson](settings)
    known = list[FollowedPerson]()
    tracks = dict[str, PersonTrack]()
    unusable = 0
    faults = dict[str, None]()
    size = resolve_image_size(stated=detections.image_size, keypoints=_stack_keypoints(detections))
    camera = detections.intrinsics or Intrinsics.from_image_size(*size, settings.nominal_focal_length)
    for frame, (stamp_ns, found_people) in enumerate(zip(detections.stamps_ns, detections.people, strict=True)):
        people = [person.hide_border(size) for person in found_people]
        converted = DetectedBody.from_people(people, camera, settings.min_score, settings.min_joints)
        seen = [(p, d) for p, d in zip(people, converted, strict=True) if d is not None]
        unusable += len(people) - len(seen)
        for lost in who.find_lost(stamp_ns, known):
            known.remove(lost)
            if lost.id in who.doubles:
                whole = tracks[who.doubles[lost.id]]
                joined = tracks.pop(lost.id).detection_by_frame | whole.detection_by_frame
                whole.detection_by_frame = dict(sorted(joined.items()))
        if who.is_everybody_gone(stamp_ns):
            who = who.restart()
            known = []
        matches = who.match(stamp_ns, known, [d for _, d in seen])
        known = [person for person in known if person not in matches.replaced]
        names = {person.id for person in known}
        is_tentative = who.is_first_tentative(stamp_ns)
        for detection, found, members in zip(matches.detections, matches.tracks, matches.members, strict=True):
            person = found or FollowedPerson(who.name(stamp_ns, detection, names), stamp_ns, is_tentative)
            if found is None:
                known.append(person)
            person.add_frame(stamp_ns, detection)
            track = tracks.setdefault(person.id, PersonTrack(person.id))
            track.detection_by_frame[frame] = _join_parts([seen[m][0] for m in members], settings.min_score)
        who.end_frame(stamp_ns, has_people=bool(seen))
        faults |= dict.fromkeys(who.list_faults())
    few = f'{unusable} detections left out, of which fewer than {settings.min_joints} joints are seen'
    return list(tracks.values()), (*faults, *([few] if unusable else []))


def _join_parts(parts: Sequence[Person2D], min_score: float) -> Person2D:
    """Return a person with those keypoints of the parts, with the same joints, that the first of them lacks."""
    whole = parts[0]
    for part in parts[1:]:
        if part.joints == whole.joints:
            is_added = (whole.score < min_score) & (part.score >= min_score)
            points = np.where(is_added[:, None], part.points, whole.points)
            depth = choose_depth(~is_added, whole.depth, part.depth)
            score = np.where(is_added, part.score, whole.score)
            whole = replace(whole, points=points, score=score, depth=depth)
    return whole


def select_person(
    detections: Detections, person_id: str | None = None, settings: TrackerConfig = DEFAULTS
) -> tuple[KeypointSequence, list[str]]:
    """Select the person with a name, or with an id of the detector, by default the one seen in most frames.

    Returns the keypoints from the first frame with that person to the last, and lines for the user that say who
    was selected, what was left out and what was assumed.
    """
    tracks, ignored = associate_people(detections, settings)
    if not tracks:
        _refuse_other_unit(detections)
        raise InputError(f'no person is seen with {settings.min_joints} joints in any frame')
    frame_counts = Counter({track.id: len(track.detection_by_frame) for track in tracks})
    everybody = list_some([f'{name} ({n})' for name, n in frame_counts.most_common()])
    wanted = frame_counts.most_common(1)[0][0] if person_id is None else person_id
    if wanted not in frame_counts:
        by_id = Counter({t.id: sum(p.id == wanted for p in t.detection_by_frame.values()) for t in tracks})
        ((found, count),) = by_id.most_common(1)
        wanted = found if count else wanted
    if wanted not in frame_counts:
        raise InputError(f'no person {wanted!r}; there are {everybody}')
    line = f'person {wanted!r}, seen in {frame_counts[wanted]} of {len(detections.people)} frames'
    if len(tracks) > 1:
        line += f'; {len(tracks) - 1} more, choose by --person: {everybody}'
    (sequence,), notes = arrange_people(detections, [track for track in tracks if track.id == wanted])
    return sequence, [line, *ignored, *notes]


def arrange_people(
    detections: Detections, tracks: Sequence[PersonTrack]
) -> tuple[list[KeypointSequence], tuple[str, ...]]:
    """Arrange the keypoints of some of the tracks, each from the first frame with that person to the last.

    An image size that is not known is assumed to hold all people. Returns a sequence for each track, and lines on
    what was left out of the detections and assumed of them.
    """
    _refuse_other_unit(detections)
    is_size_assumed = not all(detections.image_size)
    if is_size_assumed:
        size = resolve_image_size(keypoints=_stack_keypoints(detections))
        line = f'image size not known, {size[0]}x{size[1]} px assumed; give it by --image-size or --video'
        detections = replace(detections, image_size=size, notes=(*detections.notes, line))
    sequences = [_arrange_sequence(detections, track) for track in tracks]
    return [replace(s, is_size_assumed=is_size_assumed) for s in sequences], detections.notes


def _stack_keypoints(detections: Detections) -> Array:
    people = [np.column_stack([p.points, p.score]) for in_frame in detections.people for p in in_frame]
    return np.concatenate([np.zeros((0, 3)), *people])


def _refuse_other_unit(detections: Detections) -> None:
    keypoints = _stack_keypoints(detections)
    if fault := describe_other_unit(keypoints[:, :2], keypoints[:, 2], detections.image_size[0]):
        raise InputError(f'keypoints: {fault}')


def _arrange_sequence(detections: Detections, track: PersonTrack) -> KeypointSequence:
    frames = range(min(track.detection_by_frame), max(track.detection_by_frame) + 1)
    names = tuple(dict.fromkeys(name for person in track.detection_by_frame.values() for name in person.joints))
    column = {name: i for i, name in enumerate(names)}
    if len(frames) * len(names) > MAX_KEYPOINTS:
        raise InputError(f'{len(frames)} frames of {len(names)} joints, more than {MAX_KEYPOINTS} keypoints')
    keypoints = np.full((len(frames), len(names), 3), [np.nan, np.nan, 0.0])
    depth = np.full(keypoints.shape[:2], np.nan)
    for frame, person in track.detection_by_frame.items():
        columns = [column[name] for name in person.joints]
        keypoints[frame - frames[0], columns] = np.column_stack([person.points, person.score])
        if person.depth is not None:
            depth[frame - frames[0], columns] = person.depth
    stamps = tuple(detections.stamps_ns[frame] for frame in frames)
    return KeypointSequence(
        keypoints=keypoints,
        joint_names=names,
        timestamps=np.array(stamps) / NS_PER_S,
        image_size=detections.image_size,
        person_id=track.id,
        frame_id=detections.frame_id,
        recorded_ns=stamps,
        calibration=detections.intrinsics,
        recording_start=detections.stamps_ns[0] / NS_PER_S,
        depth=None if np.isnan(depth).all() else depth,
    )


def list_some(people: Sequence[str]) -> str:
    """Return the first `MAX_LISTED_PEOPLE` names in a line."""
    return ', '.join(people[:MAX_LISTED_PEOPLE]) + (', ...' if len(people) > MAX_LISTED_PEOPLE else '')
