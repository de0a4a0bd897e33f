# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Mistakes in valid input: of images that follow one another (`InputChecks`), of lenses and of joint names.

A vertical that people contradict is suspected once they do so for seconds (`VerticalCheck`); misspelt names of
joints, distortions without an inverse, stamps that are those of no camera, and a camera without a calibration are
certain. Whether the points fit their layout and the image, `summary.RunSummary` judges.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable
from functools import lru_cache

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.config import Config, TrackerConfig
from mocap_ros.findings import SOUND, Fault, Finding, Grade, find_kind, find_worst
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.level import Floor
from mocap_ros.keypoints.identities import find_absence
from mocap_ros.keypoints.validation import MIN_JUDGED_FRAMES, describe_rate
from mocap_ros.messages.keypoints import KeypointsFrame
from mocap_ros.models.upward_direction import Stances
from mocap_ros.people import People, TrackedFrame
from mocap_ros.skeleton import CMU15, KNOWN_JOINTS, canonical_joint_names
from mocap_ros.solvers.vertical import AUTO, NONE
from mocap_ros.units import NS_PER_S

# s; a CameraInfo comes within it, if at all: publishers send it with every image
CALIBRATION_WAIT_S = 2.5
MIN_LIKENESS = 0.8  # 1, of difflib; one or two letters of a joint's name
GRID_SIZE = 9  # points in each direction of the middle of the image, at which a lens is checked
# 1; radius of the middle of the image, of half the shorter side. A fisheye whose image circle fits the image shows
# there what is up to 63 degrees from its axis, if it sees half of the space, and up to 86, if it sees 246 degrees.
MIDDLE_RADIUS = 0.7
MAX_LENS_ERROR = 0.01  # of half the shorter side; far above the errors of the inversion where there is an inverse
MAX_DISTORTED_SHARE = 0.2  # 1; part of the middle of the image, in all of which lenses have an inverse
MAX_CACHED_LENSES = 4  # lenses of the cameras of one node
MAX_CACHED_NAMES = 64  # lists of joint names; guards memory against messages that name ever new ones
SLOWEST_STREAM_S = 5.0  # s, from image to image, of detectors that run now and then
MIN_BOX_IMAGES = 10  # images; models for poses leave out keypoints of a low score, at times all of a person
UNUSABLE_S = 2.0  # s; from the first unusable detection, while nobody is shown, until it is described
MIN_OFF_SHARE = 0.8  # 1; P: one person among several for whom it is not so speaks against it
MAX_STEP_S = 1.0  # s; longest time that one frame stands for, so that a stream of 1 Hz still reaches S
MAX_ANGLE_DEG = 40.0  # who sits or bends down is below it, who lies is above
MEMORY_S = 20.0  # s; T, as long as a vertical that is found is remembered
REACH_M = 0.8  # m; from the middle of a body to its hands and feet
MAX_DEPTH_M = 100.0  # m; farther away no depth camera measures anything
MIN_SHARE_NEAR = 0.3  # 1; of depths that are those of a person, of whom furniture may hide the legs and an arm
KEPT_SHARE = 0.99  # 1; of what is known, from frame to frame
MIN_JUDGED_S = 5.0  # s; S, longer than it takes to fall or to lie down for an exercise


