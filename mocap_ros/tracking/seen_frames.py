# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What was seen of a tracked person: the keypoints of the sliding window, with left and right put right.

A new frame may change the decision whether left and right of the body or of a part of it were swapped in earlier
frames. These frames are then corrected anew, and the lifted poses from the first of them on are dropped.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.virtual_camera import VirtualCamera
from mocap_ros.keypoints.association import Extent, measure_extent
from mocap_ros.keypoints.extremities import Extremities, exchange_body_sides
from mocap_ros.keypoints.left_right import SwapFilter
from mocap_ros.models.lifter import LiftedPoses
from mocap_ros.solvers.observed_window import ObservedWindow
from mocap_ros.tracking.delayed_output import find_oldest_needed_ns
from mocap_ros.tracking.detection import Detection
from mocap_ros.units import NS_PER_S

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SeenFrames:
    """The F frames of a person's window, F >= 1.

    Attributes:
        given_id: name that the detector gave the person last; empty if it gave none.
        first_stamp_ns: ns, stamp of the person's first frame, which the window may have left behind.
        stamps_ns: (F,) ns, stamps of the frames, increasing.
        rays: (F, J, 2) x / z and y / z of the joints in the real camera, with the detector's labels.
        weight: (F, J) confidence scores with the detector's labels; 0 for a joint that was not seen.
        extremities: face, feet and hands with the detector's labels.
        extents: (F,) centre and size of the person in the image, in the units of rays.
        swap_filter: filter that finds the parts of the body whose left and right are swapped.
        observed: the same frames with swaps undone, their lifted poses, and one virtual camera that faces the
            person in all of them; its times begin with 0 at the first frame of the window.
        is_relabelled: whether the newest frame has changed the decision about swaps in a frame before it.
    """

    given_id: str
    first_stamp_ns: int
    stamps_ns: tuple[int, ...]
    rays: Array
    weight: Array
    extremities: Extremities
    extents: tuple[Extent, ...]
    swap_filter: SwapFilter
    observed: ObservedWindow
    is_relabelled: bool = False

    @staticmethod
    def begin(
        stamp_ns: int, detection: Detection, swap_filter: SwapFilter, intrinsics: Intrinsics, focal: float
    ) -> SeenFrames:
        """Return the window of a person who is seen for the first time.

        Args:
            stamp_ns: ns, stamp of the frame.
            detection: the person in this frame.
            swap_filter: filter that has seen no frame.
            intrinsics: intrinsics of the real camera.
            focal: px, focal length that the solvers assume; infinite for weak perspective.
        """
        seen = detection.rays[None], detection.weight[None], Extremities(*(a[None] for a in detection.extremities))
        stamps_ns = (stamp_ns,)
        swap_filter = swap_filter.update(0.0, detection.rays, detection.weight, detection.extent.size)
        observed = _correct_sides(stamps_ns, *seen, swap_filter, intrinsics, focal, None)
        extents = (detection.extent,)
        return SeenFrames(detection.given_id, stamp_ns, stamps_ns, *seen, extents, swap_filter, observed)

    @property
    def age_s(self) -> float:
        """Time in s from the person's first frame to the newest."""
        return (self.stamps_ns[-1] - self.first_stamp_ns) / NS_PER_S

    @property
    def times_s(self) -> Array:
        """Times (F,) in s of the frames, that of the newest is 0."""
        stamps_ns = np.array(self.stamps_ns)
        return np.asarray((stamps_ns - stamps_ns[-1]) / NS_PER_S)

    @property
    def intrinsics(self) -> Intrinsics:
        """Intrinsics of the real camera."""
        return self.observed.virtual_camera.intrinsics

    @property
    def is_newest_swapped(self) -> bool:
        """Whether left and right of the body or of a part of it were swapped in the newest frame."""
        return bool(self.swap_filter.is_swapped[-1].any())

    def count_older_frames(self, stamp_ns: int, window_s: float, lag_s: float) -> int:
        """Return the number of frames that are too old for a window that ends at a stamp.

        With a lag, the frames that are still to be put out stay, also in a shorter window.

        Args:
            stamp_ns: ns, end of the window.
            window_s: s, length of the window.
            lag_s: s, delay of the output.
        """
        older = bisect_left(self.stamps_ns, stamp_ns - window_s * NS_PER_S)
        if lag_s == 0:
            return older
        return min(older, max(bisect_right(self.stamps_ns, find_oldest_needed_ns(stamp_ns, lag_s)) - 1, 0))

    def add_frame(self, stamp_ns: int, detection: Detection, dropped: int) -> SeenFrames:
        """Return the window with one more frame and without the oldest ones.

        Args:
            stamp_ns: ns, stamp of the frame.
            detection: the person in this frame.
            dropped: number of frames to drop.
        """
        time_s = (stamp_ns - self.first_stamp_ns) / NS_PER_S
        seen = detection.rays, detection.weight, detection.extent.size
        swap_filter = self.swap_filter.update(time_s, *seen, dropped)
        is_changed = (swap_filter.is_swapped[:-1] != self.swap_filter.is_swapped[dropped:]).any(axis=1)
        is_relabelled = bool(is_changed.any())
        unchanged = int(is_changed.argmax()) if is_relabelled else len(is_changed)
        stamps_ns = (*self.stamps_ns[dropped:], stamp_ns)
        rays = np.concatenate([self.rays[dropped:], detection.rays[None]])
        weight = np.concatenate([self.weight[dropped:], detection.weight[None]])
        all_seen = rays, weight, self.extremities.append_frame(detection.extremities, dropped)
        lifted, old = None, self.observed
        if old.lifted is not None and unchanged:
            lifted = old.lifted.select_frames(slice(dropped, dropped + unchanged))
        observed = _correct_sides(stamps_ns, *all_seen, swap_filter, self.intrinsics, old.focal, lifted)
        extents = (*self.extents[dropped:], detection.extent)
        name, first_ns = detection.given_id or self.given_id, self.first_stamp_ns
        return SeenFrames(name, first_ns, stamps_ns, *all_seen, extents, swap_filter, observed, is_relabelled)

    def append_lifted(self, lifted: LiftedPoses) -> SeenFrames:
        """Return the window with lifted poses of the frames that had none; see `ObservedWindow.append_lifted`."""
        return SeenFrames(
            self.given_id,
            self.first_stamp_ns,
            self.stamps_ns,
            self.rays,
            self.weight,
            self.extremities,
            self.extents,
            self.swap_filter,
            self.observed.append_lifted(lifted),
            self.is_relabelled,
        )

    def change_camera(self, intrinsics: Intrinsics, focal: float) -> SeenFrames:
        """Return the window under other intrinsics: the image points stay the same, and nothing is lifted yet.

        If the size of the images has changed, the image points are moved as the image is resized.

        Args:
            intrinsics: intrinsics from now on.
            focal: px, focal length that the solvers assume from now on.
        """
        old = self.intrinsics.resize_like(intrinsics)

        def convert(rays: Array) -> Array:
            directions = np.concatenate([rays, np.ones_like(rays[..., :1])], axis=-1)
            return intrinsics.pixels_to_rays(old.project(directions))

        rays, swap_filter = convert(self.rays), self.swap_filter.convert_points(convert)
        extremities = Extremities(convert(self.extremities.rays), self.extremities.weight)
        observed = _correct_sides(
            self.stamps_ns, rays, self.weight, extremities, swap_filter, intrinsics, focal, None
        )
        extents = tuple(measure_extent(*frame) for frame in zip(rays, self.weight, strict=True))
        return replace(
            self, rays=rays, extremities=extremities, extents=extents, swap_filter=swap_filter, observed=observed
        )

    def select_frames(self, step_s: float, span_s: float) -> NDArray[np.intp]:
        """Return the indices of the frames with the highest scores, one for each step of time, increasing.

        The newest frame is always selected.

        Args:
            step_s: s, length of a step.
            span_s: s, age beyond which no frame is selected.
        """
        age_s = -self.times_s
        step = (age_s / step_s + 0.5).astype(int)
        total_weight = np.append(self.weight[:-1].sum(axis=1), np.inf)
        order = np.lexsort((-total_weight, step))
        is_first_of_step = np.diff(step[order], prepend=-1) != 0
        selected = np.sort(order[is_first_of_step])
        return np.asarray(selected[age_s[selected] <= span_s])


def _correct_sides(
    stamps_ns: tuple[int, ...],
    rays: Array,
    weight: Array,
    extremities: Extremities,
    swap_filter: SwapFilter,
    intrinsics: Intrinsics,
    focal: float,
    lifted: LiftedPoses | None,
) -> ObservedWindow:
    """Return frames with swaps of left and right undone, seen by a virtual camera that faces the person."""
    rays, weight, extremities = exchange_body_sides(rays, weight, extremities, swap_filter.is_swapped)
    camera = VirtualCamera.look_at_mean_position(rays, weight, intrinsics)
    times = (np.array(stamps_ns) - stamps_ns[0]) / NS_PER_S
    return ObservedWindow(times, rays, weight, camera, focal, lifted, extremities)
