# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Feet that stand, and roots with inertia against a dense least squares, whole and live."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mocap_ros.engine import footing as engine
from mocap_ros.keypoints.rays import Extremities
from mocap_ros.skeleton import BODY26, CMU15
from mocap_ros.solvers.extremities import ANCHORS
from mocap_ros.solvers.footing import HEELS_AND_TOES, LEGS, find_contacts, plant_newest, plant_sequence

Array = np.ndarray
Motion = tuple[Array, Array, Array, Array]
FRAMES, NOISE_M = 12, 0.01
UPWARD, UNKNOWN = np.array([0.0, -1.0, 0.0]), np.full(3, np.nan)


class Live:
    """A person whose frames come one after the other."""

    def __init__(self) -> None:
        self.states = np.full((1, engine.FOOTING.itemsize // 8), np.nan)
        self.state = self.states.view(engine.FOOTING)[0]

    def advance(self, time_s: float, core: Array, feet: Array, log_odds: float | Array) -> Array:
        """Return the core (15, 3) m by the odds (4,) that are known of heels and toes."""
        planted = core[None].copy()
        self.state['log_odds'] = log_odds
        engine.advance(self.states, np.array([time_s]), np.array([NOISE_M]), planted, feet[None].copy(), LEGS)
        return np.asarray(planted[0])

    def plant(self, time_s: float, core: Array, offsets: Array, observed: Any, frame: int) -> Array:
        """Return the core (15, 3) m by a frame of a window."""
        planted, noise = core[None].copy(), np.array([NOISE_M])
        seen = [observed], [frame], planted, offsets[None], UPWARD
        plant_newest(self.states, np.array([time_s]), *seen, noise)
        return np.asarray(planted[0])


@pytest.fixture
def motion(rng: np.random.Generator) -> Motion:
    """Times (F,), cores (F, 15, 3), feet (F, 4, 3) and contacts (F, 4) of somebody 7 m away who jitters."""
    times = np.cumsum(rng.uniform(0.02, 0.05, FRAMES))
    core = rng.normal(0, 0.3, (15, 3)) + [0.5, 0.2, 7.0] + 0.01 * rng.normal(size=(FRAMES, 15, 3))
    core += 0.02 * rng.normal(size=(FRAMES, 1, 3))
    for hip, knee, ankle in LEGS:  # knees are where legs can reach farther
        core[:, ankle] = core[:, hip] + [0.0, 0.7, 0.1]
        core[:, knee] = core[:, hip] + [0.0, 0.4, -0.2]
    feet = np.array([[-0.05, 0.05, 0], [0.18, 0.05, 0]] * 2) + 0.002 * rng.normal(size=(FRAMES, 4, 3))
    return times, core, feet, rng.uniform(0, 1, (FRAMES, 4))


def solve_densely(
    times: Array, core: Array, feet: Array, contact: Array, expected: Array | None, *, is_live: bool = False
) -> Array:
    """Return the displacements (F, 9) that minimise the formula of `solvers.footing`.

    The loss of feet is linearised at displacements (F, 2, 9) that are expected of a frame and the one before.
    """
    constants = engine.list_constants(NOISE_M, is_live)
    along, across, error_s, leg_s, *accelerations, tilt, leg, slip, pace, roll, fast = constants
    count, steps = len(times), np.diff(times)
    root = core[:, LEGS[:, 0]].mean(axis=1)
    points = core[:, LEGS[[0, 0, 1, 1], 2]] + feet
    rows, values = [], []

    def add(parts: list[tuple[int, int, float]], value: Array, weights: Array) -> None:
        row = np.zeros((3, count, 9))
        for frame, at, factor in parts:
            row[:, frame, at : at + 3] += factor * weights
        rows.append(row.reshape(3, -1))
        values.append(-weights @ value)

    def weigh(t: int, deep: float, wide: float, leg: Array | None = None) -> Array:
        sight = root[t]
        if leg is not None:  # the way of an ankle as the leg tilts in depth
            hip, _, ankle = core[t, leg]
            sight = hip - hip @ (ankle - hip) / np.sum((ankle - hip) ** 2) * (ankle - hip)
        sight = sight / np.linalg.norm(sight)
        return np.eye(3) / wide + (1 / deep - 1 / wide) * np.outer(sight, sight)

    for t in range(count):
        for at, seconds, weights in (
            (0, error_s, weigh(t, along * max(np.linalg.norm(root[t]) / 5, 1), across)),
            (3, leg_s, weigh(t, tilt, leg, LEGS[0])),
            (6, leg_s, weigh(t, tilt, leg, LEGS[1])),
        ):
            kept = np.exp(-steps[t - 1] / seconds) if t else 0.0
            parts = [(t, at, 1.0), *([(t - 1, at, -kept)] if t else [])]
            add(parts, np.zeros(3), weights / np.sqrt(1 - kept**2))
        if t > 1:
            a, b = 1 / steps[t - 2], 1 / steps[t - 1]
            velocity = a * (root[t - 1] - root[t - 2])
            change = b * (root[t] - root[t - 1]) - velocity
            wider = 1 + (velocity @ velocity / pace**2) ** 2
            weights = weigh(t, *accelerations) / np.sqrt((steps[t - 2] + steps[t - 1]) / 2 / 30 * wider)
            add([(t - 2, 0, a), (t - 1, 0, -a - b), (t, 0, b)], change, weights)
        for k in range(4 if t else 0):
            at, limit = 3 + 3 * (k // 2), 4 * fast
            moved = points[t, k] - points[t - 1, k] - roll * (root[t] - root[t - 1])
            last = moved
            if expected is not None and np.isfinite(expected[t]).all():
                change = expected[t, 1] - expected[t, 0]
                last, limit = moved + (1 - roll) * change[:3] + change[at : at + 3], fast
            p = min(contact[t, k], contact[t - 1, k]) / (1 + (last @ last) / (limit * steps[t - 1]) ** 2)
            parts = [(t, 0, 1 - roll), (t, at, 1.0), (t - 1, 0, roll - 1), (t - 1, at, -1.0)]
            add(parts, moved, np.eye(3) * np.sqrt(p) / (slip * steps[t - 1]))
    return np.linalg.lstsq(np.concatenate(rows), np.concatenate(values), rcond=None)[0].reshape(count, 9)


def check_displaced(core: Array, planted: Array, displacements: Array) -> None:
    of_hips = displacements[:3][None].repeat(2, 0)
    np.testing.assert_allclose(planted[LEGS[:, 0]] - core[LEGS[:, 0]], of_hips, atol=1e-9)
    moved = displacements[:3] + displacements[3:].reshape(2, 3)
    np.testing.assert_allclose(planted[LEGS[:, 2]] - core[LEGS[:, 2]], moved, atol=1e-9)
    for leg in LEGS:
        before, after = (np.linalg.norm(np.diff(j[leg], axis=0), axis=1) for j in (core, planted))
        np.testing.assert_allclose(after, before, atol=1e-9)


@pytest.mark.parametrize('rounds', [1, 3])
def test_a_sequence_is_that_of_the_dense_least_squares(motion: Motion, rounds: int) -> None:
    times, core, feet, contact = motion
    found = None
    for _ in range(rounds):
        pairs = None if found is None else np.stack([np.roll(found, 1, axis=0), found], axis=1)
        found = solve_densely(times, core, feet, contact, pairs)
    assert found is not None
    assert np.abs(found).max() > 0.01
    planted = engine.smooth(NOISE_M, times, core, feet, contact, LEGS, rounds)
    for before, after, own in zip(core, planted, found, strict=True):
        check_displaced(before, after, own)


def test_the_newest_frame_is_that_of_all_frames_so_far(motion: Motion) -> None:
    times, core, feet, contact = motion
    live, odds = Live(), np.log(contact / (1 - contact))
    root, estimates, own = core[:, LEGS[:, 0]].mean(axis=1), np.full((FRAMES, 2, 9), np.nan), np.zeros((2, 9))
    for t, step_s in enumerate(np.diff(times, prepend=times[0] - 1)):
        planted = live.advance(times[t], core[t], feet[t], odds[t])
        if t > 1:  # feet stand or not as if the root went on
            estimates[t] = own[-1]
            velocity = (root[t - 1] + own[-1, :3] - root[t - 2] - own[-2, :3]) / (times[t - 1] - times[t - 2])
            estimates[t, 1, :3] += root[t - 1] + velocity * step_s - root[t]
        until = slice(t + 1)
        own = solve_densely(times[until], core[until], feet[until], contact[until], estimates, is_live=True)
        check_displaced(core[t], planted, own[-1])


def test_feet_stand_and_what_is_not_on_the_ground_moves(rng: np.random.Generator) -> None:
    """Somebody stands still while the solution swims by 5 cm in depth; then the same in the air."""
    times, joints = np.arange(90) / 30, np.zeros((15, 3))
    joints[:, 2] = 4.0
    joints[[CMU15.index(j) for j in ('lknee', 'rknee')]] += [0.0, 0.4, -0.1]
    joints[[CMU15.index(j) for j in ('lankle', 'rankle')]] += [0.0, 0.8, 0.0]
    core = np.tile(joints, (90, 1, 1))
    core[..., 2] += 0.05 * np.sin(4 * times)[:, None] + 0.005 * rng.normal(size=(90, 1))
    feet, slides = np.zeros((90, 4, 3)), []
    for probability in (1.0, 0.0):
        planted = engine.smooth(NOISE_M, times, core, feet, np.full((90, 4), probability), LEGS, 3)
        slides.append(np.abs(np.diff(planted[:, LEGS[0, 2], 2])).mean())
    before = np.abs(np.diff(core[:, LEGS[0, 2], 2])).mean()
    assert slides[0] < 0.15 * before < 0.5 * slides[1]


def test_unseen_legs_do_not_hold_the_root(motion: Motion) -> None:
    times, core, _, _ = motion
    weight = np.ones((FRAMES, 15))
    weight[:, LEGS[:, 1:].ravel()] = 0
    observed: Any = SimpleNamespace(times=times, rays=core[..., :2] / 4, weight=weight, extremities=None)
    offsets, upward = np.zeros((FRAMES, 11, 3)), np.tile([0.0, -1.0, 0.0], (FRAMES, 1))
    feet = np.zeros((FRAMES, 4, 3))
    free = engine.smooth(NOISE_M, times, core, feet, np.zeros((FRAMES, 4)), LEGS, 3)
    np.testing.assert_array_equal(plant_sequence(observed, core, offsets, upward, NOISE_M), free)
    planted, inert = Live(), Live()
    for t, time_s in enumerate(times):
        seen: Any = SimpleNamespace(**{**vars(observed), 'times': times[: t + 1]})
        free = inert.advance(time_s, core[t], feet[0], -np.inf)
        np.testing.assert_array_equal(planted.plant(time_s, core[t], offsets[0], seen, t), free)


def test_another_solution_far_away_begins_anew(motion: Motion) -> None:
    times, core, feet, _ = motion
    live = Live()
    for time_s, joints in zip(times, core, strict=True):
        live.advance(time_s, joints, feet[0], 0.0)
    far = core[0] + [0.0, 0.0, 6.0]
    planted = live.advance(times[-1] + 1 / 30, far, feet[0], 0.0)
    np.testing.assert_allclose(planted[LEGS[:, 0]], far[LEGS[:, 0]], atol=1e-6)


def walk(rate_hz: float = 30.0) -> tuple[Array, ...]:
    """Joints (F, 26, 3) m, 4 m away, rays, weights, times, and when (F,) the left foot swings and stands.

    The right foot stands, the left one stands for 1 s and swings for 0.5 s.
    """
    times = np.arange(round(4.5 * rate_hz)) / rate_hz
    joints = np.zeros((len(times), 26, 3)) + [0.0, 0.0, 4.0]
    time = times % 1.5
    phase = (time - 1.0).clip(0) * 2
    swung = np.floor(times / 1.5) + phase
    for joint, x in (('lankle', 0.0), ('lheel', -0.05), ('ltoe', 0.2)):
        lift = -0.15 * np.sin(np.pi * phase)
        joints[:, BODY26.index(joint)] = np.stack([x + 0.6 * swung, 1.0 + lift, 0 * times + 4], axis=1)
    for joint, x in (('rankle', 0.3), ('rheel', 0.25), ('rtoe', 0.5)):
        joints[:, BODY26.index(joint)] = [x, 1.0, 4.0]
    swings, stands = (phase > 0.2) & (phase < 0.8), (time > 0.2) & (time < 0.8)
    return joints, joints[..., :2] / joints[..., 2:], np.ones(joints.shape[:2]), times, swings, stands


@pytest.mark.parametrize(
    ('rate_hz', 'count', 'upward'),
    [(10.0, 26, UPWARD), (30.0, 26, UPWARD), (120.0, 15, UPWARD), (30.0, 15, UPWARD), (30.0, 26, UNKNOWN)],
)
def test_a_foot_that_swings_does_not_stand(rate_hz: float, count: int, upward: Array) -> None:
    joints, rays, weight, times, swings, stands = walk(rate_hz)
    contact = find_contacts(rays[:, :count], weight[:, :count], joints[:, :count], upward, times, 0.0)
    assert contact.shape == (len(times), 4)
    assert contact[:, 2:].min() > 0.7
    assert contact[swings, :2].max() < 0.3
    assert contact[stands, :2].min() > 0.7


@pytest.mark.parametrize(('noise_m', 'least'), [(0.01, 0.7), (0.05, 0.3)])
def test_points_of_detectors_and_points_that_are_not_seen(noise_m: float, least: float) -> None:
    joints, rays, weight, times, swings, stands = walk()
    rays = rays + np.random.default_rng(0).normal(0, noise_m, rays.shape) / 4
    weight[40:50, HEELS_AND_TOES[2]] = 0  # the heel of the foot that stands is hidden
    contact = find_contacts(rays, weight, joints, UPWARD, times, noise_m)
    assert contact[40:50, 2].min() > 0.7
    assert contact[swings, :2].mean() < 0.3
    assert contact[stands, :2].mean() > least
    assert contact[:, 2:].mean() > 0.7, 'as fast as the noise makes it seem'


def test_nothing_is_known_of_a_person_who_is_not_seen() -> None:
    joints, rays, weight, times, _, _ = walk()
    weight[10:, HEELS_AND_TOES[2:]] = 0  # behind a table from then on
    contact = find_contacts(rays, weight, joints, UPWARD, times, 0.0)
    assert np.isfinite(np.r_[contact[:, :2], contact[:30, 2:]]).all()
    assert np.isnan(contact[110:, 2:]).all()
    assert np.isnan(find_contacts(0 * rays, 0 * weight, joints * np.nan, UNKNOWN, times, 0.0)).all()
    assert np.isnan(find_contacts(rays[:1], weight[:1] + 1, joints[:1], UPWARD, times[:1], 0.0)).all(), 'one frame'


@pytest.mark.parametrize('rate_hz', [10.0, 15.0, 20.0, 30.0])
def test_what_is_known_live_is_what_the_newest_frame_shows(rate_hz: float) -> None:
    joints, rays, weight, times, swings, stands = walk(rate_hz)
    live, offsets = Live(), joints[:, 15:] - joints[:, ANCHORS]
    found, expected = np.empty((2, len(times), 2))
    for frame, time_s in enumerate(times):
        until = slice(frame + 1)
        cut = rays[until], weight[until], times[until]
        others = Extremities(cut[0][:, 15:].copy(), cut[1][:, 15:].copy())
        seen, weights = (values[:, :15].copy() for values in cut[:2])
        observed: Any = SimpleNamespace(times=cut[2], rays=seen, weight=weights, extremities=others)
        core = joints[frame, :15].copy()
        live.plant(time_s, core, offsets[frame], observed, frame)
        found[frame] = live.state['standing'][0]
        newest = find_contacts(*cut[:2], joints[until], UPWARD, cut[2], NOISE_M)[-1]
        expected[frame] = np.fmax(newest[::2], newest[1::2])
    assert np.isnan(found[:2]).all()
    assert np.nanmean(np.abs(found - expected)) < 0.06
    assert found[10:, 1].min() > 0.9
    assert found[swings, 0].mean() < 0.3 < 0.7 < found[stands, 0].mean()
    observed.weight, observed.extremities = 0 * observed.weight, None  # behind a table from then on
    is_forgotten = np.zeros(150, bool)
    for ago in range(150):
        live.plant(times[-1] + 1 + ago, core, offsets[-1], observed, frame)
        is_forgotten[ago] = np.isnan(live.state['standing'][0, 1])
    assert np.argmax(is_forgotten) / rate_hz == pytest.approx(1.0, abs=0.1)
