# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Poses and clock offsets of cameras, found from people whom several of them see at the same time.

x = R_c x_c + t_c takes a point from the optical frame of camera c to that of the first, where R = I and t = 0.
Minimised over R_c, t_c and log k_p is

    sum_ab sum_i w_i (rho(|L_r (y_a - y_b)|^2) + W rho(|L_p (q_a - q_b)|^2) + rho((e_ab / LINE_STD_M)^2))
        + N sum_p (log k_p / SIZE_STD)^2,               y_c = k_p R_c r_c + t_c,    q_c = k_p R_c s_c

over pairs of cameras a, b and samples i of people whom both see, where rho(z) = nu log(1 + z / nu) is applied to
each coordinate, and

    r, s    m, root and joints about the root in the frame of a camera
    k_p     size factor of a person in one camera, which shows sizes and distances in proportion alone; mean log 0
    w_i     min(1, N / n) where the person is turned to a camera as in n samples of the pair (`SECTORS`): they err
            alike, so that somebody who always looks one way shows little
    L       Cholesky factors of the inverse covariances of these differences
    e       m at the person, Sampson distance of two lines of sight (Hartley and Zisserman, eq. 11.9)
    W       `POSE_WEIGHT`, small: the poses of one camera err alike in all frames, which turns the start

The start is the rotation that fits the joints about the root best (Procrustes, reweighted by rho), which is 2 to
10 degrees off, and the median translation of the roots. The scale is that of the people.

Who is who is not known. Each person of one camera is tried as each of another, at the likeliest clock offsets
(`solvers.seen_people`). Camera by camera, the hypothesis wins under which the people of the new camera agree with
those of all cameras before for the most seconds. The angle to a rival that is nearly as good is a deviation, too.

Variances are those of the last linearisation, of samples `SAMPLE_STEP_S` apart, times C - 1, for each of C cameras
is in so many pairs with the same errors. `COMMON_STD` is added: what all frames share, such as where a detector
sees joints, does not average out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import combinations, count, product
from typing import NamedTuple

import numpy as np

from mocap_ros.arrays import Array
from mocap_ros.config import TrackerConfig
from mocap_ros.errors import InputError
from mocap_ros.geometry.rotations import cross_matrix, fit_rotation, rotation_from_vector, vector_from_rotation
from mocap_ros.models.joint_std import compute_joint_covariance
from mocap_ros.people import PoseSequence
from mocap_ros.solvers.seen_people import SeenPerson, find_clock_offsets

SAMPLE_STEP_S = 0.2  # s; with twice as many samples the poses are the same to 0.1 degrees
MAX_SAMPLES = 2000  # of all pairs of cameras together, for which four cameras take some seconds
# Chosen by 60 pairs of cameras that saw training people for 5 to 20 s
POSE_WEIGHT = 0.05  # W; 0.01 lets people who stay in place upset the solution, 0.3 turns it by a degree
LINE_STD_M = 0.06  # m; detectors see joints 0.03 m elsewhere, for each camera in its own way
SIZE_STD = 0.05  # of log k, 1: by body heights and by what the poses add
FREEDOM = 4.0  # nu: at times people err by several deviations
CORRELATED_SAMPLES = 10.0  # N, 2 s
SECTORS = 8  # of headings, 45 degrees wide; poses of one heading err alike
START_ROUNDS = 6  # reweightings of the start
# m; median differences, by a start, beyond which two people are not one
ROOT_TOLERANCE_M, POSE_TOLERANCE_M = 1.0, 0.25
# 1, share of the weighted seconds of the best hypothesis with which another one might be right, as the cycles of a
# walk in a circle look alike; and rad, by which it then turns the camera: other starts differ by less
RIVAL_SHARE, MIN_DOUBT = 0.8, 0.35
CLOCK_SCALE_S = 10.0  # s; of offsets that fit alike, as the cycles of a walk do, the smaller is likelier
# rad of rotations, and share of the distance of translations, with which as many errors of training people are
# within a deviation after 20 s as after 5 s
COMMON_STD = 0.01
MIN_BASELINE_M = 1e-6  # m; guards the direction between two cameras in one place
MIN_SLOPE = 1e-9  # 1/m; guards the distance at an epipole
TOLERANCE = 1e-5  # 1; relative change of parameters or cost at which the solution ends, far below the deviations


