"""From the bytes of an input message to the bytes of the outputs: what the live node and a replay both feed.

Pure but for the tracker's state: no ROS, no clock, no files.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import Protocol

import numpy as np

from mocap_ros.base_poses import BasePoses, load_model
from mocap_ros.config import Config
from mocap_ros.errors import FrameDropped, InputError, SkeletonError
from mocap_ros.io import messages
from mocap_ros.io.journal import Verdict
from mocap_ros.io.markers import MarkerMemory
from mocap_ros.io.messages import CameraInfo, Header, KeypointsFrame, OutputMessage
from mocap_ros.people import Intrinsics, Person2D, Person3D
from mocap_ros.skeleton import CMU15
from mocap_ros.tracker import Tracker

OUTPUTS = {
    'skeletons': messages.SKELETONS,
    'cameras': messages.CAMERAS,
    'markers': messages.MARKERS,
}
LATCHED_OUTPUTS = {'skeleton_definition': messages.SKELETON_DEFINITION}


class Source(Enum):
    """What an input is; the value is the relative name of its topic."""

    KEYPOINTS = 'keypoints'
    CAMERA_INFO = 'camera_info'


@dataclass(frozen=True)
class Outcome:
    """What became of an input.

    Attributes:
        verdict: accepted or not.
        reason: why not; where accepted, what is worth saying all the same, mostly nothing.
        outputs: to publish and record.
    """

    verdict: Verdict
    reason: str = ''
    outputs: tuple[OutputMessage, ...] = ()


@dataclass
class Counters:
    """What became of the inputs so far; `dropped` by reason."""

    accepted: int = 0
    invalid: int = 0
    dropped: Counter[str] = field(default_factory=Counter)


class FrameTracker(Protocol):
    """What the pipeline needs of a tracker; `went_back` as in `tracker.Tracker`."""

    went_back: float

    def update(self, stamp_ns: int, people: tuple[Person2D, ...], intrinsics: Intrinsics) -> tuple[Person3D, ...]:
        """As `tracker.Tracker.update`."""

    def reset(self) -> None:
        """Forget everything."""


class Pipeline:
    """Decodes, tracks and encodes.

    Args:
        config: of tracker, solver and node.
        model: base poses; by default the one that the configuration names.
        make_tracker: what tracks.

    Attributes:
        counters: what became of the inputs, for as long as the pipeline lives.
        camera_info: the CameraInfo message in use, or None.
        header: of the last accepted frame.

    Raises:
        ModelError: the model cannot be had.
    """

    def __init__(
        self,
        config: Config,
        model: BasePoses | None = None,
        make_tracker: Callable[[BasePoses, Config], FrameTracker] = Tracker,
    ) -> None:
        self.config = config
        self.counters = Counters()
        self.camera_info: bytes | None = None
        self._camera: CameraInfo | None = None
        self._model = model or load_model(config.tracker.model)
        self._make_tracker = make_tracker
        self._tracker = make_tracker(self._model, config)
        self._markers = MarkerMemory()
        self.header = Header(0, '')

    def feed(self, source: Source, raw: bytes) -> Outcome:
        """Take any input; never raises for a bad one."""
        try:
            if source is Source.KEYPOINTS:
                outputs = self.process(raw)
                back = self._tracker.went_back
                said = f'time went back by {back:.1f} s: started afresh' if back else ''
                return Outcome(Verdict.ACCEPTED, said, outputs)
            self.set_camera_info(raw)
        except InputError as error:
            return Outcome(Verdict.INVALID, str(error))
        except FrameDropped as error:
            return Outcome(Verdict.DROPPED, str(error))
        return Outcome(Verdict.ACCEPTED)

    def process(self, raw: bytes) -> tuple[OutputMessage, ...]:
        """Take a Keypoints2DArray.

        Args:
            raw: CDR.

        Returns:
            One message for each of `OUTPUTS`.

        Raises:
            InputError: the message cannot be used; names the field.
            FrameDropped: the tracker does not accept its stamp.
        """
        try:
            frame = messages.decode_keypoints(raw, self.config.node)
            intrinsics = self._intrinsics(frame)
            people = self._tracked(frame, intrinsics)
        except InputError:
            self.counters.invalid += 1
            raise
        except FrameDropped:
            self.counters.dropped['stamp'] += 1
            if frame.header.stamp_ns == self.header.stamp_ns == 0:
                raise FrameDropped('header.stamp is not set') from None
            raise
        self.counters.accepted += 1
        self.header = frame.header
        return self._outputs(frame.header, people)

    def set_camera_info(self, raw: bytes) -> None:
        """Take a sensor_msgs/CameraInfo, which holds for the frames after it.

        Raises:
            InputError: it cannot be used.
        """
        try:
            self._camera = messages.decode_camera_info(raw)
        except InputError:
            self.counters.invalid += 1
            raise
        self.camera_info = raw

    def note_overtaken(self) -> Outcome:
        """Count an input that was not taken because newer ones were waiting."""
        self.counters.dropped['overtaken'] += 1
        return Outcome(Verdict.OVERTAKEN, 'newer messages were waiting')

    def reset(self) -> OutputMessage:
        """Forget everybody; returns the message that deletes all markers."""
        self._tracker.reset()
        cleared = self._markers.clear(self.header)
        return OutputMessage('markers', messages.MARKERS, self.header.stamp_ns, cleared)

    def reconfigure(self, config: Config) -> bool:
        """Take other parameters; returns True where that made the tracker start anew."""
        old, self.config = self.config, config
        if (old.solver, old.tracker) == (config.solver, config.tracker):
            return False
        self._tracker = self._make_tracker(self._model, config)
        return True

    def _intrinsics(self, frame: KeypointsFrame) -> Intrinsics:
        camera, node = self._camera, self.config.node
        said = (frame.image_width, frame.image_height)
        if camera is not None:
            calibrated = (camera.width, camera.height)
            if all(said) and all(calibrated) and said != calibrated:
                raise InputError(
                    'image_width, image_height: {} x {} px, but CameraInfo is for {} x {} px'.format(
                        *said, *calibrated
                    )
                )
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
        data = {
            'skeletons': messages.encode_skeletons(header, people),
            'cameras': messages.encode_cameras(header, people),
            'markers': self._markers.update(header, people, self.config.node.marker_lifetime),
        }
        return tuple(OutputMessage(t, OUTPUTS[t], header.stamp_ns, data[t]) for t in OUTPUTS)


def skeleton_definition() -> OutputMessage:
    """The latched message that names the joints of the skeletons."""
    data = messages.encode_skeleton_definition(CMU15)
    return OutputMessage('skeleton_definition', messages.SKELETON_DEFINITION, 0, data)
