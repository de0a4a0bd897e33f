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

import numpy as np
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import compile_kernels
from mocap_ros.config import Config, TrackerConfig
from mocap_ros.errors import FrameDropped, InputError
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.level import Floor
from mocap_ros.geometry.virtual_camera import solver_focal
from mocap_ros.keypoints.left_right import BodySides, SwapFilter
from mocap_ros.keypoints.person import Person2D
from mocap_ros.models.base_poses import ALL_MOTIONS, BasePoses
from mocap_ros.models.model_file import load_prior_lifter, load_velocity_correction
from mocap_ros.models.upward_direction import find_standing, find_upward
from mocap_ros.people import CameraVertical, Person3D, PredictedPerson
from mocap_ros.skeleton import keypoint_layout
from mocap_ros.solvers.joint.solver import solve
from mocap_ros.solvers.leading_prior import can_base_poses_lead, let_base_poses_lead
from mocap_ros.solvers.observed_window import RAY_FOCAL
from mocap_ros.solvers.vertical import AUTO as AUTO_VERTICAL
from mocap_ros.solvers.vertical import NONE as NO_VERTICAL
from mocap_ros.solvers.vertical import (
    Vertical,
    lift_under_vertical,
    read_given_vertical,
    turn_towards_vertical,
)
from mocap_ros.tracking.body_size import (
    MAX_REMEMBERED,
    BodySize,
    FloorContact,
    assume_size,
    read_body_heights,
    resize,
)
from mocap_ros.tracking.deferred_work import FRAME_BUDGET, FRAME_BUDGET_WITHOUT_LIFTER, DeferredWork
from mocap_ros.tracking.delayed_output import find_delayed_frame
from mocap_ros.tracking.detection import Detection
from mocap_ros.tracking.hypotheses import HypothesisChecker
from mocap_ros.tracking.matching import match_detections
from mocap_ros.tracking.pose_memory import KeyPoseMemory
from mocap_ros.tracking.prediction import predict_ahead, predict_person
from mocap_ros.tracking.same_camera import is_same_camera
from mocap_ros.tracking.solver_input import build_refinement_window
from mocap_ros.tracking.state import TrackerState
from mocap_ros.tracking.track import Track
from mocap_ros.tracking.whole_person import (
    collect_track_evidence,
    complete_prediction,
    make_whole_person,
)
from mocap_ros.units import NS_PER_S

Array = NDArray[np.float64]

CHECK_INTERVAL_S = 0.5  # s; longest interval between checks without a lifter, where models take turns
TENTATIVE_FORGET_S = 0.2  # s; a detector misses a person for a few frames, and a new one must not be new again
# s; shortest `tracker.lag` with which accelerations are limited. The velocity of a frame whose future is unknown
# rests on few noisy frames; to go on with it costs the newest frame 1 to 6 mm, and one 0.1 s before it 1 to 3 mm.
MIN_ACCELERATION_LAG_S = 0.15
# Factor on `solver.scale_weight` below that lag: inertia holds back the newest frame of somebody who approaches.
# At 1, the root of a person who walks at 3 m, with points like OpenPose's, is off by 266 mm in place of 185.
NEWEST_SCALE_FACTOR = 0.1
LIFTER_CHECK_INTERVAL_S = 5.0  # s; the longest with a lifter, whose prior makes errors rare


