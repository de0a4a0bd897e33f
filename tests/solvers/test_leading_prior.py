# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Which prior leads: base poses of the very person do, those of another motion or of all motions do not."""

from dataclasses import replace

import numpy as np
import pytest

from mocap_ros.config import Config, SolverConfig
from mocap_ros.demo.motions import load_motions
from mocap_ros.evaluation.metrics import scale_to_reference
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.rotations import centre_poses, rotation_from_vector
from mocap_ros.keypoints.person import Person2D
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.offline import whole_sequence
from mocap_ros.offline.whole_sequence import reconstruct_sequence
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.leading_prior import (
    MAX_NOISE,
    MAX_NOISE_RATIO,
    NEGLIGIBLE_NOISE,
    explains_as_well,
)
from mocap_ros.solvers.window import Array
from mocap_ros.tracking.tracker import Tracker
from mocap_ros.training.fit_base_poses import fit_base_poses
from tests.support.synthetic_walk import BODY_TO_OPTICAL

FRAMES = 30
TIMES = np.arange(FRAMES) / 30
UNKNOWN = Intrinsics(20_000.0, (320.0, 240.0), is_focal_known=False)  # the scenes are orthographic
STEP_NS = 33_333_333  # ns, 30 frames/s


def make_motion(name: str, times: Array = TIMES) -> tuple[Array, BasePoses, Array]:
    """Return poses (F, 15, 3) m of a motion of the demo in the camera's axes, its base poses and keypoints."""
    model, motions = load_motions()
    base_poses = fit_base_poses(
        [model.poses(motions[name].sample(TIMES)[:, :-2])], name='own', alignment='heading'
    )
    poses = model.poses(motions[name].sample(times)[:, :-2])
    truth = poses @ (BODY_TO_OPTICAL @ rotation_from_vector(np.array([0.0, 0.0, 0.8]))).T
    keypoints = np.concatenate([200 * truth[..., :2] + [320, 240], np.ones((*poses.shape[:2], 1))], axis=-1)
    return centre_poses(truth), base_poses, keypoints


def reconstruct(keypoints: Array, base_poses: BasePoses, prior: str = 'learned') -> Array:
    config = Config(solver=SolverConfig(prior=prior))
    found = reconstruct_sequence(keypoints, CMU15.joints, TIMES, UNKNOWN, base_poses, config)
    return centre_poses(found.core)


@pytest.mark.parametrize('lifter_noise', [0.0, 0.001, 0.01, 0.02, 2 * MAX_NOISE])
def test_a_little_more_noise_is_allowed_but_not_any(lifter_noise: float) -> None:
    total = MAX_NOISE_RATIO * np.hypot(lifter_noise, NEGLIGIBLE_NOISE)
    limit = min(np.sqrt(total**2 - NEGLIGIBLE_NOISE**2), MAX_NOISE)
    assert explains_as_well(0.999 * limit, lifter_noise)
    assert not explains_as_well(1.001 * limit, lifter_noise)
    assert explains_as_well(1.001 * limit, lifter_noise, slack=1.1)


def test_base_poses_of_the_very_person_lead(monkeypatch: pytest.MonkeyPatch) -> None:
    truth, base_poses, keypoints = make_motion('run')

    def error_mm(joints: Array) -> float:
        return float(np.linalg.norm(scale_to_reference(joints, truth) - truth, axis=-1).mean() * 1e3)

    own, alone = (error_mm(reconstruct(keypoints, base_poses, prior)) for prior in ('learned', 'pca'))
    of_all = reconstruct(keypoints, replace(base_poses, name='all'))
    monkeypatch.setattr(whole_sequence, 'explains_as_well', lambda *_: False)
    lifter_leads = reconstruct(keypoints, base_poses)
    assert own < 1.1 * alone
    assert own < 0.6 * error_mm(lifter_leads)
    np.testing.assert_array_equal(of_all, lifter_leads, 'base poses of that name are those of all motions')


def test_live_the_lead_is_taken_and_given_back() -> None:
    """Base poses of a run lead soon after the run has begun, and no longer when a walk has taken its place."""
    times = np.arange(2 * FRAMES) / 30
    _, base_poses, run = make_motion('run', times)
    _, _, walk = make_motion('walk', times)
    trackers = [Tracker(m, Config()) for m in (base_poses, replace(base_poses, name='all'))]
    leads: list[list[bool]] = [[], []]
    for frame, keypoints in enumerate([*run, *walk]):
        for tracker, lead in zip(trackers, leads, strict=True):
            person = Person2D('', CMU15.joints, keypoints[:, :2], keypoints[:, 2])
            tracker.update(frame * STEP_NS, [person], UNKNOWN)
            tracker.run_deferred_work()
            (track,) = tracker.tracks
            lead.append(track.solved.base_poses_lead)
    own, of_all = leads
    assert not own[0], 'a first solution needs the lifter, for a frame does not tell front from back'
    assert all(own[45 : 2 * FRAMES])
    assert not any(own[3 * FRAMES + 15 :])
    assert not any(of_all)
