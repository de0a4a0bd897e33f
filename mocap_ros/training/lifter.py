"""Training of the lifter in PyTorch."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from mocap_ros.compiled.kernel import compile_kernels
from mocap_ros.models.lifter import LOG_STD_RANGE, OUTPUT_COUNT, Lifter
from mocap_ros.models.lifter_input import FEATURE_COUNT, JOINT_COUNT
from mocap_ros.skeleton import CORE_COUNT
from mocap_ros.training.motion_library import MotionLibrary
from mocap_ros.training.synthesis import ExampleBatch, ExampleSynthesiser

Array = NDArray[np.float64]

WARM_UP_SHARE = 0.1  # 1, share of the steps in which the learning rate rises (one-cycle schedule)
MAX_GRADIENT_NORM = 1.0  # 1; a batch with gross outliers cannot throw the weights off
LIKELIHOOD_UNIT_M = 0.1  # m; converts the likelihood, a pure number, to the unit of the mean distance
EXTREMITY_WEIGHT = (
    0.4  # 1; of face, feet and hands in the objective, below the core's 1, which the solvers build on
)
MIN_SQUARED_DISTANCE = 1e-8  # squared unit of the features; keeps the gradient of the distance finite at zero
ERROR_AVERAGE_RATE = 0.01  # 1 per step; the error in the provenance is averaged over about the last 100 steps


@dataclass(frozen=True)
class TrainingSettings:
    """Settings of the training; they become part of the lifter's provenance under these names.

    Attributes:
        steps: number of steps of the optimiser.
        batch: number of examples in a step.
        width: number of units in a hidden layer.
        blocks: number of residual blocks.
        dropout: share of hidden units that are left out in a step.
        rate: highest learning rate of the one-cycle schedule.
        decay: weight decay of AdamW.
        uncertainty: weight of the likelihood of the standard deviations in the objective.
        average: decay per step of the running average of the weights, which becomes the lifter.
        seed: seed of the examples, the initial weights and dropout.
    """

    steps: int = 40000
    batch: int = 256
    width: int = 768
    blocks: int = 2
    dropout: float = 0.0
    rate: float = 2e-3
    decay: float = 0.01
    uncertainty: float = 0.02
    average: float = 0.998
    seed: int = 0


class LifterNetwork(nn.Module):  # type: ignore[misc, unused-ignore]
    """The network during training; `fold_batch_norms` converts it to a `Lifter`, which needs no PyTorch."""

    def __init__(self, width: int, blocks: int, dropout: float) -> None:
        super().__init__()
        self.hidden = nn.ModuleList(
            nn.Sequential(
                nn.Linear(width if i else FEATURE_COUNT, width),
                nn.BatchNorm1d(width),
                nn.ReLU(),
                nn.Dropout(dropout),
            )
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

    def fold_batch_norms(self, provenance: Mapping[str, object]) -> Lifter:
        """Return the lifter that computes the same as this network in evaluation mode."""
        layers = []
        for linear, norm, *_ in self.hidden:
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
    """Compute the loss L = mean_j a_j |P_j - P*_j| + uncertainty * 0.1 m * mean_j a_j NLL_j.

        NLL_j = 2 log sigma_xy + sqrt(3) e_xy / sigma_xy + log sigma_z + sqrt(2) e_z / sigma_z

    a_j is 1 for the core, `EXTREMITY_WEIGHT` for other joints and 0 where the true joint is not known; means are
    over the core's joints. P_j and P*_j are the estimated and the true position, NLL_j the negative log
    likelihood.
    e_xy is the error of joint j in the image and e_z its error in depth. The likelihood is that of Laplace's
    distribution in depth and of its rotationally symmetric counterpart in the image. The errors enter the
    likelihood without gradient, so it trains the standard deviations only.

    Args:
        out: (N, OUTPUT_COUNT) outputs of the network.
        batch: examples that the outputs belong to.
        uncertainty: weight of the likelihood.

    Returns:
        The loss L in m, and the (J,) mean distance of each joint in m, of any value where it is not known.
    """
    newest, target = torch.from_numpy(batch.newest), torch.from_numpy(batch.target)
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


def train_lifter(
    trials: Sequence[Array],
    shares: Array,
    settings: TrainingSettings,
    provenance: Mapping[str, object],
    progress: Callable[[Iterable[int]], Iterable[int]] = iter,
) -> Lifter:
    """Train a lifter; the same trials, settings and library versions give the same lifter.

    Args:
        trials: arrays (F, J, 3) of `skeleton.BODY26` or (F, J_c, 3) of `skeleton.CMU15` in m, z up, 30 frames per
            second.
        shares: (N,) share of each trial in the examples, as from `balance.balance_trials`.
        settings: settings of the training.
        provenance: entries of the lifter's provenance; the settings and the last mean error on examples are added.
        progress: function that wraps the iteration over the steps, for example to show a progress bar.
    """
    compile_kernels()
    torch.manual_seed(settings.seed)
    torch.set_flush_denormal(True)
    synthesiser = ExampleSynthesiser(MotionLibrary.from_trials(trials, shares), settings.seed)
    network = LifterNetwork(settings.width, settings.blocks, settings.dropout)
    averaged = LifterNetwork(settings.width, settings.blocks, 0.0).eval()
    averaged.load_state_dict(network.state_dict())
    optimiser = torch.optim.AdamW(network.parameters(), lr=settings.rate, weight_decay=settings.decay, fused=True)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, settings.rate, settings.steps, pct_start=WARM_UP_SHARE
    )
    mean_error = 0.0
    for step in progress(range(1, settings.steps + 1)):
        batch = synthesiser.make_batch(settings.batch)
        with torch.autocast('cpu', torch.bfloat16):
            out = network(torch.from_numpy(batch.features))
        loss, distance = compute_loss(out.float(), batch, settings.uncertainty)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), MAX_GRADIENT_NORM)
        optimiser.step()
        schedule.step()
        _update_average(averaged, network, min(settings.average, 1 - 1 / step))
        mean_error += (float(distance[:CORE_COUNT].mean()) - mean_error) * max(ERROR_AVERAGE_RATE, 1 / step)
    results = {'settings': vars(settings), 'error_mm': round(mean_error * 1e3, 1), 'torch': torch.__version__}
    return averaged.fold_batch_norms({**provenance, **results})


def _update_average(averaged: LifterNetwork, network: LifterNetwork, decay: float) -> None:
    """Move the weights of `averaged` towards those of `network`: average = decay average + (1 - decay) weights."""
    with torch.no_grad():
        states = zip(averaged.state_dict().values(), network.state_dict().values(), strict=True)
        for average, current in states:
            if average.is_floating_point():
                average.lerp_(current, 1 - decay)
