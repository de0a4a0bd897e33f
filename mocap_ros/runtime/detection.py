# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Run a 2D keypoint detector on a video: who is seen when, and where the detector goes over to another person."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

from mocap_ros.detectors.detector import Detector, Image
from mocap_ros.detectors.load import load_detector
from mocap_ros.errors import InputError, ModelError
from mocap_ros.formats.detections import MAX_FRAMES, Detections, PersonTrack, associate_people, create_person
from mocap_ros.formats.video import VideoImage, VideoReader, read_ahead
from mocap_ros.keypoints.person import Person2D
from mocap_ros.units import NS_PER_S

# A function that shows progress while the images are iterated; its second argument is their number, if known.
ShowProgress = Callable[[Iterable[VideoImage], int | None], Iterable[VideoImage]]

MAX_LISTED_CHANGES = 5  # changes of the person that are named in a line
NOBODY_SEEN = 'nobody is seen in any image'


def detect_people(detector: Detector, image: Image, time_s: float) -> list[Person2D]:
    """Return the people whom a detector finds in the next image (H, W, 3).

    Raises:
        InputError: the detector's keypoints are of no known layout, or not valid.
        ModelError: the detector failed.
    """
    return [create_person(keypoints) for keypoints in detector.detect(image, time_s)]


def detect_in_video(
    path: Path,
    model: Path | None,
    max_people: int = 1,
    show_progress: ShowProgress = lambda images, _: images,
    *,
    is_camera: bool = False,
    is_interrupted: Callable[[], bool] = lambda: False,
) -> Detections:
    """Run a detector on all images of a video.

    Args:
        path: the video, or the device of a camera.
        model: file of the detector's model, None for the model that comes with some versions of MediaPipe.
        max_people: largest number of people to find in an image.
        show_progress: function that shows progress, and that may end a camera's images.
        is_camera: whether `path` is a camera.
        is_interrupted: tells whether to end while a camera gives no image.

    Returns:
        The people in each image. Their ids are those of `name_people`; the remarks name the detector, what was
        left out, and why the images ended early.

    Raises:
        InputError: the video cannot be decoded, is too long, or shows nobody; the error names it.
        ModelError: the model cannot be used; the error names it.
        Both end the images of a camera instead, which nobody can show again, once somebody was detected.
    """
    with VideoReader(path, is_camera=is_camera) as reader:
        detector = load_detector(model, max_people)
        people: list[Sequence[Person2D]] = []
        stamps_ns: list[int] = []
        size = (0, 0)
        ending = ''
        images = read_ahead(iter(reader), is_ended=is_interrupted if is_camera else None)
        try:
            shown = show_progress(images, reader.image_count)
            for item, found in _detect_in_images(shown, detector, path, model):
                people.append(found)
                stamps_ns.append(round(item.time_s * NS_PER_S))
                size = item.image.shape[1], item.image.shape[0]
        except (InputError, ModelError) as error:
            if not (is_camera and any(people)):
                raise
            ending = f'warning: ended early: {str(error).removeprefix(f"{path}: ")}'
        finally:
            images.close()
            detector.close()
        left_out, ending = reader.left_out, ending or reader.ending
    if not any(people):
        raise InputError(f'{path}: {NOBODY_SEEN} ({len(people)} images, {detector.name})')
    remarks = [f'keypoints by {detector.name}']
    if left_out:
        remarks.append(f'{left_out} images left out that are damaged or not later than the one before')
    if ending:
        remarks.append(ending)
    detections, changes = name_people(Detections(people, stamps_ns, size))
    return replace(detections, remarks=(*remarks, *changes))


def _detect_in_images(
    images: Iterable[VideoImage], detector: Detector, path: Path, model: Path | None
) -> Iterator[tuple[VideoImage, list[Person2D]]]:
    """Yield each image of a video with the people in it; the arguments are those of `detect_in_video`.

    Raises:
        InputError: the size of the images changes, or there are more than `MAX_FRAMES`; the error names the video.
        ModelError: the detector failed; the error names the model.
    """
    size = (0, 0)
    for count, item in enumerate(images):
        before, size = size, (item.image.shape[1], item.image.shape[0])
        if count and size != before:
            raise InputError(
                f'{path}: the size of the images changes from {before[0]} x {before[1]} px to '
                f'{size[0]} x {size[1]} px at {item.time_s:.3f} s'
            )
        if count == MAX_FRAMES:
            raise InputError(f'{path}: more than {MAX_FRAMES} images')
        try:
            yield item, detect_people(detector, item.image, item.time_s)
        except ModelError as error:
            raise ModelError(f'{model or detector.name}: {error}') from None


def name_people(detections: Detections) -> tuple[Detections, list[str]]:
    """Name the people of a detector that does not tell who is who, by where they are.

    A detector of one person may change from one person to another. These are two people here, told apart by the
    gates of `keypoints.association`, whatever the gaps, and a line says so.

    Args:
        detections: people without ids.

    Returns:
        The same people with ids, and lines that name the changes.
    """
    tracks = associate_people(replace(detections, is_one_person=False))
    id_by_person = {id(person): track.id for track in tracks for person in track.detection_by_frame.values()}
    people = [
        [replace(person, id=id_by_person[id(person)]) for person in in_frame if id(person) in id_by_person]
        for in_frame in detections.people
    ]
    changes = _describe_changes(detections, tracks) if all(len(p) <= 1 for p in people) else []
    return replace(detections, people=people), changes


def _describe_changes(detections: Detections, tracks: Sequence[PersonTrack]) -> list[str]:
    """Return a line about the frames in which a detector of one person goes over to another person."""
    seen = sorted((frame, track.id) for track in tracks for frame in track.detection_by_frame)
    changes = [
        f'at {detections.stamps_ns[frame] / NS_PER_S:.2f} s from {before} to {after}'
        for (_, before), (frame, after) in pairwise(seen)
        if before != after
    ]
    if not changes:
        return []
    listed = ', '.join(changes[:MAX_LISTED_CHANGES])
    more = f' and {len(changes) - MAX_LISTED_CHANGES} times more' if len(changes) > MAX_LISTED_CHANGES else ''
    return [f'warning: the detector jumps between people: {listed}{more}']