class VerticalCheck:
    """Whether people contradict a given vertical for seconds.

    With x_i the share of the people of frame i who do, and dt_i the time for which that frame stands,

        n = sum_i k_i dt_i,    m = sum_i k_i dt_i x_i,    k_i = exp(-(t - t_i) / T)

    they do once n is at least S and m at least the share P of n. Frames without people do not count.

    The directions upwards that poses show (`models.upward_direction`) are compared with the vertical in every
    frame. The lifter takes a wrong vertical for a right one, so poses lean towards it, and errors below 60 degrees
    are hardly seen; a wrong sign or axis is. So it is if all people lie.
    """

    def __init__(self) -> None:
        self._sums = np.zeros(3)  # n and m in s, and the sum of m with the angles in degrees as factors
        self._stamp_ns: int | None = None

    def advance(self, stamp_ns: int, people: People, vertical: Array) -> float | None:
        """Return the mean angle in degrees by which people contradict a vertical (3,); None if they do not."""
        seen = people.core[~(people.tentative | people.predicted)]
        cosines = Stances.of(seen).upward @ vertical
        angles = np.degrees(np.arccos(cosines[np.isfinite(cosines)].clip(-1, 1)))
        age_s = 0.0 if self._stamp_ns is None else (stamp_ns - self._stamp_ns) / NS_PER_S
        self._stamp_ns = stamp_ns
        self._sums *= math.exp(-age_s / MEMORY_S) if age_s >= 0 else 0.0  # less than 0 where the stamps began anew
        if angles.size and age_s > 0:
            is_off = angles > MAX_ANGLE_DEG
            self._sums += min(age_s, MAX_STEP_S) * np.array([1.0, is_off.mean(), (angles * is_off).mean()])
        seconds, seconds_off, degrees_off = self._sums.tolist()
        lasts = seconds >= MIN_JUDGED_S and seconds_off >= MIN_OFF_SHARE * seconds
        return degrees_off / seconds_off if lasts else None


class DepthCheck:
    """Whether measured depths are where people are, by the newest frames, about `1 / (1 - KEPT_SHARE)` of them."""

    def __init__(self) -> None:
        self._sums = np.zeros(3)  # of frames, and of the shares of depths that are near the person, and too far

    def add(self, depth: Array, distance: float) -> None:
        """Add the depths (J,) of a person in a frame, and the person's distance, all in m; NaN is unknown."""
        known = depth[np.isfinite(depth)]
        if len(known) and math.isfinite(distance):
            shares = 1.0, (np.abs(known - distance) < REACH_M).mean(), (known > MAX_DEPTH_M).mean()
            self._sums = KEPT_SHARE * self._sums + shares

    def judge(self) -> Finding:
        """Return what is wrong with the depths."""
        frames, near, far = self._sums.tolist()
        if frames < MIN_JUDGED_FRAMES:
            return SOUND
        if far > frames / 2:
            return Fault.DEPTH_UNIT.found(far=far / frames, limit_m=MAX_DEPTH_M)
        is_near = near > MIN_SHARE_NEAR * frames
        return SOUND if is_near else Fault.DEPTH_ELSEWHERE.found(near=near / frames, reach_m=REACH_M)


