# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The tracker: a sliding window for each person, and a reconstruction of its newest part at every new frame.

The tracker uses no ROS, no clock and no files. Its state depends only on the frames that it accepted, in their
order, so a replay of these frames gives the same people.

A new frame changes the newest part of each window in a few steps of the joint solver, all people of one model in
one batch. At intervals a person's window is solved from scratch or under another model from some of its frames; if
that explains the image better, it replaces the person's solution. Wrong cameras and changes of motion are found in
this way.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import accumulate

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.config import Config
from mocap_ros.errors import FrameDropped
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.level import CALIBRATED_TILT_STD, Floor
from mocap_ros.geometry.virtual_camera import solver_focal
from mocap_ros.keypoints.identities import Identities, Names
from mocap_ros.keypoints.left_right import BodySides, SwapFilter
from mocap_ros.keypoints.matching import DetectedBody
from mocap_ros.keypoints.person import Person2D
from mocap_ros.models.base_poses import ALL_MOTIONS, PoseModel
from mocap_ros.models.lifter import LiftedPoses
from mocap_ros.models.model_file import load_prior_lifter, load_velocity_correction
from mocap_ros.models.upward_direction import Stances
from mocap_ros.people import CameraVertical, People, PredictedPeople, TrackedFrame
from mocap_ros.skeleton import keypoint_layout
from mocap_ros.solvers.depth import fade, find_corrections
from mocap_ros.solvers.image_roll import CameraSide, find_roll
from mocap_ros.solvers.leading_prior import can_base_poses_lead, let_base_poses_lead
from mocap_ros.solvers.observed_window import append_lifted, sample_unlifted_histories
from mocap_ros.solvers.vertical import AUTO as AUTO_VERTICAL
from mocap_ros.solvers.vertical import NONE as NO_VERTICAL
from mocap_ros.solvers.vertical import Vertical, lift_under_vertical, read_given_vertical, turn_towards_vertical
from mocap_ros.tracking.body_size import BodySize, SizeEvidence, assume_size, read_body_heights
from mocap_ros.tracking.deferred_work import FRAME_BUDGET, FRAME_BUDGET_WITHOUT_LIFTER, DeferredWork
from mocap_ros.tracking.hypotheses import HypothesisChecker
from mocap_ros.tracking.output import Shown, describe_cores, follow_motion, make_people, widen_deviations
from mocap_ros.tracking.prediction import predict_ahead, predict_people
from mocap_ros.tracking.refinement import Refinement, refine
from mocap_ros.tracking.schedule import MIN_CHECK_INTERVAL_S
from mocap_ros.tracking.track import Track, find_delayed_frame
from mocap_ros.units import NS_PER_S

CHECK_INTERVAL_S = 0.5  # s; longest interval between checks without a lifter, where models take turns
# s; shortest `tracker.lag` with which accelerations are limited. The velocity of a frame whose future is unknown
# rests on few noisy frames; to go on with it costs the newest frame 1 to 6 mm, and one 0.1 s before it 1 to 3 mm.
MIN_ACCELERATION_LAG_S = 0.15
# Factor on `solver.scale_weight` below that lag: inertia holds back the newest frame of a person who approaches.
# At 1, the root of a person who walks at 3 m, with points like OpenPose's, is off by 266 mm instead of 185.
NEWEST_SCALE_FACTOR = 0.1
LIFTER_CHECK_INTERVAL_S = 5.0  # s; the longest with a lifter, whose prior makes errors rare
# 1; relative difference of focal lengths, and of the principal point over the focal length, up to which intrinsics
# are those of the same camera: 4 mm of the depth of a person 4 m away, and below a pixel in the image.
MAX_CAMERA_DIFFERENCE = 1e-3