class FoundCameras(NamedTuple):
    """Where C cameras are, and how their clocks differ.

    Attributes:
        poses: (C, 4, 4) m, transforms from each camera's optical frame to that of the first, so the first is the
            identity. Translations are in the unit of the people: their body heights are those of the trackers.
        rotation_std: (C,) rad, standard deviation of each rotation: root mean square of the angle of its error.
        translation_std: (C,) m, likewise of the length of the error of each translation, but for the common scale.
        clock_offsets: (C,) s, to be added to the times of each camera to have those of the first.
        seconds: (C,) s, for which another camera sees the same person; those of several people add up.
    """

    poses: Array
    rotation_std: Array
    translation_std: Array
    clock_offsets: Array
    seconds: Array


class _Pair(NamedTuple):
    """Samples of people whom two cameras, by their numbers, see at the same time."""

    cameras: tuple[int, int]
    people: tuple[SeenPerson, SeenPerson]


class _Hypothesis(NamedTuple):
    """Where a camera may be: transform (4, 4) to the frame of another, and clock offset in s; and how likely."""

    weight: float  # correlation of speeds, or seconds of people who agree times that
    camera: int
    pose: Array
    offset: float


def find_camera_poses(
    views: Sequence[Sequence[PoseSequence]], config: TrackerConfig | None = None
) -> FoundCameras:
    """Find the poses of two cameras or more.

    Args:
        views: of each camera, the people whom its tracker found. Their ids need not be the same. Times are those
            of each camera's clock; keypoints are used where a person has them.
        config: `min_score` and `undo_swaps` apply to the keypoints.

    Raises:
        InputError: no person of a camera is seen by another one at the same time.
    """
    config, numbers = config or TrackerConfig(), count()
    seen = [[SeenPerson.of(person, next(numbers), config) for person in people] for people in views]
    start, offsets, doubts = _find_start(seen)
    pairs = list(_list_pairs(seen, start, offsets))
    step = slice(None, None, math.ceil(sum(len(pair.people[0].times) for pair in pairs) / MAX_SAMPLES))
    thinned = [_Pair(cameras, (a.select(step), b.select(step))) for cameras, (a, b) in pairs]
    poses, rotation_std, translation_std = _refine(thinned, start, sum(map(len, seen)))
    lengths = [(pair.cameras, len(pair.people[0].times) * SAMPLE_STEP_S) for pair in pairs]
    seconds = [max((s for cameras, s in lengths if c in cameras), default=0.0) for c in range(len(views))]
    rotation_std = np.hypot(rotation_std, doubts)
    return FoundCameras(poses, rotation_std, translation_std, offsets, np.array(seconds))


def _sample(first: SeenPerson, other: SeenPerson, offset: float) -> tuple[SeenPerson, SeenPerson]:
    """Return two people at the times at which both are known; in the clocks of their cameras."""
    begin, end = max(first.times[0], other.times[0] + offset), min(first.times[-1], other.times[-1] + offset)
    times = np.arange(begin, end, SAMPLE_STEP_S)
    pair = first.at(times), other.at(times - offset)
    both = np.asarray(np.isfinite(pair[0].joints + pair[1].joints).all(axis=(1, 2)))
    return pair[0].select(both), pair[1].select(both)


def _fit_start(first: SeenPerson, other: SeenPerson) -> Array:
    """Return the transform (4, 4) from the second camera to the first by which two people fit best."""
    p, q = (person.about_root.reshape(-1, 3) for person in (first, other))
    precision = 1 / (first.std**2 + other.std**2).reshape(-1, 1)
    weight, pose = precision, np.eye(4)
    for _ in range(START_ROUNDS):
        pose[:3, :3] = fit_rotation(q * weight, p)
        error = ((p - q @ pose[:3, :3].T) ** 2).sum(axis=1, keepdims=True)
        weight = precision / (1 + error * precision / FREEDOM)
    pose[:3, 3] = np.median(first.roots - other.roots @ pose[:3, :3].T, axis=0)
    return pose