class InputChecks:
    """Checks of successive images of one camera; `warnings` says what seems wrong as of the last one."""

    def __init__(self) -> None:
        self._last_ns = 0  # stamp of the last image
        self._stamps: list[int] = []  # of the last images, in ns
        self.rate = SOUND  # whether the stamps can be those of a camera, as of `MIN_JUDGED_FRAMES` of them
        self._has_keypoints = False  # whether any detection so far had some
        self._box_images = 0  # images so far with detections of people without any
        self.reset()

    def reset(self) -> None:
        """Forget what was found so far, and what was described."""
        self._vertical, self._depth = VerticalCheck(), DepthCheck()
        self._newest_seen_ns = 0  # stamp of the newest image in which a person was detected
        self._first_nominal_ns: int | None = None  # stamp of the first image of people without a CameraInfo
        self._unusable_ns: int | None = None  # stamp of the first unusable detection since people were shown
        self._described: set[str] = set()  # kinds of what was described
        self.findings: list[Finding] = []  # as of the last image, but for the rate

    @property
    def warnings(self) -> list[str]:
        """What makes the input doubtful or wrong, in words."""
        return [finding.words for finding in (self.rate, *self.findings) if finding.grade is not Grade.GOOD]

    def add_stamp(self, stamp_ns: int) -> list[str]:
        """Add the stamp of any image; return what is wrong with the stamps and was not described before."""
        self._stamps.append(stamp_ns)
        if len(self._stamps) == MIN_JUDGED_FRAMES:
            words = describe_rate((np.array(self._stamps) - self._stamps[0]) / NS_PER_S, SLOWEST_STREAM_S)
            self.rate = Finding(Grade.DOUBTFUL, Fault.OTHER, words) if words else SOUND
            self._stamps = []
        return self._choose_new([self.rate])

    def advance(
        self,
        frame: KeypointsFrame,
        intrinsics: Intrinsics,
        tracked: TrackedFrame,
        config: Config,
        floor: tuple[Floor | None, str],
        points: Finding = SOUND,
        other_camera: str = '',
    ) -> list[str]:
        """Return what is wrong with the input and was not described before.

        Once no person has been seen for so long that the tracker has forgotten all, everything is described anew.
        The floor, if it is known, comes with what it cannot be used for, in words; `points` is what was found in
        them (`summary.RunSummary`), and `other_camera` why the CameraInfo is not used, in words.
        """
        stamp_ns = frame.header.stamp_ns
        if frame.people or stamp_ns < self._newest_seen_ns:
            self._newest_seen_ns = stamp_ns
        elif self._last_ns - self._newest_seen_ns > find_absence(config.tracker) * NS_PER_S:
            self.reset()
            self._newest_seen_ns = stamp_ns
        self._last_ns = stamp_ns
        calibration = SOUND if other_camera else self._check_calibration(stamp_ns, intrinsics, config)
        of_people = [
            Fault.OTHER.found(Grade.GOOD, words=floor[1]),
            _check_camera_height(intrinsics, config.tracker, floor[0]),
            calibration,
            *(Fault.OTHER.found(Grade.GOOD, words=words) for words in tracked.faults),
        ]
        found = [
            *(of_people if frame.people else ()),
            self._check_keypoints(frame),
            self._check_usable(stamp_ns, tracked),
            self._check_vertical(tracked, config, floor[0]),
            self._check_depth(frame, tracked, intrinsics),
            points._replace(words=f'people: {points.words}') if points.grade is not Grade.GOOD else SOUND,
            find_worst(SOUND, *(find_misspelt_joint(p.joints) for p in frame.people)),
            find_unusable_distortion(intrinsics),
            Fault.OTHER.found(words=other_camera),
        ]
        self.findings = [finding for finding in found if finding.words]
        return self._choose_new(self.findings)

    def _choose_new(self, findings: Iterable[Finding]) -> list[str]:
        new = []
        for words in (finding.words for finding in findings if finding.words):
            if (kind := find_kind(words)) not in self._described:
                self._described.add(kind)
                new.append(words)
        return new

    def _check_keypoints(self, frame: KeypointsFrame) -> Finding:
        self._has_keypoints |= bool(frame.people)
        self._box_images += bool(frame.without_keypoints)
        is_box_model = self._box_images >= MIN_BOX_IMAGES and not self._has_keypoints
        return Fault.NO_KEYPOINTS.found(Grade.GOOD) if is_box_model else SOUND

    def _check_usable(self, stamp_ns: int, tracked: TrackedFrame) -> Finding:
        if len(tracked.people):
            self._unusable_ns = None
        elif tracked.unusable:
            self._unusable_ns = min(stamp_ns, self._unusable_ns or stamp_ns)
            if stamp_ns - self._unusable_ns > UNUSABLE_S * NS_PER_S:
                return Fault.UNUSABLE.found(Grade.GOOD, lasting_s=UNUSABLE_S)
        return SOUND

    def _check_calibration(self, stamp_ns: int, intrinsics: Intrinsics, config: Config) -> Finding:
        focal = config.tracker.nominal_focal_length
        if intrinsics.is_focal_known or focal != TrackerConfig().nominal_focal_length:
            self._first_nominal_ns = None
            return SOUND
        if self._first_nominal_ns is None or stamp_ns < self._first_nominal_ns:
            self._first_nominal_ns = stamp_ns
        if stamp_ns - self._first_nominal_ns < CALIBRATION_WAIT_S * NS_PER_S:
            return SOUND
        hfov_deg = math.degrees(2 * math.atan(0.5 / focal))
        return Fault.NO_CALIBRATION.found(Grade.GOOD, focal=focal, hfov_deg=hfov_deg)

    def _check_depth(self, frame: KeypointsFrame, tracked: TrackedFrame, intrinsics: Intrinsics) -> Finding:
        depths = [person.depth for person in frame.people if person.depth is not None]
        if depths and not intrinsics.is_focal_known:
            return Fault.DEPTH_UNUSED.found(Grade.GOOD)
        distances = tracked.people.core[:, :, 2].mean(axis=1)
        for depth in depths if len(distances) else ():
            nearest = np.abs(distances - np.nanmedian(depth)).argmin()
            self._depth.add(depth, float(distances[nearest]))
        return self._depth.judge()

    def _check_vertical(self, tracked: TrackedFrame, config: Config, floor: Floor | None) -> Finding:
        given, vertical = config.tracker.vertical, tracked.vertical
        is_parameter = given not in (AUTO, NONE)
        if vertical is None or not (is_parameter or (floor is not None and given == AUTO)):
            return SOUND
        angle_deg = self._vertical.advance(tracked.stamp_ns, tracked.people, vertical.direction)
        if angle_deg is None:
            return SOUND
        if floor is None or is_parameter:
            return Fault.VERTICAL.found(given=given, angle_deg=angle_deg)
        return Fault.FLOOR.found(source=floor.source, angle_deg=angle_deg)


