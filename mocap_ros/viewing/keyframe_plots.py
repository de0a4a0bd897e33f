# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Figures of the keyframes of a sequence, after figures 3, 4 and 6 of Loy et al. 2004 (matplotlib, no display)."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.offline.keyframes.keyframe_set import KeyframeSet
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.observed_window import ObservedWindow
from mocap_ros.viewing.plots import TRUTH_COLOUR, choose_side_colour, make_printable

COLUMNS = 12  # skeletons in a row; more would be too small to recognise
MAX_DRAWN_KEYFRAMES = 36  # keyframes of one half: three rows
MAX_MATRIX_PIXELS = 1200  # rows and columns drawn of a distance matrix, more than the figure has pixels for it
FIGURE_WIDTH = 13.0  # inches
SKELETON_HEIGHT = 1.35  # inches, of a row of skeletons
OCCURRENCE_HEIGHT = 2.4  # inches, of the plot of nearest keyframes
DISTANCE_COLOURS = 'Greys_r'  # colour map; dark where poses are alike, as in the paper's figure 3
DISTANCE_PERCENTILE = 99  # %; the lightest colour, so that a few large distances do not darken all others
WELL_REPRESENTED_COLOUR = '#1f77b4'  # blue
INTERPOLATABLE_COLOUR = '#ff9f1c'  # orange
UNCOVERED_COLOUR = '#d62728'  # red
BETA_COLOUR = '#d62728'  # red


