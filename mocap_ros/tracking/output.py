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

from mocap_ros.arrays import Array
from mocap_ros.geometry.interpolation import central_velocity
from mocap_ros.models.joint_std import estimate_joint_std
from mocap_ros.models.model_file import load_velocity_correction
from mocap_ros.models.velocity_correction import SPANS_S, VelocityPast
from mocap_ros.people import HIPS, Motion, Person3D
from mocap_ros.skeleton import CMU15, CORE_COUNT, Skeleton
from mocap_ros.solvers.extremities import (
    ANGULAR_SPEED_STD,
    SEGMENT_OF,
    ExtremityEvidence,
    attach,
    collect_evidence,
    follow_extremities,
    read_states,
)
from mocap_ros.solvers.footing import Footing
from mocap_ros.tracking.body_size import BodySize, estimate_root_covariance
from mocap_ros.tracking.motion_filter import CoreMotion, filter_motion, read_motion
from mocap_ros.tracking.track import Track
from mocap_ros.units import NS_PER_S

CORRECTED_STD = 0.7  # 1; f, for two thirds of the errors to be within, of persons in no training as well
CORRECTION_STD = 0.7  # 1; g, chosen likewise
ROOT_SPREAD = 1.3  # 1; h, for errors of the root's velocity are often small and at times large: 95 % are within

UNKNOWN_CONTACT, NO_SHIFT = np.full(2, np.nan), np.zeros(3)  # of the two feet; (3,) m
_AGO = np.array([0.0, *SPANS_S])
_NOW = np.array([0.0])
_HIPS = np.array(HIPS)
_ANCHORS = SEGMENT_OF[CORE_COUNT:]  # core joints on which the extremities hang


class Shown(NamedTuple):
    """P >= 1 solved people, each in one frame of the window."""

    tracks: Sequence[Track]
    frames: Sequence[int]
    times: Array  # (P,) s, of these frames since each person's first
    noise: Array  # (P,) m, image noise at people of the assumed size

    @staticmethod
    def of(tracks: Sequence[Track], frames: Sequence[int] | None = None) -> Shown:
        """Return people in a frame of each, by default the newest."""
        if frames is None:
            frames = [t.newest for t in tracks]
        ages = [t.stamps_ns[f] - t.first_ns for t, f in zip(tracks, frames, strict=True)]
        noise = [t.solved.noise / t.solved.stature_ratio for t in tracks]
        return Shown(tracks, frames, np.array(ages) / NS_PER_S, np.array(noise))


def follow_motion(shown: Shown, upward: Array | None, *, is_steady: bool) -> tuple[CoreMotion, ExtremityEvidence]:
    """Filter the motion of people, if `is_steady`, plant their feet and follow their extremities."""
    tracks, times = shown.tracks, shown.times
    now, earlier = locate_past(shown)
    if is_steady:
        filters = filter_motion([t.motion_filter for t in tracks], times, now, shown.noise)
        for track, own in zip(tracks, filters, strict=True):
            track.motion_filter = own
    motion = find_published_motion(shown, now, earlier)
    plant_feet(shown, motion, upward)
    seen, before = collect_seen(shown, motion.joints), np.array([t.extremities_s for t in tracks])
    known, statures = [t.extremity_state for t in tracks], np.array([t.solved.model.stature for t in tracks])
    states = follow_extremities(known, times - before, seen, statures, is_steady=is_steady)
    for track, state, time in zip(tracks, states, np.maximum(times, before).tolist(), strict=True):
        track.extremity_state, track.extremities_s = state, time
    return motion, seen


def locate_joints(shown: Shown, ago: Array = _NOW) -> Array:
    """Return solved joints (P, T, J, 3) m of people of the assumed size, times (T,) s before the frame."""
    people = zip(shown.tracks, shown.frames, strict=True)
    return np.array([t.solved.sample_joints(t.observed.times, f, ago) for t, f in people])


def find_motion(shown: Shown, located: Array) -> CoreMotion:
    """Return the motion of people in the frame, filtered and standing where that is known.

    `located` (P, J, 3) m are the solved joints.
    """
    motion = read_motion([t.motion_filter for t in shown.tracks], shown.times, located)
    for p, (track, frame) in enumerate(zip(shown.tracks, shown.frames, strict=True)):
        if 0 < frame < track.newest and np.isnan(motion.velocity[p, 0, 0]):
            solution, near = track.solved, np.arange(frame - 1, frame + 2)
            positions = solution.compute_joints(near) + solution.roots[near, None]
            times = track.observed.times[near] - track.observed.times[frame]
            motion.velocity[p] = central_velocity(times, positions / solution.stature_ratio)[1]
    _stand(shown, motion)
    return motion


def plant_feet(shown: Shown, motion: CoreMotion, upward: Array | None) -> None:
    """Give the roots of people inertia and let their feet stand, up to the frame; sets the joints."""
    offsets = read_states(np.array([t.extremity_state for t in shown.tracks]))['offsets']
    for p, (track, frame) in enumerate(zip(shown.tracks, shown.frames, strict=True)):
        before, time_s = track.footing, float(shown.times[p])
        if before is None or time_s > before.time_s:  # else, with a lag, this frame was shown before
            seen = track.observed, frame, upward, float(shown.noise[p])
            track.footing = Footing.advance(before, time_s, motion.joints[p], offsets[p], *seen)
    _stand(shown, motion)


def _stand(shown: Shown, motion: CoreMotion) -> None:
    for track, time_s, joints in zip(shown.tracks, shown.times.tolist(), motion.joints, strict=True):
        if track.footing is not None and track.footing.time_s == time_s:
            joints[:] = track.footing.core