def _check_camera_height(intrinsics: Intrinsics, tracker: TrackerConfig, floor: Floor | None) -> Finding:
    has_floor = floor is not None and floor.camera_height != tracker.camera_height
    if not tracker.camera_height or (intrinsics.is_focal_known and not has_floor and tracker.vertical != NONE):
        return SOUND
    why = 'the focal length is not known, and distances with it; publish camera_info or set node.hfov'
    if intrinsics.is_focal_known:
        why = 'node.output_frame gives the floor' if has_floor else 'tracker.vertical is none'
    return Fault.HEIGHT_UNUSED.found(Grade.GOOD, height=tracker.camera_height, why=why)


def find_unusable_distortion(intrinsics: Intrinsics) -> Finding:
    """Return whether the distortion of a lens is undone in the middle of the image."""
    if intrinsics.image_size is None or not intrinsics.distortion.coefficients:
        return SOUND
    share = _measure_distorted_share(intrinsics, intrinsics.image_size)
    return Fault.DISTORTION.found(share=share) if share > MAX_DISTORTED_SHARE else SOUND


@lru_cache(maxsize=MAX_CACHED_LENSES)
def _measure_distorted_share(intrinsics: Intrinsics, image_size: tuple[int, int]) -> float:
    """Return the share of the middle of an image, in px, where the camera shows the ray of a point elsewhere."""
    half_side = min(image_size) / 2
    x, y = np.meshgrid(*[np.linspace(-MIDDLE_RADIUS, MIDDLE_RADIUS, GRID_SIZE)] * 2)
    offsets = np.stack([x, y], axis=-1)[np.hypot(x, y) <= MIDDLE_RADIUS]
    points = np.array(image_size) / 2 + half_side * offsets
    with np.errstate(all='ignore'):  # coefficients of 1e200 overflow
        rays = intrinsics.pixels_to_rays(points)
        shown = intrinsics.project(np.concatenate([rays, np.ones_like(rays[..., :1])], axis=-1))
        is_undone = np.linalg.norm(shown - points, axis=-1) <= MAX_LENS_ERROR * half_side
    return float(1 - is_undone.mean())


@lru_cache(maxsize=MAX_CACHED_NAMES)
def find_misspelt_joint(joints: tuple[str, ...]) -> Finding:
    """Return whether a name is nearly that of a joint which is missing, by the first one."""
    canonical = canonical_joint_names(joints)
    missing = [j for j in CMU15.joints if j not in canonical]
    for name in joints if missing else ():
        if canonical_joint_names([name])[0] not in KNOWN_JOINTS:
            word = re.sub('[^a-z]', '', name.lower().replace('left', 'l').replace('right', 'r'))
            same_side = [j for j in missing if j[0] == word[:1]]
            for meant in difflib.get_close_matches(word, same_side, 1, MIN_LIKENESS):
                return Fault.MISSPELT.found(name=name, meant=meant)
    return SOUND
