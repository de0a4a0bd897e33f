"""One detection of a person, converted to rays of the camera and to the joints of the model."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.association import Extent, measure_extent
from mocap_ros.keypoints.joint_map import map_to_model_joints
from mocap_ros.keypoints.person import Person2D

Array = NDArray[np.float64]

MIN_SIZE = 1e-3  # rays, 0.5 px at a focal length of 500 px; guards divisions by the size if all joints coincide
MAX_POINT_PX = 1e7  # px; far outside any image; keeps arithmetic finite for callers that validate nothing


@dataclass(frozen=True, eq=False)
class Detection:
    """One detected person.

    Attributes:
        given_id: name that the detector gives the person; empty if it gives none.
        rays: (J, 2) x / z and y / z of the model's joints in the camera; 0 for a joint that was not seen.
        weight: (J,) confidence scores in [0, 1]; 0 for a joint that was not seen.
    """

    given_id: str
    rays: Array
    weight: Array

    @staticmethod
    def from_person(person: Person2D, intrinsics: Intrinsics, min_score: float) -> Detection:
        """Convert the keypoints of a person to rays of the model's joints.

        Args:
            person: keypoints as a detector gave them.
            intrinsics: intrinsics of the camera.
            min_score: confidence score below which a keypoint counts as not seen.

        Raises:
            SkeletonError: The person's joints do not cover enough of the model's.
        """
        with np.errstate(invalid='ignore'):
            is_valid = np.asarray((np.abs(person.points) < MAX_POINT_PX).all(axis=-1))
        score = np.where(is_valid, np.minimum(person.score, 1.0), 0.0)
        valid_points = np.where(is_valid[:, None], person.points, 0.0)
        points, weight = map_to_model_joints(valid_points, score, person.joints, min_score)
        rays = np.where(weight[:, None] > 0, intrinsics.pixels_to_rays(points), 0.0)
        return Detection(person.id, rays, weight)

    @cached_property
    def extent(self) -> Extent:
        """Centre and size in the image, in the units of rays."""
        return measure_extent(self.rays, self.weight)

    def is_usable(self, min_joints: int) -> bool:
        """Return whether enough joints were seen, and not all of them in one place.

        Args:
            min_joints: smallest number of seen joints.
        """
        if (self.weight > 0).sum() < min_joints:
            return False
        return self.extent.size > MIN_SIZE
