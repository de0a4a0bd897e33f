# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Trains the correction of velocities that ships (`models/velocity_correction.py`): tracks people, and fits.

It is no benchmark. The people are those of `motion_predictor.py`, seen at 30, 15 and 10 Hz; those of
`common.HELD_OUT_SUBJECTS` are left out, also by the lifter, so `robots.py` tests what ships. It wants PyTorch (the
extra `train`).

The least mean distances along and across the line of sight are fitted, each rounded off near 0: along it errors
are larger, and alone they would cost the others. Some people are shown again as if they were moved otherwise than
their limbs move, as by a robot that drives, by wheels or a treadmill: training has none of these.
"""

import argparse
from dataclasses import asdict
from pathlib import Path

import common
import numpy as np
from detected import make_robot_scene, track_scene
from motion_predictor import WARM_UP, list_views
from numpy.typing import NDArray

from mocap_ros.engine.motion import build_inputs
from mocap_ros.models.model_file import VELOCITY_NAME
from mocap_ros.models.motion_predictor import INPUT_LIMIT
from mocap_ros.models.velocity_correction import SHAPE, SPANS_S, VelocityCorrection, VelocityPast
from mocap_ros.npz_file import write_npz
from mocap_ros.skeleton import CMU15
from mocap_ros.tracking.output import Shown, describe_past, find_motion, locate_past

Array = NDArray[np.float64]

STEPS = (1, 1, 2, 3, 1, 1, 2, 1)  # frames of 1/30 s between two that are tracked, of groups of four views in turn
MOVED_SHARE = 0.15  # of the samples, that are shown again with another velocity of the whole body
MOVED_RANGE_M_S = 0.3, 2.0  # m/s; of that
HIDDEN = 128  # units; two such layers are hardly better on persons who were left out
ROUNDED_M_S = 0.5, 0.25  # m/s; of errors along and across the line of sight, below which their squares count
ACROSS_WEIGHT = 1.5  # of the latter; more of it costs more along the line of sight than it gains
EPOCHS = 16  # rounds over all samples
BATCH = 512  # samples of a step
LEARNING_RATE = 2e-3  # largest
WEIGHT_DECAY = 0.05
LEAST_SCALE = 1e-3  # of an input, which is divided by it
MIRRORED = np.array([1.0, -1.0, 1.0])  # of the axes of the body
FILE = common.ROOT / 'mocap_ros' / 'models' / 'shipped' / f'{VELOCITY_NAME}.npz'


def collect(frames: int) -> tuple[list[VelocityPast], Array]:
    """Track people until so many frames are tracked.

    Returns:
        What the correction of N samples rests on, and the true velocities (N, 15, 3) m/s.
    """
    model, held_out = common.provide_held_out()
    pasts: list[VelocityPast] = []
    velocities, done = [], 0
    for view, (trial, number, most) in enumerate(common.show_progress(list_views(), 'trials')):
        if done >= frames:
            break
        scene, step = make_robot_scene(trial, number, most), STEPS[view // 4 % len(STEPS)]
        truth = np.gradient(scene.view.true_poses, 1 / common.FPS, axis=0)
        parameters = {**held_out, 'tracker.body_height': scene.stature}
        for frame, tracker, person in track_scene(scene, model, parameters, step=step):
            if person.predicted or frame < WARM_UP or frame + 1 == scene.view.frames:
                continue
            now, earlier = locate_past(shown := Shown.of(tracker.tracks))
            past = describe_past(shown, find_motion(shown, now), now, earlier)
            if np.isfinite(past.std).all():
                pasts.append(VelocityPast(*(values[0] for values in past)))
                velocities.append(truth[frame])
        done += len(range(0, scene.view.frames - 1, step))
    return pasts, np.array(velocities)


def fit(pasts: list[VelocityPast], velocity: Array, seed: int = 0) -> VelocityCorrection:
    """Return the network that is fitted to N samples and their true velocities (N, 15, 3) m/s."""
    rng = np.random.default_rng(seed)
    pasts, missing = list(pasts), [true - past.velocity for past, true in zip(pasts, velocity, strict=True)]
    for n in rng.choice(len(pasts), round(MOVED_SHARE * len(pasts)), replace=False):
        pasts.append(_move(pasts[n], rng))
        missing.append(missing[n])
    inputs = np.concatenate(build_inputs(tuple(map(np.array, zip(*pasts, strict=True))), *SHAPE).swapaxes(0, 1))
    targets = np.array([own @ past.axes for past, own in zip(pasts, missing, strict=True)])
    targets = np.concatenate([targets, targets[:, list(CMU15.mirror)] * MIRRORED])
    centre, scale = inputs.mean(axis=0), inputs.std(axis=0) + LEAST_SCALE
    layers = _train(((inputs - centre) / scale).clip(-INPUT_LIMIT, INPUT_LIMIT), inputs[:, -3:], targets, seed)
    return VelocityCorrection(centre.astype('f4'), scale.astype('f4'), *layers)


def _move(past: VelocityPast, rng: np.random.Generator) -> VelocityPast:
    """Return the past of somebody who is moved besides, horizontally, at a speed of `MOVED_RANGE_M_S`."""
    drawn = np.cross(past.axes[:, 2], rng.standard_normal(3))
    moved = rng.uniform(*MOVED_RANGE_M_S) * drawn / np.linalg.norm(drawn)
    earlier = past.earlier - np.array(SPANS_S)[:, None, None] * moved
    return past._replace(velocity=past.velocity + moved, earlier=earlier)


def _train(inputs: Array, sights: Array, targets: Array, seed: int) -> list[NDArray[np.float32]]:
    """Return weights and biases of a network, of inputs (N, I) and corrections (N, J, 3) m/s.

    `sights` (N, 3) are unit vectors along the line of sight, in the axes of the body as the corrections are.
    """
    import torch

    torch.manual_seed(seed)
    rng, joints = np.random.default_rng(seed), targets.shape[1]
    first, last = torch.nn.Linear(inputs.shape[1], HIDDEN), torch.nn.Linear(HIDDEN, 3 * (joints + 1))
    network = torch.nn.Sequential(first, torch.nn.SiLU(), last)
    x, y, sight = (torch.tensor(values, dtype=torch.float32) for values in (inputs, targets, sights))
    batches = max(len(x) // BATCH, 1)
    optimiser = torch.optim.AdamW(network.parameters(), LEARNING_RATE, weight_decay=WEIGHT_DECAY)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, LEARNING_RATE, total_steps=EPOCHS * batches + 1)
    for _ in range(EPOCHS):
        for rows in np.array_split(rng.permutation(len(x)), batches):
            found = network(x[rows]).view(-1, joints + 1, 3)
            error = found[:, :-1] + found[:, -1:] - y[rows]
            along = (error * sight[rows, None]).sum(dim=-1) ** 2
            across = ((error**2).sum(dim=-1) - along).clamp(min=0)
            loss = torch.sqrt(along + ROUNDED_M_S[0] ** 2).mean()
            loss += ACROSS_WEIGHT * torch.sqrt(across + ROUNDED_M_S[1] ** 2).mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
    return [a.detach().numpy().T.copy() for layer in (first, last) for a in (layer.weight, layer.bias)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('-o', '--output', type=Path, default=FILE, metavar='FILE')
    parser.add_argument('--frames', type=int, default=64_000, metavar='N', help='to track (five minutes)')
    args = parser.parse_args()
    pasts, velocities = collect(args.frames)
    network = fit(pasts, velocities)
    write_npz(args.output, asdict(network))
    print(f'{args.output}: fitted to {len(pasts)} samples')


if __name__ == '__main__':
    main()
