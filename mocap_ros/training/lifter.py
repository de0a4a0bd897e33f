# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Training of the lifter in PyTorch.

The learning rate of step n of N is

    rate min(1, n / (0.02 N), (N - n) / (0.25 N))

so that it is constant for most of the training, and a training that was stopped can go on with a larger N.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from mocap_ros.arrays import Array
from mocap_ros.errors import MocapError
from mocap_ros.models.lifter import LOG_STD_RANGE, OUTPUT_COUNT, Lifter
from mocap_ros.models.lifter_input import FEATURE_COUNT, JOINT_COUNT
from mocap_ros.skeleton import CORE_COUNT
from mocap_ros.training.motion_library import MotionLibrary
from mocap_ros.training.synthesis import ExampleBatch, ExampleSynthesiser

WARM_UP_SHARE = 0.02  # 1, share of the steps in which the learning rate rises
DECAY_SHARE = 0.25  # 1, share of the steps in which the learning rate falls to zero
BLOCK_BATCHES = 256  # batches of examples that are made at a time; 131,072 examples take 0.5 GB
CHECKPOINT_BLOCKS = 2  # blocks between two checkpoints, some two minutes
MAX_GRADIENT_NORM = 1.0  # 1; a batch with gross outliers cannot throw the weights off
LIKELIHOOD_UNIT_M = 0.1  # m; converts the likelihood, a pure number, to the unit of the mean distance
EXTREMITY_WEIGHT = 0.4  # 1; of face, feet and hands in the objective; the core, on which solvers build, has 1
MIN_SQUARED_DISTANCE = 1e-8  # squared unit of the features; keeps the gradient of the distance finite at zero
ERROR_AVERAGE_RATE = 0.01  # 1 per step; the error in the provenance is averaged over about the last 100 steps
# 1; the highest learning rate of a training that starts from a lifter. The usual one destroys what it has learned.
START_FROM_RATE = 1.5e-4
# 1; share that the lifter to start from has in the weights of the result, which so forgets little of what it knew
# (Wortsman et al., "Robust fine-tuning of zero-shot models", CVPR 2022): left-out people in usual postures cost as
# before, and those in postures that are new keep two thirds of the gain.
START_FROM_SHARE = 0.4
TIMED_STEPS = 3  # steps by which the precisions are compared, after one that allocates memory
MIN_SPEED_UP = 1.25  # 1; bfloat16 rounds to three digits, so it has to be worth it


@dataclass(frozen=True)
class TrainingSettings:
    """Settings of the training; they become part of the lifter's provenance under these names."""

    steps: int = 60000  # number of steps of the optimiser
    batch: int = 512  # number of examples in a step
    # number of steps in which each example is used; making an example takes longer than a step with it
    passes: int = 2
    width: int = 768  # number of units in a hidden layer
    blocks: int = 2  # number of residual blocks
    rate: float = 2e-3  # highest learning rate
    decay: float = 0.01  # weight decay of AdamW
    uncertainty: float = 0.02  # weight of the likelihood of the standard deviations in the objective
    average: float = 0.998  # decay per step of the running average of the weights, which becomes the lifter
    seed: int = 0  # seed of the examples and the initial weights
    precision: str = 'float32'  # number format of the network's products, `float32` or `bfloat16`
    without: tuple[str, ...] = ()  # kinds of `postures.KINDS` that are left out of the examples


