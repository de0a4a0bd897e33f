"""Image points of one person for the keyframe method, as virtual cameras that look at the person see them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import TrackerConfig
from mocap_ros.errors import InputError
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.virtual_camera import VirtualCamera, solver_focal
from mocap_ros.keypoints.joint_map import map_to_model_joints
from mocap_ros.keypoints.left_right import find_swapped_frames
from mocap_ros.offline.keyframes.body_halves import estimate_torso_lengths
from mocap_ros.offline.keyframes.filters import nan_median
from mocap_ros.offline.whole_sequence import VIEW_SMOOTHING_S
from mocap_ros.skeleton import CMU15

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MAX_SECTION_S = 60.0  # s; bounds the memory of the virtual cameras, which grows with its square
SECTION_MARGIN_S = 6.0  # s; at this distance a frame hardly weighs in the mean of `VIEW_SMOOTHING_S`
MIN_POSE_JOINTS = 4  # joints seen in a frame, below which a camera cannot be estimated
CUT_DISPLACEMENT = 0.5  # torso lengths between frames; more than a body moves, less than it jumps at a cut
MAX_ABSENCE_S = 0.5  # s without a pose, after which the motion before no longer says which side is left


@dataclass(frozen=True, eq=False)
class Observations:
    """One person's joints in the images of virtual cameras.

    Attributes:
        times: (F,) s, increasing.
        pixels: (F, J, 2) px in the real camera's image, joints of `CMU15`, left and right corrected; 0 where the
            weight is 0.
        points: (F, J, 2) px in the virtual camera's image, relative to its optical axis; 0 where the weight is 0.
        weight: (F, J) confidence scores, 0 where not seen.
        virtual_camera: virtual cameras, one a frame.
        focal: px, focal length; infinite for weak perspective.
    """

    times: Array
    pixels: Array
    points: Array
    weight: Array
    virtual_camera: VirtualCamera
    focal: float

    def exclude_points(self, excluded: Mask) -> Observations:
        """Return the observations with the points of a mask (F, J) set to not seen."""
        weight = np.where(excluded, 0.0, self.weight)
        seen = weight[..., None] > 0
        return replace(
            self,
            weight=weight,
            points=np.where(seen, self.points, 0.0),
            pixels=np.where(seen, self.pixels, 0.0),
        )


def split_into_sections(times: Array, max_seconds: float, margin: float) -> list[tuple[slice, slice]]:
    """Split the frames of a sequence into sections of about equal duration.

    Args:
        times: (F,) s, increasing.
        max_seconds: s, maximum duration of a section without its margins.
        margin: s, added before and after each section.

    Returns:
        For each section the frames with both margins, and the frames without.
    """
    count = max(int(np.ceil((times[-1] - times[0]) / max_seconds)), 1)
    edges = np.searchsorted(times, np.linspace(times[0], times[-1], count + 1)[1:-1]).tolist()
    bounds = sorted({0, *edges, len(times)})
    out = []
    for first, last in pairwise(bounds):
        padded = np.searchsorted(times, [times[first] - margin, times[last - 1] + margin], side='left')
        out.append((slice(int(padded[0]), max(int(padded[1]), last)), slice(first, last)))
    return out


def prepare_observations(
    keypoints: Array, joint_names: tuple[str, ...], times: Array, intrinsics: Intrinsics, config: TrackerConfig
) -> Observations:
    """Map keypoints to the model's joints, correct left and right, and project them into virtual cameras.

    Args:
        keypoints: (F, J, 3) x and y in px, and confidence score; NaN or score 0 where not seen.
        joint_names: (J,) any names that `keypoints.joint_map` knows.
        times: (F,) s, increasing.
        intrinsics: intrinsics of the camera.
        config: parameters; `min_score`, `undo_swaps` and `perspective` apply.

    Raises:
        SkeletonError: These names give too few of the model's joints.
        InputError: No frame has four seen joints.
    """
    pixels, weight = map_to_model_joints(keypoints[..., :2], keypoints[..., 2], joint_names, config.min_score)
    if not ((weight > 0).sum(axis=1) >= MIN_POSE_JOINTS).any():
        raise InputError('no frame has four seen joints: nothing to reconstruct')
    points, rotations = np.empty_like(pixels), np.empty((len(times), 3, 3))
    if config.undo_swaps:
        pixels, weight = _undo_swaps(pixels, weight, times)
    for padded, section in split_into_sections(times, MAX_SECTION_S, SECTION_MARGIN_S):
        inner = slice(section.start - padded.start, section.stop - padded.start)
        rays = intrinsics.pixels_to_rays(pixels[padded])
        camera = VirtualCamera.look_at_person(rays, weight[padded], times[padded], VIEW_SMOOTHING_S, intrinsics)
        points[section] = camera.project_rays(rays)[inner]
        rotations[section] = camera.rotation[inner]
    points = np.where(weight[..., None] > 0, points, 0.0)
    camera = VirtualCamera(rotations, intrinsics)
    return Observations(times, pixels, points, weight, camera, solver_focal(intrinsics, config.perspective))


def _undo_swaps(points: Array, weight: Array, times: Array) -> tuple[Array, Array]:
    """Return points and weights with swapped left and right exchanged back, each shot on its own."""
    mirror = np.array(CMU15.mirror)
    points, weight = points.copy(), weight.copy()
    for shot in find_shots(points, weight, times):
        swapped = np.flatnonzero(find_swapped_frames(times[shot], points[shot], weight[shot], mirror)) + shot.start
        points[swapped], weight[swapped] = points[swapped][:, mirror], weight[swapped][:, mirror]
    return points, weight


def find_shots(points: Array, weight: Array, times: Array) -> list[slice]:
    """Split a sequence into shots at its cuts.

    A cut is where the median joint moves more than `CUT_DISPLACEMENT` between frames, or where no frame shows a
    pose for more than `MAX_ABSENCE_S`. Swapped left and right are no cut. A shot longer than `MAX_SECTION_S` is
    split.

    Args:
        points: (F, J, 2) px, joints of `CMU15`; arbitrary where the weight is 0.
        weight: (F, J) confidence scores, 0 where not seen.
        times: (F,) s, increasing.

    Returns:
        The frames of each shot.
    """
    pose_frames = np.flatnonzero((weight > 0).sum(axis=1) >= MIN_POSE_JOINTS)
    torso = estimate_torso_lengths(points, weight, times)[pose_frames[1:]]
    mirror = np.array(CMU15.mirror)
    before, after = pose_frames[:-1], pose_frames[1:]
    displacements = []
    for order in (np.arange(len(mirror)), mirror):  # with the labels as they are, and with left and right swapped
        both_seen = (weight[after] > 0) & (weight[before][:, order] > 0)
        moved = np.linalg.norm(points[after] - points[before][:, order], axis=-1)
        displacements.append(np.nan_to_num(nan_median(np.where(both_seen, moved, np.nan), axis=1)))
    displacement = np.minimum(*displacements)
    is_cut = (displacement > CUT_DISPLACEMENT * torso) | (np.diff(times[pose_frames]) > MAX_ABSENCE_S)
    section_starts = {section.start for _, section in split_into_sections(times, MAX_SECTION_S, 0.0)}
    bounds = sorted({0, *after[is_cut].tolist(), *section_starts, len(times)})
    return [slice(a, b) for a, b in pairwise(bounds)]
