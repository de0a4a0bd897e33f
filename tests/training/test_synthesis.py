# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Training examples: offsets of a detector are fixed to the trunk, and the target knows nothing of them."""

from __future__ import annotations

import numpy as np
import pytest

from mocap_ros.models.base_poses import BasePoses
from mocap_ros.skeleton import BODY26, CORE_COUNT
from mocap_ros.training import synthesis
from mocap_ros.training.motion_library import MotionLibrary, balance_trials
from mocap_ros.training.synthesis import ExampleSynthesiser

EXAMPLES = 64


@pytest.fixture(scope='module')
def library(walk_model: BasePoses) -> MotionLibrary:
    theta = 0.2 * np.sin(np.linspace(0, 9, 90))[:, None] * walk_model.std[:6]
    still = np.repeat(walk_model.mean[None], 40, axis=0)
    return MotionLibrary.from_trials([walk_model.poses(theta), still], np.array([0.75, 0.25]))


def test_trials_are_drawn_by_their_shares(library: MotionLibrary) -> None:
    probability = np.diff(library.cumulative_probability, prepend=0)
    is_still = np.isin(library.first_frame, library.first_frame[len(library.first_frame) - 1 :])
    moving = np.abs(library.bone_vectors - library.bone_vectors[-1]).max(axis=(1, 2)) > 1e-6
    assert probability[~moving].sum() == pytest.approx(0.25, abs=0.02)
    assert not moving[is_still].any()


def test_offsets_are_fixed_to_the_trunk_and_alike_on_both_sides(library: MotionLibrary) -> None:
    synthesiser = ExampleSynthesiser(library, seed=0)
    vectors, _, _ = synthesiser._draw_motion(EXAMPLES)
    points = synthesiser.joints_from_bones @ vectors
    offsets = synthesiser._draw_offsets(points)
    trunks = synthesis._find_trunks(points)
    assert np.abs(np.swapaxes(trunks, -1, -2) @ trunks - np.eye(3)).max() < 1e-5
    local = offsets @ trunks
    assert np.abs(local - local[:, :1]).max() < 1e-5
    left, right = (list(side) for side in zip(*BODY26.left_right_pairs, strict=True))
    assert local[:, 0, left] == pytest.approx(local[:, 0, right] * [1, -1, 1], abs=1e-5)
    assert 0.01 < local[:, 0, BODY26.index('lknee')].std() < 0.04, 'm'


def test_trials_without_extremities_have_no_targets_for_them(walk_model: BasePoses) -> None:
    core = walk_model.poses(walk_model.std[:1] * np.sin(np.linspace(0, 9, 90))[:, None])
    body = np.concatenate([core, np.repeat(core[:, [11]], len(BODY26.joints) - CORE_COUNT, axis=1)], axis=1)
    motions = MotionLibrary.from_trials([core, body + 0.1], np.array([0.5, 0.5]))
    batch = ExampleSynthesiser(motions, seed=2).make_batch(EXAMPLES)
    of_body = batch.is_known[:, CORE_COUNT:]
    assert batch.is_known[:, :CORE_COUNT].all()
    assert (of_body.all(axis=1) | ~of_body.any(axis=1)).all()
    assert 0.3 < of_body.mean() < 0.7
    scores = batch.features[:, :-4].reshape(EXAMPLES, -1, len(BODY26.joints), 3)[..., 2]
    assert not scores[:, :, CORE_COUNT:][~of_body.all(axis=1)].any()
    assert scores[:, :, CORE_COUNT:][of_body.all(axis=1)].any()


def test_the_target_is_the_true_pose(library: MotionLibrary, monkeypatch: pytest.MonkeyPatch) -> None:
    batches = []
    for factor in (1e-6, 3.0):
        monkeypatch.setattr(synthesis, 'OFFSET_SIZE_RANGE', (factor, factor))
        batches.append(ExampleSynthesiser(library, seed=1).make_batch(EXAMPLES))
    small, large = batches
    assert large.target * large.size[:, None, None] == pytest.approx(
        small.target * small.size[:, None, None], abs=1e-5
    )
    assert np.abs(large.newest - small.newest).max() > 0.01


def test_shares_follow_the_formula() -> None:
    shares = balance_trials(['golf', 'golf', 'golf', 'dance'], ['a', 'a', 'b', 'a'], [100, 300, 900, 2500])
    expected = np.array([20 / 4, 20 * 3 / 4, 30, 50])
    assert shares == pytest.approx(expected / expected.sum())