class LifterNetwork(nn.Module):  # type: ignore[misc, unused-ignore]
    """The network during training; `fold_batch_norms` converts it to a `Lifter`, which needs no PyTorch."""

    def __init__(self, width: int, blocks: int) -> None:
        super().__init__()
        self.hidden = nn.ModuleList(
            nn.Sequential(nn.Linear(width if i else FEATURE_COUNT, width), nn.BatchNorm1d(width), nn.ReLU())
            for i in range(1 + 2 * blocks)
        )
        self.last = nn.Linear(width, OUTPUT_COUNT)

    def forward(self, features: Tensor) -> Tensor:
        """Evaluate the network: features (N, FEATURE_COUNT) to outputs (N, OUTPUT_COUNT)."""
        first, *rest = self.hidden
        x = first(features)
        for a, b in zip(rest[::2], rest[1::2], strict=True):
            x = x + b(a(x))
        return self.last(x)

    def start_from(self, lifter: Lifter) -> None:
        """Take over the weights of a lifter, and compute the same.

        The weights get the size of those of a new network, on which the effect of a step of the optimiser depends.
        The batch norms undo that, and are not trained. Raises `MocapError` if the layers are others.
        """
        layers = [(torch.from_numpy(w.T.astype('f4')), torch.from_numpy(b.astype('f4'))) for w, b in lifter.layers]
        own = [*(linear for linear, *_ in self.hidden), self.last]
        if [weight.shape for weight, _ in layers] != [linear.weight.shape for linear in own]:
            raise MocapError('the layers of the lifter to start from have other sizes than those of the network')
        with torch.no_grad():
            for (linear, norm, _), (weight, bias) in zip(self.hidden, layers[:-1], strict=True):
                scale = linear.weight.square().mean().sqrt() / weight.square().mean().sqrt()
                linear.weight.copy_(scale * weight)
                linear.bias.zero_()
                norm.running_var.fill_(1 - norm.eps)
                norm.weight.fill_(1 / scale)
                norm.bias.copy_(bias)
                norm.eval().requires_grad_(requires_grad=False)
            self.last.weight.copy_(layers[-1][0])
            self.last.bias.copy_(layers[-1][1])

    def fold_batch_norms(self, provenance: Mapping[str, object]) -> Lifter:
        """Return the lifter that computes the same as this network in evaluation mode."""
        layers = []
        for linear, norm, _ in self.hidden:
            factor = norm.weight / torch.sqrt(norm.running_var + norm.eps)
            bias = (linear.bias - norm.running_mean) * factor + norm.bias
            layers.append((linear.weight * factor[:, None], bias))
        layers.append((self.last.weight, self.last.bias))
        arrays = tuple(
            (np.ascontiguousarray(w.detach().numpy().T, np.float32), b.detach().numpy().astype(np.float32))
            for w, b in layers
        )
        return Lifter(arrays, provenance)


def compute_loss(out: Tensor, batch: ExampleBatch, uncertainty: float) -> tuple[Tensor, Tensor]:
    """Return the loss L in m, and the mean distance (J,) in m of each joint, of any value where it is not known.

        L = mean_j a_j |P_j - P*_j| + uncertainty * 0.1 m * mean_j a_j NLL_j
        NLL_j = 2 log sigma_xy + sqrt(3) e_xy / sigma_xy + log sigma_z + sqrt(2) e_z / sigma_z

    a_j is 1 for the core, `EXTREMITY_WEIGHT` for other joints and 0 where the true joint P*_j is not known; means
    are over the core's joints. NLL_j is the negative log likelihood of Laplace's distribution in depth and of its
    rotationally symmetric counterpart in the image; the errors e enter it without gradient, so that it trains the
    standard deviations only.
    """
    newest = torch.from_numpy(batch.newest)
    target = torch.from_numpy(batch.target)
    pose = out[:, : 3 * JOINT_COUNT].reshape(-1, JOINT_COUNT, 3)
    pose = torch.cat([pose[..., :2] + newest, pose[..., 2:]], dim=-1)
    error = pose - pose[:, :CORE_COUNT].mean(dim=1, keepdim=True) - target
    distance = torch.sqrt((error**2).sum(dim=-1) + MIN_SQUARED_DISTANCE) * torch.from_numpy(batch.size)[:, None]
    log_std = out[:, 3 * JOINT_COUNT :].reshape(-1, JOINT_COUNT, 2).clamp(*LOG_STD_RANGE)
    image_error, depth_error = error.detach()[..., :2].norm(dim=-1), error.detach()[..., 2].abs()
    negative_log_likelihood = (
        2 * log_std[..., 0]
        + 3**0.5 * image_error * torch.exp(-log_std[..., 0])
        + log_std[..., 1]
        + 2**0.5 * depth_error * torch.exp(-log_std[..., 1])
    )
    weight = torch.full((JOINT_COUNT,), EXTREMITY_WEIGHT)
    weight[:CORE_COUNT] = 1.0
    weight = weight * torch.from_numpy(batch.is_known)
    cost = distance + uncertainty * LIKELIHOOD_UNIT_M * negative_log_likelihood
    return (weight * cost).sum() / (CORE_COUNT * len(out)), distance.detach().mean(dim=0)


