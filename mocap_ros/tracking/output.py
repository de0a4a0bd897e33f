# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The 3D person of a track in one solved frame: joints, velocities, how sure they are, extremities, orientations.

With a motion filter, joints and velocities are of its state. Without one, as with a lag, the solution before and
after a frame is smooth, and the velocity is the central difference of the frames beside it
(`geometry.interpolation`).

What is published of the newest frame has the filter's velocity with a learned correction, if the pose was lifted
(`models/velocity_correction.py`). With the filter's standard deviation s_j and the correction c_j of a joint, and
likewise with the filter's covariance S of the root's velocity and the correction c_0 of that, these become

    sqrt((f s_j)^2 + (g |c_j|)^2)        h^2 (f^2 S + g^2 c_0 c_0^T)
"""

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
from mocap_ros.geometry.interpolation import central_velocity
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.joint_std import estimate_joint_std
from mocap_ros.models.model_file import load_velocity_correction
from mocap_ros.models.velocity_correction import SPANS_S, VelocityPast
from mocap_ros.people import HIPS, Motion, Person3D
from mocap_ros.skeleton import BODY26, CMU15, EXTREMITY_COUNT, Skeleton
from mocap_ros.solvers.extremities import (
    ANGULAR_SPEED_STD,
    SEGMENT_OF,
    ExtremityEvidence,
    ExtremityState,
    collect_evidence,
)
from mocap_ros.tracking.body_size import BodySize
from mocap_ros.tracking.motion_filter import CoreMotion, MotionFilter
from mocap_ros.tracking.track import Track
from mocap_ros.units import NS_PER_S

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

CORRECTED_STD = 0.7  # 1; f, for two thirds of the errors to be within, of persons in no training as well
CORRECTION_STD = 0.7  # 1; g, chosen likewise (docs/method.md)
ROOT_SPREAD = 1.3  # 1; h, for errors of the root's velocity are often small and at times large: 95 % are within

_AGO = -np.array(SPANS_S)
_NOT_SEEN = np.zeros(EXTREMITY_COUNT)


def filter_motion(track: Track, stamp_ns: int, frame: int, model: BasePoses) -> None:
    """Filter the motion of a solved track up to a frame with a stamp in ns; `model` is that of its solution."""
    joints = track.solved.locate_joints(frame, model)
    if track.motion_filter is None:
        track.motion_filter = MotionFilter(stamp_ns, joints)
    elif stamp_ns > track.motion_filter.stamps_ns[-1]:  # else, with a lag, this frame was put out before
        track.motion_filter.advance(stamp_ns, joints, track.solved.noise / track.solved.stature_ratio)


def follow_extremities(track: Track, stamp_ns: int, frame: int, model: BasePoses) -> None:
    """Follow the extremities up to a frame, as the motion has been filtered; the arguments are those above."""
    before, age_ns = track.extremity_state, stamp_ns - track.extremities_ns
    if before is not None and age_ns <= 0:  # with a lag, this frame was put out before
        return
    core, noise = find_motion(track, frame, model).joints, track.solved.noise / track.solved.stature_ratio
    evidence = collect_evidence(core[None], track.observed, noise, slice(frame, frame + 1)).select_frame(0)
    if before is None:
        track.extremity_state = ExtremityState.begin(evidence, model.stature)
    else:
        track.extremity_state = before.advance(age_ns / NS_PER_S, evidence, model.stature)
    track.extremities_ns = stamp_ns


def find_motion(track: Track, frame: int, model: BasePoses) -> CoreMotion:
    """Return the core of a person of the assumed size in one solved frame, filtered if there is a filter.

    Args:
        track: a solved track.
        frame: index of the frame.
        model: base poses of the track's solution.
    """
    motion_filter, stamps_ns = track.motion_filter, track.stamps_ns
    if motion_filter is not None and motion_filter.stamps_ns[-1] == stamps_ns[frame]:
        return motion_filter.motion
    solution, velocity = track.solved, np.full((len(model.mean), 3), np.nan)
    if 0 < frame < len(solution.theta) - 1:
        frames = np.arange(frame - 1, frame + 2)
        times = np.array([stamps_ns[i] - stamps_ns[frame] for i in frames]) / NS_PER_S
        places = solution.compute_joints(model, frames) + solution.roots[frames, None]
        velocity = central_velocity(times, places / solution.stature_ratio)[1]
    joints, root = solution.locate_joints(frame, model), solution.roots[frame] / solution.stature_ratio
    return CoreMotion(joints, root, velocity, np.full(len(velocity), np.nan), np.full((3, 3), np.nan))


def _correct_velocity(found: CoreMotion, track: Track, frame: int, model: BasePoses) -> CoreMotion:
    """Return what `find_motion` found, with the velocity corrected where that is learned (module)."""
    past = sample_velocity_past(track, model, found) if frame == track.newest else None
    if past is None:
        return found
    correction = load_velocity_correction().correct(past)
    if not correction.any():
        return found
    uncertainty = _correct_uncertainty(found.velocity_std, found.root_velocity_covariance, correction)
    return CoreMotion(found.joints, found.root, found.velocity + correction, *uncertainty)


def sample_velocity_past(track: Track, model: BasePoses, filtered: CoreMotion) -> VelocityPast | None:
    """Return what the correction of the velocities in the newest frame rests on; None where it is not trained for.

    Args:
        track: a solved track.
        model: base poses of the track's solution.
        filtered: what the filter says of the newest frame.
    """
    solution, frame = track.solved, track.newest
    is_filtered = track.motion_filter is not None and filtered is track.motion_filter.motion
    if track.observed.lifted is None or not is_filtered or model.skeleton.joints != CMU15.joints:
        return None
    return VelocityPast(
        filtered.velocity,
        filtered.velocity_std,
        solution.locate_joints(frame, model),
        solution.sample_joints(model, track.times_s, _AGO),
        solution.rotation[frame],
    )


@kernel(types.Tuple((FLOATS_1D, FLOATS_2D))(INPUT_1D, INPUT_2D, INPUT_2D))
def _correct_uncertainty(std: Array, covariance: Array, correction: Array) -> tuple[Array, Array]:
    """Return the last two attributes of `CoreMotion` from those of the filter and corrections (J, 3) m/s."""
    out, root = np.empty(len(std)), (ROOT_SPREAD * CORRECTED_STD) ** 2 * covariance
    for j in range(len(std)):
        squared = correction[j, 0] ** 2 + correction[j, 1] ** 2 + correction[j, 2] ** 2
        out[j] = math.sqrt((CORRECTED_STD * std[j]) ** 2 + CORRECTION_STD**2 * squared)
    at_root = (correction[HIPS[0]] + correction[HIPS[1]]) / 2
    for i in range(3):
        for k in range(3):
            root[i, k] += (ROOT_SPREAD * CORRECTION_STD) ** 2 * at_root[i] * at_root[k]
    return out, root


def make_person(track: Track, frame: int, model: BasePoses) -> Person3D:
    """Return the core of a person of the assumed size in one solved frame, filtered if there is a filter.

    `body_size.resize` gives the person the size that is known, and with it the covariance of the root.

    Args:
        track: a solved track.
        frame: index of the frame.
        model: base poses of the track's solution.
    """
    solution, classification = track.solved, track.schedule.classification
    found = _correct_velocity(find_motion(track, frame, model), track, frame, model)
    motion, category = classification.motion, classification.periodic_model_name or solution.model_name
    return Person3D(
        id=track.id,
        joints=found.joints,
        std=find_joint_std(track, frame, found.root),
        inferred=_find_inferred(track, frame),
        scale=float(track.intrinsics.focal / found.root[2]),
        rotation=solution.rotation[frame].copy(),  # the caller may change it
        translation=track.intrinsics.project(found.root),
        motion=Motion(motion.kind, category, solution.residual, motion.cadence),
        residual=float(solution.frame_residuals[frame]),
        scale_known=track.intrinsics.is_focal_known,
        predicted=False,
        tentative=track.is_tentative,
        velocity=found.velocity,
        velocity_std=found.velocity_std,
        root_velocity_covariance=found.root_velocity_covariance,
        age=(track.stamps_ns[frame] - track.first_ns) / NS_PER_S,
    )


def find_joint_std(track: Track, frame: int, root: Array) -> Array:
    """Return the standard deviations (J,) m of the joints of a person of the assumed size in one solved frame.

    Args:
        track: a solved track.
        frame: index of the frame.
        root: (3,) m, origin of the person's body.
    """
    solution, observed = track.solved, track.observed
    return estimate_joint_std(
        solution.joint_std,
        _find_inferred(track, frame),
        None if observed.lifted is None else observed.lifted.std[frame],
        solution.noise,
        size=1 / solution.stature_ratio,
        depth=float(observed.virtual_camera.measure_depth(root[None])[0]),
    )


def _find_inferred(track: Track, frame: int) -> Bools:
    """Return a mask (J,) of the joints that are not seen in a frame."""
    return np.asarray(track.observed.weight[frame] == 0)


def make_whole_person(track: Track, frame: int, model: BasePoses, skeleton: Skeleton) -> Person3D:
    """Return the person of a track in the frame that its extremities have been followed to.

    Args:
        track: a solved track.
        frame: index of the frame.
        model: base poses of the track's solution.
        skeleton: `skeleton.BODY26`, or `skeleton.CMU15` for the core alone.
    """
    seen = track.observed.extremities
    weight = _NOT_SEEN if seen is None else seen.weight[frame]
    return _complete(make_person(track, frame, model), track.extremity_state, weight, skeleton)


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
    extremities = track.extremity_state
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
