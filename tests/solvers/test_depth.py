# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Measured depths: the likeliest distance, which depths are a joint's own, and what they change of poses."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from mocap_ros.config import Config
from mocap_ros.demo.scene import make_recording
from mocap_ros.engine import depth as engine
from mocap_ros.findings import Fault
from mocap_ros.keypoints.keypoint_sequence import GroundTruth, KeypointSequence
from mocap_ros.models.lifter import LiftedPoses
from mocap_ros.models.model_file import load_base_pose_models
from mocap_ros.skeleton import BODY26, CMU15, find_roots
from mocap_ros.solvers.depth import EXPECTED_SHARE, SEGMENTS, THICKNESS, compare_depths, find_corrections
from mocap_ros.tracking.tracker import PeopleTracker
from mocap_ros.verdict.input_faults import DepthCheck
from tests.support.bodies import STANDING
from tests.support.whole_sequence import reconstruct_sequence

DISTANCE_M, HEIGHT_M = 3.0, 1.7
AXES = np.array([[0.0, 0.0, 1.0]])
HIDDEN, VISIBLE, OTHER_M, NOISE_M, STEREO = 0.01, 0.5, 0.7, 0.04, 0.00125
WRIST, ELBOW, KNEES = CMU15.index('lwrist'), CMU15.index('lelbow'), [CMU15.index('lknee'), CMU15.index('rknee')]
BODY = STANDING - STANDING.mean(axis=0)
SURFACE = (BODY[:, 2] + DISTANCE_M - THICKNESS[:, 0])[None]
SURFACE[0, [CMU15.index(joint) for joint in ('head', 'neck', 'pelvis')]] = np.nan


def measure(surface: np.ndarray, std: np.ndarray, expected: float) -> tuple[float, np.ndarray]:
    found = engine.measure_depths(
        surface,
        np.zeros((1, 15, 2)),
        AXES,
        BODY[None] / DISTANCE_M,
        std,
        np.array([expected]),
        EXPECTED_SHARE,
        THICKNESS[None, :, 0].copy(),
        *SEGMENTS,
    )
    return float(found[0][0]), found[3][0]


@pytest.mark.parametrize('seed', range(4))
def test_the_distance_is_the_likeliest(seed: int) -> None:
    rng = np.random.default_rng(seed)
    std = rng.uniform(0.01, 0.04, (1, 15))
    surface = SURFACE + rng.normal(0, 0.03, (1, 15))
    surface[0, rng.integers(15, size=4)] += rng.choice([-0.5, 0.4, 1.5], 4)
    expected = DISTANCE_M * rng.uniform(0.9, 1.1)
    distance, trust = measure(surface, std, expected)
    z = (surface + THICKNESS[:, 0])[0]
    known = np.isfinite(z)
    z, deep, s = z[known], 1 + BODY[known, 2] / DISTANCE_M, std[0, known]
    spread = np.sqrt((s * expected) ** 2 + NOISE_M**2 + (STEREO * z**2) ** 2)
    grid = np.linspace(0.7 * DISTANCE_M, 1.4 * DISTANCE_M, 20_001)[:, None]
    own = VISIBLE * np.exp(-(((z - grid * deep) / spread) ** 2) / 2) / (spread * math.sqrt(2 * math.pi))
    other = (1 - VISIBLE) / OTHER_M
    total = np.log(own + other).sum(axis=1) - np.log1p(((grid[:, 0] / expected - 1) / EXPECTED_SHARE) ** 2)
    best = int(total.argmax())
    assert distance == pytest.approx(float(grid[best, 0]), abs=0.01)
    np.testing.assert_allclose(trust[known], own[best] / (own[best] + other), atol=0.05)


def correct(surface: np.ndarray, joints: np.ndarray, std_m: float) -> np.ndarray:
    """Return the corrected depths (15,) m of a standing body whose lifted joints (15, 3) m are wrong."""
    body = np.zeros((1, 26, 3))
    body[0, :15] = joints / DISTANCE_M
    lifted = LiftedPoses(body, np.full((1, 26, 3), std_m / DISTANCE_M))
    found = find_corrections(surface, np.zeros((1, 15, 2)), np.eye(3)[None], lifted, HEIGHT_M).apply(lifted)
    moved = found.joints[0, :, 2] * DISTANCE_M
    assert moved[BODY26.index('lhand')] == pytest.approx(moved[WRIST] - body[0, WRIST, 2] * DISTANCE_M)
    return np.asarray(moved[:15] - moved[:15].mean())