def draw_keyframes_figure(
    observed: ObservedWindow, keyframes: tuple[KeyframeSet, KeyframeSet], title: str
) -> Figure:
    """Draw the keyframes of both halves as skeletons, and over time which keyframe is nearest to each frame.

    At most `MAX_DRAWN_KEYFRAMES` keyframes of a half are drawn, those that represent most frames. Keyframes are
    numbered by time; `observed` holds the image points without suspect points.
    """
    drawn = [_choose_drawn_keyframes(half) for half in keyframes]
    rows = [max(-(-len(numbers) // COLUMNS), 1) for numbers in drawn]
    figure_height = SKELETON_HEIGHT * sum(rows) + 2 * OCCURRENCE_HEIGHT
    figure = Figure(figsize=(FIGURE_WIDTH, figure_height), dpi=100, layout='constrained')
    FigureCanvasAgg(figure)
    heights = [h for count in rows for h in (SKELETON_HEIGHT * count, OCCURRENCE_HEIGHT)]
    panels: Any = figure.subfigures(4, 1, height_ratios=heights)
    for half, numbers, upper, lower in zip(keyframes, drawn, panels[::2], panels[1::2], strict=True):
        _draw_skeletons(upper, observed, half, numbers)
        _draw_occurrence(lower.subplots(), observed.times, half)
    figure.suptitle(make_printable(title), fontsize=11, parse_math=False)
    return figure


def _choose_drawn_keyframes(half: KeyframeSet) -> NDArray[np.intp]:
    order = half.chronological_order
    frame_count = np.bincount(half.nearest[half.well_represented], minlength=len(half.frames))[order]
    return np.sort(np.argsort(-frame_count, kind='stable')[:MAX_DRAWN_KEYFRAMES])


def _draw_skeletons(figure: Any, observed: ObservedWindow, half: KeyframeSet, numbers: NDArray[np.intp]) -> None:
    """Draw the keyframes of the given numbers, the half's own bones in colour."""
    count = len(half.frames)
    left_out = f'; the {len(numbers)} that represent most frames' if count > len(numbers) else ''
    figure.suptitle(
        f'{count} keyframes of the {half.body_half.name} body, {half.coverage:.0%} of frames covered{left_out}',
        fontsize=10,
        x=0.01,
        ha='left',
    )
    rows = max(-(-len(numbers) // COLUMNS), 1)
    grid = figure.subplots(rows, COLUMNS, squeeze=False).ravel()
    for axes in grid:
        axes.set_axis_off()
    for axes, number in zip(grid, numbers, strict=False):
        frame = half.frames[half.chronological_order[number]]
        points = np.where(observed.weight[frame][:, None] > 0, observed.points[frame], np.nan)
        for parent, child in CMU15.bones:
            is_in_half = (parent, child) in half.body_half.bones
            colour = choose_side_colour(CMU15.joints[child]) if is_in_half else TRUTH_COLOUR
            axes.plot(*points[[parent, child]].T, color=colour, linewidth=2.0 if is_in_half else 1.0)
        time_s = observed.times[frame] - observed.times[0]
        axes.set_title(f'{number}: {time_s:.1f} s', fontsize=7, pad=1)
        axes.set_aspect('equal', adjustable='datalim')
        axes.invert_yaxis()


def _draw_occurrence(axes: Any, times: Array, half: KeyframeSet) -> None:
    number = np.append(np.argsort(half.chronological_order), -1)[half.nearest]
    elapsed = times - times[0]
    for frames, colour, label in (
        (half.well_represented, WELL_REPRESENTED_COLOUR, 'well represented'),
        (half.has_pose & half.covered & ~half.well_represented, INTERPOLATABLE_COLOUR, 'between: interpolated'),
        (half.has_pose & ~half.covered, UNCOVERED_COLOUR, 'not covered'),
    ):
        axes.plot(elapsed[frames], number[frames], '.', markersize=3, color=colour, label=label)
    keyframes = half.frames[half.chronological_order]
    axes.plot(elapsed[keyframes], np.arange(len(keyframes)), 'k|', markersize=6, label='keyframe')
    axes.set_xlim(elapsed[0], max(elapsed[-1], elapsed[0] + 1e-3))
    axes.set_xlabel('time, s', fontsize=9)
    axes.set_ylabel('nearest keyframe', fontsize=9)
    axes.legend(loc='upper left', bbox_to_anchor=(1, 1), fontsize=8, frameon=False, markerscale=2)
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    axes.tick_params(labelsize=8)
    for side in ('top', 'right'):
        axes.spines[side].set_visible(False)


def draw_distances_figure(
    observed: ObservedWindow, keyframes: tuple[KeyframeSet, KeyframeSet], beta: float, title: str
) -> Figure:
    """Draw the distance matrices D of both halves, dark where poses are alike (figure 3).

    The distance `beta`, in torso lengths, is marked on the colour bar.
    """
    figure = Figure(figsize=(FIGURE_WIDTH, 6.2), dpi=100, layout='constrained')
    FigureCanvasAgg(figure)
    for axes, half in zip(figure.subplots(1, 2), keyframes, strict=True):
        frames = half.matrix_frames
        if not len(frames):
            axes.set_title(f'{half.body_half.name} body: never seen', fontsize=10)
            axes.set_axis_off()
            continue
        step = max(-(-len(frames) // MAX_MATRIX_PIXELS), 1)
        times = observed.times[frames[::step]] - observed.times[0]
        edges = np.append(times, 2 * times[-1] - times[-2] if len(times) > 1 else times[-1] + 1)
        matrix = half.distance_matrix[::step, ::step]
        lightest = max(float(np.percentile(matrix, DISTANCE_PERCENTILE)), beta)
        mesh = axes.pcolormesh(edges, edges, matrix, cmap=DISTANCE_COLOURS, vmin=0, vmax=lightest, rasterized=True)
        axes.set_aspect('equal')
        axes.invert_yaxis()
        extent = f', the first {times[-1]:.0f} s' if len(frames) < half.has_pose.sum() else ''
        axes.set_title(f'{half.body_half.name} body{extent}', fontsize=10)
        axes.set_xlabel('time, s', fontsize=9)
        axes.set_ylabel('time, s', fontsize=9)
        axes.tick_params(labelsize=8)
        bar = figure.colorbar(mesh, ax=axes, shrink=0.8)
        bar.set_label('distance, torso lengths', fontsize=9)
        bar.ax.axhline(beta, color=BETA_COLOUR)
    figure.suptitle(make_printable(title), fontsize=11, parse_math=False)
    return figure
