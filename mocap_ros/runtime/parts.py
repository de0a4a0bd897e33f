# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Cut a long bag into parts that are replayed apart and give the same messages as the whole.

A tracker forgets everything about earlier people when nobody was there for `tracker.forget_all_after`. So a bag
may be cut before an image without people, if before that image nobody had been there for as long. It is not cut

- if its people come on several topics (ROS4HRI), whose messages are assembled to images across a cut,
- if its journal holds resets or changes of parameters, but for those of the recorder,
- if its images are of several cameras, as the images of which one are used depends on those before,
- or if transforms are among its inputs, as a part needs those before it.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass

from mocap_ros.bags.journal import PARAMETERS, RecordedRun, read_run
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.topics import Source, find_people_topics, find_people_type, find_transform_topics
from mocap_ros.config import Config, Value, with_values
from mocap_ros.errors import FrameDropped, InputError
from mocap_ros.messages.camera_info import CameraInfo, check_image_size, decode_camera_info
from mocap_ros.messages.input_types import decode_frame
from mocap_ros.runtime.frame_assembly import MISSING_STAMP
from mocap_ros.tracking.tracker import find_absence
from mocap_ros.units import NS_PER_S

ANY_SIZE = (1, 1)  # px, size of images whose messages state none; it does not matter for the number of people


@dataclass(frozen=True)
class Part:
    """A part of a bag that is replayed alone.

    Attributes:
        number: 0 for the first part.
        start_ns: log time in ns from which on inputs belong to it; None for the first part.
        stop_ns: log time in ns from which on they do not; None for the last part.
        inputs_before: number of inputs of the earlier parts.
        camera_info: the CameraInfo in use at its start as CDR; None if there was none.
    """

    number: int
    start_ns: int | None
    stop_ns: int | None
    inputs_before: int
    camera_info: bytes | None


def find_parts(
    bag: Bag, config: Config, topic: str | None = None, camera_info: str | None = None, *, min_seconds: float
) -> list[Part]:
    """Find the parts of a bag, each of which has at least a given length.

    Args:
        bag: the bag.
        config: parameters; of a recorded run, those at its start.
        topic: topic of the keypoints; needed only for a bag with several.
        camera_info: topic of the CameraInfo; needed only for a bag with several.
        min_seconds: s of log time, length of a part at least, but for the last one.

    Returns:
        The parts, at least one.

    Raises:
        InputError: the bag cannot be used.
    """
    inputs = find_people_topics(bag, topic)
    whole = [Part(0, None, None, 0, None)]
    run = read_run(bag)
    if list(inputs.values()) != [Source.KEYPOINTS] or _has_changes(run) or run.lost_count:
        return whole
    if find_transform_topics(bag, config.node, run.input_topics):
        return whole
    config = with_values(config, {'node.input_type': find_people_type(bag, inputs)})
    camera_topic = bag.find_camera_info_topic(next(iter(inputs)), camera_info)
    topics = {*inputs} | ({camera_topic} if camera_topic else set())
    finder = _CutFinder(config, min_seconds)
    for number, message in enumerate(run.leave_out_repeated(bag.messages(topics)), 1):
        if message.topic == camera_topic:
            finder.add_camera_info(message.time_ns, message.raw)
        elif number in run.skipped_inputs:
            finder.add_other(message.time_ns)
        else:
            finder.add_people(number, message.time_ns, message.raw)
    if len(finder.camera_names) > 1:
        return whole
    starts = [*whole, *finder.parts]
    stops = [*(part.start_ns for part in finder.parts), None]
    return [
        Part(i, part.start_ns, stop, part.inputs_before, part.camera_info)
        for i, (part, stop) in enumerate(zip(starts, stops, strict=True))
    ]


def _has_changes(run: RecordedRun) -> bool:
    """Return whether a run was reset or had other parameters later; those of the recorder change no result."""
    entries = [entry for at_input in run.events.values() for entry in at_input]
    return any(
        entry.kind != PARAMETERS or _drop_recorder(entry.parameters) != _drop_recorder(run.parameters)
        for entry in entries
    )


def _drop_recorder(parameters: Mapping[str, Value]) -> dict[str, Value]:
    """Return the parameters but for those of the recorder."""
    return {name: value for name, value in parameters.items() if not name.startswith('recorder.')}


class _CutFinder:
    """Finds the inputs before which a bag may be cut.

    Attributes:
        parts: The parts that begin there.
        camera_names: Names of the optical frames of the images, but for empty ones.
    """

    def __init__(self, config: Config, min_seconds: float) -> None:
        settings = config.tracker
        self._config = config
        self._absence_ns = find_absence(settings) * NS_PER_S
        self._min_ns = min_seconds * NS_PER_S
        self._camera_info: bytes | None = None
        self._camera: CameraInfo | None = None  # the same, decoded
        self._newest_ns: int | None = None  # stamp of the newest image
        self._newest_person_ns: int | None = None  # stamp of the newest image that may show somebody
        self._last_time_ns = -1  # log time of the input before
        self._part_start_ns: int | None = None  # log time of the first input of the current part
        self._shows_people = False  # whether the current part does
        self.parts: list[Part] = []
        self.camera_names: set[str] = set()

    def add_camera_info(self, time_ns: int, raw: bytes) -> None:
        """Add a CameraInfo."""
        self.add_other(time_ns)
        with suppress(InputError):  # the pipeline refuses it, too, and goes on with the one before
            self._camera = decode_camera_info(raw, rectified=self._config.node.rectified_input)
            self._camera_info = raw

    def add_other(self, time_ns: int) -> None:
        """Add an input that is no image."""
        self._last_time_ns = time_ns
        if self._part_start_ns is None:
            self._part_start_ns = time_ns

    def add_people(self, number: int, time_ns: int, raw: bytes) -> None:
        """Add an image by the number of its input."""
        last_time_ns = self._last_time_ns
        self.add_other(time_ns)
        try:
            frame = decode_frame(raw, self._config.node.input_type, self._config.node, ANY_SIZE)
            self.camera_names |= {frame.header.frame_id} - {''}
            if frame.header.stamp_ns == 0:
                raise FrameDropped(MISSING_STAMP)
            if self._camera is not None:
                check_image_size(frame, self._camera)
        except (InputError, FrameDropped):
            self._newest_person_ns = self._newest_ns  # the tracker never gets it; no cut near it
            return
        stamp_ns = frame.header.stamp_ns
        before_ns = self._newest_ns
        if before_ns is None or stamp_ns <= before_ns or frame.people:
            self._newest_ns = stamp_ns if before_ns is None else max(stamp_ns, before_ns)
            self._newest_person_ns = self._newest_ns
            self._shows_people = self._shows_people or bool(frame.people)
            return
        person_ns = self._newest_person_ns
        was_absent = person_ns is not None and before_ns - person_ns > self._absence_ns
        self._newest_ns = stamp_ns
        if self._part_start_ns is None or not was_absent or time_ns <= last_time_ns:
            return
        if self._shows_people and time_ns - self._part_start_ns >= self._min_ns:
            self._part_start_ns, self._shows_people = time_ns, False
            self.parts.append(Part(0, time_ns, None, number - 1, self._camera_info))
