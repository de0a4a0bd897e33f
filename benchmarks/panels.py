# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Pictures of the benchmarks: panels in one style, and colours that colour-blind readers can distinguish."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

WALK = '#0072b2'
RUN = '#d55e00'
JUMP = '#009e73'
PERIODIC = '#aa4499'
TRUTH = '#b0b0b0'
NEUTRAL = '#444444'
COLOURS = {'walk': WALK, 'run': RUN, 'jump': JUMP, 'periodic': PERIODIC}  # of the kinds of motion

mpl.rcParams.update(
    {
        'font.size': 9,
        'axes.titlesize': 9,
        'axes.spines.top': False,
        'axes.spines.right': False,
        'axes.grid': True,
        'grid.color': '#e4e4e4',
        'grid.linewidth': 0.6,
        'lines.linewidth': 1.4,
        'lines.markersize': 3.5,
        'legend.frameon': False,
        'legend.fontsize': 8,
    }
)


def make_panels(
    columns: int, width: float = 7.4, height: float = 2.7, rows: int = 1, **options: Any
) -> tuple[Figure, Any]:
    """Make a figure, and return it with its axes, (columns,) or (rows, columns)."""
    figure = Figure(figsize=(width, height), dpi=110, layout='constrained')
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns, squeeze=False, **options)
    return figure, axes[0] if rows == 1 else axes


def label_axes(axes: Any, x: str, y: str, title: str = '') -> None:
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.set_title(title, loc='left')


def draw_curves(
    axes: Any, x: ArrayLike, curves: Mapping[str, ArrayLike], colours: Sequence[str], marker: str = 'o-'
) -> None:
    """Draw named curves over the same x, one for each of the colours."""
    for (name, y), colour in zip(curves.items(), colours, strict=True):
        axes.plot(x, y, marker, color=colour, label=name)


def draw_weights(panels: Sequence[Any], times: ArrayLike, weights: Mapping[str, Any]) -> None:
    """Draw the weights (F, 4 or more) m of the first four base poses, in a panel for each kind, with a legend."""
    for ax, (title, theta) in zip(panels, weights.items(), strict=True):
        named = {f'base pose {k + 1}': theta[:, k] for k in range(4)}
        draw_curves(ax, times, named, (WALK, RUN, JUMP, NEUTRAL), '-')
        label_axes(ax, 'time, s', 'weight, m' if ax is panels[0] else '', title)
    panels[0].figure.legend(*panels[0].get_legend_handles_labels(), loc='outside lower center', ncols=4)