class Tracker:
    """Reconstructs people in 3D from 2D keypoints, frame by frame.

    All that changes is one immutable `TrackerState`, which is replaced when a frame is finished. A frame that
    raises an error leaves no trace in it.

    Args:
        models: base poses, or several models by name. Each person has the likeliest of them; with a learned prior
            everybody has the model of all motions, if it is among them.
        config: all parameters; the tracker uses those of solver, classifier and tracker.

    Raises:
        ModelError: The lifter that `solver.prior` names cannot be loaded.
        ConfigError: The vertical that `tracker.vertical` gives is no unit vector, or `tracker.body_heights` are no
            ids with heights.

    Attributes:
        config: all parameters.
        models: base-pose models by name, rescaled to `tracker.body_height`.
    """

    def __init__(self, models: BasePoses | Mapping[str, BasePoses], config: Config) -> None:
        compile_kernels()
        by_name = {models.name: models} if isinstance(models, BasePoses) else models
        settings = config.tracker
        components = min(settings.components, config.solver.components)
        self.config = config
        self.models = {
            n: m.rescale(settings.body_height / m.stature).truncate(components) for n, m in by_name.items()
        }
        skeleton = next(iter(self.models.values())).skeleton
        self._new_swap_filter = SwapFilter(BodySides.of(skeleton), enabled=settings.undo_swaps)
        self._skeleton = keypoint_layout(settings.skeleton)
        self._lifter = load_prior_lifter(config.solver.prior, skeleton)
        has_lifter = self._lifter is not None
        if has_lifter:
            load_velocity_correction()  # so that a file that is missing is told before the first frame
        is_all_enough = has_lifter and ALL_MOTIONS in self.models
        self._candidate_models = (ALL_MOTIONS,) if is_all_enough else tuple(self.models)
        scale_weight = NEWEST_SCALE_FACTOR * config.solver.scale_weight
        of_newest = replace(config.solver, pose_acceleration_weight=0.0, scale_weight=scale_weight)
        checked = replace(config, solver=of_newest)
        self._checker = HypothesisChecker(self.models, checked)
        default_interval_s = LIFTER_CHECK_INTERVAL_S if has_lifter else CHECK_INTERVAL_S
        max_interval_s = settings.hypothesis_check_interval or default_interval_s
        budget = FRAME_BUDGET if has_lifter else FRAME_BUDGET_WITHOUT_LIFTER
        compares_leads = has_lifter and any(map(can_base_poses_lead, self._candidate_models))
        self._deferred_work = DeferredWork(
            self._checker, self._candidate_models, max_interval_s, budget, compares_leads=compares_leads
        )
        refinement = checked.solver if settings.lag < MIN_ACCELERATION_LAG_S else config.solver
        refinement = replace(refinement, max_iterations=settings.iterations)
        self._refinement_configs = {False: refinement, True: let_base_poses_lead(refinement)}
        self._limits_accelerations = refinement.pose_acceleration_weight > 0
        sizes = tuple((name, len(model.components)) for name, model in self.models.items())
        vertical = read_given_vertical(settings)
        read_body_heights(settings.body_heights)  # raises what is wrong with them
        self._state = TrackerState(models=sizes, is_lifted=has_lifter, vertical=vertical)

    @property
    def backward_jump_s(self) -> float:
        """Time in s by which the last accepted stamp went back, so that tracking restarted; else 0."""
        return self._state.backward_jump_s

    @property
    def output_stamp_ns(self) -> int:
        """Stamp in ns of the frame whose people `update` last returned; with `tracker.lag`, an older one."""
        return self._state.output_stamp_ns

    @property
    def swapped_frames(self) -> int:
        """Number of frames so far in which a person's left and right were swapped back."""
        return self._state.swapped_frames

    @property
    def unusable_people(self) -> int:
        """Number of detections so far that were no person of their own.

        They had too few joints, or all of them in one place, or were part of somebody who was detected besides.
        """
        return self._state.unusable_people

    @property
    def vertical(self) -> CameraVertical | None:
        """What is known of the camera's vertical; None if nothing is."""
        known = self._state.vertical
        return None if known is None else CameraVertical(known.direction, known.std)

    def snapshot(self) -> TrackerState:
        """Return the whole state, for `restore`; later updates do not change it."""
        return self._state

    def restore(self, state: TrackerState) -> None:
        """Return to the state of a `snapshot` of a tracker with the same models and parameters.

        Args:
            state: the state.

        Raises:
            InputError: This is no state of a tracker, or its models, their numbers of base poses or the use of a
                lifter are not those of this tracker; the state has not changed.
        """
        if not isinstance(state, TrackerState):
            found = type(state).__name__  # type: ignore[unreachable]  # callers may have no type checker
            raise InputError(f'state: expected a TrackerState, got {found}')
        own = self._state
        if (state.models, state.is_lifted) != (own.models, own.is_lifted):
            raise InputError(
                f'state: it is of a tracker with {_describe_models(state)}; '
                f'this tracker has {_describe_models(own)}'
            )
        if self.config.tracker.vertical != AUTO_VERTICAL:  # that of the parameter, not of the other tracker
            state = replace(state, vertical=read_given_vertical(self.config.tracker))
        self._state = state

    def reset(self) -> None:
        """Forget all people and all stamps."""
        self._state = self._state.forget_everybody()

    def update(
        self, stamp_ns: int, people: Sequence[Person2D], intrinsics: Intrinsics, floor: Floor | None = None
    ) -> tuple[Person3D, ...]:
        """Track the people of a new frame.

        A stamp that is older than the newest by more than `tracker.restart_after` restarts the tracker. The
        deferred work of the frame before is done first, if it was not done yet.

        Args:
            stamp_ns: ns, time of the image.
            people: all people detected in the image, possibly none.
            intrinsics: intrinsics of the camera. Those of the frame before are used where these hardly differ
                (`same_camera`).
            floor: floor that the people stand on, which tells how tall they are; None if it is not known.

        Returns:
            All people reconstructed in this frame, in the order of `people`, and then those who are predicted
            because they were not detected, or with fewer than `tracker.min_joints` joints. With `tracker.lag`, the
            people are those of the frame `output_stamp_ns`, in the order in which they came, and nobody is
            predicted. New people are tentative until they have been seen for a while, and are not predicted
            before. Parts of a person who were detected as several people are one.

        Raises:
            FrameDropped: The stamp repeats the newest or is a little older; the state has not changed.
            SkeletonError: Joints do not fit the model; the state has not changed.
        """
        settings = self.config.tracker
        backward_jump_s = self._measure_backward_jump(stamp_ns)
        intrinsics = self._choose_intrinsics(stamp_ns, intrinsics, backward_jump_s)
        converted = [Detection.from_person(p, intrinsics, settings.min_score, settings.min_joints) for p in people]
        detections = [d for d in converted if d is not None]
        self.run_deferred_work()
        state = self._state.forget_everybody() if backward_jump_s > 0 else self._state
        state = self._change_camera(state, intrinsics)
        state = self._use_floor(state, stamp_ns, floor)
        state = self._forget_lost_tracks(state, stamp_ns)
        state = self._forget_all_after_absence(state, stamp_ns)
        state, tracks = self._add_detections(state, stamp_ns, detections, intrinsics)
        state, tracks = self._lift_new_frames(state, stamp_ns, tracks)
        tracks = self._initialise_tracks(tracks, state.pose_memory)
        tracks = self._refine_tracks(tracks)
        state = state.put_tracks(tracks)
        state = self._wait_for_lag(state, stamp_ns)
        output_stamp_ns, shown = self._choose_output(stamp_ns, state, tracks)
        if settings.steady_output and settings.lag < MIN_ACCELERATION_LAG_S:
            shown = self._filter_motion(output_stamp_ns, shown)
        shown = self._follow_extremities(output_stamp_ns, shown)
        state = state.put_tracks([track for track, _ in shown])
        output, state = self._make_people(output_stamp_ns, shown, state, floor)
        output += self._predict_people(stamp_ns, state)
        self._state = replace(
            state,
            newest_stamp_ns=stamp_ns,
            newest_person_ns=stamp_ns if detections else state.newest_person_ns,
            output_stamp_ns=output_stamp_ns,
            intrinsics=intrinsics,
            is_work_pending=True,
            backward_jump_s=backward_jump_s,
            swapped_frames=state.swapped_frames + sum(t.seen.is_newest_swapped for t in tracks),
            unusable_people=state.unusable_people + len(people) - len(tracks),
        )
        return tuple(output)

    def predict(self, times_s: Sequence[float]) -> list[list[PredictedPerson]]:
        """Return the people of the newest frame at some times after it; nobody with `tracker.lag`.

        Args:
            times_s: s, times after the newest frame, not negative.

        Returns:
            The people at each of the times, without those who are tentative.
        """
        state, stamp_ns = self._state, self._state.newest_stamp_ns
        if stamp_ns is None:
            return [[] for _ in times_s]
        upward = None if state.vertical is None else state.vertical.direction
        tracks = self._list_known_tracks(stamp_ns, state)
        models = [self.models[t.solved.model_name] for t in tracks]
        sizes = [self._find_size(t, state) for t in tracks]
        people = predict_ahead(tracks, stamp_ns, times_s, models, upward, sizes)
        return [[person[i] for person in people] for i in range(len(times_s))]

    def run_deferred_work(self) -> None:
        """Do the part of the hypothesis checks and classifications that follows the last frame, if not done yet.

        The next `update` would do this work first. A caller who has time before then spares that frame the delay.
        """
        for state in self._deferred_work.advance(self._state):
            self._state = state

    def _measure_backward_jump(self, stamp_ns: int) -> float:
        """Return by how many seconds the stamp goes back, so that tracking must restart; 0 for a newer stamp.

        Raises:
            FrameDropped: The stamp repeats the newest or is a little older.
        """
        newest_stamp_ns = self._state.newest_stamp_ns
        if newest_stamp_ns is None:
            return 0.0
        back_ns = newest_stamp_ns - stamp_ns
        if back_ns > self.config.tracker.restart_after * NS_PER_S:
            return back_ns / NS_PER_S
        if back_ns >= 0:
            relation = 'is older than' if back_ns else 'repeats'
            raise FrameDropped(f'stamp {stamp_ns} ns {relation} the newest accepted, {newest_stamp_ns} ns')
        return 0.0

    def _choose_intrinsics(self, stamp_ns: int, given: Intrinsics, backward_jump_s: float) -> Intrinsics:
        """Return the intrinsics in use, or those given if they are of another camera, or nobody is known."""
        used = self._state.intrinsics
        if used is None or backward_jump_s > 0 or self._is_all_forgotten(self._state, stamp_ns):
            return given
        return used if is_same_camera(used, given) else given

    def _change_camera(self, state: TrackerState, intrinsics: Intrinsics) -> TrackerState:
        """Return the state with all tracks converted to the intrinsics of this frame, if these have changed."""
        if state.intrinsics in (None, intrinsics):
            return state
        focal = solver_focal(intrinsics, self.config.tracker.perspective)
        return replace(
            state,
            tracks=tuple(t.change_camera(intrinsics, focal) for t in state.tracks),
            leaving=tuple(t.change_camera(intrinsics, focal) for t in state.leaving),
            vertical=state.vertical and state.vertical.forget(),
        )

    def _forget_lost_tracks(self, state: TrackerState, stamp_ns: int) -> TrackerState:
        """Return the state without tracks that were not detected for `tracker.forget_after`.

        The state remembers some of their poses. Tentative tracks are forgotten sooner and without a trace.
        """
        longest_ns = self.config.tracker.forget_after * NS_PER_S
        lost = [
            t
            for t in state.tracks
            if stamp_ns - t.seen.stamps_ns[-1] > longest_ns or self._is_nobody(state, t, stamp_ns)
        ]
        if not lost:
            return state
        memory = state.pose_memory
        for track in lost:
            if not track.is_tentative:
                memory = self._checker.remember_poses(memory, track)
        return replace(state.end_tracks(lost), pose_memory=memory)

    def _forget_all_after_absence(self, state: TrackerState, stamp_ns: int) -> TrackerState:
        """Return the state of a new tracker, with the newest stamp, if nobody was there for long enough.

        Poses and names of earlier people then have no influence on what follows, so a recording that is cut in
        two after such an absence gives the same people as the whole.
        """
        if not self._is_all_forgotten(state, stamp_ns):
            return state
        return replace(state.forget_everybody(), newest_stamp_ns=state.newest_stamp_ns)

    def _is_all_forgotten(self, state: TrackerState, stamp_ns: int) -> bool:
        """Return whether nobody was there for so long that everything is forgotten."""
        newest_ns = state.newest_person_ns
        return newest_ns is not None and stamp_ns - newest_ns > find_absence(self.config.tracker) * NS_PER_S

    @staticmethod
    def _is_nobody(state: TrackerState, track: Track, stamp_ns: int) -> bool:
        """Return whether a tentative track was seen neither in the frame before nor shortly before this one."""
        newest_ns = track.seen.stamps_ns[-1]
        was_missed = newest_ns != state.newest_stamp_ns
        return track.is_tentative and was_missed and stamp_ns - newest_ns > TENTATIVE_FORGET_S * NS_PER_S

    def _add_detections(
        self, state: TrackerState, stamp_ns: int, detections: Sequence[Detection], intrinsics: Intrinsics
    ) -> tuple[TrackerState, list[Track]]:
        """Match the detections with the known people, and begin the tracks of new people.

        A new person is called as the detector does or, without an id or if it is in use, by a new name, and is
        tentative. Only in a stream so slow that nobody is known from one frame to the next, new people are not.

        Returns:
            The state, without tracks whose id the detector has given to another person; and the track of each
            person detected with this frame added, which the state does not hold yet.
        """
        settings = self.config.tracker
        focal = solver_focal(intrinsics, settings.perspective)
        matches = match_detections(stamp_ns, state.tracks, detections)
        if matches.replaced_ids:
            state = state.end_tracks([t for t in state.tracks if t.id in matches.replaced_ids])
        used_ids, name_count = {t.id for t in state.tracks}, state.name_count
        before_ns = stamp_ns if state.newest_stamp_ns is None else state.newest_stamp_ns
        is_tentative = stamp_ns - before_ns <= settings.forget_after * NS_PER_S
        tracks = []
        for detection, known in zip(matches.detections, matches.tracks, strict=True):
            if known is not None:
                tracks.append(known.add_frame(stamp_ns, detection, settings.window, settings.lag))
                continue
            name = detection.given_id
            while not name or name in used_ids:
                name_count += 1
                name = f'person_{name_count}'
            used_ids.add(name)
            new = stamp_ns, detection, self._new_swap_filter, intrinsics, focal, is_tentative
            tracks.append(Track.begin(name, *new))
        if name_count != state.name_count:
            state = replace(state, name_count=name_count)
        return state, tracks

    def _lift_new_frames(
        self, state: TrackerState, stamp_ns: int, tracks: list[Track]
    ) -> tuple[TrackerState, list[Track]]:
        """Return the tracks with their new frames lifted, all in one batch, if there is a lifter.

        The lifter gets a vertical that is given, for those who stand. The lifted poses are turned towards the
        vertical as it was known before; the state has it as it is known now, stamp in ns.
        """
        if self._lifter is None or not tracks:
            return state, tracks
        inputs = [t.seen.observed.sample_unlifted_histories() for t in tracks]
        points, weight = (np.concatenate(parts) for parts in zip(*inputs, strict=True))
        counts = [len(own_weight) for _, own_weight in inputs]
        cameras = [t.seen.observed.virtual_camera.rotation for t in tracks]
        known, direction, std = state.vertical, None, None
        if known is not None:
            direction = np.repeat([camera @ known.direction for camera in cameras], counts, axis=0)
            std = np.full(len(direction), known.std)
        given = (direction, std) if known is not None and known.is_given else (None, None)
        lifted = lift_under_vertical(self._lifter, points, weight, RAY_FOCAL, *given)
        ends = np.cumsum(counts)
        if self.config.tracker.vertical != NO_VERTICAL:
            newest = lifted.joints[ends - 1]
            if direction is not None and std is not None:
                lifted = turn_towards_vertical(lifted, direction, std)
            state = self._update_vertical(state, stamp_ns, tracks, newest, cameras)
        return state, [
            track.append_lifted(lifted.select_frames(slice(end - count, end)))
            for track, count, end in zip(tracks, counts, ends.tolist(), strict=True)
        ]

    @staticmethod
    def _update_vertical(
        state: TrackerState, stamp_ns: int, tracks: Sequence[Track], joints: Array, cameras: Sequence[Array]
    ) -> TrackerState:
        """Return the state with what the newest poses of people who are not tentative tell of the vertical.

        Args:
            state: state before.
            stamp_ns: ns, stamp of the newest frame.
            tracks: P tracks of the people in it.
            joints: (P, J, 3) their newest poses, in the axes of the virtual cameras.
            cameras: P rotations (3, 3) from the real camera to the virtual cameras.
        """
        directions = find_upward(joints)
        known = [p for p, track in enumerate(tracks) if not track.is_tentative and math.isfinite(directions[p, 0])]
        if not known:
            return state
        upward = np.array([directions[p] @ cameras[p] for p in known])
        if state.vertical is None:
            return replace(state, vertical=Vertical.begin(stamp_ns, upward))
        standing = find_standing(joints[known])
        return replace(state, vertical=state.vertical.advance(stamp_ns, upward, standing))

    def _initialise_tracks(self, tracks: Sequence[Track], memory: KeyPoseMemory) -> list[Track]:
        """Return the tracks with a first solution where there is none, all new people in one batch a model."""
        new = [t for t in tracks if t.solution is None]
        solutions = self._checker.initialise(new, self._candidate_models, memory) if new else []
        started = {t.id: t.begin_solution(s) for t, s in zip(new, solutions, strict=True)}
        return [started.get(t.id, t) for t in tracks]

    def _refine_tracks(self, tracks: Sequence[Track]) -> list[Track]:
        """Return the tracks with their newest `tracker.refine_seconds` solved.

        All people of one model and one leading prior are a batch.

        The frame before the refined ones keeps its state, so the older part of a window does not change and costs
        no time.
        """
        refined = {t.id: t for t in tracks}
        unsolved = [t for t in tracks if t.has_unsolved_frame]
        for name, lead in {(t.solved.model_name, t.solved.base_poses_lead): None for t in unsolved}:
            model, config = self.models[name], self._refinement_configs[lead]
            own_tracks = [t for t in unsolved if (t.solved.model_name, t.solved.base_poses_lead) == (name, lead)]
            parts = [self._select_refined_frames(t) for t in own_tracks]
            windows = [
                build_refinement_window(t.seen, t.solved, model, *part)
                for t, part in zip(own_tracks, parts, strict=True)
            ]
            results = solve(windows, model, config)
            for track, part, result in zip(own_tracks, parts, results, strict=True):
                solution = track.solved.refine(result, track.seen.observed, *part, model)
                refined[track.id] = track.refine(solution)
        return list(refined.values())

    def _select_refined_frames(self, track: Track) -> tuple[int, int]:
        """Return the index of the first frame that the solver gets, and how many frames it must not change."""
        stamps_ns = track.seen.stamps_ns
        settings = self.config.tracker
        oldest_ns = stamps_ns[-1] - max(settings.refine_seconds, settings.lag) * NS_PER_S
        first = min(bisect_left(stamps_ns, oldest_ns), len(track.solved.theta))
        fixed_frames = min(first, 2 if self._limits_accelerations else 1)
        return first - fixed_frames, fixed_frames

    def _wait_for_lag(self, state: TrackerState, stamp_ns: int) -> TrackerState:
        """Return the state with the frames that wait to be put out because of `tracker.lag`, stamp in ns.

        The first of them is the one that is put out, or the first frame since anybody was there.
        """
        lag_s = self.config.tracker.lag
        if lag_s == 0:
            return state.drop_shown(stamp_ns)
        if state.newest_person_ns is None:
            state = replace(state, waiting_ns=(), has_output_begun=False)
        stamps_ns = (*state.waiting_ns, stamp_ns)
        first, has_begun = find_delayed_frame(stamps_ns, lag_s, has_begun=state.has_output_begun)
        return replace(state, waiting_ns=stamps_ns[first:], has_output_begun=has_begun).drop_shown(
            stamps_ns[first]
        )

    def _choose_output(
        self, stamp_ns: int, state: TrackerState, detected: Sequence[Track]
    ) -> tuple[int, list[tuple[Track, int]]]:
        """Return the stamp of the frame that is put out, and who was detected in it, each with its index.

        It is this frame or, with `tracker.lag`, an older one (`delayed_output.py`); before one is old enough, the
        first frame, without its people.

        Args:
            stamp_ns: ns, stamp of this frame.
            state: state with this frame.
            detected: tracks of the people who were detected, in the order of the detections.
        """
        if self.config.tracker.lag == 0:
            return stamp_ns, [(t, len(t.seen.stamps_ns) - 1) for t in detected]
        shown_ns = state.waiting_ns[0]
        if not state.has_output_begun:
            return shown_ns, []
        return shown_ns, [
            (t, t.seen.stamps_ns.index(shown_ns))
            for t in sorted((*state.leaving, *state.tracks), key=lambda t: t.first_ns)
            if shown_ns in t.seen.stamps_ns
        ]

    def _filter_motion(self, stamp_ns: int, shown: Sequence[tuple[Track, int]]) -> list[tuple[Track, int]]:
        """Return the tracks with their motion filtered up to the frame that is put out, stamp in ns."""
        return [
            (t.filter_motion(stamp_ns, t.solved.locate_joints(frame, self.models[t.solved.model_name])), frame)
            for t, frame in shown
        ]

    def _follow_extremities(self, stamp_ns: int, shown: Sequence[tuple[Track, int]]) -> list[tuple[Track, int]]:
        """Return the tracks with face, feet and hands followed up to the frame that is put out, stamp in ns."""
        followed = []
        for track, frame in shown:
            model = self.models[track.solved.model_name]
            evidence = collect_track_evidence(track, frame, model)
            followed.append((track.follow_extremities(stamp_ns, evidence, model.stature), frame))
        return followed

    def _use_floor(self, state: TrackerState, stamp_ns: int, floor: Floor | None) -> TrackerState:
        """Return the state with the vertical of the floor, stamp in ns, unless `tracker.vertical` gives another.

        A vertical of a floor is forgotten when the floor is no longer known, for the camera may move.
        """
        if self.config.tracker.vertical != AUTO_VERTICAL:
            return state
        if floor is not None:
            return replace(state, vertical=Vertical(floor.upward, math.inf, stamp_ns))
        if state.vertical is not None and state.vertical.is_given:
            return replace(state, vertical=None)
        return state

    def _make_people(
        self, stamp_ns: int, shown: Sequence[tuple[Track, int]], state: TrackerState, floor: Floor | None
    ) -> tuple[list[Person3D], TrackerState]:
        """Return the people who are put out, and the state with what their feet tell of their sizes.

        Args:
            stamp_ns: ns, stamp of the frame that is put out.
            shown: tracks, and index of that frame in each.
            state: state before.
            floor: floor that the people stand on; None if it is not known.
        """
        people = [
            make_whole_person(t, frame, self.models[t.solved.model_name], self._skeleton) for t, frame in shown
        ]
        if floor is not None:
            contacts, body_height = dict(state.contacts), self.config.tracker.body_height
            for person, (track, _) in zip(people, shown, strict=True):
                if person.tentative or not person.scale_known:
                    continue
                before = _find_contact(contacts, track)
                contacts.pop(person.id, None)
                contact = FloorContact.advance(before, stamp_ns, person, floor, body_height)
                if contact is not None:
                    contacts[person.id] = contact  # the newest come last
            state = replace(state, contacts=tuple(contacts.items())[-MAX_REMEMBERED:])
        sized = zip(people, shown, strict=True)
        return [resize(person, self._find_size(track, state)) for person, (track, _) in sized], state

    def _find_size(self, track: Track, state: TrackerState) -> BodySize:
        """Return what is known of a person's size; the detector may tell who it is when the track has a name."""
        settings, given_id = self.config.tracker, track.seen.given_id
        person_id = given_id if given_id in read_body_heights(settings.body_heights) else track.id
        assumed = assume_size(settings, person_id, is_focal_known=track.seen.intrinsics.is_focal_known)
        contact = _find_contact(dict(state.contacts), track)
        return assumed if contact is None else contact.find_size(assumed)

    def _predict_people(self, stamp_ns: int, state: TrackerState) -> list[Person3D]:
        """Return the people who are predicted for this frame, stamp in ns; nobody with `tracker.lag`."""
        upward = None if state.vertical is None else state.vertical.direction
        predicted = []
        for track in self._list_known_tracks(stamp_ns, state):
            if track.seen.stamps_ns[-1] < stamp_ns:
                model, size = self.models[track.solved.model_name], self._find_size(track, state)
                person = predict_person(track, stamp_ns, model, upward, size)
                predicted.append(complete_prediction(person, track, stamp_ns, model, self._skeleton, size))
        return predicted

    def _list_known_tracks(self, stamp_ns: int, state: TrackerState) -> list[Track]:
        """Return the tracks that are seen in this frame, stamp in ns, or predicted; none with `tracker.lag`."""
        settings = self.config.tracker
        if settings.lag > 0:
            return []
        longest_ns = settings.predict_for * NS_PER_S
        return [t for t in state.tracks if not t.is_tentative and stamp_ns - t.seen.stamps_ns[-1] <= longest_ns]


def find_absence(settings: TrackerConfig) -> float:
    """Return the time in s without anybody after which everything is forgotten, and nobody waits to be put out."""
    return max(settings.forget_all_after, settings.forget_after, settings.lag)


def _find_contact(contacts: Mapping[str, FloorContact], track: Track) -> FloorContact | None:
    """Return what feet on the floor have told of a person's size; nothing of who had the same id before."""
    contact = contacts.get(track.id)
    return None if contact is None or contact.stamp_ns < track.first_ns else contact


def _describe_models(state: TrackerState) -> str:
    """Return the models of a state's tracker, their numbers of base poses and the use of a lifter, in words."""
    models = ', '.join(f'{name} ({count} base poses)' for name, count in state.models)
    return f'the models {models or "(none)"} and {"a" if state.is_lifted else "no"} lifter'
