# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""One tracked person: the keypoints of the sliding window, with left and right put right, and what follows.

A new frame may change the decision whether left and right of the body or of a part of it were swapped in earlier
frames. These frames are then corrected anew, and the lifted poses from the first of them on are dropped.

With `tracker.lag`, an older frame is shown. With t_0 < ... < t_n the stamps of the frame that was shown last and
of all after it, h = (t_n - t_0) / n and the lag L, the next frame is shown if it is older than L - s with
s = min(h, L) / 2, and frames are left out only where a later one is older than L + s. So one frame follows another
if none is more than h / 4 early or late, and is shown L - s to L + s + h after it was taken.
"""

from __future__ import annotations

import copy
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.virtual_camera import VirtualCamera
from mocap_ros.keypoints.identities import is_new
from mocap_ros.keypoints.left_right import SwapFilter, exchange_sides
from mocap_ros.keypoints.matching import DetectedBody
from mocap_ros.keypoints.rays import Extremities
from mocap_ros.models.lifter import LiftedPoses
from mocap_ros.solvers.observed_window import ObservedWindow
from mocap_ros.tracking.body_size import SizeEvidence
from mocap_ros.tracking.motion_filter import UNFILTERED, restart_motion
from mocap_ros.tracking.schedule import CheckSchedule
from mocap_ros.tracking.solution import TrackSolution
from mocap_ros.units import NS_PER_S


@dataclass(eq=False)
class Track:
    """A tracked person, whom every stage of a frame changes in place.

    No array is written to: a stage gives the track new ones. So `copy` is cheap, and a check works on such a copy
    while further frames come.
    """

    id: str  # stable name of the person in the output
    first_ns: int  # ns, stamp of the person's first frame, which the window may have left behind
    swap_filter: SwapFilter  # filter that finds the parts of the body whose left and right are swapped
    intrinsics: Intrinsics
    focal: float  # px, focal length that the solvers assume; infinite for weak perspective
    is_tentative: bool  # whether the person has not been seen for long enough to be certain
    rays: Array  # (F, J, 2) x / z and y / z of the joints in the real camera, with the detector's labels
    weight: Array  # (F, J) confidence scores with the detector's labels; 0 for a joint that was not seen
    extremities: Extremities  # face, feet and hands with the detector's labels
    is_evidence: NDArray[np.bool_]  # (F, J) as of `DetectedBody`
    # the same frames with swaps undone, their lifted poses, and one virtual camera that faces the person in all of
    # them; its times count from the person's first frame
    observed: ObservedWindow = field(init=False)
    given_id: str = ''  # name that the detector gave the person last; empty if it gave none
    has_newest_id: bool = False  # whether it gave a name in the newest frame
    # number of frames in which the person was seen, some of which the window may have left behind
    frames_seen: int = 0
    stamps_ns: tuple[int, ...] = ()  # (F,) ns, stamps of the frames of the window, increasing
    # solution of the first S of these frames, where S is F, or F - 1 between the arrival of a frame and its
    # solution; None before the first solution
    solution: TrackSolution | None = None
    schedule: CheckSchedule = field(default_factory=CheckSchedule)  # the checks of the solution that are due
    filters: Array = field(default_factory=UNFILTERED.copy)  # (R,) `FILTERS` of the output
    size_by_floor: SizeEvidence | None = None  # what feet on the floor say of the person's size; None if nothing
    size_by_depth: SizeEvidence | None = None  # what measured depths say of it
    # (F, J) m, depths of the surfaces at joints with the detector's labels, NaN where unknown; None if all were so
    depth: Array | None = None
    correction: Array | None = None  # (J,) of the newest lifted pose by measured depths, as of `solvers.depth`

    @staticmethod
    def begin(
        name: str,
        stamp_ns: int,
        detection: DetectedBody,
        swap_filter: SwapFilter,
        intrinsics: Intrinsics,
        focal: float,
        is_tentative: bool = True,
    ) -> Track:
        """Return the track of a person whom a frame shows first; the attributes have the arguments' meaning."""
        arrays = detection.rays, detection.weight, *detection.extremities
        rays, weight, *others = (a[None][:0] for a in arrays)
        camera = intrinsics, focal, is_tentative
        track = Track(name, stamp_ns, swap_filter, *camera, rays, weight, Extremities(*others), weight > 0)
        track._correct_sides(np.zeros(0), None)
        track.add_frame(stamp_ns, detection, window_s=0.0)
        return track

    @property
    def solved(self) -> TrackSolution:
        """The solution of a track that has one.

        Raises:
            ValueError: The track has no solution yet.
        """
        if self.solution is None:
            raise ValueError(f'track {self.id} is not solved yet')
        return self.solution

    @property
    def has_unsolved_frame(self) -> bool:
        """Whether the newest frame of the window is not solved yet."""
        return self.solution is None or len(self.solution.theta) < len(self.stamps_ns)

    @property
    def newest(self) -> int:
        """Index of the newest frame."""
        return len(self.stamps_ns) - 1

    @property
    def age_s(self) -> float:
        """Time in s from the person's first frame to the newest."""
        return (self.stamps_ns[-1] - self.first_ns) / NS_PER_S

    @property
    def times_s(self) -> Array:
        """Times (F,) in s of the frames, that of the newest is 0."""
        stamps_ns = np.fromiter(self.stamps_ns, np.int64)
        return np.asarray((stamps_ns - stamps_ns[-1]) / NS_PER_S)

    def copy(self) -> Track:
        """Return the track as it is now."""
        other = copy.copy(self)
        other.schedule = copy.copy(self.schedule)
        return other

    def add_frame(self, stamp_ns: int, detection: DetectedBody, window_s: float, lag_s: float = 0.0) -> None:
        """Add a frame and drop those older than `window_s` s that are not still to be shown after `lag_s` s.

        If the frame changes the decision about swaps in earlier frames, a check becomes due.
        """
        dropped = bisect_left(self.stamps_ns, stamp_ns - window_s * NS_PER_S)
        if lag_s > 0:
            dropped = min(
                dropped, max(bisect_right(self.stamps_ns, find_oldest_needed_ns(stamp_ns, lag_s)) - 1, 0)
            )
        before, time_s = self.swap_filter.is_swapped[dropped:], (stamp_ns - self.first_ns) / NS_PER_S
        self.swap_filter = self.swap_filter.update(
            time_s, detection.rays, detection.weight, detection.size, dropped
        )
        swapped, unchanged = self.swap_filter.is_swapped[:-1], len(before)
        if swapped.tobytes() != before.tobytes():
            unchanged = int((swapped != before).any(axis=1).argmax())
            self.schedule.check_at(stamp_ns)
        lifted = self.observed.lifted if unchanged else None
        if lifted is not None:
            lifted = lifted.select_frames(slice(dropped, dropped + unchanged))
        if self.solution is not None:
            self.solution = self.solution.drop_oldest(dropped)
        self.given_id, self.has_newest_id = detection.given_id or self.given_id, bool(detection.given_id)
        self.stamps_ns = (*self.stamps_ns[dropped:], stamp_ns)
        self.rays = np.concatenate([self.rays[dropped:], detection.rays[None]])
        self.weight = np.concatenate([self.weight[dropped:], detection.weight[None]])
        self.is_evidence = np.concatenate([self.is_evidence[dropped:], detection.is_evidence[None]])
        self.extremities = self.extremities.append_frame(detection.extremities, dropped)
        if self.depth is not None or detection.depth is not None:
            unknown = np.full((len(self.stamps_ns), self.weight.shape[1]), np.nan)
            kept = unknown[1:] if self.depth is None else self.depth[dropped:]
            self.depth = np.concatenate([kept, unknown[:1] if detection.depth is None else detection.depth[None]])
        self.frames_seen += 1
        self.is_tentative = self.is_tentative and is_new(self.frames_seen, time_s)
        self._correct_sides(np.concatenate([self.observed.times[dropped:], [time_s]]), lifted)

    def _correct_sides(self, times: Array, lifted: LiftedPoses | None) -> None:
        """Undo the swaps of left and right, and face the person; the first frames have lifted poses."""
        rays, weight, extremities, swapped = self.rays, self.weight, self.extremities, self.swap_filter.is_swapped
        depth = self.depth
        if np.count_nonzero(swapped):
            if depth is not None:
                _, depth = exchange_sides(rays, depth, swapped, self.swap_filter.sides)
            rays, weight = exchange_sides(rays, weight, swapped, self.swap_filter.sides)
            extremities = extremities.exchange_sides(swapped)
        camera = VirtualCamera.look_at_mean_position(rays, weight, self.intrinsics)
        self.observed = ObservedWindow(
            times, rays, weight, camera, self.focal, lifted, extremities, self.is_evidence, depth
        )

    def change_camera(self, intrinsics: Intrinsics, focal: float) -> None:
        """Use other intrinsics: the image points stay, or are resized as the image is; nothing is lifted yet."""
        if self.solution is not None:
            self.solution = self.solution.change_camera(self.intrinsics, intrinsics)
        old = self.intrinsics.resize_like(intrinsics)

        def convert(rays: Array) -> Array:
            directions = np.concatenate([rays, np.ones_like(rays[..., :1])], axis=-1)
            return intrinsics.pixels_to_rays(old.project(directions))

        self.intrinsics, self.focal, self.filters = intrinsics, focal, restart_motion(self.filters)
        self.rays, self.swap_filter = convert(self.rays), self.swap_filter.convert_points(convert)
        self.extremities = Extremities(convert(self.extremities.rays), self.extremities.weight)
        self._correct_sides(self.observed.times, None)

    def select_frames(self, step_s: float, span_s: float) -> NDArray[np.intp]:
        """Return the indices of the best seen frame of each `step_s` s up to `span_s` s, with the newest."""
        age_s = -self.times_s
        step = (age_s / step_s + 0.5).astype(int)
        total_weight = np.append(self.weight[:-1].sum(axis=1), np.inf)
        order = np.lexsort((-total_weight, step))
        is_first_of_step = np.diff(step[order], prepend=-1) != 0
        selected = np.sort(order[is_first_of_step])
        return np.asarray(selected[age_s[selected] <= span_s])


def find_delayed_frame(stamps_ns: Sequence[int], lag_s: float, *, has_begun: bool) -> tuple[int, bool]:
    """Return the index of the frame that is shown, and whether the output has begun, of stamps (n + 1,) ns.

    The first stamp is that of the frame that was shown last or, before the output has begun, of the first frame.
    """
    lag_ns = lag_s * NS_PER_S
    newest_ns = stamps_ns[-1]
    interval_ns = (newest_ns - stamps_ns[0]) / max(len(stamps_ns) - 1, 1)
    tolerance_ns = min(interval_ns, lag_ns) / 2
    due_ns, overdue_ns = newest_ns - lag_ns + tolerance_ns, newest_ns - lag_ns - tolerance_ns
    if not has_begun and stamps_ns[0] > due_ns:
        return 0, False
    is_next_due = has_begun and len(stamps_ns) > 1 and stamps_ns[1] <= due_ns
    return max(bisect_right(stamps_ns, overdue_ns) - 1, int(is_next_due)), True


def find_oldest_needed_ns(newest_ns: int, lag_s: float) -> float:
    """Return a stamp in ns; of the frames up to it, only the newest may be shown now or later."""
    return newest_ns - 1.5 * lag_s * NS_PER_S
