# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The 3D person of a track in one solved frame: joints, velocities, their deviations, extremities, orientations.

With a motion filter, joints and velocities are of its state; with a lag, the velocity is the central difference of
the smooth solution. In the newest frame, lifted poses give a learned correction (`models/velocity_correction.py`)
of the velocity. With the filter's deviation s_j and correction c_j of a joint, and S and c_0 of the root, these
become

    sqrt((f s_j)^2 + (g |c_j|)^2)        h^2 (f^2 S + g^2 c_0 c_0^T)
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mocap_ros.engine import motion as engine
from mocap_ros.geometry.interpolation import central_velocity
from mocap_ros.models.joint_std import estimate_joint_std
from mocap_ros.models.model_file import load_velocity_correction
from mocap_ros.models.velocity_correction import SPANS_S, VelocityPast
from mocap_ros.people import HIPS, Motion, Person3D
from mocap_ros.skeleton import CMU15, Skeleton
from mocap_ros.solvers.extremities import (
    ANGULAR_SPEED_STD,
    SEGMENT_OF,
    ExtremityState,
    attach,
    collect_frame_evidence,
    read_states,
)
from mocap_ros.tracking.body_size import BodySize, estimate_root_covariance
from mocap_ros.tracking.motion_filter import CoreMotion, MotionFilter
from mocap_ros.tracking.track import Track
from mocap_ros.units import NS_PER_S

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

CORRECTED_STD = 0.7  # 1; f, for two thirds of the errors to be within, of persons in no training as well
CORRECTION_STD = 0.7  # 1; g, chosen likewise
ROOT_SPREAD = 1.3  # 1; h, for errors of the root's velocity are often small and at times large: 95 % are within

_AGO = -np.array(SPANS_S)
_ANCHORS = SEGMENT_OF[len(CMU15.joints) :]  # core joints on which the extremities hang


def filter_motion(track: Track, stamp_ns: int, frame: int) -> None:
    """Filter the motion of a solved track up to a frame with a stamp in ns."""
    joints = track.solved.locate_joints(frame)
    if track.motion_filter is None:
        track.motion_filter = MotionFilter(stamp_ns, joints)
    elif stamp_ns > track.motion_filter.stamps_ns[-1]:  # else, with a lag, this frame was shown before
        track.motion_filter.advance(stamp_ns, joints, track.solved.noise / track.solved.stature_ratio)


def follow_extremities(track: Track, stamp_ns: int, frame: int, core: Array) -> ExtremityState:
    """Follow the extremities of a track up to a frame with a core (J, 3) m, stamp in ns, and return them."""
    before, age_ns, solution = track.extremity_state, stamp_ns - track.extremities_ns, track.solved
    if before is not None and age_ns <= 0:  # with a lag, this frame was shown before
        return before
    noise = solution.noise / solution.stature_ratio
    evidence = collect_frame_evidence(core, track.observed, noise, frame)
    if before is None:
        followed = ExtremityState.begin(evidence, solution.model.stature)
    else:
        followed = before.advance(age_ns / NS_PER_S, evidence, solution.model.stature)
    track.extremity_state, track.extremities_ns = followed, stamp_ns
    return followed


def find_motion(track: Track, frame: int) -> CoreMotion:
    """Return the core of a person of the assumed size in one solved frame, filtered if there is a filter."""
    motion_filter, stamps_ns = track.motion_filter, track.stamps_ns
    if motion_filter is not None and motion_filter.stamps_ns[-1] == stamps_ns[frame]:
        return motion_filter.motion
    solution, joints = track.solved, track.solved.locate_joints(frame)
    velocity = np.full(joints.shape, np.nan)
    if 0 < frame < len(solution.theta) - 1:
        frames = np.arange(frame - 1, frame + 2)
        times = np.array([stamps_ns[i] - stamps_ns[frame] for i in frames]) / NS_PER_S
        positions = solution.compute_joints(frames) + solution.roots[frames, None]
        velocity = central_velocity(times, positions / solution.stature_ratio)[1]
    return CoreMotion(joints, velocity, np.full(len(joints), np.nan), np.full((3, 3), np.nan))


def find_published_motion(track: Track, frame: int) -> CoreMotion:
    """Return what `find_motion` does, with the velocity corrected where that is learned (module)."""
    found = find_motion(track, frame)
    past = sample_velocity_past(track, found) if frame == track.newest else None
    if past is None:
        return found
    correction, factors = load_velocity_correction().correct(past), (CORRECTED_STD, CORRECTION_STD, ROOT_SPREAD)
    filtered = found.velocity, found.velocity_std, found.root_velocity_covariance
    corrected = engine.add_correction(*filtered, correction, *HIPS, *factors)
    return found if corrected is None else CoreMotion(found.joints, *corrected)


def sample_velocity_past(track: Track, filtered: CoreMotion) -> VelocityPast | None:
    """Return what the correction of the newest velocities rests on; None where it is not trained for."""
    solution = track.solved
    is_filtered = track.motion_filter is not None and filtered is track.motion_filter.motion
    if track.observed.lifted is None or not is_filtered or solution.model.skeleton.joints != CMU15.joints:
        return None
    return VelocityPast(
        filtered.velocity,
        filtered.velocity_std,
        solution.locate_joints(track.newest),
        solution.sample_joints(track.observed.times, track.observed.times[-1] + _AGO),
        solution.rotation[track.newest],
    )