def _match(
    first: Sequence[SeenPerson], other: Sequence[SeenPerson], pose: Array, offset: float
) -> tuple[float, list[tuple[SeenPerson, SeenPerson]]]:
    """Return the seconds for which people of two cameras agree, and the samples of those who are one person.

    A person who is lost and found again may be several people in turn.
    """
    found = []
    for p in first:
        for q in other:
            samples = a, b = _sample(p, q, offset)
            if not len(a.times):
                continue
            root = np.median(np.linalg.norm(a.roots - b.roots @ pose[:3, :3].T - pose[:3, 3], axis=-1))
            about = np.median(np.linalg.norm(a.about_root - b.about_root @ pose[:3, :3].T, axis=-1))
            share = 1 - (root / ROOT_TOLERANCE_M) ** 2 - (about / POSE_TOLERANCE_M) ** 2
            if share > 0:
                found.append((float(share) * len(a.times) * SAMPLE_STEP_S, p, q, samples))
    total, chosen = 0.0, list[tuple[SeenPerson, SeenPerson, tuple[SeenPerson, SeenPerson]]]()
    for gain, p, q, samples in sorted(found, key=lambda match: -match[0]):
        rivals = [s[0].times for p2, q2, s in chosen if (p2 is p) != (q2 is q)]
        times = samples[0].times
        if all(t[-1] < times[0] or times[-1] < t[0] for t in rivals):
            chosen.append((p, q, samples))
            total += gain
    return total, [samples for *_, samples in chosen]


def _list_hypotheses(
    camera: int, first: Sequence[SeenPerson], other: Sequence[SeenPerson]
) -> Iterator[_Hypothesis]:
    """Yield where the second camera, of this number, may be in the frame of the first."""
    for p, q in product(first, other):
        for offset, correlation in find_clock_offsets(p, q):
            samples = _sample(p, q, offset)
            if len(samples[0].times):
                yield _Hypothesis(correlation, camera, _fit_start(*samples), offset)


def _find_start(seen: Sequence[Sequence[SeenPerson]]) -> tuple[Array, Array, Array]:
    """Return poses (C, 4, 4), clock offsets (C,) s, and angles (C,) in rad to rivals that fit nearly as well."""
    poses, offsets, doubts = np.tile(np.eye(4), (len(seen), 1, 1)), np.zeros(len(seen)), np.zeros(len(seen))
    known = [0]
    while missing := [c for c in range(len(seen)) if c not in known]:
        starts = []
        for a, new in product(known, missing):
            for weight, _, link, lag in _list_hypotheses(new, seen[a], seen[new]):
                pose, offset = poses[a] @ link, offsets[a] + lag
                relative = [(c, np.linalg.inv(poses[c]) @ pose, offset - offsets[c]) for c in known]
                seconds = sum(_match(seen[c], seen[new], between, own_lag)[0] for c, between, own_lag in relative)
                gain = seconds * weight / (1 + abs(offset) / CLOCK_SCALE_S)
                starts.append(_Hypothesis(gain, new, pose, offset))
        best = max(starts, key=lambda start: start.weight, default=None)
        if best is None or not best.weight > 0:
            raise InputError(f'camera {missing[0] + 1} sees nobody whom another camera sees at the same time')
        rivals = [s.pose for s in starts if s.camera == best.camera and s.weight > RIVAL_SHARE * best.weight]
        turns = vector_from_rotation(best.pose[:3, :3].T @ np.array(rivals)[:, :3, :3])
        angle = float(np.linalg.norm(turns, axis=1).max())
        poses[best.camera], offsets[best.camera] = best.pose, best.offset
        doubts[best.camera] = angle if angle > MIN_DOUBT else 0.0
        known.append(best.camera)
    return poses, offsets, doubts


def _list_pairs(seen: Sequence[Sequence[SeenPerson]], poses: Array, offsets: Array) -> Iterator[_Pair]:
    for a, b in combinations(range(len(seen)), 2):
        pose, offset = np.linalg.inv(poses[a]) @ poses[b], float(offsets[b] - offsets[a])
        _, matches = _match(seen[a], seen[b], pose, offset)
        if matches:
            first, other = (
                SeenPerson(*(np.concatenate(columns) for columns in zip(*people, strict=True)))
                for people in zip(*matches, strict=True)
            )
            yield _Pair((a, b), (first, other))


def _whiten(pair: _Pair, poses: Array) -> tuple[Array, Array]:
    """Return L_r (N, 3, 3) and L_p (N, 15, 3, 3) of a pair of cameras with these poses, in 1/m."""
    root, joints = np.zeros((3, 3)), np.zeros((3, 3))
    for camera, person in zip(pair.cameras, pair.people, strict=True):
        rotation = poses[camera, :3, :3]
        root = root + rotation @ person.root_covariance @ rotation.T
        joints = joints + rotation @ compute_joint_covariance(person.std, person.joints) @ rotation.T
    root, joints = (np.linalg.cholesky(np.linalg.inv(covariance)) for covariance in (root, joints))
    return np.swapaxes(root, -1, -2), np.swapaxes(joints, -1, -2)


