# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A picture of a run over many recordings: who was seen in which motion, how well it fitted, and what it cost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

COLOUR = '#1f77b4'  # blue
BINS = 30  # bars of a histogram; few enough to be seen in a panel of 8 cm


def draw_corpus_figure(
    seconds: Mapping[str, float], cadences: Sequence[float], residuals: Sequence[float], work: Sequence[float]
) -> Figure:
    """Draw the picture of a run.

    Args:
        seconds: s of all people in each kind of motion, by its name.
        cadences: Hz, of each appearance in periodic motion.
        residuals: px, of each appearance.
        work: CPU seconds of each recording.
    """
    figure = Figure(figsize=(9, 5.5), layout='constrained')
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 2)
    bars, cadence, residual, cost = axes.flat
    bars.barh(list(seconds), [s / 60 for s in seconds.values()], color=COLOUR)
    bars.set_title('people by motion')
    bars.set_xlabel('min')
    panels = (
        (cadence, cadences, 'cadence of walking and running', 'Hz', 'appearances'),
        (residual, residuals, 'mean reprojection error', 'px', 'appearances'),
        (cost, work, 'work on a recording', 'CPU s', 'recordings'),
    )
    for panel, values, title, unit, counted in panels:
        panel.set_title(title)
        panel.set_xlabel(unit)
        panel.set_ylabel(counted)
        if len(values):
            panel.yaxis.get_major_locator().set_params(integer=True)
            panel.hist(np.asarray(values, float), bins=BINS, color=COLOUR)
        else:
            panel.text(0.5, 0.5, 'none', ha='center', transform=panel.transAxes)
    return figure
