"""The tracker: a sliding window for each person, and a reconstruction of it at every new frame.

Pure: no ROS, no clock, no files. Its state depends only on the frames it accepted, in their order, so a replay of
those frames gives the same people.

A new frame changes the newest part of each window in a few steps of the joint solver, everybody in one batch. Now
and then a person's window is solved afresh, under one of the models in turn, from a few of its frames; if that
explains the image better, it is taken over. So wrong cameras and changes of motion are found.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import Config
from mocap_ros.errors import FrameDropped
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.association import Expected, associate, distance, extent, tolerance
from mocap_ros.keypoints.left_right import SwapFilter
from mocap_ros.keypoints.person import Person2D
from mocap_ros.models.base_poses import ALL_MOTIONS, BasePoses
from mocap_ros.models.joint_std import joint_std
from mocap_ros.models.model_file import lifter_for_prior
from mocap_ros.people import MotionKind, Person3D
from mocap_ros.skeleton import model_joints
from mocap_ros.solvers.joint.solver import solve
from mocap_ros.tracking.hypotheses import Examiner
from mocap_ros.tracking.pose_memory import KeyPoseMemory
from mocap_ros.tracking.track import NS, Track

Array = NDArray[np.float64]
Snapshot = Mapping[str, Any]

FIRST_CHALLENGE = 0.1
CHALLENGE_GROWTH = 0.2
ALARM = 1.3
YOUNG = 1.0
EXAMINATION_GAP = 0.2
MOTION_EVERY = 1.0
SELDOM = 5.0
EXTENT_LEAST = 1e-3
FARTHEST_PX = 1e7
OTHER_PERSON = 5.0
PREDICTED_SPEED_STD = 0.5
UNKNOWN_CAMERA = Intrinsics(1.0, (0.0, 0.0), known=False)


def to_model_joints(person: Person2D, min_score: float) -> tuple[Array, Array]:
    """(J, 2) px and (J,) scores of the model's joints; score 0 (point 0) where not seen.

    Raises:
        SkeletonError: the person's joints do not cover enough of the model's.
    """
    with np.errstate(invalid='ignore'):
        near = np.asarray((np.abs(person.points) < FARTHEST_PX).all(axis=-1))
    score = np.where(near, np.minimum(person.score, 1.0), 0.0)
    return model_joints(np.where(near[:, None], person.points, 0.0), score, person.joints, min_score)


@dataclass(frozen=True, eq=False)
class _Detection:
    """A person of the message: rays (J, 2) and weights (J,) of the model's joints."""

    given_id: str
    rays: Array
    weight: Array

    @cached_property
    def extent(self) -> tuple[Array, float]:
        """Centre and size in ray units."""
        return extent(self.rays, self.weight)


def _somebody_else(expected: Expected, found: tuple[Array, float]) -> bool:
    """A detector that gives a known id to somebody far away means somebody else."""
    return distance(expected, found) > OTHER_PERSON * tolerance(expected)