def find_fastest_precision(settings: TrainingSettings) -> str:
    """Return the `precision` in which a step takes less time on this processor: many have no bfloat16 at all."""
    seconds = {p: _time_steps(replace(settings, precision=p)) for p in ('float32', 'bfloat16')}
    return 'bfloat16' if MIN_SPEED_UP * seconds['bfloat16'] < seconds['float32'] else 'float32'


def _time_steps(settings: TrainingSettings) -> float:
    network = LifterNetwork(settings.width, settings.blocks)
    features = torch.zeros(settings.batch, FEATURE_COUNT)
    begin = 0.0
    for step in range(1 + TIMED_STEPS):
        if step == 1:
            begin = time.perf_counter()
        _evaluate(network, features, settings).sum().backward()
    return time.perf_counter() - begin


def _evaluate(network: LifterNetwork, features: Tensor, settings: TrainingSettings) -> Tensor:
    with torch.autocast('cpu', torch.bfloat16, enabled=settings.precision == 'bfloat16'):
        return network(features).float()


def train_lifter(
    trials: Sequence[Array],
    shares: Array,
    settings: TrainingSettings,
    provenance: Mapping[str, object],
    *,
    start: Lifter | None = None,
    checkpoint: Mapping[str, Any] | None = None,
    keep: Callable[[Mapping[str, Any]], None] | None = None,
    progress: Callable[[Iterable[int]], Iterable[int]] = iter,
) -> Lifter:
    """Train a lifter; the same trials, settings and library versions give the same lifter, interrupted or not.

    Args:
        trials: (F, J, 3) of `skeleton.BODY26` or (F, J_c, 3) of `skeleton.CMU15` in m, z up, 30 frames a second.
        shares: (N,) share of each trial in the examples, as from `balance_trials`.
        settings: settings of the training.
        provenance: entries of the lifter's provenance; the settings and the last mean error on examples are added.
        start: lifter with the initial weights, of which the result keeps `START_FROM_SHARE`, and with its batch
            norms as they are; by default the weights are random.
        checkpoint: state of a training with the same arguments but for the number of steps, which goes on there.
        keep: function that is given a checkpoint every `CHECKPOINT_BLOCKS` blocks of examples.
        progress: function that wraps the iteration over the steps.

    Raises:
        MocapError: the checkpoint is of a training with other settings or trials, or `start` has other layers.
    """
    torch.manual_seed(settings.seed)
    torch.set_flush_denormal(True)
    library = MotionLibrary.from_trials(trials, shares)
    training = _Training(ExampleSynthesiser(library, settings.seed, settings.without), settings, start)
    fixed = {**vars(settings), 'steps': None, 'trials': [len(t) for t in trials]}
    if checkpoint is not None:
        if checkpoint['fixed'] != fixed:
            raise MocapError('the checkpoint is of a training with other settings or other data')
        training.restore(checkpoint)
    block_steps = BLOCK_BATCHES * settings.passes
    for step in progress(range(training.step, settings.steps)):
        training.step_once()
        if keep is not None and (step + 1) % (CHECKPOINT_BLOCKS * block_steps) == 0:
            keep({'fixed': fixed, **training.to_checkpoint()})
    results = {
        'settings': vars(settings),
        'error_mm': round(training.mean_error * 1e3, 1),
        'torch': torch.__version__,
    }
    lifter = training.averaged.fold_batch_norms({**provenance, **results})
    if start is None:
        return lifter
    share = np.float32(START_FROM_SHARE)
    layers = (
        (share * weight_0 + (1 - share) * weight, share * bias_0 + (1 - share) * bias)
        for (weight_0, bias_0), (weight, bias) in zip(start.layers, lifter.layers, strict=True)
    )
    return Lifter(tuple(layers), {**lifter.provenance, 'start_from_share': START_FROM_SHARE})


