# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Trains the motion predictor that ships (`models/motion_predictor.py`): tracks people, and fits what came next.

It is no benchmark. The people are seen by four detectors, 2 to 6 m away, with their heights known. Those of
`common.HELD_OUT_SUBJECTS` are left out, also by the lifter, so `robots.py` tests what ships. It wants PyTorch (the
extra `train`).

The place of the root at the newest frame counts as right: that a person is nearer or farther than thought is no
error of the prediction, and is in the covariance of the root already. The network is trained to the least mean
distance of the joints, not the least squares, by which few fast motions would outweigh all others. Some bodies are
shown to it facing anywhere, as they are seen the wrong way round at times, and some moving otherwise than their
limbs do, as people on wheels and treadmills: training has none of these. Errors for the variances are those on
persons who were left out.
"""

import argparse
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, TypeVar

import common
import numpy as np
from detected import load_motion, look_ahead, make_robot_scene, track_scene
from numpy.typing import NDArray
from scipy.optimize import nnls

from mocap_ros.models.model_file import PREDICTOR_NAME
from mocap_ros.models.motion_predictor import (
    MIRRORED,
    PAST_S,
    Features,
    MotionPredictor,
    Past,
    collect_inputs,
    compute_features,
    mirror,
)
from mocap_ros.npz_file import write_npz
from mocap_ros.skeleton import CMU15, HIPS
from mocap_ros.tracking.prediction import sample_past

Array = NDArray[np.float64]
Samples = TypeVar('Samples', Past, Features)

FRAMES_A_TRIAL = 240  # from the middle of each trial
WARM_UP = 15  # frames at the beginning of a trial that are left out
FIRST_TRIALS = 366  # that are seen first, of all kinds of motion alike; the others are mostly exercises
LATER_FRAMES = 160  # of each of the others
OTHER_VIEW = 1001  # added to the number of a trial, so that it is seen from elsewhere by another detector
EXERCISES = 'uiprmd'  # begins the names of persons who do the same few exercises, which are not seen again
STEP = 2  # frames between two samples; neighbouring ones are much the same
MIN_FRAMES = 60  # of a trial; 1 s of the past and 1 s ahead
GAITS = {'walk', 'run'}  # whose trials come three times as soon as others
FILE = common.ROOT / 'mocap_ros' / 'models' / 'shipped' / f'{PREDICTOR_NAME}.npz'
TIMES_S = (0.2, 0.4, 0.6, 1.0)  # s ahead, for which a predictor is fitted
TYPICAL_ERRORS_M = (0.12, 0.2, 0.26, 0.4)  # m, at these times; distances are divided by them
DIRECTIONS = 60  # principal directions of the limbs' features
HIDDEN = 128  # units of each hidden layer; 256 are no better on others than those fitted to
LAYERS = 3  # the last without an activation
DROPOUT = 0.3  # share of the hidden units that are left out in a step
TURNED_SHARE = 0.3  # of the samples, that are shown again with a wrong heading; 5 % worse where it is right
MOVED_SHARE = 0.2  # of the samples, that are shown again with another velocity of the whole body
MOVED_RANGE_M_S = (
    0.6,
    1.6,
)  # m/s; of that: wheels and treadmills at the speed of a walk. Slower motions may well end
EPOCHS = 10  # rounds over all samples; more are no better on others
BATCH = 512  # samples of a step
LEARNING_RATE = 2e-3  # largest
WEIGHT_DECAY = 0.05
OUTPUT_UNIT_M = 0.1  # m; of the outputs of the network while it is trained
LEAST_SCALE = 1e-3  # of an input, which is divided by it
FOLDS = 2  # groups of persons, each left out once
WITHIN_95 = 7.815  # 1; squared Mahalanobis distance in three dimensions that 95 of 100 normal errors are below
ROUNDS = 4  # of a fit of variances, each weighted by the variances of the one before


def order_trials() -> list[str]:
    """Return the trials of the training data, the kinds of motion in turn."""
    queues: dict[str, list[str]] = {}
    rng, rows = np.random.default_rng(5), load_motion()[2]
    for name, row in rows.items():
        if row['subject'] not in common.HELD_OUT_SUBJECTS and int(row['frames']) >= MIN_FRAMES:
            queues.setdefault(row['category'], []).append(name)
    for queue in queues.values():
        rng.shuffle(queue)
    out: list[str] = []
    while any(queues.values()):
        for category, queue in queues.items():
            count = 3 if category in GAITS else 1
            out += queue[:count]
            del queue[:count]
    return out


def list_views() -> list[tuple[str, int, int]]:
    """Return trials, numbers of their views, and most frames of each.

    First come trials of all kinds, then in turn the others, and again those of the first that are no exercises.
    """
    views, rows = list(enumerate(order_trials())), load_motion()[2]
    first = [(trial, number, FRAMES_A_TRIAL) for number, trial in views[:FIRST_TRIALS]]
    later = [(trial, number, LATER_FRAMES) for number, trial in views[FIRST_TRIALS:]]
    again = [
        (trial, number + OTHER_VIEW, frames)
        for trial, number, frames in first
        if not rows[trial]['subject'].startswith(EXERCISES)
    ]
    return first + [view for pair in zip(later, again, strict=False) for view in pair]


def collect(frames: int) -> tuple[Past, Array, NDArray[np.str_]]:
    """Track trials until so many frames are tracked.

    Returns:
        The past of N samples, the true joints (N, K, 15, 3) m ahead, moved so that the root was right, and who it
        is.
    """
    (model, held_out), pasts, futures, persons, done = common.provide_held_out(), [], [], [], 0
    rows = load_motion()[2]
    for trial, number, most in common.show_progress(list_views(), 'trials'):
        if done >= frames:
            break
        scene = make_robot_scene(trial, number, most)
        parameters = {**held_out, 'tracker.body_height': scene.stature}
        truth = scene.view.true_poses
        for frame, tracker, person in track_scene(scene, model, parameters):
            if person.predicted or frame < WARM_UP or frame % STEP:
                continue
            upward = None if tracker.vertical is None else tracker.vertical.direction
            pasts.append(sample_past(tracker.tracks, upward))
            persons.append(rows[trial]['subject'])
            futures.append(look_ahead(truth, frame, TIMES_S) + person.root - scene.root[frame])
        done += scene.view.frames
    return _join(*pasts), np.array(futures), np.array(persons)


def fit_predictor(past: Past, future: Array, persons: NDArray[np.str_]) -> MotionPredictor:
    """Return the predictor that is fitted to N samples of N persons.

    `future` (N, K, J, 3) m are the true joints at the `TIMES_S` after, moved so that the root was right at the
    newest frame; NaN where not known.
    """
    features, now = compute_features(past), past.joints
    predicted = np.full(future.shape, np.nan)
    for left_out in np.array_split(np.random.default_rng(0).permutation(np.unique(persons)), FOLDS):
        is_out = np.isin(persons, left_out)
        draft = _fit_network(*_add_others(past, features, future - now[:, None], np.flatnonzero(~is_out)))
        rows = np.flatnonzero(is_out)
        ahead = draft.predict(_select(past, rows), np.tile(TIMES_S, (len(rows), 1)))
        predicted[rows] = now[rows, None] + ahead.joints
    root_variance, limb_variance = _fit_variances(
        predicted,
        future,
        features.line_of_sight,
        past.std,
        features.root_squares,
        features.limb_squares,
    )
    fitted = _fit_network(*_add_others(past, features, future - now[:, None], np.arange(len(now))))
    return replace(fitted, root_variance=root_variance, limb_variance=limb_variance)


def _add_others(
    past: Past, features: Features, displacement: Array, rows: NDArray[np.intp]
) -> tuple[Features, Array]:
    """Return features and displacements of some samples, and of these again turned or moved, as of the module."""
    rng = np.random.default_rng(0)
    turned, moved = (rng.choice(rows, round(s * len(rows)), replace=False) for s in (TURNED_SHARE, MOVED_SHARE))
    other_way = _select(past, turned)._replace(heading=rng.standard_normal((len(turned), 3)))
    pushed, further = _select(past, moved), []
    for i, upward in enumerate(pushed.upward):
        drawn = np.cross(upward, rng.standard_normal(3))
        velocity = rng.uniform(*MOVED_RANGE_M_S) * drawn / np.linalg.norm(drawn)
        pushed.earlier[i] -= np.array(PAST_S)[:, None, None] * velocity
        pushed.velocity[i] += velocity
        further.append(displacement[moved[i]] + np.array(TIMES_S)[:, None, None] * velocity)
    joined = _join(_select(features, rows), compute_features(_join(other_way, pushed)))
    return joined, np.concatenate([displacement[rows], displacement[turned], np.array(further)])


def _select(samples: Samples, rows: NDArray[np.intp]) -> Samples:
    """Return some of the samples."""
    return type(samples)(*(values[rows] for values in samples))


def _join(*groups: Samples) -> Samples:
    """Return groups of samples as one."""
    return type(groups[0])(*map(np.concatenate, zip(*groups, strict=True)))


def _fit_network(features: Features, displacement: Array) -> MotionPredictor:
    """Return a predictor whose variances are 0, of displacements (N, K, J, 3) m in the optical frame."""
    both = _join(features, mirror(features))
    limbs = both.limbs
    mean = limbs.mean(axis=0)
    directions = np.linalg.eigh(np.cov((limbs - mean).T))[1][:, ::-1][:, :DIRECTIONS]
    inputs = np.concatenate([(limbs - mean) @ directions, collect_inputs(both)], axis=1)
    root = _centre(displacement)
    joints = (displacement - root[:, :, None]) @ features.body[:, None]
    root = root @ features.line_of_sight
    mirrored_joints = joints[:, :, list(CMU15.mirror)] * MIRRORED
    targets = np.concatenate([joints, mirrored_joints]), np.concatenate([root, root * MIRRORED])
    turns = both.line_of_sight.swapaxes(1, 2) @ both.body
    scale = inputs.std(axis=0) + LEAST_SCALE
    untrained = MotionPredictor(
        times=np.array(TIMES_S),
        mean=mean,
        directions=directions,
        centre=inputs.mean(axis=0),
        scale=scale,
        root_variance=np.zeros((len(TIMES_S), 3, 4)),
        limb_variance=np.zeros((len(TIMES_S), len(CMU15.joints), 4)),
        **{f'{kind}_{i}': np.zeros(0) for kind in ('weight', 'bias') for i in range(LAYERS)},
    )
    return replace(untrained, **_train(untrained.build_inputs(both), *targets, turns))


def _train(inputs: Array, joints: Array, root: Array, turns: Array) -> dict[str, Array]:
    """Return the weights and biases of a network, of inputs (N, I), and displacements in m; NaN where not known.

    `joints` (N, K, J, 3) are about the root in the axes of the bodies, `root` (N, K, 3) in those of the line of
    sight; `turns` (N, 3, 3) lead from the former to the latter.
    """
    import torch

    torch.manual_seed(0)
    times, count = joints.shape[1], joints.shape[2]
    layers: list[Any] = []
    for width in (inputs.shape[1], HIDDEN):
        layers += [torch.nn.Linear(width, HIDDEN), torch.nn.SiLU(), torch.nn.Dropout(DROPOUT)]
    network = torch.nn.Sequential(*layers, torch.nn.Linear(HIDDEN, times * (count + 1) * 3))
    known = np.isfinite(joints).all(axis=(2, 3)) & np.isfinite(root).all(axis=2)
    data = [torch.tensor(np.nan_to_num(a), dtype=torch.float32) for a in (inputs, joints, root, turns, known)]
    weight = 1 / torch.tensor(TYPICAL_ERRORS_M)
    steps = EPOCHS * max(len(inputs) // BATCH, 1)
    optimiser = torch.optim.AdamW(network.parameters(), LEARNING_RATE, weight_decay=WEIGHT_DECAY)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, LEARNING_RATE, total_steps=steps + 1)
    for epoch in range(EPOCHS):
        order = np.random.default_rng(epoch).permutation(len(inputs))
        for rows in np.array_split(order, max(len(inputs) // BATCH, 1)):
            x, limb, centre, turn, is_known = (d[rows] for d in data)
            found = network(x).view(-1, times, count + 1, 3) * OUTPUT_UNIT_M
            root_error = torch.einsum('nka,nab->nkb', found[:, :, -1] - centre, turn)
            error = found[:, :, :-1] - limb + root_error[:, :, None]
            distance = torch.sqrt((error**2).sum(dim=-1) + 1e-6).mean(dim=-1)
            loss = (distance * weight * is_known).sum() / is_known.sum().clamp(min=1)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
    linear = [layer for layer in network if isinstance(layer, torch.nn.Linear)]
    out: dict[str, Array] = {}
    for i, layer in enumerate(linear):
        unit = OUTPUT_UNIT_M if layer is linear[-1] else 1.0
        out[f'weight_{i}'] = layer.weight.detach().numpy().T.astype(float) * unit
        out[f'bias_{i}'] = layer.bias.detach().numpy().astype(float) * unit
    return out


def _fit_variances(
    predicted: Array, future: Array, sights: Array, std: Array, root_squares: Array, limb_squares: Array
) -> tuple[Array, Array]:
    """Return the variances (K, 3, 4) of the root and (K, J, 4) of the joints, of N samples.

    `predicted` and `future` are (N, K, J, 3) m, `sights` (N, 3, 3) the axes of the line of sight in columns, `std`
    (N, J) m; on `root_squares` (N, 4) and `limb_squares` (N, J, 4) the variances depend.
    """
    error = predicted - future
    root_error = (_centre(error) @ sights) ** 2
    limb_error = ((error - _centre(error)[:, :, None]) ** 2).sum(axis=3)
    root_variance, limb_variance = [], []
    for k in range(error.shape[1]):
        known = np.isfinite(error[:, k]).all(axis=(1, 2))
        own = np.array([_fit_squares(root_squares[known], root_error[known, k, a]) for a in range(3)])
        distance = (root_error[known, k] / (root_squares[known] @ own.T)).sum(axis=1)
        root_variance.append(own * np.quantile(distance, 0.95) / WITHIN_95)
        fitted = []
        for j in range(error.shape[2]):
            squares, squared = limb_squares[known, j], limb_error[known, k, j]
            before = std[known, j] ** 2
            weights = _fit_squares(squares, squared, before)
            fitted.append(weights * _find_factor(squares @ weights, squared, before))
        limb_variance.append(fitted)
    return np.array(root_variance), np.array(limb_variance)


def _fit_squares(squares: Array, squared: Array, before: Array | float = 0.0) -> Array:
    """Return the weights (S,), none negative, with which squares (N, S) explain squared errors (N,)."""
    weight = np.ones(len(squared))
    out = np.zeros(squares.shape[1])
    for _ in range(ROUNDS):
        out = nnls(squares * weight[:, None], (squared - before) * weight)[0]
        variance = squares @ out + before
        weight = 1 / np.maximum(variance, np.quantile(variance, 0.05))
    return np.asarray(out)


def _find_factor(growth: Array, squared: Array, before: Array) -> float:
    """Return the factor on the growth (N,) so that 95 of 100 squared errors (N,) are within the ellipsoid."""
    low, high = 0.0, 10.0
    for _ in range(30):
        factor = (low + high) / 2
        is_enough = (squared * 3 <= WITHIN_95 * (before + factor * growth)).mean() >= 0.95
        low, high = (low, factor) if is_enough else (factor, high)
    return high


def _centre(places: Array) -> Array:
    """Return the middle (..., 3) between the hips of places (..., J, 3)."""
    return np.asarray((places[..., HIPS[0], :] + places[..., HIPS[1], :]) / 2)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('-o', '--output', type=Path, default=FILE, metavar='FILE')
    parser.add_argument('--frames', type=int, default=68_700, metavar='N', help='to track (15 minutes)')
    args = parser.parse_args()
    past, futures, persons = collect(args.frames)
    predictor = fit_predictor(past, futures, persons)
    write_npz(args.output, {name: array.astype('f4') for name, array in asdict(predictor).items()})
    print(f'{args.output}: fitted to {len(futures)} samples')


if __name__ == '__main__':
    main()