class Tracker:
    """Turns 2D keypoints, frame by frame, into 3D people.

    Args:
        models: base poses, or several by name: each person has the likeliest, or with a learned prior everybody
            those of all motions, if they are among them.
        config: of solver and tracker.

    Raises:
        ModelError: the lifter that `solver.prior` names cannot be had.

    Attributes:
        went_back: s by which the stamp of the last accepted frame went back, so that it started afresh; else 0.
        output_ns: stamp of the frame whose people `update` last returned; with `lag`, an older one.
        swapped_frames: frames of people so far whose left and right were put right.
        unusable_people: detections so far with too few joints, or all of them in one place.
    """

    def __init__(self, models: BasePoses | Mapping[str, BasePoses], config: Config) -> None:
        by_name = {models.name: models} if isinstance(models, BasePoses) else models
        height = config.tracker.body_height
        components = min(config.tracker.components, config.solver.components)
        self.config = config
        self.models = {n: m.rescaled(height / m.stature).truncated(components) for n, m in by_name.items()}
        self._lifter = lifter_for_prior(config.solver.prior, next(iter(self.models.values())).skeleton)
        self._rivals = list(self.models)
        if self._lifter is not None and ALL_MOTIONS in self.models:
            self._rivals = [ALL_MOTIONS]
        self._examiner = Examiner(self.models, config)
        self.went_back = 0.0
        self.output_ns = 0
        self.swapped_frames = 0
        self.unusable_people = 0
        self.reset()

    def reset(self) -> None:
        """Forget everybody and every stamp."""
        self._tracks: list[Track] = []
        self._newest: int | None = None
        self._examined = 0
        self._born = 0
        self._camera = UNKNOWN_CAMERA
        self._pending: list[str] = []
        self._memory = KeyPoseMemory()

    def snapshot(self) -> Snapshot:
        """Everything it knows, for `restore`; later updates do not change it."""
        keep = (
            '_tracks',
            '_newest',
            '_examined',
            '_pending',
            '_memory',
            '_born',
            '_camera',
            'went_back',
            'output_ns',
            'swapped_frames',
            'unusable_people',
        )
        tracks = [copy.copy(t) for t in self._tracks]
        return {**{name: getattr(self, name) for name in keep}, '_tracks': tracks}

    def restore(self, snapshot: Snapshot) -> None:
        """Back to where a `snapshot` was taken, by a tracker with the same models and configuration."""
        self.__dict__.update({**snapshot, '_tracks': [copy.copy(t) for t in snapshot['_tracks']]})

    def update(self, stamp_ns: int, people: Sequence[Person2D], intrinsics: Intrinsics) -> tuple[Person3D, ...]:
        """One new frame; where its stamp is older than the newest by more than `restart_after`, the first one.

        Args:
            stamp_ns: time of the image, ns.
            people: everyone detected in it, possibly nobody.
            intrinsics: of the camera.

        Returns:
            Everyone reconstructed in this frame, in the order of `people`, then those who are predicted because
            they were not detected, or with fewer than `min_joints` joints.

        Raises:
            FrameDropped: the stamp repeats the newest or is a little older; nothing has changed then.
            SkeletonError: joints that do not fit the model; nothing has changed then.
        """
        settings = self.config.tracker
        back_ns = 0 if self._newest is None else self._newest - stamp_ns
        restart = back_ns > settings.restart_after * NS
        if self._newest is not None and back_ns >= 0 and not restart:
            what = 'is older than' if back_ns else 'repeats'
            raise FrameDropped(f'stamp {stamp_ns} ns {what} the newest accepted, {self._newest} ns')
        detections = [self._detection(p, intrinsics) for p in people]
        self.examine()
        if restart:
            self.reset()
        self.went_back = back_ns / NS if restart else 0.0
        self._newest = stamp_ns
        self._see_through(intrinsics)
        keep = stamp_ns - settings.forget_after * NS
        for track in self._tracks:
            if track.stamps[-1] < keep and track.solved:
                self._memory = self._examiner.remembered(self._memory, track, self._camera)
        self._tracks = [t for t in self._tracks if t.stamps[-1] >= keep]

        usable = [d for d in detections if self._usable(d)]
        self.unusable_people += len(detections) - len(usable)
        seen = self._associated(stamp_ns, usable)
        for track, detection in seen:
            before = track.swapped
            track.push(stamp_ns, detection.rays, detection.weight, settings.window)
            self.swapped_frames += track.swapped - before
        tracks = [track for track, _ in seen]
        self._lift(tracks)
        self._begin([t for t in tracks if not t.solved])
        self._refine([t for t in tracks if len(t.theta) < len(t.stamps)])
        self._pending = [t.id for t in tracks]
        return self._output(stamp_ns, tracks)

    def examine(self) -> None:
        """Ask what there is to ask about the last frame's people, if that was not done yet.

        The next `update` would do it first; a caller who has time before then saves that frame the wait.
        """
        pending, self._pending = set(self._pending), []
        if pending and self._newest is not None:
            self._ask([t for t in self._tracks if t.id in pending], self._newest)

    def _detection(self, person: Person2D, intrinsics: Intrinsics) -> _Detection:
        points, weight = to_model_joints(person, self.config.tracker.min_score)
        rays = np.where(weight[:, None] > 0, intrinsics.rays(points), 0.0)
        return _Detection(person.id, rays, weight)

    def _see_through(self, intrinsics: Intrinsics) -> None:
        """Carry the windows over to another camera's intrinsics, if they have changed."""
        old, self._camera = self._camera, intrinsics
        if old in (UNKNOWN_CAMERA, intrinsics):
            return
        for track in self._tracks:
            ones = np.ones_like(track.rays[..., :1])
            track.lifted = None
            track.rays = intrinsics.rays(old.project(np.concatenate([track.rays, ones], axis=-1)))
            track.look()
            depth = track.roots[:, 2:] * intrinsics.focal / old.focal
            rays = intrinsics.rays(old.project(track.roots))
            track.roots = np.concatenate([rays * depth, depth], axis=-1)

    def _usable(self, detection: _Detection) -> bool:
        """Enough joints, and not all in one place."""
        if (detection.weight > 0).sum() < self.config.tracker.min_joints:
            return False
        return detection.extent[1] > EXTENT_LEAST

    def _associated(self, stamp: int, usable: Sequence[_Detection]) -> list[tuple[Track, _Detection]]:
        """The track of each detection: by the detector's id, else by position and size, else new."""
        named = {t.given_id: t for t in self._tracks if t.given_id}
        for detection in usable:
            known = named.get(detection.given_id)
            if known is not None and _somebody_else(known.expected(stamp), detection.extent):
                self._tracks.remove(named.pop(detection.given_id))
        free = [t for t in self._tracks if not t.given_id]
        nameless = [d for d in usable if not d.given_id]
        match = associate([t.expected(stamp) for t in free], [d.extent for d in nameless])
        found = {id(d): free[m] for d, m in zip(nameless, match, strict=True) if m is not None}
        return [
            (found.get(id(d)) or (named.pop(d.given_id, None) if d.given_id else None) or self._new(stamp, d), d)
            for d in usable
        ]

    def _new(self, stamp: int, detection: _Detection) -> Track:
        name = detection.given_id
        taken = {t.id for t in self._tracks}
        while not name or name in taken:
            self._born += 1
            name = f'person_{self._born}'
        mirror = next(iter(self.models.values())).skeleton.mirror
        swaps = SwapFilter(np.array(mirror), enabled=self.config.tracker.undo_swaps)
        track = Track(name, detection.given_id, stamp, swaps)
        self._tracks.append(track)
        return track

    def _lift(self, tracks: Sequence[Track]) -> None:
        """The learned prior of everybody's new frames, as one batch."""
        if self._lifter is None or not tracks:
            return
        histories = [track.to_lift(self._camera) for track in tracks]
        points, weight = (np.concatenate(part) for part in zip(*histories, strict=True))
        lifted = self._lifter.lift(points, weight, self._camera.focal)
        ends = np.cumsum([len(w) for _, w in histories])
        for track, end, (_, own) in zip(tracks, ends, histories, strict=True):
            track.add_lifted(lifted.take(slice(end - len(own), end)), self._camera)

    def _begin(self, tracks: Sequence[Track]) -> None:
        """A first solution under the likeliest model, or from a pose of somebody lost that looked the same."""
        for track in tracks:
            self._examiner.begin(track, self._camera, self._rivals, self._memory)
            track.challenge_at = track.stamps[-1] + round(FIRST_CHALLENGE * NS)

    def _refine(self, tracks: Sequence[Track]) -> None:
        """A few steps for the newest frames, from the last solution; people of one model as one batch."""
        settings = self.config.tracker
        limited = replace(self.config.solver, max_iterations=settings.iterations)
        for name, model in self.models.items():
            own = [t for t in tracks if t.model == name]
            batch = []
            for track in own:
                first = int(np.searchsorted(track.stamps, track.stamps[-1] - settings.refine_seconds * NS))
                first = min(first, len(track.theta))
                held = 1 if first > 0 else 0
                frames = np.arange(first - held, len(track.stamps))
                batch.append((frames, held, self._examiner.window(track, self._camera, frames, held)))
            solutions = solve([w for _, _, w in batch], model, limited) if batch else ()
            for track, (frames, held, _), solution in zip(own, batch, solutions, strict=True):
                track.take(solution, frames, held, self._camera)
                track.resize(model)

    def _ask(self, tracks: Sequence[Track], stamp: int) -> None:
        """One question about one person, and none too soon after the last."""
        for track in tracks:
            if track.noise > ALARM * track.calm_noise:
                track.hurry, track.calm_noise, track.challenge_at = len(self._rivals), math.inf, stamp
        if stamp < self._examined + EXAMINATION_GAP * NS:
            return
        due = [(t.challenge_at, False, t) for t in tracks if t.stamps[-1] > t.born]
        due += [(t.motion_at, True, t) for t in tracks]
        due = [d for d in due if d[0] <= stamp]
        if not due:
            return
        self._examined = stamp
        _, motion, track = min(due, key=lambda d: d[0])
        if motion:
            self._examiner.motion(track, self._camera)
            known = track.motion.kind is MotionKind.PERIODIC
            track.motion_at = stamp + round((MOTION_EVERY if known else MOTION_EVERY / 2) * NS)
        else:
            self._challenge(track, stamp)

    def _challenge(self, track: Track, stamp: int) -> None:
        """Another model for the same poses, and every few times, or in a hurry, a fresh start."""
        names = self._rivals
        name = names[track.challenges % len(names)]
        track.challenges += 1
        age = (stamp - track.born) / NS
        longest = self.config.tracker.hypothesis_check_interval if self._lifter is None else SELDOM
        wait = min(max(FIRST_CHALLENGE, CHALLENGE_GROWTH * age), longest)
        if track.hurry or age < YOUNG or name == track.model:
            self._examiner.start_afresh(track, self._camera, [name])
        else:
            self._examiner.compare(track, self._camera, [name])
        if track.hurry:
            track.hurry -= 1
            wait = min(wait, FIRST_CHALLENGE)
        if not track.hurry and track.challenges % len(names) == 0:
            track.calm_noise = track.noise
        track.challenge_at = stamp + round(wait * NS)

    def _output(self, stamp: int, seen: Iterable[Track]) -> tuple[Person3D, ...]:
        settings = self.config.tracker
        seen = list(seen)
        missing = [
            t
            for t in self._tracks
            if t.solved and t not in seen and stamp - t.stamps[-1] <= settings.predict_for * NS
        ]
        if settings.lag == 0:
            self.output_ns = stamp
            return tuple(
                [self._person(t, len(t.stamps) - 1) for t in seen] + [self._predicted(t, stamp) for t in missing]
            )
        known = sorted({s for t in self._tracks for s in t.stamps if s <= stamp - settings.lag * NS})
        if not known:
            self.output_ns = stamp
            return ()
        self.output_ns = known[-1]
        return tuple(self._person(t, t.stamps.index(known[-1])) for t in self._tracks if known[-1] in t.stamps)

    def _person(self, track: Track, frame: int) -> Person3D:
        model = self.models[track.model]
        size = 1 / track.size_ratio
        rotation, root = track.rotation[frame], track.roots[frame] * size
        inferred = track.right[1][frame] == 0
        lifted = None if track.lifted is None else track.lifted.spread[frame] * root[2]
        joints = model.poses(track.theta[frame]) @ rotation.T * size + root
        return Person3D(
            id=track.id,
            joints=joints,
            std=joint_std(track.spread * size, inferred, lifted),
            inferred=inferred,
            scale=float(self._camera.focal / root[2]),
            rotation=rotation,
            translation=self._camera.project(root),
            motion=replace(track.motion, category=track.periodic_model or track.model, residual=track.residual),
            residual=track.frame_residual,
            scale_known=self._camera.known,
            predicted=False,
        )

    def _predicted(self, track: Track, stamp: int) -> Person3D:
        """The last state, moved on with its velocity."""
        age = (stamp - track.stamps[-1]) / NS
        last = self._person(track, len(track.stamps) - 1)
        moved = track.velocity() * age / track.size_ratio
        root = track.roots[-1] / track.size_ratio + moved
        joints = last.joints + moved
        if root[2] < joints[:, 2].max() - root[2] + 0.1:
            joints, root = last.joints, track.roots[-1] / track.size_ratio
        return replace(
            last,
            joints=joints,
            std=np.sqrt(last.std**2 + (PREDICTED_SPEED_STD * age) ** 2),
            inferred=np.ones_like(last.inferred),
            scale=float(self._camera.focal / root[2]),
            translation=self._camera.project(root),
            residual=float('nan'),
            predicted=True,
        )
