# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of the taking over of a solution of some frames ago."""

from dataclasses import replace

import numpy as np
import pytest

from mocap_ros.config import Config, with_values
from mocap_ros.geometry.rotations import rotation_from_vector
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.tracking.take_over import is_outdated, take_over
from mocap_ros.tracking.track import Track
from tests.support.synthetic_walk import make_walk
from tests.support.tracks import CAMERA, STEP_NS, make_track, track_walk

FRAMES, NEWER, DROPPED = 20, 6, 4
CONFIG = with_values(Config(), {'solver.prior': 'pca', 'tracker.components': 10})


@pytest.fixture(scope='module')
def models(walk_model: BasePoses) -> dict[str, BasePoses]:
    return {'walk': walk_model.rescale(1.7 / walk_model.stature).truncate(10)}


@pytest.fixture(scope='module')
def now(walk_model: BasePoses) -> Track:
    tracker = track_walk({'walk': walk_model}, CONFIG, make_walk(walk_model, FRAMES)[2])
    (track,) = tracker.snapshot().tracks
    return track


@pytest.fixture(scope='module')
def then(now: Track, walk_model: BasePoses) -> Track:
    """The same track without its newest frames; its solution is that of the later track."""
    kept, solution = FRAMES - NEWER, now.solved
    states = {n: getattr(solution, n)[:kept] for n in ('theta', 'rotation', 'roots', 'bone_lengths')}
    seen = make_track(make_walk(walk_model, FRAMES)[2][:kept]).seen
    return replace(now, seen=seen, solution=replace(solution, **states))


def test_the_own_solution_comes_back(then: Track, now: Track, models: dict[str, BasePoses]) -> None:
    result = take_over(then.solved, then, now, models)
    for name in ('theta', 'rotation', 'roots', 'bone_lengths'):
        assert getattr(result, name) == pytest.approx(getattr(now.solved, name), abs=1e-6), name


def test_newer_frames_move_as_the_person_has_moved(
    then: Track, now: Track, models: dict[str, BasePoses], walk_model: BasePoses
) -> None:
    """A found solution that is turned, farther away and in another pose stays so, and moves on."""
    model, last = models['walk'], FRAMES - NEWER - 1
    turn = rotation_from_vector(np.array([0.0, 0.3, 0.0]))
    own = then.solved
    found = replace(own, theta=own.theta + 0.02, rotation=own.rotation @ turn, roots=2 * own.roots)
    shorter = replace(
        now,
        seen=make_track(make_walk(walk_model, FRAMES)[2], window_s=(FRAMES - DROPPED - 0.5) * STEP_NS / 1e9).seen,
        solution=now.solved.drop_oldest(DROPPED),
    )
    assert len(shorter.seen.stamps_ns) == FRAMES - DROPPED
    result = take_over(found, then, shorter, models)
    assert len(result.theta) == FRAMES - DROPPED
    assert (result.theta[: last + 1 - DROPPED] == found.theta[DROPPED:]).all()
    before, after = now.solved, last + 3
    turned = before.rotation[after] @ before.rotation[last].T
    assert result.rotation[after - DROPPED] == pytest.approx(turned @ found.rotation[last], abs=1e-12)
    moved = 2 * (before.roots[after] - before.roots[last])
    assert result.roots[after - DROPPED] == pytest.approx(found.roots[last] + moved, abs=1e-9)
    frames = np.array([last, after])
    change = np.subtract(*before.compute_joints(model, frames)[::-1])
    expected = found.compute_joints(model, frames[:1])[0] + change
    joints = result.compute_joints(model, np.array([after - DROPPED]))[0]
    assert np.linalg.norm(joints - expected, axis=-1).mean() < 0.25 * np.linalg.norm(change, axis=-1).mean() + 0.01


def test_what_makes_a_window_outdated(then: Track, now: Track) -> None:
    assert not is_outdated(then.seen, now.seen)
    assert is_outdated(then.seen, now.seen.change_camera(replace(CAMERA, focal=600.0), 600.0))
    for frame, is_earlier in ((FRAMES - NEWER - 1, True), (FRAMES - NEWER, False)):
        is_swapped = now.seen.swap_filter.is_swapped.copy()
        is_swapped[frame] = True
        swapped = replace(now.seen.swap_filter, is_swapped=is_swapped)
        assert is_outdated(then.seen, replace(now.seen, swap_filter=swapped)) is is_earlier
    later = tuple(s + 10 * FRAMES * STEP_NS for s in now.seen.stamps_ns)
    assert is_outdated(then.seen, replace(now.seen, stamps_ns=later)), 'no frame is left'
