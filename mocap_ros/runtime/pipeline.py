"""From the bytes of an input message to the bytes of the outputs: what the live node and a replay both feed.

Pure but for the tracker's state: no ROS, no clock, no files.
"""

from __future__ import annotations

import traceback
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from mocap_ros.bags.journal import Verdict
from mocap_ros.bags.topics import PEOPLE_SOURCES, Source
from mocap_ros.config import Config
from mocap_ros.errors import FrameDropped, InputError, SkeletonError
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.camera_info import CameraInfo, check_size, decode_camera_info, image_size
from mocap_ros.messages.cameras import CAMERAS, encode_cameras
from mocap_ros.messages.cdr import Header, OutputMessage
from mocap_ros.messages.keypoints import KeypointsFrame
from mocap_ros.messages.markers import MARKERS, MarkerMemory
from mocap_ros.messages.point_cloud import POINTS, encode_points
from mocap_ros.messages.skeletons import (
    SKELETON_DEFINITION,
    SKELETONS,
    encode_skeleton_definition,
    encode_skeletons,
)
from mocap_ros.messages.transforms import TRANSFORMS, encode_transforms
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.model_file import load_base_pose_models
from mocap_ros.people import Person3D
from mocap_ros.runtime.frame_assembly import NO_STAMP, PeopleReader
from mocap_ros.skeleton import CMU15
from mocap_ros.tracking.tracker import Tracker

OUTPUTS = {
    'skeletons': SKELETONS,
    'cameras': CAMERAS,
    'markers': MARKERS,
    'points': POINTS,
}
TF_OUTPUT = {'/tf': TRANSFORMS}
FAULTS_BEFORE_RESET = 3
BACKLOG = (
    'passed over, newer messages were waiting: the node falls behind; lower tracker.components, '
    'tracker.iterations or tracker.refine_seconds, send fewer frames or people, or use a faster core'
)
LATCHED_OUTPUTS = {'skeleton_definition': SKELETON_DEFINITION}


@dataclass(frozen=True)
class Outcome:
    """What became of an input: of a message, or of one of the images that it completes.

    Attributes:
        verdict: accepted or not; of several images the worst.
        reason: why not; where accepted, what is worth saying all the same, mostly nothing.
        outputs: to publish and record, of every image that was accepted.
        fault: traceback of an error of ours, mostly empty.
    """

    verdict: Verdict
    reason: str = ''
    outputs: tuple[OutputMessage, ...] = ()
    fault: str = ''


def _refusal(error: Exception) -> Outcome:
    """Of a message or an image that was not accepted because of this."""
    if isinstance(error, InputError):
        return Outcome(Verdict.INVALID, str(error))
    if isinstance(error, FrameDropped):
        return Outcome(Verdict.DROPPED, str(error))
    reason = f'internal error: {type(error).__name__}: {error}'
    return Outcome(Verdict.DROPPED, reason, fault=''.join(traceback.format_exception(error)))


def _together(outcomes: Sequence[Outcome]) -> Outcome:
    """Of a message that completed several images, or one."""
    return Outcome(
        max(o.verdict for o in outcomes),
        '; '.join(o.reason for o in outcomes if o.reason),
        tuple(output for o in outcomes for output in o.outputs),
        '\n'.join(o.fault for o in outcomes if o.fault),
    )


@dataclass
class Counters:
    """What became of the inputs so far; `dropped` by reason."""

    accepted: int = 0
    invalid: int = 0
    dropped: Counter[str] = field(default_factory=Counter)


class FrameTracker(Protocol):
    """What the pipeline needs of a tracker; attributes as in `tracker.Tracker`."""

    went_back: float
    output_ns: int

    def update(self, stamp_ns: int, people: tuple[Person2D, ...], intrinsics: Intrinsics) -> tuple[Person3D, ...]:
        """As `tracker.Tracker.update`."""

    def examine(self) -> None:
        """As `tracker.Tracker.examine`."""

    def reset(self) -> None:
        """Forget everything."""


