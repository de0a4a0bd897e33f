# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The pipeline shared by the live node and replays: decode an input message, track its people, encode the outputs.

The pipeline uses no ROS, no clock and no files. Its outputs depend only on its inputs, its parameters and the
state of its tracker.
"""

from __future__ import annotations

import traceback
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from mocap_ros.bags.journal import Acceptance
from mocap_ros.bags.topics import PEOPLE_SOURCES, TRANSFORM_SOURCES, Source
from mocap_ros.config import Config
from mocap_ros.errors import ConfigError, FrameDropped, InputError
from mocap_ros.findings import find_worst
from mocap_ros.formats.reading_options import find_focal_length
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.image_size import UNKNOWN_SIZE, ImageSize, resolve_image_size
from mocap_ros.messages.camera_info import CameraInfo, check_image_size, decode_camera_info
from mocap_ros.messages.cdr import Header, OutputMessage, read_frame_id
from mocap_ros.messages.keypoints import KeypointsFrame
from mocap_ros.messages.skeletons import read_prediction_times
from mocap_ros.messages.transform_tree import TransformTree
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.models.model_file import load_base_pose_models
from mocap_ros.people import People
from mocap_ros.runtime.frame_assembly import MISSING_STAMP, FrameAssembler, is_stamp_missing
from mocap_ros.runtime.input_camera import GIVEN, KNOWN, NOMINAL, CalibrationWait, FocalSource, InputCamera
from mocap_ros.runtime.output_frame import OutputFrame
from mocap_ros.runtime.outputs import OutputEncoder
from mocap_ros.runtime.run_memory import NOTHING, RunMemory
from mocap_ros.tracking.tracker import PeopleTracker
from mocap_ros.units import NS_PER_S
from mocap_ros.verdict.input_faults import InputChecks
from mocap_ros.verdict.summary import RunSummary

TRACKER_GROUPS = 'solver', 'classifier', 'tracker'  # fields of `Config` that a tracker reads when it is made
NOTED_GAP_S = 10.0  # s between the stamps of successive images, from which on a note says so
MAX_CONSECUTIVE_ERRORS = 3  # messages; after as many internal errors in a row the tracker's state is discarded
BACKLOG_REASON = (
    'the message was skipped because newer messages were waiting, as the node cannot keep up with its input; '
    'lower tracker.components or tracker.iterations, send fewer frames or people, '
    'or use a CPU core that is faster or less busy with other processes'
)


@dataclass(frozen=True)
class ProcessingResult:
    """The result of processing one input message, or one of the images that the message completed."""

    acceptance: Acceptance  # whether the input was accepted; the worst of several images
    reason: str = ''  # why the input was not accepted, or what is to be said of an accepted input; usually empty
    outputs: tuple[OutputMessage, ...] = ()  # messages to publish and to record, from every accepted image
    error_traceback: str = ''  # traceback of an internal error; usually empty
    # Whether the message could be decoded, so that it may have had an effect though it was refused
    was_decoded: bool = True

    @classmethod
    def of_error(cls, error: Exception, *, was_decoded: bool) -> ProcessingResult:
        """Return the result of a message or an image whose processing raised this error."""
        if isinstance(error, InputError | FrameDropped):
            acceptance = Acceptance.INVALID if isinstance(error, InputError) else Acceptance.DROPPED
            return cls(acceptance, str(error), was_decoded=was_decoded)
        reason = f'internal error: {type(error).__name__}: {error}'
        return cls(Acceptance.DROPPED, reason, (), ''.join(traceback.format_exception(error)), was_decoded)

    @classmethod
    def merge(cls, results: Sequence[ProcessingResult]) -> ProcessingResult:
        """Return the result of a message that completed several images, or none."""
        if not results:
            return cls(Acceptance.ACCEPTED)
        return cls(
            max(r.acceptance for r in results),
            '; '.join(r.reason for r in results if r.reason),
            tuple(output for r in results for output in r.outputs),
            '\n'.join(r.error_traceback for r in results if r.error_traceback),
            all(r.was_decoded for r in results),
        )


@dataclass
class Counters:
    """Numbers of input messages so far, by what became of them."""

    accepted: int = 0  # messages of people that were accepted
    invalid: int = 0  # messages that could not be used
    # Messages that were dropped, by reason: `stamp`, `backlog` or `internal error`
    dropped: Counter[str] = field(default_factory=Counter)


class Pipeline:
    """Decoder, tracker and encoders of one camera's stream of people.

    Tests and benchmarks pass base poses and a tracker of their own.

    Attributes:
        counters: Numbers of inputs by what became of them, since the pipeline was created.
        header: Header of the last accepted image.
        output_header: Header of the outputs of that image, in whose frame the people are published.
        people: People in the outputs of the last accepted image, in the camera's optical frame.
        checks: What seems to be wrong with the input, as of that image.
        summary: What the people rest on, and whether the input is sound, since the pipeline was created.
    """

    def __init__(
        self,
        config: Config,
        models: Mapping[str, PoseModel] | None = None,
        make_tracker: Callable[..., Any] = PeopleTracker,
    ) -> None:
        self.config = config
        self.counters = Counters()
        self._output_frame = OutputFrame(config.node)
        self._prediction_times = read_prediction_times(config)
        _check_lens(config)
        self.models = models or load_base_pose_models(config.tracker.model)
        self._make_tracker = make_tracker
        self._tracker: PeopleTracker = make_tracker(self.models, config)
        self._checked = config, self._tracker  # the last parameters that were checked, and their tracker
        self.swapped_frames = 0  # detections so far whose left and right were swapped back
        # detections so far that were no person of their own, as those with too few visible joints
        self.unusable_people = 0
        self._outputs = OutputEncoder()
        self._assembler = FrameAssembler()
        self._camera = InputCamera()
        self._camera_note = ''
        self.checks, self.summary = InputChecks(), RunSummary()
        self._wait = CalibrationWait()
        self._consecutive_errors = 0
        self.header = self.output_header = Header(0, '')
        self.people = People.none()

    @property
    def camera_info(self) -> bytes | None:
        """The newest CameraInfo message that was accepted as CDR, or None."""
        return self._camera.calibration.raw if self._camera.calibration else None

    @property
    def missing_camera(self) -> str:
        """The `frame_id` of images for which only the CameraInfo of another camera has come; usually empty."""
        name = self._camera.name
        return name if self.focal_source == NOMINAL and self._camera.describe_other(name) else ''

    @property
    def focal_source(self) -> FocalSource:
        """Where the focal length of the next image is from."""
        calibration, node = self._camera.find_calibration(''), self.config.node
        if calibration is not None and calibration.intrinsics.is_focal_known:
            return KNOWN
        return GIVEN if node.hfov or node.focal else NOMINAL

    @property
    def transforms(self) -> TransformTree:
        """All coordinate frames of /tf and /tf_static."""
        return self._output_frame.transforms

    def feed(self, source: Source, raw: bytes, topic: str = '') -> ProcessingResult:
        """Process an input message; the result reports invalid inputs and internal errors, and nothing is raised.

        The topic is needed only for ROS4HRI bodies, whose topics contain their ids.
        """
        try:
            frames = self._decode_frames(source, raw, topic)
        except Exception as error:
            has_image, result = source in PEOPLE_SOURCES, ProcessingResult.of_error(error, was_decoded=False)
        else:
            has_image, result = bool(frames), ProcessingResult.merge([*map(self._process_frame, frames)])
            if source is Source.CAMERA_INFO:
                result = ProcessingResult(Acceptance.ACCEPTED, self._take_camera_note())
        self._count(source, result)
        if has_image:
            self._consecutive_errors = self._consecutive_errors + 1 if result.error_traceback else 0
            if self._consecutive_errors == MAX_CONSECUTIVE_ERRORS:
                self._tracker.reset()
        return result

    def run_deferred_work(self) -> str:
        """Do the work that can wait until the outputs of `feed` are published; return an error's traceback."""
        try:
            self._tracker.run_deferred_work()
            self.summary.advance_judgement()
        except Exception:
            return traceback.format_exc()
        return ''

    def note_backlog(self) -> ProcessingResult:
        """Count an input that is skipped because newer inputs are waiting, and return its result."""
        self.counters.dropped['backlog'] += 1
        return ProcessingResult(Acceptance.BACKLOG, BACKLOG_REASON)

    def set_camera_info(self, raw: bytes, topic: str = '') -> None:
        """Use a sensor_msgs/CameraInfo for all following images, as `InputCamera.add_calibration` does."""
        self._camera.add_calibration(decode_camera_info(raw, rectified=self.config.node.rectified_input), topic)

    def _take_camera_note(self) -> str:
        """Return what the CameraInfo in use is not used for, or replaces, once until it changes."""
        calibration, before, node = self._camera.calibration, self._camera_note, self.config.node
        is_lens_ignored = self.focal_source == KNOWN and (node.hfov or node.focal)
        ignored = 'the camera is calibrated; node.hfov and node.focal are not used' if is_lens_ignored else ''
        self._camera_note = '; '.join(filter(None, (calibration.note if calibration else '', ignored)))
        return '' if self._camera_note == before else self._camera_note

    @property
    def memory(self) -> RunMemory:
        """What a recording keeps that starts now."""
        return RunMemory(self._wait.is_over, self._tracker.list_names())

    def reset(self, memory: RunMemory = NOTHING) -> tuple[OutputMessage, ...]:
        """Discard all people but for what is remembered, and return the messages that delete them from viewers."""
        self._tracker.reset()
        self._tracker.recall_names(memory.names)
        self._assembler.reset()
        self._camera.reset()
        self._output_frame.forget_imu()
        self.checks = InputChecks()
        self.summary.restart()
        self._wait = CalibrationWait(is_over=self._wait.is_over or memory.has_waited)
        self.people = People.none()
        self.header = Header(0, '')
        return self._outputs.encode_clear(self.output_header)

    def reconfigure(self, config: Config) -> bool:
        """Use other parameters; return whether the tracker had to be restarted. An error leaves all as it was."""
        if config != self._checked[0]:
            self.check(config)
        self.config, tracker = self._checked
        if tracker is self._tracker:
            return False
        self._tracker = tracker
        return True

    def check(self, config: Config) -> None:
        """Make the tracker that other parameters need, if they need one, for `reconfigure`; errors as there."""
        _check_lens(config)
        read_prediction_times(config)
        is_same = all(getattr(self.config, group) == getattr(config, group) for group in TRACKER_GROUPS)
        self._checked = config, self._tracker if is_same else self._make_tracker(self.models, config)

    def _decode_frames(self, source: Source, raw: bytes, topic: str) -> list[KeypointsFrame]:
        if source is Source.CAMERA_INFO:
            self.set_camera_info(raw, topic)
            return []
        if source in TRANSFORM_SOURCES:
            self.transforms.add(raw, is_static=source is Source.STATIC_TRANSFORMS)
            return []
        if source is Source.IMU:
            self._output_frame.add_imu(raw, self.config.node)
            return []
        size, restart_after = self._find_size(read_frame_id(raw)), self.config.tracker.restart_after
        return self._assembler.assemble(source, raw, topic, self.config.node, size, restart_after)

    def _process_frame(self, frame: KeypointsFrame) -> ProcessingResult:
        """Track the people of an image; the result of an accepted image has one message for each of `OUTPUTS`."""
        config, tracker, stamp_ns = self.config, self._tracker, frame.header.stamp_ns
        faults = self.checks.add_stamp(stamp_ns)
        self.summary.rate = find_worst(self.checks.rate, self.summary.rate)
        try:
            if is_stamp_missing(stamp_ns, self.header.stamp_ns):
                raise FrameDropped(MISSING_STAMP)
            size = self._find_size(frame.header.frame_id, (frame.image_width, frame.image_height))
            restart = self._camera.check(frame.header, size)
            calibration = self._camera.find_calibration(frame.header.frame_id)
            intrinsics, focal_source = self._find_intrinsics(frame, calibration, size)
            if (
                calibration is None
                and focal_source == NOMINAL
                and self._wait.is_waiting(stamp_ns, config.node.camera_info_wait)
            ):
                return ProcessingResult(Acceptance.ACCEPTED, '; '.join(faults))
            restart = restart or self._wait.find_restart(focal_source)
            floor = self._output_frame.find_floor(frame.header, intrinsics, config)
            if restart:
                tracker.reset()
            tracked = tracker.update(stamp_ns, frame.people, intrinsics, floor[0])
            self.swapped_frames += tracked.swapped
            self.unusable_people += tracked.unusable
            if tracked.has_restarted:
                self._outputs.restart()
            shown = Header(tracked.stamp_ns, frame.header.frame_id)
            header, placement, reason = self._output_frame.place_camera(shown, config.node)
            predicted = tracker.predict(self._prediction_times) if self._prediction_times else ()
            height_m = config.tracker.camera_height if tracked.is_floor_seen else 0.0
            known_m = height_m or None if floor[0] is None else floor[0].camera_height
            outputs = self._outputs.encode(
                header, tracked.people, config.node, placement, tracked.vertical, predicted, known_m
            )
            self.summary.add(stamp_ns, frame.people, tracked, intrinsics, focal_source, config)
            other_camera = self._camera.describe_other(frame.header.frame_id) if focal_source == NOMINAL else ''
            faults += self.checks.advance(
                frame, intrinsics, tracked, config, floor, self.summary.finding, other_camera
            )
        except Exception as error:
            if isinstance(error, FrameDropped) and stamp_ns == self.header.stamp_ns == 0:
                error = FrameDropped(MISSING_STAMP)
            result = ProcessingResult.of_error(error, was_decoded=True)
            return replace(result, reason='; '.join((result.reason, *faults)))
        before_ns = self.header.stamp_ns
        self.header, self.output_header, self.people = frame.header, header, tracked.people
        self._camera.accept(frame.header, size)
        if before_ns and stamp_ns - before_ns > NOTED_GAP_S * NS_PER_S:
            gap_s = (stamp_ns - before_ns) / NS_PER_S
            reason = f'a gap of {gap_s:.1f} s before this stamp: no images for so long, or the clock was set'
        if back_s := tracked.backward_jump_s:
            reason = f'the stamp went back by {back_s:.1f} s, so tracking was restarted'
        return ProcessingResult(Acceptance.ACCEPTED, '; '.join(filter(None, (restart, reason, *faults))), outputs)

    def _find_size(self, frame_id: str, stated: ImageSize = UNKNOWN_SIZE) -> ImageSize:
        """Return the size of an image, by the CameraInfo of another camera only where nothing else says it."""
        node, known, newest = self.config.node, self._camera.find_calibration(frame_id), self._camera.calibration
        return resolve_image_size(
            stated=stated,
            camera=known.size if known else None,
            configured=(node.image_width, node.image_height),
            other_camera=newest.size if newest else None,
        )

    def _find_intrinsics(
        self, frame: KeypointsFrame, camera: CameraInfo | None, size: ImageSize
    ) -> tuple[Intrinsics, FocalSource]:
        node = self.config.node
        if camera is not None:
            check_image_size(frame, camera)
            if camera.intrinsics.is_focal_known:
                return camera.intrinsics, KNOWN
        if not all(size):
            raise InputError(
                'image_width, image_height: not set, and neither CameraInfo nor the parameters '
                'node.image_width and node.image_height give the size of the image'
            )
        if node.hfov or node.focal:
            focal = find_focal_length(size[0], node.hfov or None, node.focal or None, 'node.focal')
            return Intrinsics.centred(float(focal or 0), size), GIVEN
        return Intrinsics.from_image_size(*size, self.config.tracker.nominal_focal_length), NOMINAL

    def _count(self, source: Source, result: ProcessingResult) -> None:
        if result.error_traceback:
            self.counters.dropped['internal error'] += 1
        elif result.acceptance is Acceptance.DROPPED:
            self.counters.dropped['stamp'] += 1
        elif result.acceptance is Acceptance.INVALID:
            self.counters.invalid += 1
        if source in PEOPLE_SOURCES:
            self.summary.count(result.acceptance)
            self.counters.accepted += bool(result.outputs) or result.acceptance is Acceptance.ACCEPTED


def _check_lens(config: Config) -> None:
    if config.node.hfov and config.node.focal:
        raise ConfigError('node.focal: node.hfov is given as well; set one of them to 0')
