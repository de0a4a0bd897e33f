# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The pipeline shared by the live node and replays: decode an input message, track its people, encode the outputs.

The pipeline uses no ROS, no clock and no files. Its outputs depend only on its inputs, its parameters and the
state of its tracker.
"""

from __future__ import annotations

import math
import traceback
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from mocap_ros.bags.journal import Verdict
from mocap_ros.bags.topics import PEOPLE_SOURCES, TRANSFORM_SOURCES, Source
from mocap_ros.config import Config, TrackerConfig
from mocap_ros.errors import ConfigError, FrameDropped, InputError, SkeletonError
from mocap_ros.geometry.floor import Floor, is_level
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.rigid_transform import RigidTransform, parse_camera_pose
from mocap_ros.keypoints.image_size import resolve_image_size
from mocap_ros.keypoints.person import Person2D
from mocap_ros.messages.camera_info import CameraInfo, check_image_size, decode_camera_info
from mocap_ros.messages.camera_placement import CameraPlacement
from mocap_ros.messages.cdr import Header, OutputMessage
from mocap_ros.messages.foreign.definitions import HRI_SKELETON
from mocap_ros.messages.keypoints import KeypointsFrame
from mocap_ros.messages.robots.predictions import PredictedFrame, read_prediction_times
from mocap_ros.messages.transform_tree import TransformTree
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.model_file import load_base_pose_models
from mocap_ros.people import CameraVertical, Person3D, PredictedPerson
from mocap_ros.runtime.camera_switch import MAX_DISPLACED, CameraSwitch
from mocap_ros.runtime.frame_assembly import MISSING_STAMP, FrameAssembler, is_stamp_missing
from mocap_ros.runtime.input_doubts import InputDoubts
from mocap_ros.runtime.outputs import OutputEncoder
from mocap_ros.runtime.remarks import find_kind
from mocap_ros.solvers.vertical import AUTO, NONE
from mocap_ros.tracking.tracker import Tracker, find_absence
from mocap_ros.tracking.vertical_check import VerticalCheck
from mocap_ros.units import NS_PER_S

CAMERA_MOTION_S = 0.1  # s; over which the motion of the camera is found: as long as velocities are smoothed over
TRACKER_GROUPS = 'solver', 'classifier', 'tracker'  # fields of `Config` that a tracker reads when it is made
CALIBRATION_WAIT_S = 2.5  # s; a CameraInfo comes within it, if at all: publishers send it with every image
MAX_CONSECUTIVE_ERRORS = 3  # messages; after as many internal errors in a row the tracker's state is discarded
BACKLOG_REASON = (
    'the message was skipped because newer messages were waiting, as the node cannot keep up with its input; '
    'lower tracker.components or tracker.iterations, send fewer frames or people, '
    'or use a CPU core that is faster or less busy with other processes'
)


@dataclass(frozen=True)
class ProcessingResult:
    """The result of processing one input message, or one of the images that the message completed.

    Attributes:
        verdict: Whether the input was accepted; the worst verdict of several images.
        reason: Why the input was not accepted, or a remark on an accepted input; usually empty.
        outputs: Messages to publish and to record, from every accepted image.
        error_traceback: Traceback of an internal error; usually empty.
        was_decoded: Whether the message could be decoded, so that it may have had an effect though it was refused.
    """

    verdict: Verdict
    reason: str = ''
    outputs: tuple[OutputMessage, ...] = ()
    error_traceback: str = ''
    was_decoded: bool = True


def _reject(error: Exception) -> ProcessingResult:
    """Return the result of a message or an image whose processing raised this error."""
    if isinstance(error, InputError):
        return ProcessingResult(Verdict.INVALID, str(error))
    if isinstance(error, FrameDropped):
        return ProcessingResult(Verdict.DROPPED, str(error))
    reason = f'internal error: {type(error).__name__}: {error}'
    return ProcessingResult(Verdict.DROPPED, reason, error_traceback=''.join(traceback.format_exception(error)))


def _read_fixed_pose(config: Config) -> RigidTransform | None:
    """Return the transform from the optical frame to `node.output_frame` that the parameters give, if any.

    Raises:
        ConfigError: `node.camera_pose` is not a pose, or there is no frame that it is given in.
    """
    node = config.node
    if not node.camera_pose:
        return None
    if not node.output_frame:
        raise ConfigError('node.camera_pose: needs node.output_frame, the frame in which the pose is given')
    return parse_camera_pose(node.camera_pose, 'node.camera_pose')


def _read_floor_height(config: Config) -> float | None:
    """Return the height of the floor in `node.output_frame` in m, if the parameters give it.

    Raises:
        ConfigError: `node.floor_height` is not a finite number, or there is no frame that it is given in.
    """
    node = config.node
    if not node.floor_height:
        return None
    if not node.output_frame:
        raise ConfigError('node.floor_height: needs node.output_frame, the frame in which the height is given')
    try:
        height = float(node.floor_height)
    except ValueError:
        height = math.nan
    if not math.isfinite(height):
        raise ConfigError(f'node.floor_height = {node.floor_height!r}: expected a number of metres, such as 0')
    return height


def _merge_results(results: Sequence[ProcessingResult]) -> ProcessingResult:
    """Merge the results of the images that one message completed."""
    return ProcessingResult(
        max(r.verdict for r in results),
        '; '.join(r.reason for r in results if r.reason),
        tuple(output for r in results for output in r.outputs),
        '\n'.join(r.error_traceback for r in results if r.error_traceback),
        all(r.was_decoded for r in results),
    )


@dataclass
class Counters:
    """Numbers of input messages so far, by verdict.

    Attributes:
        accepted: Messages of people that were accepted.
        invalid: Messages that could not be used.
        dropped: Messages that were dropped, by reason: `stamp`, `backlog` or `internal error`.
    """

    accepted: int = 0
    invalid: int = 0
    dropped: Counter[str] = field(default_factory=Counter)


class FrameTracker(Protocol):
    """The part of `tracker.Tracker` that the pipeline uses; attributes and methods have the same meaning."""

    @property
    def backward_jump_s(self) -> float:
        """Time in s by which the last accepted stamp went back, so that tracking restarted; else 0."""

    @property
    def output_stamp_ns(self) -> int:
        """Stamp in ns of the frame whose people `update` last returned."""

    @property
    def swapped_frames(self) -> int:
        """Number of frames so far in which a person's left and right were swapped back."""

    @property
    def unusable_people(self) -> int:
        """Number of detections so far that were no person of their own: too little seen, or part of somebody."""

    @property
    def vertical(self) -> CameraVertical | None:
        """What is known of the camera's vertical; None if nothing is."""

    def update(
        self, stamp_ns: int, people: tuple[Person2D, ...], intrinsics: Intrinsics, floor: Floor | None = None
    ) -> tuple[Person3D, ...]:
        """Track the people of an image; see `tracker.Tracker.update`."""

    def predict(self, times_s: Sequence[float]) -> list[list[PredictedPerson]]:
        """Predict the people of the newest image; see `tracker.Tracker.predict`."""

    def run_deferred_work(self) -> None:
        """Check the hypotheses of the tracks; see the method of `tracker.Tracker`."""

    def reset(self) -> None:
        """Discard all tracks and stamps."""


