# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The figures of a soak: growth of memory and times, by themselves and in units of a fixed calculation."""

from __future__ import annotations

import numpy as np
import pytest
from soak import HOUR_S, SAMPLE_S, Samples, summarise

HOURS = 4.0


def make_samples(*, node_growth: float, machine_growth: float, memory_growth: float) -> Samples:
    """Return samples of a run in whose second half all times and the memory have grown, by shares."""
    samples, cpu_s = Samples(), 0.0
    for now_s in np.arange(0.0, HOURS * HOUR_S, SAMPLE_S):
        is_late = now_s >= HOURS * HOUR_S / 2
        slower = (1 + machine_growth) if is_late else 1.0
        latency_ms = 8.0 * slower * ((1 + node_growth) if is_late else 1.0)
        memory_mb = 300.0 * ((1 + memory_growth) if is_late else 1.0)
        samples.node.append((now_s, memory_mb, 20, 30, cpu_s))
        samples.reference.append(3.0 * slower)
        samples.latencies += [(now_s + t, latency_ms) for t in np.arange(0.0, SAMPLE_S, 1.0)]
        cpu_s += latency_ms * 1e-3 * SAMPLE_S * 30
    return samples


@pytest.mark.parametrize('node_growth', [0.0, 0.2])
@pytest.mark.parametrize('machine_growth', [0.0, 0.3, -0.2])
def test_growth_in_units_is_that_of_the_node_alone(node_growth: float, machine_growth: float) -> None:
    samples = make_samples(node_growth=node_growth, machine_growth=machine_growth, memory_growth=0.05)
    found = summarise(samples, HOURS * HOUR_S)
    both = 100 * ((1 + node_growth) * (1 + machine_growth) - 1)
    assert found['p99_growth_percent'] == pytest.approx(both, abs=0.1)
    assert found['cpu_growth_percent'] == pytest.approx(both, abs=0.1)
    assert found['reference_growth_percent'] == pytest.approx(100 * machine_growth, abs=0.1)
    assert found['p99_growth_percent_in_units'] == pytest.approx(100 * node_growth, abs=0.1)
    assert found['cpu_growth_percent_in_units'] == pytest.approx(100 * node_growth, abs=0.1)
    assert found['memory_growth_percent'] == pytest.approx(5.0, abs=0.1)
