# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Mistakes in valid input, each described in words once: what is suspicious, and what to check.

A vertical that people contradict is suspected once they do so for seconds (`verdict/vertical_check.py`); misspelt
names of joints, distortions without an inverse, stamps that are those of no camera, and a camera without a
calibration are certain. Whether the points fit their layout and the image, `summary.RunSummary` judges.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable
from functools import lru_cache

import numpy as np

from mocap_ros.config import Config, TrackerConfig
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.level import Floor
from mocap_ros.keypoints.identities import find_absence
from mocap_ros.keypoints.validation import MIN_JUDGED_FRAMES, describe_rate
from mocap_ros.messages.keypoints import KeypointsFrame
from mocap_ros.people import TrackedFrame
from mocap_ros.skeleton import CMU15, KNOWN_JOINTS, canonical_joint_names
from mocap_ros.solvers.vertical import AUTO, NONE
from mocap_ros.units import NS_PER_S
from mocap_ros.verdict.vertical_check import VerticalCheck

# s; a CameraInfo comes within it, if at all: publishers send it with every image
CALIBRATION_WAIT_S = 2.5
LEAST_LIKENESS = 0.8  # 1, of difflib; one or two letters of a joint's name
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
# Why messages of detections show no people.
UNUSABLE = 'their scores are below tracker.min_score, or fewer than six joints are seen'
WITHOUT_KEYPOINTS = (
    'the detections have no keypoints, as those of a model that finds boxes; '
    'run a model for poses, such as yolo11n-pose.pt'
)

# Parts of a message in words that may differ between messages of one kind: addresses, numbers and quoted names.
VARIABLE_PARTS = re.compile(r"0x\w+|[\d.]*\d|'.*'|\".*\"", re.DOTALL)


def find_kind(words: str) -> str:
    """Return what texts that differ only in numbers, addresses and quoted names have in common."""
    return VARIABLE_PARTS.sub('#', words)


def _check_camera_height(intrinsics: Intrinsics, tracker: TrackerConfig, *, has_floor: bool) -> str:
    if not tracker.camera_height or (intrinsics.is_focal_known and not has_floor and tracker.vertical != NONE):
        return ''
    fault = 'the focal length is not known, and distances with it; publish camera_info or set node.hfov'
    if intrinsics.is_focal_known:
        fault = 'node.output_frame gives the floor' if has_floor else 'tracker.vertical is none'
    return f'tracker.camera_height = {tracker.camera_height:g} is not used: {fault}'


