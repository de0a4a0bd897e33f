# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Mistakes in valid input: joints in another order, images of another size, misspelt names, unusable distortions.

The first two are doubted once they are so for most people over seconds (`tracking/lasting_doubt.py`).
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.person import Person2D
from mocap_ros.keypoints.validation import describe_points_outside, describe_transposed_size
from mocap_ros.people import Person3D
from mocap_ros.skeleton import CMU15, KEYPOINT_LAYOUTS, canonical_joint_names
from mocap_ros.tracking.lasting_doubt import LastingDoubt

MEMORY_S = 5.0  # s; a corrected mistake is forgotten soon
LEAST_S = 2.5  # s; longer than a burst of wrong points, such as while somebody enters the image
# 1; RMS residual divided by the body radius. With it, none of 150 recordings of motion capture with the errors of
# three detectors is doubted, and all of 50 with joints reversed, one on, or in random order are.
MAX_RESIDUAL = 0.25
LEAST_LIKENESS = 0.8  # 1, of difflib; one or two letters of a joint's name
GRID_SIZE = 9  # points in each direction of the middle of the image, at which a lens is checked
# 1; radius of the middle of the image, of half the shorter side. A fisheye whose image circle fits the image shows
# there what is up to 63 degrees from its axis, if it sees half of the space, and up to 86, if it sees 246 degrees.
MIDDLE_RADIUS = 0.7
MAX_LENS_ERROR = 0.01  # of half the shorter side; far above the errors of the inversion where there is an inverse
MAX_DISTORTED_SHARE = 0.2  # 1; part of the middle of the image, in all of which lenses have an inverse
MAX_CACHED_LENSES = 4  # lenses of the cameras of one node
MAX_CACHED_NAMES = 64  # lists of joint names; guards memory against messages that name ever new ones
KNOWN_JOINTS = frozenset(j for layout in KEYPOINT_LAYOUTS.values() for j in layout.joints)


class InputDoubts:
    """Checks of the keypoints of successive images of one camera."""

    def __init__(self) -> None:
        self._joint_order, self._image_size = (LastingDoubt(MEMORY_S, LEAST_S) for _ in range(2))

    def advance(
        self,
        stamp_ns: int,
        detections: Sequence[Person2D],
        people: Sequence[Person3D],
        intrinsics: Intrinsics,
    ) -> tuple[str, ...]:
        """Return what is doubted, each in words; usually nothing.

        Args:
            stamp_ns: ns, stamp of the image.
            detections: The people whom the detector saw in it.
            people: The people who were reconstructed up to it.
            intrinsics: The intrinsics of the camera.
        """
        image_size = intrinsics.image_size
        residuals = [p.motion.residual for p in people if not p.predicted and math.isfinite(p.motion.residual)]
        doubts = []
        if self._joint_order.advance(stamp_ns, [r > MAX_RESIDUAL for r in residuals]) and residuals:
            doubts.append(
                'people: no person has joints where the points are: beside the skeletons by '
                f'{np.mean(residuals):.2f} of the radius of a body; check that skeleton or joint_names of the '
                'messages give the joints in the order of the points'
            )
        outside = [describe_outside(p, image_size) for p in detections] if image_size else []
        if self._image_size.advance(stamp_ns, [*map(bool, outside)]) and any(outside):
            doubts.append(
                f'people: {next(filter(None, outside))}; check that the detector sees images of that size, and '
                'gives points in px from the upper left corner'
            )
        misspelt = next(filter(None, (describe_misspelt_joint(p.joints) for p in detections)), '')
        return *doubts, *filter(None, (misspelt, describe_unusable_distortion(intrinsics)))


def describe_outside(person: Person2D, image_size: tuple[int, int]) -> str:
    """Describe in a clause that most points of a person lie outside the image, in px; empty if they do not."""
    keypoints = person.points, person.score, image_size
    outside = describe_points_outside(*keypoints)
    return outside and (describe_transposed_size(*keypoints) or outside)


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