def _compare(pair: _Pair, whitening: tuple[Array, Array], poses: Array, sizes: Array) -> Array:
    """Return the differences of the module's formula: those of roots (3 N), poses (45 N) and lines (15 N)."""
    root, about = np.zeros(3), np.zeros(3)
    for camera, person, sign in zip(pair.cameras, pair.people, (1, -1), strict=True):
        turned, size = poses[camera, :3, :3].T, sign * sizes[person.number.astype(int), None]
        root = root + size * (person.roots @ turned) + sign * poses[camera, :3, 3]
        about = about + size[..., None] * (person.about_root @ turned)
    parts = [(factor @ d[..., None]).ravel() for factor, d in zip(whitening, (root, about), strict=True)]
    between = np.linalg.inv(poses[pair.cameras[0]]) @ poses[pair.cameras[1]]
    return np.concatenate([*parts, find_line_distances(*pair.people, between).ravel() / LINE_STD_M])


def find_line_distances(first: SeenPerson, other: SeenPerson, pose: Array) -> Array:
    """Return the Sampson distances (N, 15) m at the person of lines of sight; 0 where one is not known.

    `pose` (4, 4) is the transform from the second camera to the first.
    """
    p, q = (np.concatenate([s.rays, np.ones((*s.rays.shape[:-1], 1))], axis=-1) for s in (first, other))
    essential = cross_matrix(pose[:3, 3] / max(float(np.linalg.norm(pose[:3, 3])), MIN_BASELINE_M)) @ pose[:3, :3]
    line_p, line_q = q @ essential.T, p @ essential  # epipolar lines in the image of the first and of the second
    slope = [
        np.linalg.norm(line[..., :2], axis=-1) / s.joints[..., 2] for line, s in ((line_p, first), (line_q, other))
    ]
    return np.nan_to_num((p * line_p).sum(axis=-1) / np.maximum(np.hypot(*slope), MIN_SLOPE))


def _weigh_samples(person: SeenPerson) -> Array:
    """Return the weights w (N,)."""
    sector = np.floor(person.headings / (2 * math.pi / SECTORS)).astype(int) % SECTORS
    return np.minimum(1.0, CORRELATED_SAMPLES / np.bincount(sector, minlength=SECTORS)[sector])


def _refine(pairs: Sequence[_Pair], start: Array, people: int) -> tuple[Array, Array, Array]:
    """Return poses (C, 4, 4), and the deviations (C,) of their rotations in rad and of their translations in m."""
    from scipy.optimize import least_squares  # which takes time to load

    others = len(start) - 1
    whitening = [_whiten(pair, start) for pair in pairs]

    def unpack(x: Array) -> tuple[Array, Array]:
        poses = start.copy()
        turns, poses[1:, :3, 3] = x[: 6 * others].reshape(2, others, 3)
        poses[1:, :3, :3] = rotation_from_vector(turns) @ start[1:, :3, :3]
        return poses, np.exp(x[6 * others :] - x[6 * others :].mean())

    def find_residuals(x: Array) -> Array:
        found = [_compare(pair, own, *unpack(x)) for pair, own in zip(pairs, whitening, strict=True)]
        return np.concatenate([math.sqrt(CORRELATED_SAMPLES) / SIZE_STD * x[6 * others :], *found])

    weights = [np.ones(people)]
    for pair in pairs:
        own = _weigh_samples(pair.people[0])
        weights += [np.repeat(own, 3), np.repeat(POSE_WEIGHT * own, 45), np.repeat(own, 15)]
    weight = np.concatenate(weights)

    def rho(z: Array) -> Array:
        shrunk = 1 / (1 + z / FREEDOM)
        return weight * np.stack([FREEDOM * np.log1p(z / FREEDOM), shrunk, -(shrunk**2) / FREEDOM])

    x0 = np.concatenate([np.zeros(3 * others), start[1:, :3, 3].ravel(), np.zeros(people)])
    solution = least_squares(find_residuals, x0, loss=rho, x_scale='jac', xtol=TOLERANCE, ftol=TOLERANCE)
    covariance = others * np.linalg.inv(solution.jac.T @ solution.jac)
    variance = np.diag(covariance)[: 6 * others].reshape(2, others, 3).sum(axis=2)
    poses, _ = unpack(solution.x)
    distance = np.linalg.norm(poses[1:, :3, 3], axis=1)
    shared = COMMON_STD * np.stack([np.ones(others), distance])
    std = np.concatenate([np.zeros((2, 1)), np.sqrt(variance + shared**2)], axis=1)
    return poses, std[0], std[1]