def locate_past(shown: Shown) -> tuple[Array, Array]:
    """Return solved joints (P, J, 3) m in the frame, and (P, T, J, 3) of before it where it is the newest."""
    can_correct = shown.tracks[0].observed.lifted is not None
    located = locate_joints(shown, _AGO if can_correct else _NOW)
    earlier = np.ascontiguousarray(located[:, 1:])
    for own, track, frame in zip(earlier, shown.tracks, shown.frames, strict=True):
        if frame != track.newest:
            own[:] = np.nan
    return np.ascontiguousarray(located[:, 0]), earlier


def find_published_motion(shown: Shown, now: Array, earlier: Array) -> CoreMotion:
    """Return what `find_motion` does, with the velocity corrected where that is learned (module).

    The joints are those of `locate_past`.
    """
    motion = find_motion(shown, now)
    if earlier.shape[1]:
        correction = load_velocity_correction().correct(describe_past(shown.tracks, motion, now, earlier))
        who = correction.any(axis=(1, 2))
        correction, std, covariance = correction[who], motion.velocity_std, motion.root_velocity_covariance
        motion.velocity[who] += correction
        std[who] = np.hypot(CORRECTED_STD * std[who], CORRECTION_STD * np.linalg.norm(correction, axis=-1))
        at_root = CORRECTION_STD * correction[:, _HIPS].mean(axis=1)
        spread = CORRECTED_STD**2 * covariance[who] + at_root[:, :, None] * at_root[:, None]
        covariance[who] = ROOT_SPREAD**2 * spread
    return motion


def describe_past(tracks: Sequence[Track], filtered: CoreMotion, now: Array, earlier: Array) -> VelocityPast:
    """Return what the correction of the newest velocities rests on; the joints are those of `locate_past`."""
    axes = np.array([t.solved.rotation[t.newest] for t in tracks])
    return VelocityPast(filtered.velocity, filtered.velocity_std, now, earlier, axes)


class Cores(NamedTuple):
    """The cores of P people in the camera's optical frame, as in `Person3D`."""

    joints: Array  # (P, J, 3) m
    std: Array  # (P, J) m
    velocity: Array  # (P, J, 3) m/s
    velocity_std: Array  # (P, J) m/s
    root_covariance: Array  # (P, 3, 3) m^2
    root_velocity_covariance: Array  # (P, 3, 3) m^2/s^2

    @staticmethod
    def of_people(
        tracks: Sequence[Track], motion: CoreMotion, seen: ExtremityEvidence, sizes: Sequence[BodySize]
    ) -> Cores:
        """Return the cores of P >= 1 people, enlarged to their sizes."""
        std, ratio = find_joint_std(tracks, seen), np.array([[size.ratio] for size in sizes])
        wide = ratio[..., None]
        return Cores(
            motion.joints * wide,
            std * ratio,
            motion.velocity * wide,
            motion.velocity_std * ratio,
            find_root_covariance(tracks, motion.joints, std, sizes),
            motion.root_velocity_covariance * wide**2,
        )


def find_shifts(tracks: Sequence[Track]) -> Array:
    """Return the displacements (P, 3) m of P people of the assumed size by inertia and standing feet."""
    return np.array([NO_SHIFT if t.footing is None else t.footing.shift for t in tracks])


def find_root_covariance(tracks: Sequence[Track], joints: Array, std: Array, sizes: Sequence[BodySize]) -> Array:
    """Return the covariances (P, 3, 3) m^2 of roots of joints (P, J, 3) m of the assumed size.

    Where inertia and feet contradict the image, either may be wrong.
    """
    shift = find_shifts(tracks) * np.array([[size.ratio] for size in sizes])
    noise = np.array([t.solved.noise / t.solved.stature_ratio for t in tracks])
    return estimate_root_covariance(joints, std, noise, sizes) + shift[:, :, None] * shift[:, None]


def collect_seen(shown: Shown, core: Array) -> ExtremityEvidence:
    """Return what the frame shows of people with cores (P, J, 3) m of the assumed size."""
    return collect_evidence(core, [t.observed for t in shown.tracks], shown.noise, shown.frames)


def find_joint_std(tracks: Sequence[Track], seen: ExtremityEvidence) -> Array:
    """Return the standard deviations (P, J) m of the core joints of P people of the assumed size."""
    posterior = np.array([t.solved.joint_std for t in tracks])
    size = np.array([[1 / t.solved.stature_ratio] for t in tracks])
    return estimate_joint_std(size * posterior, seen.weight, seen.lifted_std, seen.noise)


def make_people(
    shown: Shown,
    cores: Cores,
    weight: Array,
    sizes: Sequence[BodySize],
    skeleton: Skeleton,
    extremities: Array,
    unseen_for: Sequence[float] | None = None,
) -> list[Person3D]:
    """Return the people in the frame.

    `cores` are enlarged to the sizes, and `extremities`, states (P, N), are of the assumed size; `weight` (P, 26)
    are the scores of the joints; `unseen_for` (P,) s of people who are predicted.
    """
    intrinsics, roots = shown.tracks[0].intrinsics, cores.joints.mean(axis=1)
    scales, translations = (intrinsics.focal / roots[:, 2]).tolist(), intrinsics.project(roots)
    states = read_states(extremities)
    quaternions, turn_inferred = states['quaternions'], ~(states['is_turn_seen'] > 0)
    joints, std, velocity, velocity_std, root_covariance, root_velocity_covariance = cores
    inferred = weight[:, : len(skeleton.joints)] == 0
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
    for p, (track, frame) in enumerate(zip(shown.tracks, shown.frames, strict=True)):
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
                contact=UNKNOWN_CONTACT.copy()
                if track.footing is None or unseen_for is not None
                else track.footing.contact,
            )
        )
    return people
