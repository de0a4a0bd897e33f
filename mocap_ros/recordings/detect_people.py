# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Run a 2D keypoint detector on a video: who is seen when, and where the detector goes over to another person."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

from mocap_ros.detectors.detector import Detector, Image, load_detector
from mocap_ros.errors import InputError, ModelError, naming
from mocap_ros.formats.detections import MAX_FRAMES, Detections, associate_people, create_person
from mocap_ros.formats.reading_options import ShowProgress
from mocap_ros.formats.video import VideoReader, read_ahead
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.image_size import UNKNOWN_SIZE, ImageSize
from mocap_ros.keypoints.person import Person2D
from mocap_ros.units import NS_PER_S

MAX_LISTED_CHANGES = 5  # changes of the person that are named in a line
NO_PERSON_SEEN = 'no person is seen in any image'


def detect_people(detector: Detector, image: Image, time_s: float) -> list[Person2D]:
    """Return the people whom a detector finds in the next image (H, W, 3)."""
    return [create_person(keypoints) for keypoints in detector.detect(image, time_s)]


def detect_in_video(
    path: Path,
    model: Path | None,
    max_people: int | None = None,
    show_progress: ShowProgress | None = None,
    *,
    is_camera: bool = False,
    is_interrupted: Callable[[], bool] = lambda: False,
) -> Detections:
    """Run a detector on all images of a video, or of a camera that is given as its device.

    Model and number of people are those of `load_detector`. `show_progress` may end the images of a
    camera, and `is_interrupted` says whether to end while it gives none. An error ends them, too, once a person
    was detected, as they cannot be shown again.
    """
    people: list[Sequence[Person2D]] = []
    stamps_ns: list[int] = []
    size, ending = UNKNOWN_SIZE, ''
    with VideoReader(path, is_camera=is_camera) as reader:
        detector = load_detector(model, max_people)
        images = read_ahead(iter(reader), is_ended=is_interrupted if is_camera else None)
        try:
            for item in show_progress(images, reader.image_count) if show_progress else images:
                with naming(f'{path}: at {item.time_s:.3f} s'):
                    size = check_image(item.image, len(people), size)
                people.append(detect_people(detector, item.image, item.time_s))
                stamps_ns.append(round(item.time_s * NS_PER_S))
        except (InputError, ModelError) as error:
            if isinstance(error, ModelError):
                error = ModelError(f'{model or detector.name}: {error}')
            if not (is_camera and any(people)):
                raise error from None
            ending = f'warning: ended early: {str(error).removeprefix(f"{path}: ")}'
        finally:
            images.close()
            detector.close()
    if not any(people):
        raise InputError(f'{path}: {NO_PERSON_SEEN} ({len(people)} images, {detector.name})')
    left_out = f'{reader.left_out} images left out that are damaged or not later than the one before'
    notes: tuple[str, ...] = (
        f'keypoints by {detector.name}',
        left_out if reader.left_out else '',
        ending or reader.ending,
    )
    intrinsics = None
    if (focal := reader.find_focal_length(size)) is not None:
        intrinsics = Intrinsics.centred(focal, size)
        notes = *notes, f'focal length of {reader.focal_mm:g} mm (on film of 35 mm) by the video'
    detections, changes = name_people(Detections(people, stamps_ns, size, intrinsics))
    return replace(detections, notes=(*filter(None, notes), *changes))


def check_image(image: Image, count: int, before: ImageSize) -> ImageSize:
    """Return the size of an image, which must be that of those `before`, of which `count` are kept."""
    size = image.shape[1], image.shape[0]
    if before not in (UNKNOWN_SIZE, size):
        change = f'from {before[0]} x {before[1]} px to {size[0]} x {size[1]} px'
        raise InputError(f'the size of the images changes {change}')
    if count == MAX_FRAMES:
        raise InputError(f'more than {MAX_FRAMES} images')
    return size


def name_people(detections: Detections) -> tuple[Detections, list[str]]:
    """Name the people of a detector that does not say who is who, by where they are.

    A detector of one person may change from one person to another, and a line that is returned says so.
    """
    tracks, _ = associate_people(detections)
    people: list[list[Person2D]] = [[] for _ in detections.people]
    for track in tracks:
        for frame, person in track.detection_by_frame.items():
            people[frame].append(replace(person, id=track.id))
    seen = sorted((frame, track.id) for track in tracks for frame in track.detection_by_frame)
    changes = [
        f'at {detections.stamps_ns[frame] / NS_PER_S:.2f} s from {before} to {after}'
        for (_, before), (frame, after) in pairwise(seen)
        if before != after
    ]
    named = replace(detections, people=people)
    if not changes or any(len(in_frame) > 1 for in_frame in people):
        return named, []
    listed = ', '.join(changes[:MAX_LISTED_CHANGES])
    more = f' and {len(changes) - MAX_LISTED_CHANGES} times more' if len(changes) > MAX_LISTED_CHANGES else ''
    return named, [f'warning: the detector jumps between people: {listed}{more}']
