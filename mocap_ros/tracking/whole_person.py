"""The whole person of a track: face, feet, hands and the orientations of all segments, beside the solved core."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.models.base_poses import BasePoses
from mocap_ros.people import Person3D
from mocap_ros.skeleton import BODY26, CMU15, EXTREMITY_COUNT, Skeleton
from mocap_ros.solvers.extremities import (
    ANCHORS,
    ANGULAR_SPEED_STD,
    SEGMENT_OF,
    ExtremityEvidence,
    ExtremityState,
    attach,
)
from mocap_ros.solvers.extremity_evidence import collect_evidence
from mocap_ros.tracking.body_size import BodySize
from mocap_ros.tracking.person_in_frame import locate_output_joints, make_person
from mocap_ros.tracking.track import Track
from mocap_ros.units import NS_PER_S

Array = NDArray[np.float64]

_NOT_SEEN = np.zeros(EXTREMITY_COUNT)


def collect_track_evidence(track: Track, frame: int, model: BasePoses) -> ExtremityEvidence:
    """Return what a solved frame of a track's window tells of the extremities.

    Args:
        track: a solved track, whose motion is filtered up to the frame if it is filtered.
        frame: index of the frame.
        model: base poses of the track's solution.
    """
    core, solution = locate_output_joints(track, frame, model), track.solved
    return collect_evidence(core, track.seen.observed, solution.noise / solution.stature_ratio, frame)


def make_whole_person(track: Track, frame: int, model: BasePoses, skeleton: Skeleton) -> Person3D:
    """Return the person of a track in the frame that its extremities have been followed to.

    Args:
        track: a solved track.
        frame: index of the frame.
        model: base poses of the track's solution.
        skeleton: `skeleton.BODY26`, or `skeleton.CMU15` for the core alone.
    """
    seen = track.seen.observed.extremities
    weight = _NOT_SEEN if seen is None else seen.weight[frame]
    return _complete(make_person(track, frame, model), track.extremities, weight, skeleton)


def complete_prediction(
    person: Person3D, track: Track, stamp_ns: int, model: BasePoses, skeleton: Skeleton, size: BodySize
) -> Person3D:
    """Return a person who was predicted for a time after the last detection, with all that the skeleton has.

    Args:
        person: the core at that time.
        track: the track of the person.
        stamp_ns: ns, that time.
        model: base poses of the track's solution.
        skeleton: as in `make_whole_person`.
        size: what is known of the person's size, which the core has already.
    """
    extremities = track.extremities
    if extremities is not None and stamp_ns > track.extremities_ns:
        step_s = (stamp_ns - track.extremities_ns) / NS_PER_S
        core = person.joints / size.ratio
        extremities = extremities.advance(step_s, ExtremityEvidence.without_image(core), model.stature)
    return _complete(person, extremities, _NOT_SEEN, skeleton, size.ratio)


def _complete(
    person: Person3D, extremities: ExtremityState | None, weight: Array, skeleton: Skeleton, ratio: float = 1.0
) -> Person3D:
    """Return a person with orientations, and with face, feet and hands if the skeleton has them.

    Args:
        person: the core of the person.
        extremities: those of the same frame; None if they have never been followed.
        weight: (11,) confidence scores of face, feet and hands; 0 where not seen.
        skeleton: as in `make_whole_person`.
        ratio: size of the person over that of the extremities.
    """
    if extremities is None:
        return person
    if skeleton == CMU15:
        told = extremities.is_turn_told
        return replace(person, orientation=extremities.quaternions, turn_inferred=~told)
    offsets = extremities.offsets * ratio
    reach = np.linalg.norm(offsets, axis=1)
    speed_std = np.hypot(person.velocity_std[ANCHORS], ANGULAR_SPEED_STD * reach)
    return replace(
        person,
        skeleton=BODY26,
        joints=attach(person.joints, offsets),
        std=np.append(person.std, np.hypot(person.std[ANCHORS], extremities.offset_std * ratio)),
        inferred=np.append(person.inferred, weight == 0),
        velocity=np.concatenate([person.velocity, person.velocity[ANCHORS] + extremities.velocity * ratio]),
        velocity_std=np.append(person.velocity_std, speed_std),
        orientation=extremities.quaternions[SEGMENT_OF],
        turn_inferred=~extremities.is_turn_told[SEGMENT_OF],
    )
