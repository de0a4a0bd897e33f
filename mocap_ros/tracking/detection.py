# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""One detection of a person, converted to rays of the camera and to the joints of the model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.association import Extent, measure_extent
from mocap_ros.keypoints.extremities import Extremities, convert_body_to_rays
from mocap_ros.keypoints.person import Person2D

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Detection:
    """One detected person of whom enough was seen to be tracked.

    Attributes:
        given_id: name that the detector gives the person; empty if it gives none.
        rays: (J, 2) x / z and y / z of the model's joints in the camera; 0 for a joint that was not seen.
        weight: (J,) confidence scores in [0, 1]; 0 for a joint that was not seen.
        extent: centre and size in the image, in the units of rays.
        extremities: face, feet and hands.
    """

    given_id: str
    rays: Array
    weight: Array
    extent: Extent
    extremities: Extremities

    @staticmethod
    def from_person(
        person: Person2D, intrinsics: Intrinsics, min_score: float, min_joints: int
    ) -> Detection | None:
        """Convert the keypoints of a person to rays of the model's joints.

        Args:
            person: keypoints as a detector gave them.
            intrinsics: intrinsics of the camera.
            min_score: confidence score below which a keypoint counts as not seen.
            min_joints: smallest number of seen joints, at least 1, that makes a detection usable.

        Returns:
            The detection; None if fewer joints were seen, or all of them in one place.

        Raises:
            SkeletonError: The person's joints do not cover enough of the model's.
        """
        keypoints = person.points, person.score, person.joints
        rays, weight, extremities = convert_body_to_rays(*keypoints, intrinsics, min_score)
        if np.count_nonzero(weight) < min_joints:
            return None
        extent = measure_extent(rays, weight)
        if extent.is_one_place:
            return None
        return Detection(person.id, rays, weight, extent, extremities)

    def join(self, part: Detection) -> Detection:
        """Return the detection with the joints of another detection of the same person that this one lacks."""
        rays, weight = _fill_gaps(self.rays, self.weight, part.rays, part.weight)
        extremities = Extremities(*_fill_gaps(*self.extremities, *part.extremities))
        return Detection(self.given_id or part.given_id, rays, weight, measure_extent(rays, weight), extremities)


def _fill_gaps(rays: Array, weight: Array, other_rays: Array, other_weight: Array) -> tuple[Array, Array]:
    """Return rays (J, 2) and weights (J,), where they were not seen from others."""
    is_own = weight > 0
    return np.where(is_own[:, None], rays, other_rays), np.where(is_own, weight, other_weight)
