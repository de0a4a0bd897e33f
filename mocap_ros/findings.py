# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What can be wrong with input: every fault with its sentence for the user, and how bad it is.

Values, units, places and the rate are checked where input enters (`keypoints.validation`), mistakes in valid input
by `verdict.input_faults`, and whether the points show people as they are said to by `verdict.plausibility`.
"""

from __future__ import annotations

import re
from enum import Enum, IntEnum
from typing import NamedTuple

# Why detections are no people.
UNUSABLE = 'their scores are below tracker.min_score, or fewer than six joints are seen'
# What to do about a size of the image that is judged by many images.
SIZE_ADVICE = 'check that the detector sees images of that size, and gives points in px from the upper left corner'

# Parts of a message in words that may differ between messages of one kind: addresses, numbers and quoted names.
VARIABLE_PARTS = re.compile(r"0x\w+|[\d.]*\d|'.*'|\".*\"", re.DOTALL)


class Grade(IntEnum):
    """How sound the input of a reconstruction is."""

    GOOD = 0
    DOUBTFUL = 1
    WRONG = 2

    @property
    def word(self) -> str:
        """The grade in summaries, tables and files."""
        return self.name.lower()


class Fault(Enum):
    """What may be wrong with input, with the sentence that says so; braces stand for values."""

    NONE = ''
    # The points of people, by what the lifter finds in them.
    UNKNOWN = 'no {stretch_s:g} s have {images} images that show {joints} joints'  # too little seen to be judged
    LAYOUT = 'these look like {layout}, not {given}: give layout {layout}, or its joint names'
    MISFIT = (
        'the points do not fit people with {given}: the joints may be in another order than their names, or the '
        'detector sees something else'
    )
    AXES = 'x and y look exchanged'
    Y_UP = 'y looks as if it pointed upwards: expected is y = 0 at the top of the image'
    MIRRORED = 'left and right look exchanged in the names of the joints'
    TURNED = (
        'people lie or are upside down in the image: x and y may be exchanged, or y points upwards; if the camera '
        'is turned, give tracker.vertical'
    )
    # The size of the image, by where the points are.
    SIZE_OUTSIDE = '{outside:.0%} of the seen keypoints lie outside {width} x {height} px'
    SIZE_TRANSPOSED_OUTSIDE = (
        f'{SIZE_OUTSIDE}, but inside {{height}} x {{width}} px: width and height look transposed'
    )
    SIZE_TRANSPOSED = 'the points lie as in an image of {height} x {width} px: width and height look transposed'
    SIZE_SMALLER = 'all points lie in the upper left quarter of {width} x {height} px: the images look smaller'
    SIZE_LARGER = f'{SIZE_OUTSIDE}, and the others towards its lower right corner: the images look larger'
    SIZE_ASSUMED = 'the image size of {width}x{height} px is assumed'
    # Units.
    NORMALISED = 'looks normalised; px expected: multiply x by the width of the image and y by its height'
    METRES = 'looks like 3D joints in m; 2D keypoints in px expected'
    RATE_LOW = 'one image every {step_s:.3g} s by the stamps: looks like {unit} taken for seconds'
    RATE_HIGH = '{rate:.0f} images/s by the stamps: looks like {unit} taken for nanoseconds'
    # Names, detections and messages.
    MISSPELT = 'joint_names: {name!r} is no known joint and is ignored; is it {meant!r}?'
    NO_KEYPOINTS = (
        'the detections have no keypoints, as those of a model that finds boxes; run a model for poses, such as '
        'yolo11n-pose.pt'
    )
    UNUSABLE = f'no usable detection for {{lasting_s:g}} s: {UNUSABLE}'
    REFUSED = '{refused} of {messages} messages were refused'
    REFUSED_LAST = 'the last {refused} messages were refused'
    # The camera and the vertical.
    DISTORTION = (
        'distortion of the camera: it cannot be undone in {share:.0%} of the middle of the image, where keypoints '
        'have wrong directions; check its coefficients'
    )
    NO_CALIBRATION = (
        'no CameraInfo: a nominal focal length of {focal:g} longer sides of the image ({hfov_deg:.0f} degrees) is '
        'assumed, to which distances from the camera are proportional; publish camera_info or set node.hfov'
    )
    HEIGHT_UNUSED = 'tracker.camera_height = {height:g} is not used: {why}'
    VERTICAL = (
        'tracker.vertical = {given!r}: people seem to stand at {angle_deg:.0f} degrees to it; check it: it is the '
        "direction upwards in the camera's optical frame, whose y axis is down, unless everybody lies"
    )
    FLOOR = (
        '{source} is taken as up: people seem to stand at {angle_deg:.0f} degrees to it; check the pose of the '
        'camera, unless everybody lies'
    )
    # Measured depths.
    DEPTH_UNIT = 'depth: {far:.0%} of the values exceed {limit_m:g} m: they look like mm, and m are expected'
    DEPTH_ELSEWHERE = (
        'depth: only {near:.0%} of the values are within {reach_m:g} m of the people: check that the depth image '
        'is registered to the image of the keypoints, of the same camera and not mirrored'
    )
    DEPTH_UNUSED = 'depth is not used, as it needs the camera: CameraInfo, camera_matrix, or the field of view'
    OTHER = '{words}'  # that another part of the program found, and says

    def found(self, grade: Grade = Grade.DOUBTFUL, **values: object) -> Finding:
        """Return the finding of this fault, with the values of its sentence."""
        return Finding(grade, self, self.describe(**values))

    def describe(self, **values: object) -> str:
        """Return the sentence with its values."""
        return str(self.value).format(**values)


class Finding(NamedTuple):
    """Something that was found in the input."""

    grade: Grade  # of input in which it is; good where it is only worth a note
    fault: Fault
    words: str  # for the user; empty if all is well


SOUND = Finding(Grade.GOOD, Fault.NONE, '')


def find_worst(*findings: Finding) -> Finding:
    """Return the first finding of the worst grade; one of input that was judged counts more than another."""
    return max(findings, key=lambda finding: (finding.grade, finding.fault is not Fault.UNKNOWN))


def find_kind(words: str) -> str:
    """Return what texts that differ only in numbers, addresses and quoted names have in common."""
    return VARIABLE_PARTS.sub('#', words)