class PeopleTracker:
    """Reconstructs people in 3D from 2D keypoints, frame by frame.

    Args:
        models: base poses, or several models by name. Each person has the likeliest of them; with a learned prior
            everybody has the model of all motions, if it is among them.
        config: all parameters; the tracker uses those of solver, classifier and tracker.

    Raises:
        ModelError: The lifter that `solver.prior` names cannot be loaded.
        ConfigError: The vertical that `tracker.vertical` gives is no unit vector, or `tracker.body_heights` are no
            ids with heights.
    """

    def __init__(self, models: PoseModel | Mapping[str, PoseModel], config: Config) -> None:
        by_name = {models.name: models} if isinstance(models, PoseModel) else models
        settings = config.tracker
        components = min(settings.components, config.solver.components)
        self.config = config
        self.models = {  # by name, rescaled to `tracker.body_height`
            n: m.rescale(settings.body_height / m.stature).truncate(components) for n, m in by_name.items()
        }
        skeleton = next(iter(self.models.values())).skeleton
        self._new_swap_filter = SwapFilter(BodySides.of(skeleton), enabled=settings.undo_swaps)
        self._skeleton = keypoint_layout(settings.skeleton)
        self._lifter = load_prior_lifter(config.solver.prior, skeleton)
        has_lifter = self._lifter is not None
        if has_lifter:
            load_velocity_correction()  # so that a missing file is found before the first frame
        is_all_enough = has_lifter and ALL_MOTIONS in self.models
        self._candidate_models = (ALL_MOTIONS,) if is_all_enough else tuple(self.models)
        scale_weight = NEWEST_SCALE_FACTOR * config.solver.scale_weight
        of_newest = replace(config.solver, pose_acceleration_weight=0.0, scale_weight=scale_weight)
        self._checker = HypothesisChecker(self.models, replace(config, solver=of_newest))
        default_interval_s = LIFTER_CHECK_INTERVAL_S if has_lifter else CHECK_INTERVAL_S
        compares_leads = has_lifter and any(map(can_base_poses_lead, self._candidate_models))
        turns = (*self._candidate_models, '') if compares_leads else self._candidate_models
        interval_s = settings.hypothesis_check_interval or default_interval_s
        budget = FRAME_BUDGET if has_lifter else FRAME_BUDGET_WITHOUT_LIFTER
        self._deferred_work = DeferredWork(self._checker, turns, interval_s, budget)
        self._is_newest_shown = settings.lag < MIN_ACCELERATION_LAG_S
        refinement = of_newest if self._is_newest_shown else config.solver
        refinement = replace(refinement, max_iterations=settings.iterations)
        configs = {False: refinement, True: let_base_poses_lead(refinement)}
        self._refinements = {
            (n, leads): Refinement(m, own) for n, m in self.models.items() for leads, own in configs.items()
        }
        self._limits_accelerations = refinement.pose_acceleration_weight > 0
        self._vertical = read_given_vertical(settings)
        read_body_heights(settings.body_heights)  # raises what is wrong with them
        self.reset()

    @property
    def vertical(self) -> CameraVertical | None:
        """What is known of the camera's vertical; None if nothing is."""
        known = self._vertical
        return None if known is None else CameraVertical(known.direction, known.std, known.is_given)

    def reset(self) -> None:
        """Begin without people, names and stamps; a vertical that was given stays."""
        self.tracks: list[Track] = []  # in the order in which people came
        self._leaving: list[Track] = []  # with a lag, tracks that have ended and are still to be shown
        self._who = Identities[Track](self.config.tracker)
        self._waiting_ns: list[int] = []  # with a lag, stamps of the frame that is shown and of those after it
        self._has_output_begun = False  # with a lag, whether a frame was old enough since anybody was there
        self._is_work_pending = False
        self._intrinsics: Intrinsics | None = None
        self._at_work: Sequence[Track] = ()  # the people whom a stage works on
        self._side = CameraSide()
        self._vertical = self._vertical and self._vertical.forget()

    def list_names(self) -> Names:
        """Return the names of people, and where they are, for a tracker that begins without them."""
        return self._who.list_names(self.tracks)

    def recall_names(self, names: Names) -> None:
        """Give people their names of before, where they were; only right after the start or `reset`."""
        self._who.recall(names)

    def update(
        self, stamp_ns: int, people: Sequence[Person2D], intrinsics: Intrinsics, floor: Floor | None = None
    ) -> TrackedFrame:
        """Track the people of a new frame.

        A stamp (ns) that is older than the newest by more than `tracker.restart_after` restarts the tracker. The
        deferred work of the frame before is done first, if it was not done yet. Intrinsics of the frame before are
        used where these hardly differ; the floor, if it is known, shows how tall people are. An error in a stage,
        which is a fault of the program, is raised; the people whom it concerns are begun anew by the next frame.

        Returns the people in this frame, in the order of `people`, parts of one person joined, and then those
        who are predicted because they were not detected, or with fewer than `tracker.min_joints` joints. With
        `tracker.lag`, they are those of an older frame, in the order in which they came, and none is predicted.
        New people are tentative until they have been seen for a while, and are not predicted before.

        Raises:
            FrameDropped: The stamp repeats the newest or is a little older; the state has not changed.
            SkeletonError: Joints do not fit the model; the state has not changed.
        """
        settings = self.config.tracker
        backward_jump_s = self._measure_backward_jump(stamp_ns)
        if backward_jump_s == 0 and not self._who.is_everybody_gone(stamp_ns):
            intrinsics = self._choose_intrinsics(intrinsics)
        converted = DetectedBody.from_people(people, intrinsics, settings.min_score, settings.min_joints)
        detections = [d for d in converted if d is not None]
        self.run_deferred_work()
        if backward_jump_s > 0:
            self.reset()
        self._at_work = ()
        has_restarted = self._who.newest_ns is None
        try:
            self._change_camera(intrinsics)
            self._use_floor(stamp_ns, floor)
            self._forget_lost(stamp_ns)
            tracks = self._associate(stamp_ns, detections, intrinsics)
            self._lift(stamp_ns, tracks)
            self._initialise(stamp_ns, [t for t in tracks if t.solution is None])
            self._refine([t for t in tracks if t.has_unsolved_frame])
            shown_ns, shown, frames = self._choose_shown(stamp_ns, tracks)
            seen = self._make_people(shown_ns, shown, frames, floor)
            output = People.concatenate([seen, self._predict_missing(stamp_ns)])
        except Exception:
            self._forget_concerned()
            raise
        finally:
            self._who.end_frame(stamp_ns, has_people=bool(detections))
            self._is_work_pending = True
        return TrackedFrame(
            stamp_ns=shown_ns,
            people=output,
            vertical=self.vertical,
            has_restarted=has_restarted,
            backward_jump_s=backward_jump_s,
            is_floor_seen=any(t.size_by_floor is not None for t in self.tracks),
            swapped=sum(bool(np.count_nonzero(t.swap_filter.is_swapped[-1])) for t in tracks),
            unusable=len(people) - len(tracks),
            faults=tuple(self._who.list_faults()),
        )

    def predict(self, times_s: Sequence[float]) -> list[PredictedPeople]:
        """Return the people of the newest frame at times after it, none tentative; none with `tracker.lag`."""
        newest_ns = self._who.newest_ns
        tracks = [] if newest_ns is None else self._list_known(newest_ns)
        return predict_ahead(tracks, newest_ns or 0, times_s, self._upward, [*map(self._find_size, tracks)])

    def run_deferred_work(self) -> None:
        """Do the part of the checks and classifications that follows the last frame, if not done yet.

        The next `update` would do this work first. A caller who has time before then spares that frame the delay.
        """
        if self._is_work_pending and self._who.newest_ns is not None:
            self._is_work_pending = False
            self._deferred_work.advance(self.tracks, self._who.newest_ns)

    def _measure_backward_jump(self, stamp_ns: int) -> float:
        """Return by how many seconds the stamp goes back, so that tracking must restart; 0 for a newer stamp.

        Raises:
            FrameDropped: The stamp repeats the newest or is a little older.
        """
        newest_ns = self._who.newest_ns
        if newest_ns is None:
            return 0.0
        back_ns = newest_ns - stamp_ns
        if back_ns > self.config.tracker.restart_after * NS_PER_S:
            return back_ns / NS_PER_S
        if back_ns >= 0:
            relation = 'is older than' if back_ns else 'repeats'
            raise FrameDropped(f'stamp {stamp_ns} ns {relation} the newest accepted, {newest_ns} ns')
        return 0.0

    def _choose_intrinsics(self, given: Intrinsics) -> Intrinsics:
        """Return the intrinsics in use, or those given if they are of another camera.

        A camera with autofocus sends a CameraInfo that differs a little from image to image. Under new intrinsics
        the whole window is lifted anew, velocities begin from nothing and the vertical is forgotten, so small
        differences from those in use are left out.
        """
        used = self._intrinsics
        if used is None or given is used:
            return given
        is_near = (
            abs(given.focal / used.focal - 1) <= MAX_CAMERA_DIFFERENCE
            and abs(given.aspect / used.aspect - 1) <= MAX_CAMERA_DIFFERENCE
            and math.dist(given.center, used.center) <= MAX_CAMERA_DIFFERENCE * used.focal
        )
        nearly = replace(given, focal=used.focal, aspect=used.aspect, center=used.center) if is_near else given
        return used if nearly == used else given

    def _change_camera(self, intrinsics: Intrinsics) -> None:
        """Convert all tracks to the intrinsics of this frame, if these have changed."""
        if self._intrinsics not in (None, intrinsics):
            for track in (*self.tracks, *self._leaving):
                self._at_work = (track,)
                track.change_camera(intrinsics, solver_focal(intrinsics, self.config.tracker.perspective))
            self._at_work = ()
            self._vertical = self._vertical and self._vertical.forget()
            self._side = CameraSide()
        self._intrinsics = intrinsics

    def _use_floor(self, stamp_ns: int, floor: Floor | None) -> None:
        """Use the vertical of the floor, stamp in ns, unless `tracker.vertical` gives another.

        A vertical of a floor is forgotten when the floor is no longer known, for the camera may move.
        """
        if self.config.tracker.vertical != AUTO_VERTICAL:
            return
        if floor is not None:
            self._vertical = Vertical.give(floor.upward, stamp_ns, floor.tilt_std)
        elif self._vertical is not None and self._vertical.is_given:
            self._vertical = None

    def _forget_lost(self, stamp_ns: int) -> None:
        """End the tracks of people who were not detected for `tracker.forget_after`.

        Tentative tracks are forgotten sooner and without a trace. If images were empty for long, everything is
        forgotten. Names of earlier people then have no influence on what follows, so a recording that is cut in
        two after such an absence gives the same people as the whole.
        """
        for track in self._who.find_lost(stamp_ns, self.tracks):
            self._end(track)
        if self._who.is_everybody_gone(stamp_ns):
            newest_ns, intrinsics = self._who.newest_ns, self._intrinsics
            self.reset()
            self._who.newest_ns, self._intrinsics = newest_ns, intrinsics

    def _end(self, track: Track) -> None:
        """End a track; with a lag, its last frames are still to be shown."""
        self.tracks.remove(track)
        self._leaving.append(track)

    def _forget_concerned(self) -> None:
        """Forget the people at whom a stage was when it raised an error, and those whom it left unsolved."""
        for tracks in (self.tracks, self._leaving):
            tracks[:] = [t for t in tracks if not (t in self._at_work or t.has_unsolved_frame)]

    def _associate(self, stamp_ns: int, detections: Sequence[DetectedBody], intrinsics: Intrinsics) -> list[Track]:
        """Match the detections with the known people; return the track of each person with this frame added.

        New people are tentative, but for a stream so slow that nobody is known from one frame to the next. The
        track of a person whose id the detector has given to another person ends.
        """
        settings = self.config.tracker
        focal = solver_focal(intrinsics, settings.perspective)
        matches = self._who.match(stamp_ns, self.tracks, detections)
        for track in matches.replaced:
            self._end(track)
        used_ids = {t.id for t in self.tracks}
        is_tentative = self._who.is_first_tentative(stamp_ns)
        tracks = []
        for detection, known in zip(matches.detections, matches.tracks, strict=True):
            if known is not None:
                self._at_work = (known,)
                known.add_frame(stamp_ns, detection, settings.window, settings.lag)
                tracks.append(known)
                continue
            name = self._who.name(stamp_ns, detection, used_ids)
            camera = intrinsics, focal, is_tentative
            tracks.append(Track.begin(name, stamp_ns, detection, self._new_swap_filter, *camera))
            self.tracks.append(tracks[-1])
        self._at_work = ()
        return tracks

    def _lift(self, stamp_ns: int, tracks: Sequence[Track]) -> None:
        """Lift the new frames of tracks, all in one batch, if there is a lifter.

        The lifter gets a vertical that is given, for those with a straight leg. The lifted poses are turned
        towards the vertical as it was known before; then it is found anew.
        """
        if self._lifter is None or not tracks:
            return
        windows = [t.observed for t in tracks]
        newest = [end - 1 for end in accumulate(len(o.times) - o.lifted_frames for o in windows)]
        if self._side.is_due(stamp_ns):
            rays, scores = np.array([t.rays[-1] for t in tracks]), np.array([t.weight[-1] for t in tracks])
            self._side.advance(stamp_ns, rays, scores)
        known, given, roll = self._vertical, None, math.pi if self._side.is_upside_down else 0.0
        if known is not None and known.is_given:
            roll = find_roll(known.direction)
        points, weight, cameras = sample_unlifted_histories(windows, roll)
        if known is not None and known.is_given:
            given = cameras @ known.direction, np.full(len(cameras), known.std)
        lifted = lift_under_vertical(self._lifter, points, weight, given)
        lifted = self._correct_by_depth(tracks, lifted, cameras)
        if self.config.tracker.vertical != NO_VERTICAL:
            stances = Stances.of(lifted.joints, cameras, weight.max(axis=1))
            if known is not None:
                towards = known.direction[None], np.array([known.std])
                lifted = turn_towards_vertical(lifted, stances, cameras, *towards)
            self._find_vertical(stamp_ns, tracks, newest, stances)
        append_lifted(windows, lifted, cameras)

    def _correct_by_depth(self, tracks: Sequence[Track], lifted: LiftedPoses, cameras: Array) -> LiftedPoses:
        """Return the lifted poses of the frames not lifted yet as measured depths correct them, if there are any.

        What is known of earlier corrections is forgotten where earlier frames are lifted anew.
        """
        windows = [t.observed.select_frames(slice(t.observed.lifted_frames, None)) for t in tracks]
        if all(window.depth is None for window in windows):
            return lifted
        surface = [np.full_like(w.weight, np.nan) if w.depth is None else w.depth for w in windows]
        rays, counts = np.concatenate([w.rays for w in windows]), [len(w.times) for w in windows]
        heights = [self.config.tracker.body_height * self._find_size(t).ratio for t in tracks]
        found = find_corrections(np.concatenate(surface), rays, cameras, lifted, np.repeat(heights, counts))
        for track, count, end in zip(tracks, counts, accumulate(counts), strict=True):
            newest, times = found.depth[end - 1], track.observed.times
            if track.correction is not None and count == 1 < len(times):
                newest[:] = fade(track.correction, newest, float(times[-1] - times[-2]))
            track.correction = newest.copy()
        return found.apply(lifted)

    def _find_vertical(
        self, stamp_ns: int, tracks: Sequence[Track], newest: Sequence[int], stances: Stances
    ) -> None:
        """Find the vertical anew by what the newest poses of tracks show."""
        shares = stances.standing.tolist()
        shown = zip(newest, tracks, strict=True)
        known = [n for n, t in shown if not t.is_tentative and math.isfinite(shares[n])]
        if not known:
            return
        if len(known) < len(shares):
            stances = Stances(*(values[known] for values in stances))
        sign = -1.0 if self._side.is_upside_down else 1.0
        if self._vertical is None:
            self._vertical = Vertical.begin(stamp_ns, stances, sign)
        else:
            self._vertical = self._vertical.advance(stamp_ns, stances, sign)

    def _initialise(self, stamp_ns: int, tracks: Sequence[Track]) -> None:
        """Give the tracks of new people a first solution, all in one batch a model; it is checked soon."""
        if tracks:
            solutions = self._checker.initialise(tracks, self._candidate_models)
            for track, solution in zip(tracks, solutions, strict=True):
                track.solution = solution
                track.schedule.check_at(stamp_ns + round(MIN_CHECK_INTERVAL_S * NS_PER_S))

    def _refine(self, tracks: Sequence[Track]) -> None:
        """Solve the newest `tracker.refine_seconds` of tracks; all of one model and one leading prior are a batch.

        The frame before the refined ones keeps its state, so the older part of a window does not change and costs
        no time.
        """
        batches: dict[tuple[str, bool], list[Track]] = {}
        for track in tracks:
            batches.setdefault((track.solved.model_name, track.solved.base_poses_lead), []).append(track)
        for way, batch in batches.items():
            parts = [self._select_refined_frames(t) for t in batch]
            solutions = refine(self._refinements[way], batch, parts)
            for track, solution in zip(batch, solutions, strict=True):
                track.solution = solution

    def _select_refined_frames(self, track: Track) -> tuple[int, int]:
        """Return the index of the first frame that the solver gets, and how many frames it must not change."""
        settings = self.config.tracker
        oldest_ns = track.stamps_ns[-1] - max(settings.refine_seconds, settings.lag) * NS_PER_S
        first = min(bisect_left(track.stamps_ns, oldest_ns), len(track.solved.theta))
        fixed_frames = min(first, 2 if self._limits_accelerations else 1)
        return first - fixed_frames, fixed_frames

    def _choose_shown(self, stamp_ns: int, detected: list[Track]) -> tuple[int, list[Track], list[int]]:
        """Choose the frame that is shown; return its stamp, who was detected in it, and its index in each window.

        It is this frame or, with `tracker.lag`, an older one (`track`); before one is old enough, the
        first frame since anybody was there, without its people.
        """
        lag_s, shown_ns = self.config.tracker.lag, stamp_ns
        if lag_s > 0:
            if self._who.newest_person_ns is None:
                self._waiting_ns, self._has_output_begun = [], False
            self._waiting_ns.append(stamp_ns)
            first, self._has_output_begun = find_delayed_frame(
                self._waiting_ns, lag_s, has_begun=self._has_output_begun
            )
            del self._waiting_ns[:first]
            shown_ns = self._waiting_ns[0]
        self._leaving = [t for t in self._leaving if t.stamps_ns[-1] >= shown_ns]
        if lag_s == 0:
            return shown_ns, detected, [t.newest for t in detected]
        if not self._has_output_begun:
            return shown_ns, [], []
        people = sorted((*self._leaving, *self.tracks), key=lambda t: t.first_ns)
        people = [t for t in people if shown_ns in t.stamps_ns]
        return shown_ns, people, [t.stamps_ns.index(shown_ns) for t in people]

    def _make_people(self, shown_ns: int, tracks: list[Track], frames: list[int], floor: Floor | None) -> People:
        """Return the people who are shown, of the sizes that the floor, if it is known, shows."""
        if not tracks:
            return People.none(self._skeleton)
        self._at_work, shown, settings = tracks, Shown.of(tracks, frames), self.config.tracker
        is_steady = settings.steady_output and self._is_newest_shown
        motion, seen = follow_motion(shown, self.vertical, self._find_size, shown_ns, is_steady=is_steady)
        if floor is None and (height := settings.camera_height) and self._vertical is not None:
            tilt_std = CALIBRATED_TILT_STD if self._vertical.is_given else self._vertical.std
            floor = Floor(self._vertical.direction, height, tilt_std)
        if floor is not None:
            for p, track in enumerate(tracks):
                if track.intrinsics.is_focal_known and not track.is_tentative:
                    track.size_by_floor = SizeEvidence.add_floor(
                        track.size_by_floor,
                        shown_ns,
                        motion.joints[p],
                        motion.velocity[p],
                        seen.weight[p],
                        floor,
                        settings.body_height,
                    )
        sizes = [*map(self._find_size, tracks)]
        own, root_covariance = describe_cores(shown, motion.joints, seen, sizes)
        std = widen_deviations(own, motion.joints, seen, sizes, self._upward)
        return make_people(shown, motion, std, root_covariance, seen.weight, sizes, self._skeleton)

    def _find_size(self, track: Track) -> BodySize:
        """Return what is known of a person's size; the detector may say who it is when the track has a name."""
        settings, person_id = self.config.tracker, track.id
        if track.given_id in read_body_heights(settings.body_heights):
            person_id = track.given_id
        hidden = 0.0 if track.solution is None else track.solution.hidden_share
        assumed = assume_size(settings, person_id, track.intrinsics.is_focal_known, hidden)
        for shown in (track.size_by_floor, track.size_by_depth):
            if shown is not None:
                assumed = shown.find_size(assumed)
        return assumed

    def _predict_missing(self, stamp_ns: int) -> People:
        """Return the people who are predicted for this frame, stamp in ns; none with `tracker.lag`."""
        missing = [t for t in self._list_known(stamp_ns) if t.stamps_ns[-1] < stamp_ns]
        self._at_work = missing
        return predict_people(missing, stamp_ns, self._upward, [*map(self._find_size, missing)], self._skeleton)

    def _list_known(self, stamp_ns: int) -> list[Track]:
        """Return the tracks that are seen in this frame, stamp in ns, or predicted; none with `tracker.lag`."""
        settings = self.config.tracker
        if settings.lag > 0:
            return []
        longest_ns = settings.predict_for * NS_PER_S
        return [t for t in self.tracks if not t.is_tentative and stamp_ns - t.stamps_ns[-1] <= longest_ns]

    @property
    def _upward(self) -> Array | None:
        return None if self._vertical is None else self._vertical.direction