def test_a_wrong_depth_is_corrected_and_an_occluder_is_not_followed() -> None:
    wrong = BODY.copy()
    wrong[[WRIST, ELBOW], 2] += [0.2, 0.1]
    wrong -= wrong.mean(axis=0)
    found = correct(SURFACE, wrong, std_m=0.12)
    assert abs(found[WRIST] - BODY[WRIST, 2]) < 0.05
    behind_table = SURFACE.copy()
    behind_table[0, [*KNEES, CMU15.index('lankle'), CMU15.index('rankle')]] -= 0.6
    found = correct(behind_table, BODY, std_m=0.06)
    np.testing.assert_allclose(found, BODY[:, 2], atol=0.03)


def test_a_joint_behind_the_body_is_not_where_the_body_is() -> None:
    folded = BODY.copy()
    folded[WRIST] = BODY[CMU15.index('neck')] + [0.0, 0.2, 0.3]  # an arm behind the back
    surface = SURFACE.copy()
    surface[0, WRIST] = DISTANCE_M + BODY[CMU15.index('neck'), 2] - 0.12
    shown = correct(surface, folded, std_m=0.1)
    assert abs(shown[WRIST] - (folded - folded.mean(axis=0))[WRIST, 2]) < 0.03


def test_a_child_is_known_by_the_depths() -> None:
    core = np.repeat((BODY + [0.0, 0.0, DISTANCE_M])[None], 2, axis=0)
    surface = np.repeat(0.6 * (SURFACE + THICKNESS[:, 0]) - THICKNESS[:, 0], 2, axis=0)
    surface[1] = np.nan
    found = compare_depths(surface, core, np.ones(2))
    assert math.exp(found.log_size[0]) == pytest.approx(0.6, abs=0.02)
    assert np.isnan(found.log_size[1])
    assert (found.find_displacement(core, np.ones(2))[1] == 0).all()


def measure_root_error(sequence: KeypointSequence, way: str) -> float:
    """Return the median error of the root's depth as a share of it."""
    models, config = load_base_pose_models('auto'), Config()
    assert sequence.truth is not None
    truth = find_roots(sequence.truth.joints)
    if way == 'whole':
        found = find_roots(reconstruct_sequence(sequence, models, config).joints)
    else:
        tracker, camera = PeopleTracker(models, config), sequence.intrinsics(0.75)
        tracked = [
            tracker.update(stamp_ns, [sequence.person(frame, 'p')], camera).people
            for frame, stamp_ns in enumerate(sequence.stamps_ns)
        ]
        found = np.array([find_roots(people.joints)[0] for people in tracked])
    return float(np.median(np.abs(found[15:, 2] / truth[15:, 2] - 1)))


def make_sequence(*, is_calibrated: bool) -> KeypointSequence:
    """Return two seconds of the demo with depths of the surfaces at its keypoints."""
    whole = make_recording().sequence(is_calibrated=is_calibrated)
    assert whole.truth is not None
    truth = whole.truth.joints[:60]
    depth = np.full((60, len(whole.joint_names)), np.nan)
    for j, joint in enumerate(whole.joint_names):
        if joint in CMU15.joints:
            at = CMU15.index(joint)
            depth[:, j] = truth[:, at, 2] - THICKNESS[at, 0]
    return replace(
        whole,
        keypoints=whole.keypoints[:60],
        timestamps=whole.timestamps[:60],
        truth=GroundTruth(truth, CMU15.joints),
        depth=depth,
    )


@pytest.mark.parametrize('way', ['whole', 'live'])
def test_depths_give_the_distance_where_the_camera_is_known(way: str) -> None:
    sequence = make_sequence(is_calibrated=True)
    assert measure_root_error(sequence, way) < 0.015
    assert measure_root_error(replace(sequence, depth=None), way) > 0.02
    assert sequence.depth is not None
    of_another = measure_root_error(replace(sequence, depth=2 * sequence.depth), way)
    assert of_another == pytest.approx(measure_root_error(replace(sequence, depth=None), way), abs=0.02)
    unknown = make_sequence(is_calibrated=False)
    assert measure_root_error(unknown, way) == measure_root_error(replace(unknown, depth=None), way)


@pytest.mark.parametrize(
    ('change', 'fault'),
    [
        (lambda depth: depth, Fault.NONE),
        (lambda depth: 1e3 * depth, Fault.DEPTH_UNIT),
        (lambda depth: depth + 1.5, Fault.DEPTH_ELSEWHERE),
    ],
)
def test_wrong_depths_are_told(change: Callable[[np.ndarray], np.ndarray], fault: Fault) -> None:
    check = DepthCheck()
    for _ in range(40):
        check.add(change(SURFACE[0]), DISTANCE_M)
    assert check.judge().fault is fault
