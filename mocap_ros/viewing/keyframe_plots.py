"""Pictures of the keyframes of a sequence, as figures 3, 4 and 6 of Loy et al. 2004 (matplotlib, no display)."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from mocap_ros.offline.keyframes.keyframe_set import Keyframes
from mocap_ros.offline.keyframes.observations import Observed
from mocap_ros.skeleton import CMU15
from mocap_ros.viewing.plots import TRUTH, side_colour

Array = NDArray[np.float64]

COLUMNS, MOST_SHOWN = 12, 36
LARGEST_PICTURE = 1200
SHADES = 'Greys_r'


def keyframes_figure(observed: Observed, keyframes: tuple[Keyframes, Keyframes], title: str) -> Figure:
    """The keyframes of both halves as skeletons, and which of them is nearest to each frame over time.

    Of more than `MOST_SHOWN` keyframes of a half those are drawn that represent most frames. They are numbered by
    their time in the sequence.
    """
    shown = [_shown(half) for half in keyframes]
    rows = [max(-(-len(s) // COLUMNS), 1) for s in shown]
    figure = Figure(figsize=(13, 1.35 * sum(rows) + 2 * 2.4), dpi=100, layout='constrained')
    FigureCanvasAgg(figure)
    heights = [h for count in rows for h in (1.35 * count, 2.4)]
    parts: Any = figure.subfigures(4, 1, height_ratios=heights)
    for half, chosen, above, below in zip(keyframes, shown, parts[::2], parts[1::2], strict=True):
        _draw_skeletons(above, observed, half, chosen)
        _draw_occurrence(below.subplots(), observed.times, half)
    figure.suptitle(title, fontsize=11, parse_math=False)
    return figure


def _shown(half: Keyframes) -> NDArray[np.intp]:
    """Numbers of the keyframes to draw, by time."""
    often = np.bincount(half.nearest[half.well], minlength=len(half.frames))[half.by_time]
    return np.sort(np.argsort(-often, kind='stable')[:MOST_SHOWN])


def _draw_skeletons(figure: Any, observed: Observed, half: Keyframes, numbers: NDArray[np.intp]) -> None:
    count = len(half.frames)
    left_out = f'; the {len(numbers)} that represent most frames' if count > len(numbers) else ''
    figure.suptitle(
        f'{count} keyframes of the {half.half.name} body, {half.coverage:.0%} of frames covered{left_out}',
        fontsize=10,
        x=0.01,
        ha='left',
    )
    rows = max(-(-len(numbers) // COLUMNS), 1)
    grid = figure.subplots(rows, COLUMNS, squeeze=False).ravel()
    for axes in grid:
        axes.set_axis_off()
    for axes, number in zip(grid, numbers, strict=False):
        frame = half.frames[half.by_time[number]]
        points = np.where(observed.weight[frame][:, None] > 0, observed.points[frame], np.nan)
        for parent, child in CMU15.bones:
            own = (parent, child) in half.half.bones
            colour = side_colour(CMU15.joints[child]) if own else TRUTH
            axes.plot(*points[[parent, child]].T, color=colour, linewidth=2.0 if own else 1.0)
        time = observed.times[frame] - observed.times[0]
        axes.set_title(f'{number}: {time:.1f} s', fontsize=7, pad=1)
        axes.set_aspect('equal', adjustable='datalim')
        axes.invert_yaxis()


def _draw_occurrence(axes: Any, times: Array, half: Keyframes) -> None:
    number = np.append(np.argsort(half.by_time), -1)[half.nearest]
    at = times - times[0]
    for chosen, colour, label in (
        (half.well, '#1f77b4', 'well represented'),
        (half.seen & half.covered & ~half.well, '#ff9f1c', 'between: interpolated'),
        (half.seen & ~half.covered, '#d62728', 'not covered'),
    ):
        axes.plot(at[chosen], number[chosen], '.', markersize=3, color=colour, label=label)
    own = half.frames[half.by_time]
    axes.plot(at[own], np.arange(len(own)), 'k|', markersize=6, label='keyframe')
    axes.set_xlim(at[0], max(at[-1], at[0] + 1e-3))
    axes.set_xlabel('time, s', fontsize=9)
    axes.set_ylabel('nearest keyframe', fontsize=9)
    axes.legend(loc='upper left', bbox_to_anchor=(1, 1), fontsize=8, frameon=False, markerscale=2)
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    axes.tick_params(labelsize=8)
    for side in ('top', 'right'):
        axes.spines[side].set_visible(False)


def distances_figure(
    observed: Observed, keyframes: tuple[Keyframes, Keyframes], beta: float, title: str
) -> Figure:
    """The distance matrices of both halves, dark where poses are alike."""
    figure = Figure(figsize=(13, 6.2), dpi=100, layout='constrained')
    FigureCanvasAgg(figure)
    for axes, half in zip(figure.subplots(1, 2), keyframes, strict=True):
        frames = half.matrix_frames
        if not len(frames):
            axes.set_title(f'{half.half.name} body: never seen', fontsize=10)
            axes.set_axis_off()
            continue
        step = max(-(-len(frames) // LARGEST_PICTURE), 1)
        times = observed.times[frames[::step]] - observed.times[0]
        edges = np.append(times, 2 * times[-1] - times[-2] if len(times) > 1 else times[-1] + 1)
        most = float(np.percentile(half.matrix[::step, ::step], 99))
        mesh = axes.pcolormesh(
            edges, edges, half.matrix[::step, ::step], cmap=SHADES, vmin=0, vmax=max(most, beta), rasterized=True
        )
        axes.set_aspect('equal')
        axes.invert_yaxis()
        part = f', the first {times[-1]:.0f} s' if len(frames) < half.seen.sum() else ''
        axes.set_title(f'{half.half.name} body{part}', fontsize=10)
        axes.set_xlabel('time, s', fontsize=9)
        axes.set_ylabel('time, s', fontsize=9)
        axes.tick_params(labelsize=8)
        bar = figure.colorbar(mesh, ax=axes, shrink=0.8)
        bar.set_label('distance, torso lengths', fontsize=9)
        bar.ax.axhline(beta, color='#d62728')
    figure.suptitle(title, fontsize=11, parse_math=False)
    return figure
