"""Training of the lifter in PyTorch."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from mocap_ros.models.lifter import FEATURES, JOINTS, LOG_SPREADS, OUTPUTS, Lifter
from mocap_ros.training.synthesis import Batch, Motions, Synthesis

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Training:
    """How to train.

    Attributes:
        steps: of the optimiser; batch: examples in each.
        width: of the hidden layers; blocks: residual ones.
        dropout: share of hidden units left out.
        rate: greatest learning rate of the one-cycle schedule; decay: of the weights.
        uncertainty: weight of the spreads' likelihood.
        average: of the weights, decay a step.
        seed: of everything.
    """

    steps: int = 20000
    batch: int = 256
    width: int = 512
    blocks: int = 2
    dropout: float = 0.0
    rate: float = 2e-3
    decay: float = 0.01
    uncertainty: float = 0.02
    average: float = 0.998
    seed: int = 0


class Network(nn.Module):  # type: ignore[misc, unused-ignore]
    """The network as it is trained; `folded` makes it what NumPy runs."""

    def __init__(self, width: int, blocks: int, dropout: float) -> None:
        super().__init__()
        self.hidden = nn.ModuleList(
            nn.Sequential(
                nn.Linear(width if i else FEATURES, width), nn.BatchNorm1d(width), nn.ReLU(), nn.Dropout(dropout)
            )
            for i in range(1 + 2 * blocks)
        )
        self.last = nn.Linear(width, OUTPUTS)

    def forward(self, features: Tensor) -> Tensor:
        """(N, FEATURES) -> (N, OUTPUTS)."""
        first, *rest = self.hidden
        x = first(features)
        for a, b in zip(rest[::2], rest[1::2], strict=True):
            x = x + b(a(x))
        return self.last(x)

    def folded(self, provenance: Mapping[str, object]) -> Lifter:
        """The lifter that does the same as this network in evaluation."""
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


def loss(out: Tensor, batch: Batch, uncertainty: float) -> tuple[Tensor, Tensor]:
    """What is minimised, and the mean distance of the joints in m, by joint.

    The spreads are fitted, by the likelihood of Laplace's distribution in depth and of its round counterpart in
    the image, to errors which they do not themselves change.
    """
    newest, target = torch.from_numpy(batch.newest), torch.from_numpy(batch.target)
    pose = out[:, : 3 * JOINTS].reshape(-1, JOINTS, 3)
    pose = torch.cat([pose[..., :2] + newest, pose[..., 2:]], dim=-1)
    error = pose - pose.mean(dim=1, keepdim=True) - target
    distance = torch.sqrt((error**2).sum(dim=-1) + 1e-8) * torch.from_numpy(batch.size)[:, None]
    log_spread = out[:, 3 * JOINTS :].reshape(-1, JOINTS, 2).clamp(*LOG_SPREADS)
    aside, away = error.detach()[..., :2].norm(dim=-1), error.detach()[..., 2].abs()
    unlikely = (
        2 * log_spread[..., 0]
        + 3**0.5 * aside * torch.exp(-log_spread[..., 0])
        + log_spread[..., 1]
        + 2**0.5 * away * torch.exp(-log_spread[..., 1])
    )
    return distance.mean() + uncertainty * 0.1 * unlikely.mean(), distance.mean(dim=0).detach()


def train(
    trials: Sequence[Array],
    settings: Training,
    provenance: Mapping[str, object],
    watch: Callable[[Iterable[int]], Iterable[int]] = iter,
) -> Lifter:
    """Train a lifter; the same trials, settings and libraries give the same one.

    Args:
        trials: (F, 15, 3) m, z up, 30 frames a second.
        settings: how.
        provenance: kept in the lifter, with the settings and the last mean error on examples.
        watch: wrapped around the steps.
    """
    torch.manual_seed(settings.seed)
    torch.set_flush_denormal(True)
    synthesis = Synthesis(Motions.of(trials), settings.seed)
    network = Network(settings.width, settings.blocks, settings.dropout)
    averaged = Network(settings.width, settings.blocks, 0.0).eval()
    averaged.load_state_dict(network.state_dict())
    optimiser = torch.optim.AdamW(network.parameters(), lr=settings.rate, weight_decay=settings.decay)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, settings.rate, settings.steps, pct_start=0.1)
    recent = 0.0
    for step in watch(range(1, settings.steps + 1)):
        batch = synthesis.batch(settings.batch)
        with torch.autocast('cpu', torch.bfloat16):
            out = network(torch.from_numpy(batch.features))
        objective, distance = loss(out.float(), batch, settings.uncertainty)
        optimiser.zero_grad(set_to_none=True)
        objective.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step()
        schedule.step()
        keep = min(settings.average, 1 - 1 / step)
        with torch.no_grad():
            for old, new in zip(averaged.state_dict().values(), network.state_dict().values(), strict=True):
                if old.is_floating_point():
                    old.lerp_(new, 1 - keep)
        recent += (float(distance.mean()) - recent) * max(0.01, 1 / step)
    told = {'settings': vars(settings), 'error_mm': round(recent * 1e3, 1), 'torch': torch.__version__}
    return averaged.folded({**provenance, **told})