class Pipeline:
    """Decodes, tracks and encodes.

    Args:
        config: of tracker, solver and node.
        models: base poses by name; by default those that the configuration names.
        make_tracker: what tracks.

    Attributes:
        models: base poses in use, by name.
        counters: what became of the inputs, for as long as the pipeline lives.
        camera_info: the CameraInfo message in use, or None.
        header: of the last accepted frame.
        people: who was in the last frame that was put out.

    Raises:
        ModelError: the model cannot be had.
    """

    def __init__(
        self,
        config: Config,
        models: Mapping[str, BasePoses] | None = None,
        make_tracker: Callable[[Mapping[str, BasePoses], Config], FrameTracker] = Tracker,
    ) -> None:
        self.config = config
        self.counters = Counters()
        self.camera_info: bytes | None = None
        self._camera: CameraInfo | None = None
        self.models = models or load_base_pose_models(config.tracker.model)
        self._make_tracker = make_tracker
        self._tracker = make_tracker(self.models, config)
        self._markers = MarkerMemory()
        self._reader = PeopleReader()
        self._faults = 0
        self.header = Header(0, '')
        self.people: tuple[Person3D, ...] = ()

    @property
    def swapped_frames(self) -> int:
        """Frames of people so far whose left and right were put right."""
        return int(getattr(self._tracker, 'swapped_frames', 0))

    @property
    def unusable_people(self) -> int:
        """Detections so far of which too little was seen."""
        return int(getattr(self._tracker, 'unusable_people', 0))

    def feed(self, source: Source, raw: bytes, topic: str = '') -> Outcome:
        """Take any input; never raises, neither for a bad one nor for an error of ours.

        Args:
            source: what it is.
            raw: CDR.
            topic: on which it came; of use for bodies only, which it names.
        """
        try:
            frames = self._frames(source, raw, topic)
        except Exception as error:
            outcomes = [_refusal(error)]
        else:
            outcomes = [self._processed(frame) for frame in frames] or [Outcome(Verdict.ACCEPTED)]
        outcome = _together(outcomes)
        self._count(source, outcome)
        return outcome

    def idle(self) -> str:
        """What the next input would have to wait for otherwise: to be called when the outputs of `feed` are out.

        Returns:
            The traceback of an error of ours, mostly empty.
        """
        try:
            self._tracker.examine()
        except Exception:
            return traceback.format_exc()
        return ''

    def _frames(self, source: Source, raw: bytes, topic: str) -> list[KeypointsFrame]:
        """The images that a message completes.

        Raises:
            InputError: the message cannot be used; names the field.
            FrameDropped: its image was complete already.
        """
        if source is Source.CAMERA_INFO:
            self.set_camera_info(raw)
            return []
        node = self.config.node
        size = image_size(self._camera, node)
        return self._reader.read(source, raw, topic, node, size, self.config.tracker.restart_after)

    def _processed(self, frame: KeypointsFrame) -> Outcome:
        """Track the people of an image; where that is accepted, one message for each of `OUTPUTS`."""
        try:
            people = self._tracked(frame, self._intrinsics(frame))
            outputs = self._outputs(Header(self._tracker.output_ns, frame.header.frame_id), people)
        except Exception as error:
            if isinstance(error, FrameDropped) and frame.header.stamp_ns == self.header.stamp_ns == 0:
                error = FrameDropped(NO_STAMP)
            return _refusal(error)
        self.header, self.people = frame.header, people
        back = self._tracker.went_back
        return Outcome(
            Verdict.ACCEPTED, f'time went back by {back:.1f} s: started afresh' if back else '', outputs
        )

    def _count(self, source: Source, outcome: Outcome) -> None:
        """Count what became of an input; forget everybody where errors of ours go on."""
        self._faults = self._faults + 1 if outcome.fault else 0
        if self._faults == FAULTS_BEFORE_RESET:
            self._tracker.reset()
        if outcome.fault:
            self.counters.dropped['internal error'] += 1
        elif outcome.verdict is Verdict.DROPPED:
            self.counters.dropped['stamp'] += 1
        elif outcome.verdict is Verdict.INVALID:
            self.counters.invalid += 1
        elif source in PEOPLE_SOURCES:
            self.counters.accepted += 1

    def set_camera_info(self, raw: bytes) -> None:
        """Take a sensor_msgs/CameraInfo, which holds for the frames after it.

        Raises:
            InputError: it cannot be used.
        """
        self._camera = decode_camera_info(raw, rectified=self.config.node.rectified_input)
        self.camera_info = raw

    def note_backlog(self) -> Outcome:
        """Count an input that was not taken because newer ones were waiting."""
        self.counters.dropped['backlog'] += 1
        return Outcome(Verdict.BACKLOG, BACKLOG)

    def reset(self) -> OutputMessage:
        """Forget everybody; returns the message that deletes all markers."""
        self._tracker.reset()
        self._reader.reset()
        self.people = ()
        cleared = self._markers.clear(self.header)
        return OutputMessage('markers', MARKERS, self.header.stamp_ns, cleared)

    def reconfigure(self, config: Config) -> bool:
        """Take other parameters; returns True where that made the tracker start anew."""
        old, self.config = self.config, config
        if (old.solver, old.tracker) == (config.solver, config.tracker):
            return False
        self._tracker = self._make_tracker(self.models, config)
        return True

    def _intrinsics(self, frame: KeypointsFrame) -> Intrinsics:
        camera, node = self._camera, self.config.node
        said = (frame.image_width, frame.image_height)
        if camera is not None:
            check_size(frame, camera)
            return camera.intrinsics
        for width, height in (said, (node.image_width, node.image_height)):
            if width and height:
                focal = self.config.tracker.nominal_focal_length
                return Intrinsics.nominal(width, height, focal)
        raise InputError(
            'image_width, image_height: not set, and neither CameraInfo nor the parameters '
            'node.image_width and node.image_height say the size of the image'
        )

    def _tracked(self, frame: KeypointsFrame, intrinsics: Intrinsics) -> tuple[Person3D, ...]:
        try:
            return self._tracker.update(frame.header.stamp_ns, frame.people, intrinsics)
        except SkeletonError as error:
            raise InputError(f'people: {error}') from None
        except np.linalg.LinAlgError as error:
            raise InputError(f'people: the reconstruction failed ({error})') from None

    def _outputs(self, header: Header, people: tuple[Person3D, ...]) -> tuple[OutputMessage, ...]:
        node = self.config.node
        data = {
            'skeletons': encode_skeletons(header, people),
            'cameras': encode_cameras(header, people),
            'markers': self._markers.update(header, people, node.marker_lifetime),
            'points': encode_points(header, people),
        }
        types = OUTPUTS
        if node.publish_tf:
            types = OUTPUTS | TF_OUTPUT
            data['/tf'] = encode_transforms(header, people, node.frame_prefix)
        return tuple(OutputMessage(t, types[t], header.stamp_ns, data[t]) for t in data)


def skeleton_definition() -> OutputMessage:
    """The latched message that names the joints of the skeletons."""
    data = encode_skeleton_definition(CMU15)
    return OutputMessage('skeleton_definition', SKELETON_DEFINITION, 0, data)
