# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""One tracked person: what was seen, what was solved of it, and what is scheduled."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mocap_ros.copying import copy_with
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.left_right import SwapFilter
from mocap_ros.models.lifter import LiftedPoses
from mocap_ros.solvers.extremities import ExtremityEvidence, ExtremityState
from mocap_ros.tracking.detection import Detection
from mocap_ros.tracking.motion_filter import MotionFilter
from mocap_ros.tracking.schedule import CheckSchedule
from mocap_ros.tracking.seen_frames import SeenFrames
from mocap_ros.tracking.solution import TrackSolution
from mocap_ros.units import NS_PER_S

# What a new person must have been seen for; docs/tracker.md has what other numbers cost.
MIN_FRAMES = 3  # frames; at a low frame rate a wrong detection is in one or two
MIN_AGE_S = 0.06  # s; at a high frame rate it lasts for several frames; three frames at 30 Hz last 0.067 s


Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Track:
    """A tracked person; every step returns a new track, so a track is a snapshot of itself.

    Attributes:
        id: stable name of the person in the output.
        seen: the F frames of the sliding window.
        solution: solution of the first S of these frames, where S is F, or F - 1 between the arrival of a frame
            and its solution; None before the first solution.
        schedule: the checks of the solution that are due.
        is_tentative: whether the person has not been seen for long enough to be sure that there is somebody.
        motion_filter: filter of the output; None before the first output, or if nothing is filtered.
        first_ns: ns, stamp of the frame in which the person was first seen.
        frames_seen: number of frames in which the person was seen, some of which the window may have left behind.
        extremities: face, feet and hands in the frame that was put out last; None before the first output.
        extremities_ns: ns, stamp of this frame.
    """

    id: str
    seen: SeenFrames
    solution: TrackSolution | None = None
    schedule: CheckSchedule = field(default_factory=CheckSchedule)
    is_tentative: bool = False
    motion_filter: MotionFilter | None = None
    first_ns: int = 0
    frames_seen: int = 1
    extremities: ExtremityState | None = None
    extremities_ns: int = 0

    @property
    def key(self) -> tuple[str, int]:
        """Id and first stamp in ns, which no other track has; a detector may give an id to several people."""
        return self.id, self.first_ns

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
        return self.solution is None or len(self.solution.theta) < len(self.seen.stamps_ns)

    @staticmethod
    def begin(
        name: str,
        stamp_ns: int,
        detection: Detection,
        swap_filter: SwapFilter,
        intrinsics: Intrinsics,
        focal: float,
        is_tentative: bool = True,
    ) -> Track:
        """Return the track of a person who is seen for the first time; the arguments are those of `SeenFrames`.

        Args:
            name: stable name of the person in the output.
            stamp_ns: ns, stamp of the frame.
            detection: the person in this frame.
            swap_filter: filter that has seen no frame.
            intrinsics: intrinsics of the real camera.
            focal: px, focal length that the solvers assume.
            is_tentative: whether only later frames can tell that there is somebody.
        """
        seen = SeenFrames.begin(stamp_ns, detection, swap_filter, intrinsics, focal)
        return Track(name, seen, is_tentative=is_tentative, first_ns=stamp_ns)

    def add_frame(self, stamp_ns: int, detection: Detection, window_s: float, lag_s: float = 0.0) -> Track:
        """Return the track with one more frame and without the frames that are too old.

        If the frame changes the decision about swaps in earlier frames, a hypothesis check becomes due.

        Args:
            stamp_ns: ns, stamp of the frame.
            detection: the person in this frame.
            window_s: s, length of the window.
            lag_s: s, delay of the output.
        """
        dropped = self.seen.count_older_frames(stamp_ns, window_s, lag_s)
        seen = self.seen.add_frame(stamp_ns, detection, dropped)
        solution = None if self.solution is None else self.solution.drop_oldest(dropped)
        schedule = self.schedule
        if seen.is_relabelled:
            schedule = schedule.check_at(stamp_ns)
        frames_seen = self.frames_seen + 1
        return copy_with(
            self,
            seen=seen,
            solution=solution,
            schedule=schedule,
            is_tentative=self.is_tentative and (frames_seen < MIN_FRAMES or seen.age_s <= MIN_AGE_S),
            frames_seen=frames_seen,
        )

    def append_lifted(self, lifted: LiftedPoses) -> Track:
        """Return the track with lifted poses of the frames that had none; see `ObservedWindow.append_lifted`."""
        return copy_with(self, seen=self.seen.append_lifted(lifted))

    def refine(self, solution: TrackSolution) -> Track:
        """Return the track with a newer solution of all its frames."""
        return copy_with(self, solution=solution)

    def filter_motion(self, stamp_ns: int, joints: Array) -> Track:
        """Return the track whose output goes on with the joints (J, 3) m of a frame, stamp in ns."""
        if self.motion_filter is None:
            motion_filter = MotionFilter.begin(stamp_ns, joints)
        elif stamp_ns > self.motion_filter.stamps_ns[-1]:
            image_noise = self.solved.noise / self.solved.stature_ratio
            motion_filter = self.motion_filter.advance(stamp_ns, joints, image_noise)
        else:  # with a lag, this frame was put out before
            return self
        return copy_with(self, motion_filter=motion_filter)

    def follow_extremities(self, stamp_ns: int, evidence: ExtremityEvidence, stature: float) -> Track:
        """Return the track with the extremities in the frame that is put out.

        Args:
            stamp_ns: ns, stamp of the frame.
            evidence: what tells of them.
            stature: m, stature of the person.
        """
        if self.extremities is None:
            extremities = ExtremityState.begin(evidence, stature)
        elif stamp_ns > self.extremities_ns:
            step_s = (stamp_ns - self.extremities_ns) / NS_PER_S
            extremities = self.extremities.advance(step_s, evidence, stature)
        else:  # with a lag, this frame was put out before
            return self
        return copy_with(self, extremities=extremities, extremities_ns=stamp_ns)

    def begin_solution(self, solution: TrackSolution) -> Track:
        """Return the track with its first solution, which is checked soon."""
        schedule = self.schedule.check_after_initialisation(self.seen.stamps_ns[-1])
        return copy_with(self, solution=solution, schedule=schedule)

    def change_camera(self, intrinsics: Intrinsics, focal: float) -> Track:
        """Return the track under other intrinsics, with the same image points, or resized as the image is.

        Args:
            intrinsics: intrinsics from now on.
            focal: px, focal length that the solvers assume from now on.
        """
        old = self.seen.intrinsics
        solution = None if self.solution is None else self.solution.change_camera(old, intrinsics)
        seen = self.seen.change_camera(intrinsics, focal)
        return copy_with(self, seen=seen, solution=solution, motion_filter=None)
