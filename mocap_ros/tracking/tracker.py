"""The tracker: a sliding window for each person, and a reconstruction of its newest part at every new frame.

The tracker uses no ROS, no clock and no files. Its state depends only on the frames that it accepted, in their
order, so a replay of these frames gives the same people.

A new frame changes the newest part of each window in a few steps of the joint solver, all people of one model in
one batch. At intervals a person's window is solved from scratch or under another model from some of its frames; if
that explains the image better, it replaces the person's solution. Wrong cameras and changes of motion are found in
this way.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mocap_ros.config import Config
from mocap_ros.errors import FrameDropped
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.association import ExpectedExtent, Extent, associate, compute_distance, compute_gate
from mocap_ros.keypoints.left_right import SwapFilter
from mocap_ros.keypoints.person import Person2D
from mocap_ros.models.base_poses import ALL_MOTIONS, BasePoses
from mocap_ros.models.model_file import load_prior_lifter
from mocap_ros.people import MotionKind, Person3D
from mocap_ros.solvers.joint.solver import solve
from mocap_ros.tracking.detection import Detection
from mocap_ros.tracking.hypotheses import HypothesisChecker
from mocap_ros.tracking.person_in_frame import make_person
from mocap_ros.tracking.pose_memory import KeyPoseMemory
from mocap_ros.tracking.prediction import predict_person
from mocap_ros.tracking.track import Track
from mocap_ros.units import NS_PER_S

# State of a tracker by name of its attribute.
Snapshot = Mapping[str, Any]

MIN_CHECK_INTERVAL_S = 0.1  # s; the first solution comes from a single frame, which leaves the heading ambiguous
CHECK_INTERVAL_GROWTH = 0.2  # s per s of the track's age; a solution that passed many checks is rarely wrong
LIFTER_CHECK_INTERVAL_S = 5.0  # s; maximum interval with a lifter, whose prior makes wrong solutions rare
NEW_TRACK_S = 1.0  # s; younger tracks are solved from scratch at each check, since their solution may be wrong
NOISE_ALARM_RATIO = 1.3  # no unit; a rise of the image noise by 30 % indicates another motion or a wrong solution
MIN_DEFERRED_GAP_S = 0.2  # s between two checks or classifications; each takes up to 70 ms (docs/tracker.md)
CLASSIFICATION_INTERVAL_S = 1.0  # s; for periodic motion; half of it for other motion, to find a new walk sooner
ID_REUSE_GATE_FACTOR = 5.0  # gates; a detection with a known id that is farther away belongs to another person
UNKNOWN_CAMERA = Intrinsics(1.0, (0.0, 0.0), is_focal_known=False)  # stands for the camera before the first frame


class Tracker:
    """Reconstructs people in 3D from 2D keypoints, frame by frame.

    Args:
        models: base poses, or several models by name. Each person has the likeliest of them; with a learned prior
            everybody has the model of all motions, if it is among them.
        config: all parameters; the tracker uses those of solver, classifier and tracker.

    Raises:
        ModelError: The lifter that `solver.prior` names cannot be loaded.

    Attributes:
        config: all parameters.
        models: base-pose models by name, rescaled to `tracker.body_height`.
        backward_jump_s: s by which the stamp of the last accepted frame went back, so that tracking restarted;
            else 0.
        output_stamp_ns: ns, stamp of the frame whose people `update` last returned; with `lag`, an older one.
        swapped_frames: number of frames so far in which a person's left and right were swapped back.
        unusable_people: number of detections so far with too few joints, or with all of them in one place.
    """

    def __init__(self, models: BasePoses | Mapping[str, BasePoses], config: Config) -> None:
        by_name = {models.name: models} if isinstance(models, BasePoses) else models
        height = config.tracker.body_height
        components = min(config.tracker.components, config.solver.components)
        self.config = config
        self.models = {n: m.rescale(height / m.stature).truncate(components) for n, m in by_name.items()}
        self._skeleton = next(iter(self.models.values())).skeleton
        self._lifter = load_prior_lifter(config.solver.prior, self._skeleton)
        self._candidate_models = list(self.models)
        if self._lifter is not None and ALL_MOTIONS in self.models:
            self._candidate_models = [ALL_MOTIONS]
        self._checker = HypothesisChecker(self.models, config)
        self.backward_jump_s = 0.0
        self.output_stamp_ns = 0
        self.swapped_frames = 0
        self.unusable_people = 0
        self.reset()

    def reset(self) -> None:
        """Forget all people and all stamps."""
        self._tracks: list[Track] = []
        self._newest_stamp_ns: int | None = None
        self._last_check_ns = 0
        self._name_count = 0
        self._camera = UNKNOWN_CAMERA
        self._pending_ids: list[str] = []
        self._pose_memory = KeyPoseMemory()

    def snapshot(self) -> Snapshot:
        """Return the whole state, for `restore`; later updates do not change it."""
        names = (
            '_tracks',
            '_newest_stamp_ns',
            '_last_check_ns',
            '_pending_ids',
            '_pose_memory',
            '_name_count',
            '_camera',
            'backward_jump_s',
            'output_stamp_ns',
            'swapped_frames',
            'unusable_people',
        )
        tracks = [copy.copy(t) for t in self._tracks]
        return {**{name: getattr(self, name) for name in names}, '_tracks': tracks}

    def restore(self, snapshot: Snapshot) -> None:
        """Return to the state of a `snapshot` of a tracker with the same models and parameters.

        Args:
            snapshot: the state.
        """
        self.__dict__.update({**snapshot, '_tracks': [copy.copy(t) for t in snapshot['_tracks']]})

    def update(self, stamp_ns: int, people: Sequence[Person2D], intrinsics: Intrinsics) -> tuple[Person3D, ...]:
        """Track the people of a new frame.

        A stamp that is older than the newest by more than `tracker.restart_after` restarts the tracker.

        Args:
            stamp_ns: ns, time of the image.
            people: all people detected in the image, possibly none.
            intrinsics: intrinsics of the camera.

        Returns:
            All people reconstructed in this frame, in the order of `people`, and then those who are predicted
            because they were not detected, or with fewer than `tracker.min_joints` joints.

        Raises:
            FrameDropped: The stamp repeats the newest or is a little older; the state has not changed.
            SkeletonError: Joints do not fit the model; the state has not changed.
        """
        backward_jump_s = self._measure_backward_jump(stamp_ns)
        min_score = self.config.tracker.min_score
        detections = [Detection.from_person(p, intrinsics, min_score) for p in people]
        self.run_deferred_work()
        if backward_jump_s > 0:
            self.reset()
        self.backward_jump_s = backward_jump_s
        self._newest_stamp_ns = stamp_ns
        self._change_camera(intrinsics)
        self._forget_lost_tracks(stamp_ns)
        usable = self._select_usable(detections)
        matches = self._match_tracks(stamp_ns, usable)
        self._append_to_windows(stamp_ns, matches)
        tracks = [track for track, _ in matches]
        self._lift_new_frames(tracks)
        self._initialise_tracks([t for t in tracks if not t.is_solved])
        self._refine_tracks([t for t in tracks if t.has_unsolved_frame])
        self._pending_ids = [t.id for t in tracks]
        return self._make_output(stamp_ns, tracks)

    def run_deferred_work(self) -> None:
        """Check the hypotheses of the people of the last frame, if that was not done yet.

        The next `update` would do this work first. A caller who has time before then spares that frame the delay.
        """
        pending, self._pending_ids = set(self._pending_ids), []
        if pending and self._newest_stamp_ns is not None:
            self._run_due_check([t for t in self._tracks if t.id in pending], self._newest_stamp_ns)

    def _measure_backward_jump(self, stamp_ns: int) -> float:
        """Return by how many seconds the stamp goes back, so that tracking must restart; 0 for a newer stamp.

        Raises:
            FrameDropped: The stamp repeats the newest or is a little older.
        """
        if self._newest_stamp_ns is None:
            return 0.0
        back_ns = self._newest_stamp_ns - stamp_ns
        if back_ns > self.config.tracker.restart_after * NS_PER_S:
            return back_ns / NS_PER_S
        if back_ns >= 0:
            relation = 'is older than' if back_ns else 'repeats'
            raise FrameDropped(f'stamp {stamp_ns} ns {relation} the newest accepted, {self._newest_stamp_ns} ns')
        return 0.0

    def _change_camera(self, intrinsics: Intrinsics) -> None:
        """Convert all windows to the intrinsics of this frame, if they have changed."""
        old, self._camera = self._camera, intrinsics
        if old in (UNKNOWN_CAMERA, intrinsics):
            return
        for track in self._tracks:
            track.change_camera(old, intrinsics)

    def _forget_lost_tracks(self, stamp_ns: int) -> None:
        """Remove tracks without a detection for `tracker.forget_after`, and remember some of their poses."""
        oldest_kept = stamp_ns - self.config.tracker.forget_after * NS_PER_S
        for track in self._tracks:
            if track.stamps_ns[-1] < oldest_kept and track.is_solved:
                self._pose_memory = self._checker.remember_poses(self._pose_memory, track, self._camera)
        self._tracks = [t for t in self._tracks if t.stamps_ns[-1] >= oldest_kept]

    def _select_usable(self, detections: Sequence[Detection]) -> list[Detection]:
        """Return the usable detections, and count the others."""
        usable = [d for d in detections if d.is_usable(self.config.tracker.min_joints)]
        self.unusable_people += len(detections) - len(usable)
        return usable

    def _match_tracks(self, stamp_ns: int, detections: Sequence[Detection]) -> list[tuple[Track, Detection]]:
        """Match each detection with a track by the detector's id, else by position and size, or create one."""
        by_given_id = {t.given_id: t for t in self._tracks if t.given_id}
        for detection in detections:
            track = by_given_id.get(detection.given_id)
            if track is not None and _is_other_person(track.expect_extent(stamp_ns), detection.extent):
                self._tracks.remove(by_given_id.pop(detection.given_id))
        tracks_without_id = [t for t in self._tracks if not t.given_id]
        detections_without_id = [d for d in detections if not d.given_id]
        indices = associate(
            [t.expect_extent(stamp_ns) for t in tracks_without_id], [d.extent for d in detections_without_id]
        )
        associated = {
            id(d): tracks_without_id[index]
            for d, index in zip(detections_without_id, indices, strict=True)
            if index is not None
        }
        matches = []
        for detection in detections:
            match = associated.get(id(detection))
            if match is None and detection.given_id:
                match = by_given_id.pop(detection.given_id, None)
            matches.append((match or self._create_track(stamp_ns, detection), detection))
        return matches

    def _create_track(self, stamp_ns: int, detection: Detection) -> Track:
        """Create a track with the detector's id or, if there is none or it is in use, with a new name."""
        name = detection.given_id
        used_ids = {t.id for t in self._tracks}
        while not name or name in used_ids:
            self._name_count += 1
            name = f'person_{self._name_count}'
        swap_filter = SwapFilter(np.array(self._skeleton.mirror), enabled=self.config.tracker.undo_swaps)
        track = Track(name, detection.given_id, stamp_ns, swap_filter)
        self._tracks.append(track)
        return track

    def _append_to_windows(self, stamp_ns: int, matches: Iterable[tuple[Track, Detection]]) -> None:
        """Append the frame to the windows of the detected people, and count swaps of left and right."""
        for track, detection in matches:
            swapped_before = track.swapped_count
            track.add_frame(stamp_ns, detection.rays, detection.weight, self.config.tracker.window)
            self.swapped_frames += track.swapped_count - swapped_before

    def _lift_new_frames(self, tracks: Sequence[Track]) -> None:
        """Lift the new frames of all people in one batch, if there is a lifter."""
        if self._lifter is None or not tracks:
            return
        inputs = [track.build_lifter_input(self._camera) for track in tracks]
        points, weight = (np.concatenate(parts) for parts in zip(*inputs, strict=True))
        lifted = self._lifter.lift(points, weight, self._camera.focal)
        ends = np.cumsum([len(w) for _, w in inputs])
        for track, end, (_, own_weight) in zip(tracks, ends, inputs, strict=True):
            own_poses = lifted.select_frames(slice(end - len(own_weight), end))
            track.append_lifted(own_poses, self._camera)

    def _initialise_tracks(self, tracks: Sequence[Track]) -> None:
        """Find the first solution of new tracks."""
        for track in tracks:
            self._checker.initialise(track, self._camera, self._candidate_models, self._pose_memory)
            track.next_check_ns = track.stamps_ns[-1] + round(MIN_CHECK_INTERVAL_S * NS_PER_S)

    def _refine_tracks(self, tracks: Sequence[Track]) -> None:
        """Refine the newest `tracker.refine_seconds` of solved tracks, all people of one model in one batch.

        The frame before them keeps its state, so the older part of a window does not change and costs no time.
        """
        settings = self.config.tracker
        solver = replace(self.config.solver, max_iterations=settings.iterations)
        for name, model in self.models.items():
            own_tracks = [t for t in tracks if t.model_name == name]
            parts = []
            for track in own_tracks:
                oldest = track.stamps_ns[-1] - settings.refine_seconds * NS_PER_S
                first = min(int(np.searchsorted(track.stamps_ns, oldest)), len(track.theta))
                fixed_frames = 1 if first > 0 else 0
                frames = np.arange(first - fixed_frames, len(track.stamps_ns))
                window = self._checker.build_window(track, self._camera, frames, fixed_frames)
                parts.append((frames, fixed_frames, window))
            solutions = solve([window for _, _, window in parts], model, solver) if parts else ()
            for track, (frames, fixed_frames, _), solution in zip(own_tracks, parts, solutions, strict=True):
                track.store_solution(solution, frames, fixed_frames, self._camera)
                track.update_stature_ratio(model)

    def _run_due_check(self, tracks: Sequence[Track], stamp_ns: int) -> None:
        """Make the hypothesis check or the classification that is due longest, if the last was long enough ago."""
        for track in tracks:
            if track.noise > NOISE_ALARM_RATIO * track.baseline_noise:
                track.pending_restarts = len(self._candidate_models)
                track.baseline_noise = math.inf
                track.next_check_ns = stamp_ns
        if stamp_ns < self._last_check_ns + MIN_DEFERRED_GAP_S * NS_PER_S:
            return
        work = [(t.next_check_ns, False, t) for t in tracks if t.stamps_ns[-1] > t.first_stamp_ns]
        work += [(t.next_classification_ns, True, t) for t in tracks]
        due_work = [w for w in work if w[0] <= stamp_ns]
        if not due_work:
            return
        self._last_check_ns = stamp_ns
        _, is_classification, track = min(due_work, key=lambda w: w[0])
        if is_classification:
            self._classify_motion(track, stamp_ns)
        else:
            self._check_hypothesis(track, stamp_ns)

    def _classify_motion(self, track: Track, stamp_ns: int) -> None:
        """Classify a track's motion, and schedule the next classification."""
        self._checker.classify_motion(track, self._camera)
        is_periodic = track.motion.kind is MotionKind.PERIODIC
        interval_s = CLASSIFICATION_INTERVAL_S if is_periodic else CLASSIFICATION_INTERVAL_S / 2
        track.next_classification_ns = stamp_ns + round(interval_s * NS_PER_S)

    def _check_hypothesis(self, track: Track, stamp_ns: int) -> None:
        """Check a track against the model whose turn it is, and schedule the next check.

        The hypothesis is the track's own poses under another model. It is a solution from scratch if the model is
        the track's own, if the track is new, or after a rise of the image noise.
        """
        names = self._candidate_models
        name = names[track.check_count % len(names)]
        track.check_count += 1
        age_s = (stamp_ns - track.first_stamp_ns) / NS_PER_S
        if track.pending_restarts or age_s < NEW_TRACK_S or name == track.model_name:
            self._checker.reinitialise(track, self._camera, [name])
        else:
            self._checker.compare_models(track, self._camera, [name])
        max_interval_s = self.config.tracker.hypothesis_check_interval
        if self._lifter is not None:
            max_interval_s = LIFTER_CHECK_INTERVAL_S
        interval_s = min(max(MIN_CHECK_INTERVAL_S, CHECK_INTERVAL_GROWTH * age_s), max_interval_s)
        if track.pending_restarts:
            track.pending_restarts -= 1
            interval_s = min(interval_s, MIN_CHECK_INTERVAL_S)
        has_finished_round = track.check_count % len(names) == 0
        if has_finished_round and not track.pending_restarts:
            track.baseline_noise = track.noise
        track.next_check_ns = stamp_ns + round(interval_s * NS_PER_S)

    def _make_output(self, stamp_ns: int, detected: Sequence[Track]) -> tuple[Person3D, ...]:
        """Return the people of this frame or, with `tracker.lag`, of the newest frame that is old enough."""
        settings = self.config.tracker
        if settings.lag == 0:
            self.output_stamp_ns = stamp_ns
            undetected = [t for t in self._tracks if t.is_solved and t not in detected]
            predicted = [t for t in undetected if stamp_ns - t.stamps_ns[-1] <= settings.predict_for * NS_PER_S]
            return tuple(
                [self._make_person(t, len(t.stamps_ns) - 1) for t in detected]
                + [predict_person(t, stamp_ns, self.models[t.model_name], self._camera) for t in predicted]
            )
        newest_allowed = stamp_ns - settings.lag * NS_PER_S
        stamps_ns = sorted({s for t in self._tracks for s in t.stamps_ns if s <= newest_allowed})
        if not stamps_ns:
            self.output_stamp_ns = stamp_ns
            return ()
        self.output_stamp_ns = stamps_ns[-1]
        shown = [t for t in self._tracks if self.output_stamp_ns in t.stamps_ns]
        return tuple(self._make_person(t, t.stamps_ns.index(self.output_stamp_ns)) for t in shown)

    def _make_person(self, track: Track, frame: int) -> Person3D:
        """Return the person of a track in one solved frame of its window."""
        return make_person(track, frame, self.models[track.model_name], self._camera)


def _is_other_person(expected: ExpectedExtent, detected: Extent) -> bool:
    """Return whether a detection with a known id is so far away that the detector has reused the id."""
    return compute_distance(expected, detected) > ID_REUSE_GATE_FACTOR * compute_gate(expected)
