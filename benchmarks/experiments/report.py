"""Sections of the report: text, tables and figures of one experiment each."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import matplotlib as mpl
from common import format_table
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

# Colours of the figures, which colour-blind readers can distinguish.
WALK = '#0072b2'
RUN = '#d55e00'
JUMP = '#009e73'
PERIODIC = '#aa4499'
TRUTH = '#b0b0b0'
NEUTRAL = '#444444'
CATEGORY_COLOURS = {'walk': WALK, 'run': RUN, 'jump': JUMP, 'periodic': PERIODIC}

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


class Section:
    """Text, tables, figures and data of one experiment."""

    def __init__(self, title: str) -> None:
        self.title = title
        self.blocks: list[str] = []
        self.figures: dict[str, Figure] = {}
        self.data: dict[str, Any] = {}

    def text(self, paragraph: str) -> None:
        self.blocks.append(' '.join(paragraph.split()))

    def table(self, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
        self.blocks.append(format_table(header, rows))

    def figure(self, name: str, figure: Figure, alternative: str) -> None:
        self.figures[f'docs/img/paper/{name}.png'] = figure
        self.blocks.append(f'![{alternative}](img/paper/{name}.png)')

    def markdown(self) -> str:
        """Return what the page shows below the section's heading and introduction."""
        return '\n\n'.join(self.blocks)

    def plain(self) -> str:
        """Return the section without figures, for a terminal."""
        return '\n\n'.join([f'## {self.title}', *(b for b in self.blocks if not b.startswith('!['))])


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