class _Training:
    """A training in progress.

    Attributes:
        step: number of steps that were made.
        mean_error: m, running average of the mean error of the core's joints on examples that are new.
        averaged: network with the running average of the weights.
    """

    def __init__(self, synthesiser: ExampleSynthesiser, settings: TrainingSettings, start: Lifter | None) -> None:
        self.step = 0
        self.mean_error = 0.0
        self._synthesiser = synthesiser
        self._settings = settings
        self._network, self.averaged = (LifterNetwork(settings.width, settings.blocks) for _ in range(2))
        if start is not None:
            self._network.start_from(start)
        self.averaged.eval()
        self.averaged.load_state_dict(self._network.state_dict())
        self._optimiser = torch.optim.AdamW(
            self._network.parameters(), lr=settings.rate, weight_decay=settings.decay, fused=True
        )
        self._block: list[ExampleBatch] = []  # batches of this block that are still to be used, last one first

    def step_once(self) -> None:
        """Make one step of the optimiser with the next batch of examples."""
        settings = self._settings
        if not self._block:
            self._block = self._make_block()
        is_new = len(self._block) > BLOCK_BATCHES * (settings.passes - 1)
        batch = self._block.pop()
        self.step += 1
        for group in self._optimiser.param_groups:
            group['lr'] = settings.rate * _rate_factor(self.step, settings.steps)
        out = _evaluate(self._network, torch.from_numpy(batch.features), settings)
        loss, distance = compute_loss(out, batch, settings.uncertainty)
        self._optimiser.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(self._network.parameters(), MAX_GRADIENT_NORM)
        self._optimiser.step()
        states = zip(self.averaged.state_dict().values(), self._network.state_dict().values(), strict=True)
        with torch.no_grad():
            for average, current in states:
                if average.is_floating_point():
                    average.lerp_(current, max(1 - settings.average, 1 / self.step))
        if is_new:
            change = float(distance[:CORE_COUNT].mean()) - self.mean_error
            self.mean_error += change * max(ERROR_AVERAGE_RATE, 1 / self.step)

    def to_checkpoint(self) -> dict[str, Any]:
        """Return the state at the end of a block, as tensors and plain values."""
        return {
            'step': self.step,
            'mean_error': self.mean_error,
            'network': self._network.state_dict(),
            'averaged': self.averaged.state_dict(),
            'optimiser': self._optimiser.state_dict(),
            'random': self._synthesiser.random.to_state(),
        }

    def restore(self, checkpoint: Mapping[str, Any]) -> None:
        """Go on from a state of `to_checkpoint`."""
        self.step = checkpoint['step']
        self.mean_error = checkpoint['mean_error']
        self._network.load_state_dict(checkpoint['network'])
        self.averaged.load_state_dict(checkpoint['averaged'])
        self._optimiser.load_state_dict(checkpoint['optimiser'])
        self._synthesiser.random.restore(checkpoint['random'])

    def _make_block(self) -> list[ExampleBatch]:
        """Make `BLOCK_BATCHES` batches of new examples, and mix them anew for each pass over them."""
        batches = [self._synthesiser.make_batch(self._settings.batch) for _ in range(BLOCK_BATCHES)]
        columns = [np.concatenate([getattr(b, field.name) for b in batches]) for field in fields(ExampleBatch)]
        mixed = list(batches)
        for _ in range(self._settings.passes - 1):
            order = self._synthesiser.random.rng.permutation(len(columns[0])).reshape(BLOCK_BATCHES, -1)
            mixed[:0] = [ExampleBatch(*(column[rows] for column in columns)) for rows in order]
        return mixed


def _rate_factor(step: int, steps: int) -> float:
    """Return the learning rate of step 1, 2, ... as a share of the highest one."""
    return min(1.0, step / max(WARM_UP_SHARE * steps, 1), (steps + 1 - step) / max(DECAY_SHARE * steps, 1))