class InputChecks:
    """Checks of successive images of one camera; `warnings` says what seems wrong as of the last one."""

    def __init__(self) -> None:
        self._last_ns = 0  # stamp of the last image
        self._stamps: list[int] = []  # of the last images, in ns
        self.rate_fault = ''  # why the stamps can be those of no camera, as of `MIN_JUDGED_FRAMES` of them
        self._has_keypoints = False  # whether any detection so far had some
        self._box_images = 0  # images so far with detections of people without any
        self.reset()

    def reset(self) -> None:
        """Forget what was found so far, and what was described."""
        self._vertical = VerticalCheck()
        self._newest_seen_ns = 0  # stamp of the newest image in which a person was detected
        self._first_nominal_ns: int | None = None  # stamp of the first image of people without a CameraInfo
        self._unusable_ns: int | None = None  # stamp of the first unusable detection since people were shown
        self._described: set[str] = set()  # kinds of what was described
        self.warnings: tuple[str, ...] = ()

    def add_stamp(self, stamp_ns: int) -> list[str]:
        """Add the stamp of any image; return what is wrong with the stamps and was not described before."""
        self._stamps.append(stamp_ns)
        if len(self._stamps) == MIN_JUDGED_FRAMES:
            times = (np.array(self._stamps) - self._stamps[0]) / NS_PER_S
            self.rate_fault = describe_rate(times, SLOWEST_STREAM_S)
            self._stamps = []
        if self.rate_fault and self.rate_fault not in self.warnings:
            self.warnings = (self.rate_fault, *self.warnings)
        return self._choose_new([self.rate_fault])

    def advance(
        self,
        frame: KeypointsFrame,
        intrinsics: Intrinsics,
        tracked: TrackedFrame,
        config: Config,
        floor: tuple[Floor | None, str],
        fault: str = '',
        other_camera: str = '',
    ) -> list[str]:
        """Return what is wrong with the input and was not described before.

        Once no person has been seen for so long that the tracker has forgotten all, everything is described anew.
        The floor, if it is known, comes with what it cannot be used for, `fault` is why the points are not sound
        (`summary.RunSummary`), and `other_camera` why the CameraInfo is not used, all in words.
        """
        stamp_ns = frame.header.stamp_ns
        if frame.people or stamp_ns < self._newest_seen_ns:
            self._newest_seen_ns = stamp_ns
        elif self._last_ns - self._newest_seen_ns > find_absence(config.tracker) * NS_PER_S:
            self.reset()
            self._newest_seen_ns = stamp_ns
        self._last_ns = stamp_ns
        found = (
            self.rate_fault,
            self._check_vertical(tracked, config, has_floor=floor[0] is not None),
            fault and f'people: {fault}',
            next(filter(None, (describe_misspelt_joint(p.joints) for p in frame.people)), ''),
            describe_unusable_distortion(intrinsics),
            other_camera,
        )
        self.warnings = tuple(filter(None, found))
        heights = floor[1], _check_camera_height(intrinsics, config.tracker, has_floor=floor[0] is not None)
        nominal = '' if other_camera else self._check_calibration(stamp_ns, intrinsics, config)
        notes = [*heights, nominal, *tracked.faults] if frame.people else []
        self._has_keypoints |= bool(frame.people)
        self._box_images += bool(frame.without_keypoints)
        if self._box_images >= MIN_BOX_IMAGES and not self._has_keypoints:
            notes.append(WITHOUT_KEYPOINTS)
        if len(tracked.people):
            self._unusable_ns = None
        elif tracked.unusable:
            self._unusable_ns = min(stamp_ns, self._unusable_ns or stamp_ns)
            if stamp_ns - self._unusable_ns > UNUSABLE_S * NS_PER_S:
                notes.append(f'no usable detection for {UNUSABLE_S:g} s: {UNUSABLE}')
        return self._choose_new((*notes, *self.warnings))

    def _choose_new(self, found: Iterable[str]) -> list[str]:
        new = []
        for words in filter(None, found):
            if (kind := find_kind(words)) not in self._described:
                self._described.add(kind)
                new.append(words)
        return new

    def _check_calibration(self, stamp_ns: int, intrinsics: Intrinsics, config: Config) -> str:
        focal = config.tracker.nominal_focal_length
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
            'camera are proportional; publish camera_info or set node.hfov'
        )

    def _check_vertical(self, tracked: TrackedFrame, config: Config, *, has_floor: bool) -> str:
        given, vertical = config.tracker.vertical, tracked.vertical
        is_parameter = given not in (AUTO, NONE)
        if vertical is None or not (is_parameter or (has_floor and given == AUTO)):
            return ''
        angle_deg = self._vertical.advance(tracked.stamp_ns, tracked.people, vertical.direction)
        if angle_deg is None:
            return ''
        if is_parameter:
            name = f'tracker.vertical = {given!r}'
            advice = "check it: it is the direction upwards in the camera's optical frame, whose y axis is down"
        else:
            name = f'node.output_frame = {config.node.output_frame!r}, whose z axis is taken as up'
            advice = 'check the pose of the camera'
        return f'{name}: people seem to stand at {angle_deg:.0f} degrees to it; {advice}, unless everybody lies'


def describe_unusable_distortion(intrinsics: Intrinsics) -> str:
    """Describe that the distortion of a lens is not undone in the middle of the image; empty if it is."""
    if intrinsics.image_size is None or not intrinsics.distortion.coefficients:
        return ''
    share = _measure_distorted_share(intrinsics, intrinsics.image_size)
    if share <= MAX_DISTORTED_SHARE:
        return ''
    return (
        f'distortion of the camera: it cannot be undone in {share:.0%} of the middle of the image, where '
        'keypoints have wrong directions; check its coefficients'
    )


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
def describe_misspelt_joint(joints: tuple[str, ...]) -> str:
    """Describe the first name that is nearly that of a joint which is missing; empty if there is none."""
    canonical = canonical_joint_names(joints)
    missing = [j for j in CMU15.joints if j not in canonical]
    for name in joints if missing else ():
        if canonical_joint_names([name])[0] not in KNOWN_JOINTS:
            word = re.sub('[^a-z]', '', name.lower().replace('left', 'l').replace('right', 'r'))
            same_side = [j for j in missing if j[0] == word[:1]]
            for meant in difflib.get_close_matches(word, same_side, 1, LEAST_LIKENESS):
                return f'joint_names: {name!r} is no known joint and is ignored; is it {meant!r}?'
    return ''
