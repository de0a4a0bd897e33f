# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""People whom several cameras see: who is who, sizes against a general optimiser, poses, roots and deviations."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import chi2

from mocap_ros.arrays import Array
from mocap_ros.people import People
from mocap_ros.skeleton import CMU15, find_roots
from mocap_ros.solvers import merging
from mocap_ros.solvers.merging import CameraView, PeopleMerger
from tests.support.several_cameras import CENTRES, FPS, SIZE_STD, make_truth, see


def merge_all(
    cameras: Sequence[Sequence[People]], merger: PeopleMerger | None = None
) -> list[merging.MergedPeople]:
    merger = merger or PeopleMerger(is_recording=True)
    return [
        merger.merge(frame / FPS, [CameraView(p, c) for p, c in zip(people, CENTRES, strict=False)])
        for frame, people in enumerate(zip(*cameras, strict=True))
    ]


@pytest.mark.parametrize('count', [2, 3, 4])
def test_merged_people_are_where_the_lines_of_sight_meet(count: int) -> None:
    rng, truth = np.random.default_rng(0), make_truth(150)
    sizes = [1.06, 0.97, 1.02, 0.95][:count]
    cameras = [see(truth, c, k, rng) for c, k in zip(CENTRES, sizes, strict=False)]
    found = [merged.people for merged in merge_all(cameras)]
    assert {people.ids for people in found} == {('1',)}
    joints = np.array([people.joints[0] for people in found])
    error, single = (
        np.linalg.norm(j - truth, axis=-1)[60:].mean() for j in (joints, [p.joints[0] for p in cameras[0]])
    )
    assert error < 0.05 < 0.2 < single
    off = find_roots(joints - truth)[60:]
    covariance = np.array([people.root_covariance[0] for people in found])[60:]
    squares = (off * np.linalg.solve(covariance, off[..., None])[..., 0]).sum(axis=-1)
    assert (squares < chi2.ppf(0.95, 3)).mean() > 0.9
    pose = (joints - find_roots(joints)[:, None] - truth + find_roots(truth)[:, None])[60:]
    std = np.array([people.joint_std[0] for people in found])[60:]
    assert ((pose**2).sum(axis=-1) < chi2.ppf(0.95, 3) * std**2 / 3).mean() > 0.9


def test_sizes_are_those_of_a_general_optimiser() -> None:
    rng, truth = np.random.default_rng(1), make_truth(20)
    cameras = [see(truth, c, k, rng) for c, k in zip(CENTRES[:3], [1.05, 0.98, 1.0], strict=True)]
    roots = np.array([[people.roots[0] for people in seen] for seen in cameras])
    merger = PeopleMerger(is_recording=True)
    merge_all(cameras, merger)
    reach = roots - CENTRES[:3, None]
    distance = np.linalg.norm(reach, axis=-1)
    sight = reach / distance[..., None]
    covariance = np.array([[people.root_covariance[0] for people in seen] for seen in cameras])
    along = np.sqrt(np.einsum('cfi,cfij,cfj->cf', sight, covariance, sight))
    across = np.maximum(np.sqrt(np.linalg.eigvalsh(covariance)[..., 0]), merging.LEAST_ACROSS_M)
    prior = np.linalg.cholesky(np.linalg.inv(SIZE_STD**2 * (0.85 + 0.15 * np.eye(3)))).T
    share = math.sqrt(1 / FPS / merging.CORRELATION_S)

    def cost(x: Array) -> Array:
        k, true_roots = x[:3], x[3:].reshape(-1, 3)
        off = true_roots - CENTRES[:3, None] - k[:, None, None] * reach
        deep = (off * sight).sum(axis=-1)
        parts = (off - deep[..., None] * sight) / across[..., None], deep / np.minimum(0.03 * distance, along)
        return np.concatenate([*(share * np.asarray(p)[:, 1:].ravel() for p in parts), prior @ (k - 1)])

    found = least_squares(cost, np.append(np.ones(3), roots.mean(axis=0).ravel()), xtol=1e-12, ftol=1e-12)
    (sizes,) = merger._sizes.values()
    np.testing.assert_allclose(sizes.factors, found.x[:3], atol=2e-4)


def test_a_joint_that_one_of_three_cameras_takes_for_another_hardly_moves() -> None:
    rng, truth = np.random.default_rng(2), make_truth(30)
    cameras = [see(truth, c, 1.0, rng) for c in CENTRES[:3]]
    sound = merge_all(cameras)[-1].people
    cameras[1][-1].joints[0, CMU15.index('lwrist')] += [0.0, 0.5, 0.0]
    spoilt = merge_all(cameras)[-1].people
    assert np.linalg.norm(sound.joints - spoilt.joints, axis=-1).max() < 0.06


def test_numbers_stay_when_people_pass_and_cameras_and_ids_come_and_go() -> None:
    rng, frames = np.random.default_rng(3), 240
    motions = [make_truth(frames, (x, 0, 4.0), phase) for x, phase in ((-0.6, math.pi), (0.6, 0.0))]
    cameras: list[list[People]] = []
    for number, centre in enumerate(CENTRES[:3]):
        both = [
            see(truth, centre, 1.03, rng, f'{number}{name}') for truth, name in zip(motions, 'ab', strict=True)
        ]
        cameras.append([People.concatenate(pair) for pair in zip(*both, strict=True)])
    cameras[0][60:120] = [People.none()] * 60  # a camera is lost for 2 s
    for frame in range(150, frames):  # a tracker restarts
        cameras[1][frame] = replace(cameras[1][frame], ids=('new', 'newer'))
    merged = merge_all(cameras)
    assert {m.people.ids for m in merged} == {('1', '2')}
    tracks = [{track[-1] for track in shown.values()} for m in merged[:150] for shown in m.tracks]
    assert all(len(names) == 1 for names in tracks)
    for person, truth in enumerate(motions):
        off = np.array([m.people.roots[person] for m in merged]) - find_roots(truth)
        assert np.linalg.norm(off, axis=-1).max() < 0.25


def test_who_is_seen_by_one_camera_passes_through() -> None:
    rng, truth = np.random.default_rng(4), make_truth(10)
    seen = see(truth, CENTRES[0], 1.0, rng)
    merged = merge_all([seen, [People.none()] * 10])[-1].people
    np.testing.assert_allclose(merged.joints, seen[-1].joints)
    assert (np.linalg.eigvalsh(merged.root_covariance[0] - seen[-1].root_covariance[0]) > 0).all()


def test_a_person_who_is_away_for_long_is_the_same_in_a_recording_and_a_tracker_may_exchange_ids() -> None:
    rng, frames = np.random.default_rng(5), 90
    motions = [make_truth(frames, (x, 0, 4.0)) for x in (-1.2, 1.2)]
    cameras = []
    for number, centre in enumerate(CENTRES[:2]):
        both = [see(truth, centre, 1.0, rng, name) for truth, name in zip(motions, 'ab', strict=True)]
        cameras.append([People.concatenate(pair) for pair in zip(*both, strict=True)])
        for frame in range(45, frames):
            if number:
                cameras[1][frame] = replace(cameras[1][frame], ids=('b', 'a'))
    merger = PeopleMerger(is_recording=True)
    for frame in range(frames):
        time_s = frame / FPS + (8.0 if frame >= 60 else 0.0)
        views = [CameraView(seen[frame], centre) for seen, centre in zip(cameras, CENTRES, strict=False)]
        people = merger.merge(time_s, views).people
        assert people.ids == ('1', '2')
        for root, truth in zip(people.roots, motions, strict=True):
            assert np.linalg.norm(root - find_roots(truth[frame])) < 0.35
