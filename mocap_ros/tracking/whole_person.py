# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The whole person of a track: face, feet, hands and the orientations of all segments, beside the solved core."""

from __future__ import annotations

import math

import numpy as np
from numba import types
from numpy.typing import NDArray

from mocap_ros.compiled.kernel import (
    BOOLS_1D,
    FLOAT,
    FLOATS_1D,
    FLOATS_2D,
    INPUT_1D,
    INPUT_2D,
    INPUT_BOOLS_1D,
    kernel,
)
from mocap_ros.copying import copy_with
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.people import Person3D
from mocap_ros.skeleton import BODY26, CMU15, EXTREMITY_COUNT, Skeleton
from mocap_ros.solvers.extremities import (
    ANGULAR_SPEED_STD,
    SEGMENT_OF,
    ExtremityEvidence,
    ExtremityState,
    collect_evidence,
)
from mocap_ros.tracking.body_size import BodySize
from mocap_ros.tracking.core_motion import locate_core
from mocap_ros.tracking.person_in_frame import make_person
from mocap_ros.tracking.track import Track
from mocap_ros.units import NS_PER_S

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

_NOT_SEEN = np.zeros(EXTREMITY_COUNT)


def collect_track_evidence(track: Track, frame: int, model: BasePoses) -> ExtremityEvidence:
    """Return what a solved frame of a track's window tells of the extremities.

    Args:
        track: a solved track, whose motion is filtered up to the frame if it is filtered.
        frame: index of the frame.
        model: base poses of the track's solution.
    """
    core, solution = locate_core(track, frame, model), track.solved
    noise = solution.noise / solution.stature_ratio
    return collect_evidence(core[None], track.seen.observed, noise, slice(frame, frame + 1)).select_frame(0)


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
        return copy_with(person, orientation=extremities.quaternions, turn_inferred=~told)
    joints, std, inferred, velocity, velocity_std, orientation, turn_inferred = _attach(
        person.joints,
        person.std,
        person.inferred,
        person.velocity,
        person.velocity_std,
        extremities.offsets,
        extremities.offset_std,
        extremities.velocity,
        weight,
        extremities.quaternions,
        extremities.is_turn_told,
        ratio,
    )
    return copy_with(
        person,
        skeleton=BODY26,
        joints=joints,
        std=std,
        inferred=inferred,
        velocity=velocity,
        velocity_std=velocity_std,
        orientation=orientation,
        turn_inferred=turn_inferred,
    )


@kernel(
    types.Tuple((FLOATS_2D, FLOATS_1D, BOOLS_1D, FLOATS_2D, FLOATS_1D, FLOATS_2D, BOOLS_1D))(
        INPUT_2D,
        INPUT_1D,
        INPUT_BOOLS_1D,
        INPUT_2D,
        INPUT_1D,
        INPUT_2D,
        INPUT_1D,
        INPUT_2D,
        INPUT_1D,
        INPUT_2D,
        INPUT_BOOLS_1D,
        FLOAT,
    )
)
def _attach(
    core: Array,
    core_std: Array,
    core_inferred: Bools,
    core_velocity: Array,
    core_velocity_std: Array,
    offsets: Array,
    offset_std: Array,
    offset_velocity: Array,
    weight: Array,
    quaternions: Array,
    is_turn_told: Bools,
    ratio: float,
) -> tuple[Array, Array, Bools, Array, Array, Array, Bools]:
    """Return joints, deviations, flags, velocities and orientations of all 26 joints of a person.

    Deviations of an extremity are those of its core joint and of its offset, whose errors are independent.

    Args:
        core: (15, 3) m, as the following four of `Person3D`.
        core_std: (15,) m.
        core_inferred: (15,).
        core_velocity: (15, 3) m/s.
        core_velocity_std: (15,) m/s.
        offsets: (11, 3) m, as the following two and the last but one of `ExtremityState`.
        offset_std: (11,) m.
        offset_velocity: (11, 3) m/s.
        weight: (11,) confidence scores of the extremities.
        quaternions: (15, 4) of the segments.
        is_turn_told: (15,).
        ratio: size of the person over that of the extremities.
    """
    count = len(core) + len(offsets)
    joints, std, inferred = np.empty((count, 3)), np.empty(count), np.empty(count, np.bool_)
    velocity, velocity_std = np.empty((count, 3)), np.empty(count)
    orientation, turn_inferred = np.empty((count, 4)), np.empty(count, np.bool_)
    for j in range(count):
        segment = SEGMENT_OF[j]
        for i in range(4):
            orientation[j, i] = quaternions[segment, i]
        turn_inferred[j] = not is_turn_told[segment]
        if j < len(core):
            std[j], inferred[j], velocity_std[j] = core_std[j], core_inferred[j], core_velocity_std[j]
            for i in range(3):
                joints[j, i], velocity[j, i] = core[j, i], core_velocity[j, i]
            continue
        e, squared = j - len(core), 0.0
        for i in range(3):
            offset = ratio * offsets[e, i]
            squared += offset * offset
            joints[j, i] = core[segment, i] + offset
            velocity[j, i] = core_velocity[segment, i] + ratio * offset_velocity[e, i]
        std[j] = math.hypot(core_std[segment], ratio * offset_std[e])
        inferred[j] = weight[e] == 0
        velocity_std[j] = math.hypot(core_velocity_std[segment], ANGULAR_SPEED_STD * math.sqrt(squared))
    return joints, std, inferred, velocity, velocity_std, orientation, turn_inferred
