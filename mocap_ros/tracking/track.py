"""One tracked person: what was seen, what was solved of it, and what is scheduled."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.left_right import SwapFilter
from mocap_ros.models.lifter import LiftedPoses
from mocap_ros.tracking.detection import Detection
from mocap_ros.tracking.schedule import CheckSchedule
from mocap_ros.tracking.seen_frames import SeenFrames
from mocap_ros.tracking.solution import TrackSolution


@dataclass(frozen=True, eq=False)
class Track:
    """A tracked person; every step returns a new track, so a track is a snapshot of itself.

    Attributes:
        id: stable name of the person in the output.
        seen: the F frames of the sliding window.
        solution: solution of the first S of these frames, where S is F, or F - 1 between the arrival of a frame
            and its solution; None before the first solution.
        schedule: the checks of the solution that are due.
    """

    id: str
    seen: SeenFrames
    solution: TrackSolution | None = None
    schedule: CheckSchedule = field(default_factory=CheckSchedule)

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
    ) -> Track:
        """Return the track of a person who is seen for the first time; the arguments are those of `SeenFrames`.

        Args:
            name: stable name of the person in the output.
            stamp_ns: ns, stamp of the frame.
            detection: the person in this frame.
            swap_filter: filter that has seen no frame.
            intrinsics: intrinsics of the real camera.
            focal: px, focal length that the solvers assume.
        """
        return Track(name, SeenFrames.begin(stamp_ns, detection, swap_filter, intrinsics, focal))

    def add_frame(self, stamp_ns: int, detection: Detection, window_s: float) -> Track:
        """Return the track with one more frame and without the frames that are too old.

        If the frame changes the decision about swaps in earlier frames, a hypothesis check becomes due.

        Args:
            stamp_ns: ns, stamp of the frame.
            detection: the person in this frame.
            window_s: s, length of the window.
        """
        dropped = self.seen.count_older_frames(stamp_ns, window_s)
        seen = self.seen.add_frame(stamp_ns, detection, dropped)
        solution = None if self.solution is None else self.solution.drop_oldest(dropped)
        schedule = self.schedule
        if seen.is_relabelled:
            schedule = schedule.check_at(stamp_ns)
        return Track(self.id, seen, solution, schedule)

    def append_lifted(self, lifted: LiftedPoses) -> Track:
        """Return the track with lifted poses of the frames that had none; see `ObservedWindow.append_lifted`."""
        return Track(self.id, self.seen.append_lifted(lifted), self.solution, self.schedule)

    def refine(self, solution: TrackSolution) -> Track:
        """Return the track with a newer solution of all its frames."""
        return Track(self.id, self.seen, solution, self.schedule)

    def begin_solution(self, solution: TrackSolution) -> Track:
        """Return the track with its first solution, which is checked soon."""
        schedule = self.schedule.check_after_initialisation(self.seen.stamps_ns[-1])
        return replace(self, solution=solution, schedule=schedule)

    def change_camera(self, intrinsics: Intrinsics, focal: float) -> Track:
        """Return the track under other intrinsics, with the same image points.

        Args:
            intrinsics: intrinsics from now on.
            focal: px, focal length that the solvers assume from now on.
        """
        old = self.seen.intrinsics
        solution = None if self.solution is None else self.solution.change_camera(old, intrinsics)
        return replace(self, seen=self.seen.change_camera(intrinsics, focal), solution=solution)