class Pipeline:
    """Decoder, tracker and encoders of one camera's stream of people.

    Args:
        config: Parameters of tracker, solver and node.
        models: Base poses by name; by default those that the parameters name.
        make_tracker: Function that creates the tracker; tests and benchmarks pass their own.

    Attributes:
        config: The parameters in use.
        models: The base poses in use, by name.
        counters: Numbers of inputs by verdict, since the pipeline was created.
        camera_info: The CameraInfo message in use as CDR, or None.
        header: Header of the last accepted image.
        output_header: Header of the outputs of that image, in whose frame the people are put out.
        transforms: All coordinate frames of /tf and /tf_static.
        people: People in the outputs of the last accepted image, in the camera's optical frame.
        doubts: What seems to be wrong with the input, in words, as of that image.

    Raises:
        ConfigError: `node.output_frame` begins with a slash; `node.camera_pose` is not a pose, `node.floor_height`
            no number or above the camera, or either is given without `node.output_frame`; bodies of ROS4HRI are
            both input and output; or `node.prediction_times` are no times up to a second, or people are to be
            predicted with `tracker.lag`.
        ModelError: The base poses cannot be loaded.
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
        self.transforms = TransformTree()
        if config.node.publish_bodies and config.node.input_type == HRI_SKELETON:
            raise ConfigError(f'node.publish_bodies: not with node.input_type {HRI_SKELETON}, of the same topics')
        if config.node.output_frame.startswith('/'):
            raise ConfigError(f'node.output_frame = {config.node.output_frame!r}: frames begin without a slash')
        self._fixed_pose = _read_fixed_pose(config)
        self._floor_height = _read_floor_height(config)
        if self._fixed_pose is not None and self._floor_height is not None:
            camera_z = self._fixed_pose.translation[2]
            if camera_z <= self._floor_height:
                raise ConfigError(
                    f'node.floor_height = {self._floor_height:g}: the camera of node.camera_pose, at z = '
                    f'{camera_z:g} m, is not above it'
                )
        self._prediction_times = read_prediction_times(config)
        self._camera: CameraInfo | None = None
        self._other_cameras: dict[
            str, tuple[CameraInfo, bytes]
        ] = {}  # of cameras that are not in use, by `frame_id`
        self.models = models or load_base_pose_models(config.tracker.model)
        self._make_tracker = make_tracker
        self._tracker = make_tracker(self.models, config)
        self._swapped_before = self._unusable_before = 0  # as the trackers of earlier parameters counted
        self._outputs = OutputEncoder()
        self._assembler = FrameAssembler()
        self._consecutive_errors = 0
        self._begin_checks()
        self._camera_switch = CameraSwitch()
        self.header = self.output_header = Header(0, '')
        self.people: tuple[Person3D, ...] = ()

    def _begin_checks(self) -> None:
        """Forget what the checks of the input have found so far, and which remarks were made."""
        self._vertical_check, self._input_doubts = VerticalCheck(), InputDoubts()
        self._newest_seen_ns = 0  # stamp of the newest image in which somebody was detected
        self._first_nominal_ns: int | None = None  # stamp of the first image of people without a CameraInfo
        self._noted: set[str] = set()  # kinds of remarks that are made once
        self.doubts: tuple[str, ...] = ()

    @property
    def swapped_frames(self) -> int:
        """Number of detections so far whose left and right were swapped back."""
        return self._swapped_before + self._tracker.swapped_frames

    @property
    def unusable_people(self) -> int:
        """Number of detections so far that were no person of their own, as those with too few visible joints."""
        return self._unusable_before + self._tracker.unusable_people

    def feed(self, source: Source, raw: bytes, topic: str = '') -> ProcessingResult:
        """Process an input message; the result reports invalid inputs and internal errors, and nothing is raised.

        Args:
            source: Kind of the message.
            raw: The message as CDR.
            topic: Name of the message's topic; needed only for ROS4HRI bodies, whose topics contain their ids.
        """
        try:
            frames = self._decode_frames(source, raw, topic)
        except Exception as error:
            has_image, results = source in PEOPLE_SOURCES, [replace(_reject(error), was_decoded=False)]
        else:
            has_image = bool(frames)
            results = [self._process_frame(frame) for frame in frames] or [ProcessingResult(Verdict.ACCEPTED)]
        result = _merge_results(results)
        self._count(source, result)
        if has_image:
            self._count_errors(result)
        return result

    def run_deferred_work(self) -> str:
        """Do the work that can wait until the outputs of `feed` are published; call this after publishing them.

        Returns:
            The traceback of an internal error; usually empty.
        """
        try:
            self._tracker.run_deferred_work()
        except Exception:
            return traceback.format_exc()
        return ''

    def _decode_frames(self, source: Source, raw: bytes, topic: str) -> list[KeypointsFrame]:
        """Decode a message and return the images that it completes.

        Raises:
            InputError: The message cannot be used; the error names the field.
            FrameDropped: The image of the message was already complete.
        """
        if source is Source.CAMERA_INFO:
            self.set_camera_info(raw)
            return []
        if source in TRANSFORM_SOURCES:
            self.transforms.add(raw, is_static=source is Source.STATIC_TRANSFORMS)
            return []
        node, camera = self.config.node, self._camera
        configured = (node.image_width, node.image_height)
        size = resolve_image_size(camera=camera.size if camera else None, configured=configured)
        return self._assembler.assemble(source, raw, topic, node, size, self.config.tracker.restart_after)

    def _process_frame(self, frame: KeypointsFrame) -> ProcessingResult:
        """Track the people of an image; the result of an accepted image has one message for each of `OUTPUTS`."""
        node = self.config.node
        try:
            if is_stamp_missing(frame.header.stamp_ns, self.header.stamp_ns):
                raise FrameDropped(MISSING_STAMP)
            camera_remark = self._camera_switch.check(frame.header)
            in_use = self._choose_camera_info(frame.header) if camera_remark else (self._camera, self.camera_info)
            intrinsics = self._find_intrinsics(frame, in_use[0])
            floor, floor_remark = self._find_floor(frame.header, intrinsics)
            if camera_remark:
                self._tracker.reset()
            people = self._track(frame, intrinsics, floor)
            header, camera, remark = self._place_camera(
                Header(self._tracker.output_stamp_ns, frame.header.frame_id)
            )
            times = self._prediction_times
            predicted = [*map(PredictedFrame, times, self._tracker.predict(times))] if times else ()
            outputs = self._outputs.encode(header, people, node, camera, self._tracker.vertical, predicted)
            once = self._check_input(frame, people, intrinsics, floor, floor_remark)
        except Exception as error:
            if isinstance(error, FrameDropped) and frame.header.stamp_ns == self.header.stamp_ns == 0:
                error = FrameDropped(MISSING_STAMP)
            return _reject(error)
        self.header, self.output_header, self.people = frame.header, header, people
        if camera_remark:
            self._change_camera_info(*in_use)
        self._camera_switch.accept(frame.header)
        back_s = self._tracker.backward_jump_s
        if back_s:
            remark = f'the stamp went back by {back_s:.1f} s, so tracking was restarted'
        remarks = camera_remark, remark, *once
        return ProcessingResult(Verdict.ACCEPTED, '; '.join(r for r in remarks if r), outputs)

    def _place_camera(self, header: Header) -> tuple[Header, CameraPlacement, str]:
        """Return the header of the outputs, the camera in its frame, and why that is not `node.output_frame`.

        Args:
            header: Time of the outputs, and the camera's optical frame.
        """
        node, own = self.config.node, CameraPlacement(header.frame_id)
        if not node.output_frame:
            return header, own, ''
        placed = Header(header.stamp_ns, node.output_frame)
        if self._fixed_pose is not None:
            return placed, CameraPlacement(header.frame_id, self._fixed_pose), ''
        frames = node.output_frame, header.frame_id
        try:
            pose = self.transforms.find(*frames, header.stamp_ns, node.transform_tolerance)
        except InputError as error:
            return header, own, f'{error}, so people are put out in the frame of the camera'
        try:
            before = self.transforms.find(*frames, header.stamp_ns, node.transform_tolerance, CAMERA_MOTION_S)
        except InputError:  # the transforms begin later
            return placed, CameraPlacement(header.frame_id, pose), ''
        return placed, CameraPlacement(header.frame_id, pose, before, CAMERA_MOTION_S), ''

    def _find_floor(self, header: Header, intrinsics: Intrinsics) -> tuple[Floor | None, str]:
        """Return the floor at the time of an image, and what `node.floor_height` is not used for, if anything.

        Without `node.floor_height`, a frame whose name says that its z axis is up tells which way is up. With
        `tracker.lag`, people of an earlier image are put out, so a camera that may move tells no more either.

        Args:
            header: header of the image.
            intrinsics: intrinsics of the camera.
        """
        height, pose, node = self._floor_height, self._fixed_pose, self.config.node
        if not node.output_frame or (height is None and not is_level(node.output_frame)):
            return None, ''
        may_move, remark = pose is None, ''
        if pose is None:
            frames = node.output_frame, header.frame_id
            try:
                pose = self.transforms.find(*frames, header.stamp_ns, node.transform_tolerance)
            except InputError:  # of which the outputs tell
                return None, ''
        floor = Floor.find(pose, height)
        if height is not None:
            if floor.camera_height is None:
                camera_z = pose.translation[2]
                remark = f'the camera is at z = {camera_z:.2f} m, below it; people keep the assumed size'
            elif not intrinsics.is_focal_known:
                remark = 'without a CameraInfo it tells which way is up, but not how far away people are'
            elif may_move and self.config.tracker.lag > 0:
                remark = 'with tracker.lag it needs node.camera_pose; people keep the assumed size'
                floor = floor._replace(camera_height=None)
        return floor, remark and f'node.floor_height = {height:g}: {remark}'

    def _check_input(
        self,
        frame: KeypointsFrame,
        people: Sequence[Person3D],
        intrinsics: Intrinsics,
        floor: Floor | None,
        floor_remark: str,
    ) -> list[str]:
        """Return the remarks on an image that are made once, until nobody has been there for long.

        Then the tracker has forgotten everybody, and a part of a bag that begins there must say the same
        (`runtime/parts.py`).
        """
        stamp_ns = frame.header.stamp_ns
        if frame.people or stamp_ns < self._newest_seen_ns:
            self._newest_seen_ns = stamp_ns
        elif self.header.stamp_ns - self._newest_seen_ns > find_absence(self.config.tracker) * NS_PER_S:
            self._begin_checks()
        found = self._input_doubts.advance(stamp_ns, frame.people, people, intrinsics)
        self.doubts = tuple(filter(None, (self._doubt_vertical(people, floor), *found)))
        remarks = self.doubts
        if frame.people:
            remarks = (floor_remark, self._describe_missing_calibration(stamp_ns, intrinsics), *remarks)
        return [self._note_once(r) for r in remarks]

    def _describe_missing_calibration(self, stamp_ns: int, intrinsics: Intrinsics) -> str:
        """Return a remark if people are seen for `CALIBRATION_WAIT_S` by the default nominal focal length."""
        focal = self.config.tracker.nominal_focal_length
        if intrinsics.is_focal_known or focal != TrackerConfig().nominal_focal_length:
            self._first_nominal_ns = None
            return ''
        if self._first_nominal_ns is None or stamp_ns < self._first_nominal_ns:
            self._first_nominal_ns = stamp_ns
        if stamp_ns - self._first_nominal_ns < CALIBRATION_WAIT_S * NS_PER_S:
            return ''
        return (
            f'no CameraInfo: a nominal focal length of {focal:g} longer sides of the image '
            f'({math.degrees(2 * math.atan(0.5 / focal)):.0f} degrees) is assumed, to which distances from the '
            'camera are proportional; publish camera_info or set tracker.nominal_focal_length'
        )

    def _doubt_vertical(self, people: Sequence[Person3D], floor: Floor | None) -> str:
        """Return a remark if people contradict the vertical that a parameter or the output frame gives."""
        tracker, vertical = self.config.tracker, self._tracker.vertical
        is_parameter = tracker.vertical not in (AUTO, NONE)
        if vertical is None or not (is_parameter or (floor is not None and tracker.vertical == AUTO)):
            return ''
        angle_deg = self._vertical_check.advance(self._tracker.output_stamp_ns, people, vertical.direction)
        if angle_deg is None:
            return ''
        if is_parameter:
            name = f'tracker.vertical = {tracker.vertical!r}'
            advice = "check it: it is the direction upwards in the camera's optical frame, whose y axis is down"
        else:
            name = f'node.output_frame = {self.config.node.output_frame!r}, whose z axis is taken as up'
            advice = 'check the pose of the camera'
        return f'{name}: people seem to stand at {angle_deg:.0f} degrees to it; {advice}, unless everybody lies'

    def _note_once(self, remark: str) -> str:
        """Return a remark if it is the first of its kind."""
        kind = find_kind(remark)
        is_known = kind in self._noted
        self._noted.add(kind)
        return '' if is_known else remark

    def _count(self, source: Source, result: ProcessingResult) -> None:
        """Count an input by its result."""
        if result.error_traceback:
            self.counters.dropped['internal error'] += 1
        elif result.verdict is Verdict.DROPPED:
            self.counters.dropped['stamp'] += 1
        elif result.verdict is Verdict.INVALID:
            self.counters.invalid += 1
        if source in PEOPLE_SOURCES and (result.outputs or result.verdict is Verdict.ACCEPTED):
            self.counters.accepted += 1

    def _count_errors(self, result: ProcessingResult) -> None:
        """Reset the tracker after internal errors at `MAX_CONSECUTIVE_ERRORS` successive images."""
        self._consecutive_errors = self._consecutive_errors + 1 if result.error_traceback else 0
        if self._consecutive_errors == MAX_CONSECUTIVE_ERRORS:
            self._tracker.reset()

    def set_camera_info(self, raw: bytes) -> None:
        """Use a sensor_msgs/CameraInfo for all following images.

        Raises:
            InputError: The message cannot be used, or is of another camera than the images, whose own is known.
        """
        camera = decode_camera_info(raw, rectified=self.config.node.rectified_input)
        name, held = self._camera_switch.name, self._camera
        if held and name and held.frame_id == name and camera.frame_id not in ('', name):
            self._remember_camera(camera, raw)
            raise InputError(
                f'header.frame_id: {camera.frame_id!r}, but the people of {name!r} are being tracked, whose '
                'CameraInfo is known; run a node for each camera'
            )
        self._camera, self.camera_info = camera, raw

    def _choose_camera_info(self, header: Header) -> tuple[CameraInfo | None, bytes | None]:
        """Return the CameraInfo of a camera that takes over, decoded and as CDR; None if none is known.

        It is the camera's own if that has come, or else the one in use, unless that is the displaced camera's.
        """
        if header.frame_id in self._other_cameras:
            return self._other_cameras[header.frame_id]
        is_displaced = self._camera is not None and self._camera.frame_id == self._camera_switch.name
        return (None, None) if is_displaced else (self._camera, self.camera_info)

    def _change_camera_info(self, camera: CameraInfo | None, raw: bytes | None) -> None:
        """Use the CameraInfo of a camera that has taken over, and keep the one in use for its return."""
        if camera is self._camera:
            return
        if self._camera is not None and self.camera_info is not None:
            self._remember_camera(self._camera, self.camera_info)
        if camera is not None:
            self._other_cameras.pop(camera.frame_id, None)
        self._camera, self.camera_info = camera, raw

    def _remember_camera(self, camera: CameraInfo, raw: bytes) -> None:
        """Keep the newest CameraInfo of a camera that is not in use."""
        self._other_cameras.pop(camera.frame_id, None)
        self._other_cameras[camera.frame_id] = camera, raw
        if len(self._other_cameras) > MAX_DISPLACED:
            del self._other_cameras[next(iter(self._other_cameras))]

    def note_backlog(self) -> ProcessingResult:
        """Count an input that is skipped because newer inputs are waiting, and return its result."""
        self.counters.dropped['backlog'] += 1
        return ProcessingResult(Verdict.BACKLOG, BACKLOG_REASON)

    def reset(self) -> tuple[OutputMessage, ...]:
        """Discard all people and return the messages that delete them from viewers and planning scenes."""
        self._tracker.reset()
        self._assembler.reset()
        self._begin_checks()
        self.people = ()
        cleared = self._outputs.encode_clear(self.output_header)
        self.header, self._camera_switch = Header(0, ''), CameraSwitch()
        return cleared

    def reconfigure(self, config: Config) -> bool:
        """Use other parameters; return whether the tracker had to be restarted for them.

        Raises:
            MocapError: The parameters cannot be used together, or a file that they name cannot be loaded; nothing
                has changed.
        """
        tracker = self.check(config)
        self.config = config
        if tracker is None:
            return False
        self._swapped_before, self._unusable_before = self.swapped_frames, self.unusable_people
        self._tracker = tracker
        return True

    def check(self, config: Config) -> FrameTracker | None:
        """Return the tracker that other parameters need, or None if they need none; errors as `reconfigure`."""
        read_prediction_times(config)
        if all(getattr(self.config, group) == getattr(config, group) for group in TRACKER_GROUPS):
            return None
        return self._make_tracker(self.models, config)

    def _find_intrinsics(self, frame: KeypointsFrame, camera: CameraInfo | None) -> Intrinsics:
        """Return the intrinsics of a CameraInfo, or nominal ones from the size in the message or parameters."""
        node, before = self.config.node, self._camera
        if camera is not None:
            # The first image of a camera that takes over has the other one's size where its message states none.
            if camera is before or before is None or (frame.image_width, frame.image_height) != before.size:
                check_image_size(frame, camera)
            return camera.intrinsics
        stated, configured = (frame.image_width, frame.image_height), (node.image_width, node.image_height)
        size = resolve_image_size(stated=stated, configured=configured)
        if not all(size):
            raise InputError(
                'image_width, image_height: not set, and neither CameraInfo nor the parameters '
                'node.image_width and node.image_height give the size of the image'
            )
        return Intrinsics.from_image_size(*size, self.config.tracker.nominal_focal_length)

    def _track(self, frame: KeypointsFrame, intrinsics: Intrinsics, floor: Floor | None) -> tuple[Person3D, ...]:
        try:
            return self._tracker.update(frame.header.stamp_ns, frame.people, intrinsics, floor)
        except SkeletonError as error:
            raise InputError(f'people: {error}') from None
        except np.linalg.LinAlgError as error:
            raise InputError(f'people: the reconstruction failed ({error})') from None
