# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The state of a tracker between two frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import Enum

from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.solvers.vertical import Vertical
from mocap_ros.tracking.body_size import FloorContact
from mocap_ros.tracking.pose_memory import KeyPoseMemory
from mocap_ros.tracking.track import Track


class WorkKind(str, Enum):
    """What a piece of deferred work finds out about a person."""

    CHECK = 'check'
    CLASSIFICATION = 'classification'


@dataclass(frozen=True, eq=False)
class BegunWork:
    """A piece of deferred work that has begun; with the tracker's parameters it determines its result.

    Attributes:
        kind: what is found out.
        track: the track as it was when the work began.
        slices_done: number of slices that are done.
    """

    kind: WorkKind
    track: Track
    slices_done: int = 0


@dataclass(frozen=True, eq=False)
class TrackerState:
    """Everything that a tracker knows; together with its models and parameters it determines what follows.

    Attributes:
        tracks: people who are tracked, in the order in which they came.
        leaving: with `tracker.lag`, tracks that have ended and whose last frames are still to be put out.
        newest_stamp_ns: ns, stamp of the newest accepted frame; None before the first.
        output_stamp_ns: ns, stamp of the frame whose people `Tracker.update` last returned; with `tracker.lag`, an
            older one.
        waiting_ns: ns, with `tracker.lag` the stamps of the frame that is put out and of those after it.
        has_output_begun: with `tracker.lag`, whether a frame was old enough to be put out since anybody was there.
        is_work_pending: whether the slices of deferred work that follow the newest frame are still to be done.
        begun_work: the piece of deferred work that has begun and is not finished; None if there is none.
        pose_memory: key poses of people who were lost.
        name_count: number of names that the tracker has given to people without an id.
        newest_person_ns: ns, stamp of the newest frame with a detection that can be used; None if there was none
            since everybody was forgotten.
        backward_jump_s: s by which the stamp of the newest frame went back, so that tracking restarted; else 0.
        swapped_frames: number of frames so far in which a person's left and right were swapped back.
        unusable_people: number of detections so far with too few joints, with all of them in one place, or of a
            part of somebody who was detected besides.
        models: name and number of base poses of each of the tracker's models.
        is_lifted: whether the tracker has a lifter, so that the frames of the tracks hold lifted poses.
        intrinsics: intrinsics of the camera in the newest accepted frame; None before the first.
        vertical: what is known of the camera's vertical; None if nothing is.
        contacts: ids, and what feet on the floor have told of the sizes of these people and of some who are gone.
    """

    tracks: tuple[Track, ...] = ()
    leaving: tuple[Track, ...] = ()
    newest_stamp_ns: int | None = None
    output_stamp_ns: int = 0
    waiting_ns: tuple[int, ...] = ()
    has_output_begun: bool = False
    is_work_pending: bool = False
    begun_work: BegunWork | None = None
    pose_memory: KeyPoseMemory = field(default_factory=KeyPoseMemory)
    name_count: int = 0
    newest_person_ns: int | None = None
    backward_jump_s: float = 0.0
    swapped_frames: int = 0
    unusable_people: int = 0
    models: tuple[tuple[str, int], ...] = ()
    is_lifted: bool = False
    intrinsics: Intrinsics | None = None
    vertical: Vertical | None = None
    contacts: tuple[tuple[str, FloorContact], ...] = ()

    def forget_everybody(self) -> TrackerState:
        """Return the state without people, names and stamps.

        It keeps the models, the counters, the last output, and a vertical that was given.
        """
        return TrackerState(
            output_stamp_ns=self.output_stamp_ns,
            backward_jump_s=self.backward_jump_s,
            swapped_frames=self.swapped_frames,
            unusable_people=self.unusable_people,
            models=self.models,
            is_lifted=self.is_lifted,
            vertical=self.vertical and self.vertical.forget(),
        )

    @property
    def newest_tracks(self) -> tuple[Track, ...]:
        """The tracks of the people whom the newest frame shows, without those who may be none."""
        return tuple(t for t in self.tracks if t.seen.stamps_ns[-1] == self.newest_stamp_ns and not t.is_tentative)

    def find_track(self, name: str) -> Track | None:
        """Return the track with an id; None if there is none."""
        return next((t for t in self.tracks if t.id == name), None)

    def put_tracks(self, tracks: Sequence[Track]) -> TrackerState:
        """Return the state with some tracks in the places of those with the same ids; new ones come last.

        A track that has ended takes its own place among those, whoever has its id now.
        """
        if not tracks:
            return self
        ended = {t.key: t for t in self.leaving}
        put = {t.key: t for t in tracks if t.key in ended}
        by_id = {t.id: t for t in self.tracks} | {t.id: t for t in tracks if t.key not in ended}
        return replace(self, tracks=tuple(by_id.values()), leaving=tuple((ended | put).values()))

    def end_tracks(self, ended: Sequence[Track]) -> TrackerState:
        """Return the state in which some tracks have ended; until `drop_shown`, their frames can be put out."""
        keys = {t.key for t in ended}
        kept = tuple(t for t in self.tracks if t.key not in keys)
        return replace(self, tracks=kept, leaving=(*self.leaving, *ended))

    def drop_shown(self, shown_ns: int) -> TrackerState:
        """Return the state without the tracks that have ended before the frame that is put out, stamp in ns."""
        if not self.leaving:
            return self
        return replace(self, leaving=tuple(t for t in self.leaving if t.seen.stamps_ns[-1] >= shown_ns))