class Cores(NamedTuple):
    """The cores of P people in the camera's optical frame, as in `Person3D`."""

    joints: Array  # (P, J, 3) m
    std: Array  # (P, J) m
    velocity: Array  # (P, J, 3) m/s
    velocity_std: Array  # (P, J) m/s
    root_covariance: Array  # (P, 3, 3) m^2
    root_velocity_covariance: Array  # (P, 3, 3) m^2/s^2

    @staticmethod
    def of_tracks(
        tracks: Sequence[Track], frames: Sequence[int], motions: Sequence[CoreMotion], sizes: Sequence[BodySize]
    ) -> Cores:
        """Return the cores of P >= 1 tracks, each in a frame of its window, enlarged to the people's sizes."""
        joints, velocity, velocity_std, covariance = (np.array(values) for values in zip(*motions, strict=True))
        std, ratio = find_joint_std(tracks, frames, joints), np.array([[size.ratio] for size in sizes])
        squared, wide = ratio[..., None] ** 2, ratio[..., None]
        return Cores(
            joints * wide,
            std * ratio,
            velocity * wide,
            velocity_std * ratio,
            estimate_root_covariance(joints, std, sizes),
            covariance * squared,
        )


def find_joint_std(tracks: Sequence[Track], frames: Sequence[int], joints: Array) -> Array:
    """Return the standard deviations (P, J) m of joints (P, J, 3) m of P people of the assumed size."""
    values = [(t.solved.joint_std, t.solved.noise, t.solved.stature_ratio) for t in tracks]
    posterior, noise, stature_ratio = (np.array(column) for column in zip(*values, strict=True))
    lifted = [
        t.observed.lifted.std[f] for t, f in zip(tracks, frames, strict=True) if t.observed.lifted is not None
    ]
    axes = np.array([t.observed.virtual_camera.rotation[2] for t in tracks])
    return estimate_joint_std(
        posterior,
        _find_inferred(tracks, frames, CMU15),
        np.array(lifted) if lifted else None,
        noise[:, None],
        size=1 / stature_ratio[:, None],
        depth=(axes * joints.mean(axis=1)).sum(axis=1)[:, None],
    )


def _find_inferred(tracks: Sequence[Track], frames: Sequence[int], skeleton: Skeleton) -> Bools:
    inferred = np.ones((len(tracks), len(skeleton.joints)), bool)
    for row, track, frame in zip(inferred, tracks, frames, strict=True):
        core, others = track.observed.weight[frame], track.observed.extremities
        row[: len(core)] = core == 0
        if len(row) > len(core) and others is not None:
            row[len(core) :] = others.weight[frame] == 0
    return inferred


def make_people(
    tracks: Sequence[Track],
    frames: Sequence[int],
    cores: Cores,
    extremities: Sequence[ExtremityState],
    sizes: Sequence[BodySize],
    skeleton: Skeleton,
    unseen_for: Sequence[float] | None = None,
) -> list[Person3D]:
    """Return P >= 1 people, of cores enlarged to their sizes, extremities of the assumed size, each in a frame."""
    intrinsics, roots = tracks[0].intrinsics, cores.joints.mean(axis=1)
    scales, translations = (intrinsics.focal / roots[:, 2]).tolist(), intrinsics.project(roots)
    states = read_states(extremities)
    quaternions, turn_inferred = states['quaternions'], ~(states['is_turn_seen'] > 0)
    joints, std, velocity, velocity_std, root_covariance, root_velocity_covariance = cores
    inferred = np.ones((len(tracks), len(skeleton.joints)), bool)
    if unseen_for is None:
        inferred = _find_inferred(tracks, frames, skeleton)
    if skeleton != CMU15:
        ratio = np.array([[size.ratio] for size in sizes])
        offsets = states['offsets'] * ratio[..., None]
        offset_std = states['offset_std'] * ratio
        turned = ANGULAR_SPEED_STD * np.sqrt((offsets**2).sum(axis=-1))
        joints = attach(joints, offsets)
        velocity = attach(velocity, states['velocity'] * ratio[..., None])
        # errors of an extremity's offset and of its core joint are independent
        std = np.concatenate([std, np.hypot(std[:, _ANCHORS], offset_std)], axis=1)
        velocity_std = np.concatenate([velocity_std, np.hypot(velocity_std[:, _ANCHORS], turned)], axis=1)
        quaternions, turn_inferred = quaternions[:, SEGMENT_OF], turn_inferred[:, SEGMENT_OF]
    people = []
    for p, (track, frame) in enumerate(zip(tracks, frames, strict=True)):
        solution, classification = track.solved, track.schedule.classification
        motion, category = classification.motion, classification.periodic_model_name or solution.model_name
        age_s = 0.0 if unseen_for is None else unseen_for[p]
        people.append(
            Person3D(
                id=track.id,
                joints=joints[p],
                std=std[p],
                inferred=inferred[p],
                scale=scales[p],
                rotation=solution.rotation[frame].copy(),  # the caller may change it
                translation=translations[p],
                motion=Motion(motion.kind, category, solution.residual, motion.cadence),
                residual=float(solution.frame_residuals[frame]) if unseen_for is None else float('nan'),
                scale_known=intrinsics.is_focal_known,
                predicted=unseen_for is not None,
                tentative=track.is_tentative,
                velocity=velocity[p],
                velocity_std=velocity_std[p],
                root_covariance=root_covariance[p],
                root_velocity_covariance=root_velocity_covariance[p],
                age=(track.stamps_ns[frame] - track.first_ns) / NS_PER_S + age_s,
                unseen_for=age_s,
                skeleton=skeleton,
                orientation=quaternions[p],
                turn_inferred=turn_inferred[p],
            )
        )
    return people
