# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""People whom several cameras see, merged from the skeletons of each: roots, sizes and poses.

A camera at o sees a root at r = o + a. Along the line of sight it is uncertain by the size of the body, which is
the same in all frames, and by little else: true are o + k a and, of joints, k (x - r), with a factor k for each
camera. What the root's covariance has along the line of sight, s |a|, is the deviation s of k; of its square the
share `COMMON` is the same for all cameras, as all assume one body height. Where lines of sight meet shows k,

    min sum_t sum_c |r_t - o_c - k_c a_tc|^2_O + |k - 1|^2_P,    P_cd = s_c s_d (COMMON + (1 - COMMON) [c = d])

a linear problem from which the r_t are eliminated and whose equations are added up over frames; those within
`CORRELATION_S` count as one. O is the information of a root, across the line of sight from its covariance, along
it from `DEPTH_NOISE` |a|. Then root and pose are the weighted means

    r = T^-1 sum_c w_c O_c (o_c + k_c a_c),          T = sum_c w_c O_c
    q_j = T_j^-1 sum_c w_c N_cj k_c (x_cj - r_c),    T_j = sum_c w_c N_cj

with N_cj from the deviation of a joint, of whose variance the share `ALONG` lies along its line of sight, and with
the weights w = (nu + 3) / (nu + e^T N e) of Student's t distribution where three cameras or more see the person.
Errors that all cameras share (definitions of joints, the lifter's bias) do not average out:

    C_r = T^-1 + J cov(k) J^T + SHARED_ROOT_M^2 I,   J = [T^-1 w_c O_c a_c],      std_j^2 = tr T_j^-1 + SHARED_M^2
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.people import People
from mocap_ros.skeleton import find_roots
from mocap_ros.solvers.same_people import SamePeople

COMMON = 0.85  # 1; of the variance of a size: the assumed body height, less what each camera makes of the pose
DEPTH_NOISE = 0.03  # 1; of a distance from frame to frame, besides the size
LEAST_ACROSS_M = 0.02  # m; a root is no more certain across the line of sight than hips are defined
LEAST_SIZE_STD = 0.01  # 1; no size is better known, by a measured height or depths
ALONG = 0.85  # 1; share of the variance of a joint along its line of sight, by training persons
CORRELATION_S = 1.0  # s; a distance errs the same way for as long
SIZE_MEMORY_S = 10.0  # s; live, since a tracker's sizes change while it learns them
FREEDOM = 4.0  # 1; nu, of Student's t distribution
ROUNDS = 4  # of reweighting; more change less than 1 mm
SHARED_M = 0.045  # m; deviation of what is wrong with a joint in all cameras, by training persons
SHARED_ROOT_M = 0.03  # m; that of a root: recorded detectors put hips elsewhere in all cameras alike
LEAST_STD, LEAST_VARIANCE = 1e-4, 1e-8  # m/s, m^2/s^2; of velocities that others call certain
INFERRED_WEIGHT = 0.1  # 1; of an orientation whose turn the image does not show
MAX_STEP_S = 0.2  # s; the longest time that one frame stands for


class CameraView(NamedTuple):
    """The people whom a camera sees in a frame, in a frame common to all cameras."""

    people: People
    centre: Array  # (3,) m, of the camera


class MergedPeople(NamedTuple):
    """The people of a frame."""

    people: People  # in the common frame
    tracks: Sequence[Mapping[int, str]]  # of each person, the id in each camera that counts, by its number


class _Sizes:
    """The factors k of one person in C cameras, and what the frames so far say of them."""

    def __init__(self, count: int, memory_s: float) -> None:
        self._memory_s = memory_s
        self.factors = np.ones(count)
        self.covariance = np.zeros((count, count))
        self._information = np.zeros((count, count))
        self._target = np.zeros(count)

    def add(self, seen: list[int], centres: Array, reach: Array, roots: Array, std: Array, step_s: float) -> None:
        """Take in a frame: of S cameras that see the person, centres and `reach` = a (S, 3), information of roots.

        `std` (C,) are the deviations s of all cameras.
        """
        kept = math.exp(-step_s / self._memory_s)
        self._information *= kept
        self._target *= kept
        if len(seen) > 1 and step_s > 0:
            inverse = np.linalg.inv(roots.sum(axis=0))
            pulled, held = (roots @ v[..., None] for v in (reach, centres))
            mean, rest = pulled[..., 0], held[..., 0]
            quadratic = np.diag((reach * mean).sum(axis=1)) - mean @ inverse @ mean.T
            linear = mean @ inverse @ rest.sum(axis=0) - (reach * rest).sum(axis=1)
            share = min(step_s, MAX_STEP_S) / CORRELATION_S
            self._information[np.ix_(seen, seen)] += share * quadratic
            self._target[seen] += share * linear
        prior = np.linalg.inv(np.outer(std, std) * (COMMON + (1 - COMMON) * np.eye(len(std))))
        self.covariance = np.linalg.inv(self._information + prior)
        self.factors = self.covariance @ (self._target + prior.sum(axis=1))


class PeopleMerger:
    """Merger of the people whom C cameras see, in successive frames.

    A recording has the people of all its frames: nothing is forgotten of them then.
    """

    def __init__(self, *, is_recording: bool = False) -> None:
        self._same_people = SamePeople(math.inf) if is_recording else SamePeople()
        self._sizes: dict[int, _Sizes] = {}
        self._size_memory_s = math.inf if is_recording else SIZE_MEMORY_S
        self._time_s = math.nan

    def rewind(self) -> None:
        """Go back to the first frame, and keep what is known of sizes and of who is who."""
        self._time_s = math.nan

    def merge(self, time_s: float, views: Sequence[CameraView]) -> MergedPeople:
        """Return the people whom C cameras see at a time in s, later than before.

        Their ids are numbers that stay, whatever those of the cameras are. A camera that does not see has a view
        of nobody, and one that only predicts a person does not count where others see them. What belongs to a
        single camera (scale, rotation, translation, residual) is not known.
        """
        step_s = 0.0 if math.isnan(self._time_s) else time_s - self._time_s
        self._time_s = time_s
        rows: dict[int, dict[int, int]] = {}  # of each person, by the number of the camera
        numbers = self._same_people.update(time_s, step_s, [view.people for view in views])
        known = self._same_people.known_numbers
        self._sizes = {number: sizes for number, sizes in self._sizes.items() if number in known}
        for camera, own in enumerate(numbers):
            for row, number in enumerate(own):
                rows.setdefault(number, {})[camera] = row
        centres = np.array([view.centre for view in views])
        merged, tracks = list[People](), list[dict[int, str]]()
        for number, shown in sorted(rows.items()):
            in_sight = {camera: row for camera, row in shown.items() if not views[camera].people.predicted[row]}
            seen = in_sight or shown
            people = People.concatenate([views[camera].people.select([row]) for camera, row in seen.items()])
            people = replace(people, is_scale_known=all(views[camera].people.is_scale_known for camera in seen))
            sizes = self._sizes.setdefault(number, _Sizes(len(views), self._size_memory_s))
            merged.append(_merge_person(str(number), people, [*seen], centres, sizes, step_s))
            tracks.append({camera: views[camera].people.ids[row] for camera, row in seen.items()})
        return MergedPeople(People.concatenate(merged) if merged else People.none(), tracks)


def _merge_person(
    person_id: str, people: People, seen: list[int], centres: Array, sizes: _Sizes, step_s: float
) -> People:
    """Return a person whom S cameras see, a row each, with centres (C, 3) m of all."""
    roots, own = people.roots, centres[seen]
    reach = roots - own
    distance = np.linalg.norm(reach, axis=1)
    direction = reach / distance[:, None]
    along = np.sqrt((direction * (people.root_covariance @ direction[..., None])[..., 0]).sum(axis=1))
    across = np.sqrt(np.maximum(np.linalg.eigvalsh(people.root_covariance)[:, 0], 0.0))
    depth_std = np.minimum(DEPTH_NOISE * distance, along)
    information = _build_information(direction, np.maximum(across, LEAST_ACROSS_M), depth_std)
    size_std = np.maximum(along / distance, LEAST_SIZE_STD)
    of_all = np.full(len(centres), size_std.mean())
    of_all[seen] = size_std
    sizes.add(seen, own, reach, information, of_all, step_s)
    factors = sizes.factors[seen]

    root = _average(own + factors[:, None] * reach, information)
    leverage = (root.shares @ reach[..., None])[..., 0].T
    root_covariance = root.covariance + SHARED_ROOT_M**2 * np.eye(3)
    root_covariance += leverage @ sizes.covariance[np.ix_(seen, seen)] @ leverage.T

    sight = people.joints - own[:, None]
    sight /= np.linalg.norm(sight, axis=-1, keepdims=True)
    std = people.joint_std
    information = _build_information(sight, std * math.sqrt((1 - ALONG) / 2), std * math.sqrt(ALONG))
    poses = factors[:, None, None] * (people.joints - roots[:, None])
    pose = _average(poses, information)
    root_velocities, likeliest = people.root_velocities, int(people.posture_probability.argmax())
    own_velocities = factors[:, None, None] * (people.joint_velocity - root_velocities[:, None])
    return People(
        ids=(person_id,),
        skeleton=people.skeleton,
        is_scale_known=people.is_scale_known,
        motion=people.motion[:1],
        joints=(root.mean + pose.mean - find_roots(pose.mean))[None],
        joint_std=np.sqrt(np.trace(pose.covariance, axis1=-2, axis2=-1) + SHARED_M**2)[None],
        root_covariance=root_covariance[None],
        joint_velocity=(root.apply(factors[:, None] * root_velocities) + pose.apply(own_velocities))[None],
        joint_velocity_std=_combine_std(people.joint_velocity_std),
        root_velocity_covariance=_combine_covariances(people.root_velocity_covariance)[None],
        joint_orientation=_average_turns(people)[None],
        inferred=np.all(people.inferred, axis=0)[None],
        turn_inferred=np.all(people.turn_inferred, axis=0)[None],
        contact=np.array([_mean_of_known(feet) for feet in people.contact.T])[None],
        posture=people.posture[[likeliest]],
        posture_probability=people.posture_probability[[likeliest]],
        predicted=np.array([np.all(people.predicted)]),
        tentative=np.array([np.all(people.tentative)]),
        age=people.age.max(keepdims=True),
        unseen_for=people.unseen_for.min(keepdims=True),
    )


class _Averaged(NamedTuple):
    """A weighted mean of what S cameras say."""

    mean: Array  # (..., 3)
    shares: Array  # (S, ..., 3, 3) matrices by which each camera's value is multiplied
    covariance: Array  # (..., 3, 3)

    def apply(self, values: Array) -> Array:
        """Return the mean (..., 3) of other values (S, ..., 3) with the same shares."""
        return np.asarray((self.shares @ values[..., None])[..., 0].sum(axis=0))


def _average(values: Array, information: Array) -> _Averaged:
    """Return the mean of values (S, ..., 3) with information (S, ..., 3, 3); of three or more it is robust."""
    weighted = information
    for _ in range(ROUNDS if len(values) > 2 else 1):
        covariance = np.linalg.inv(weighted.sum(axis=0))
        shares = covariance @ weighted
        mean = (shares @ values[..., None])[..., 0].sum(axis=0)
        off = (values - mean)[..., None]
        squares = (np.swapaxes(off, -1, -2) @ information @ off)[..., 0, 0]
        weighted = information * ((FREEDOM + 3) / (FREEDOM + squares))[..., None, None]
    return _Averaged(mean, shares, covariance)


def _build_information(direction: Array, across: Array, along: Array) -> Array:
    """Return information matrices (..., 3, 3) of deviations (...) in m across and along directions (..., 3)."""
    outer = direction[..., None] * direction[..., None, :]
    across, along = across[..., None, None], along[..., None, None]
    return np.asarray((np.eye(3) - outer) / across**2 + outer / along**2)


def _average_turns(people: People) -> Array:
    """Return the mean orientations (J, 4) of S cameras; those count most in which the image shows the turn."""
    turns = people.joint_orientation
    is_known = np.isfinite(turns).all(axis=-1, keepdims=True)
    reference = turns[int(np.argmax(is_known.sum(axis=(1, 2))))]
    aligned = turns * np.where((turns * reference).sum(axis=-1, keepdims=True) < 0, -1.0, 1.0)
    weight = np.where(people.turn_inferred, INFERRED_WEIGHT, 1.0) / people.joint_std**2
    mean = np.where(is_known, aligned * weight[..., None], 0.0).sum(axis=0)
    mean = np.where(is_known.any(axis=0), mean, np.nan)
    return np.asarray(mean / np.linalg.norm(mean, axis=-1, keepdims=True))


def _combine_covariances(covariance: Array) -> Array:
    """Return the covariance (3, 3) of the mean of independent values with covariances (S, 3, 3)."""
    safe = covariance + LEAST_VARIANCE * np.eye(3)
    return np.asarray(np.linalg.inv(np.linalg.inv(safe).sum(axis=0)))


def _combine_std(std: Array) -> Array:
    """Return the deviations (1, J) of the means of independent values with deviations (S, J)."""
    return np.asarray((np.maximum(std, LEAST_STD) ** -2.0).sum(axis=0, keepdims=True) ** -0.5)


def _mean_of_known(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else math.nan
