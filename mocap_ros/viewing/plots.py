# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Figures of sequences and reconstructions (matplotlib, without a display)."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import PercentFormatter
from numpy.typing import NDArray

from mocap_ros.arrays import Array
from mocap_ros.errors import InputError
from mocap_ros.skeleton import CMU15, CORE_COUNT, Skeleton

LEFT_COLOUR = '#1f77b4'  # blue
RIGHT_COLOUR = '#d62728'  # red
MIDDLE_COLOUR = '#444444'  # dark grey
TRUTH_COLOUR = '#b8b8b8'  # light grey, behind the other colours
INFERRED_COLOUR = '#ff9f1c'  # orange; joints that were not seen
BINS = 30  # bars of a histogram; few enough to be seen in a panel of 8 cm
MIN_RADIUS_M = 0.5  # m; half the width of a panel at least, so that a curled-up body is not magnified
RADIUS_MARGIN = 1.03  # factor; keeps the outermost joints inside the panel
IMAGE_MARGIN = 0.6  # half the width of an input panel divided by the size of the body's image
FORMATS_OF_OTHERS = frozenset(('pgf',))  # picture formats for which matplotlib runs a program, here TeX
MIN_IMAGE_SIZE_PX = 1.0  # px; guards the panel's limits if all keypoints are in one place


@dataclass(frozen=True, eq=False)
class PlotData:
    """A reconstruction with its input, to be drawn."""

    times: Array  # (F,) s
    joints: Array  # (F, J, 3) m, camera optical frame; NaN in frames without a result
    seen: NDArray[np.bool_]  # (F, J) True where a joint was seen, False where it was inferred
    skeleton: Skeleton  # of the joints
    truth: Array | None = None  # (F, J, 3) m, same joints
    keypoints: Array | None = None  # (F, Jk, 3) x and y in px, and confidence score; None to draw no 2D input
    keypoint_skeleton: Skeleton = CMU15  # layout of the keypoints
    projected: Array | None = None  # (F, J, 2) px, the joints in the image; drawn where an image is behind them
    images: Mapping[int, NDArray[np.uint8]] = field(default_factory=dict)  # (H, W, 3) of some frames, by frame
    # (3, 3) rotation from the camera's optical frame to that of a level camera
    to_level: Array = field(default_factory=lambda: np.eye(3))


def make_printable(name: str) -> str:
    """Return the name of a file with bytes that are no UTF-8 written as escapes."""
    return name.encode('utf-8', 'backslashreplace').decode()


def choose_side_colour(joint: str) -> str:
    """Return the colour of a joint's side by its name: blue for left, red for right, grey for the middle."""
    return {'l': LEFT_COLOUR, 'r': RIGHT_COLOUR}.get(joint[0], MIDDLE_COLOUR)


def draw_bones(axes: Any, points: Array, skeleton: Skeleton, colour: str | None = None, **style: Any) -> None:
    """Draw the bones of points (J, 2) in a colour, or in those of their sides; `style` is that of `axes.plot`."""
    for parent, child in skeleton.bones:
        axes.plot(
            points[[parent, child], 0],
            points[[parent, child], 1],
            color=colour or choose_side_colour(skeleton.joints[child]),
            solid_capstyle='round',
            **style,
        )


def draw_poses_figure(data: PlotData, frames: Sequence[int], title: str, labels: Sequence[str]) -> Figure:
    """Draw some frames in columns with labels: the 2D input, then the 3D result from the camera and from the side.

    The 2D input is left out where it is not known. Below is the error over time, where the truth is known.
    """
    error_mm = _compute_error_mm(data)
    has_input = data.keypoints is not None
    rows = 2 + has_input + (error_mm is not None)
    figure = Figure(figsize=(2.1 * len(frames) + 0.6, 2.35 * rows + 0.4), dpi=110)
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(rows, len(frames), hspace=0.08, wspace=0.05, top=0.88)
    poses = (data.joints if data.truth is None else data.truth)[list(frames)]
    centred = np.stack([_centre(poses), _centre(poses) @ data.to_level.T])
    radius = float(np.nanmax(np.abs(centred), initial=MIN_RADIUS_M)) * RADIUS_MARGIN
    side_axes = data.to_level[[2, 1]].T
    projections = ((lambda j: j[..., :2], 'from the camera'), (lambda j: j @ side_axes, 'from the side'))
    for column, frame in enumerate(frames):
        panels = [figure.add_subplot(grid[row, column]) for row in range(2 + has_input)]
        panels[0].set_title(labels[column], fontsize=9)
        if data.keypoints is not None:
            _draw_input(panels[0], data, data.keypoints[frame], frame)
        for axes, (projection, _) in zip(panels[has_input:], projections, strict=True):
            _draw_pose(axes, data, frame, projection, radius)
        if column == 0:
            names = ['2D input'] * has_input + [f'3D, {name}' for _, name in projections]
            for axes, name in zip(panels, names, strict=True):
                axes.set_ylabel(name, fontsize=9)
    if error_mm is not None:
        _draw_error(figure.add_subplot(grid[-1, :]), data, error_mm, frames)
    figure.suptitle(make_printable(title), fontsize=11, y=0.97, parse_math=False)
    colours = {'left': LEFT_COLOUR, 'right': RIGHT_COLOUR, 'middle': MIDDLE_COLOUR}
    handles = [Line2D([], [], color=colour, linewidth=1.8, label=side) for side, colour in colours.items()]
    if data.truth is not None:
        handles.append(Line2D([], [], color=TRUTH_COLOUR, linewidth=4, label='truth'))
    dot: dict[str, Any] = {'linestyle': '', 'marker': 'o', 'markersize': 4, 'color': INFERRED_COLOUR}
    handles.append(Line2D([], [], label='not seen, filled in by the model', **dot))
    place: dict[str, Any] = {'loc': 'upper center', 'bbox_to_anchor': (0.5, 0.955)}
    figure.legend(handles=handles, ncols=5, fontsize=9, frameon=False, **place)
    return figure


def _draw_input(axes: Any, data: PlotData, keypoints: Array, frame: int) -> None:
    """Draw the keypoints (J, 3) of one frame, or where there is an image this, the joints and the keypoints."""
    points = np.where(keypoints[:, 2:] > 0, keypoints[:, :2], np.nan)
    if frame in data.images and data.projected is not None:
        axes.imshow(data.images[frame])
        draw_bones(axes, data.projected[frame], data.skeleton, linewidth=2)
    else:
        draw_bones(axes, points, data.keypoint_skeleton, linewidth=1.6)
    axes.scatter(points[:, 0], points[:, 1], s=5, color='black', zorder=3)
    seen = points[np.isfinite(points).all(axis=1)]
    if len(seen):
        centre = (seen.min(axis=0) + seen.max(axis=0)) / 2
        half_width = max(np.ptp(seen, axis=0).max(), MIN_IMAGE_SIZE_PX) * IMAGE_MARGIN
        axes.set_xlim(centre[0] - half_width, centre[0] + half_width)
        axes.set_ylim(centre[1] + half_width, centre[1] - half_width)
    else:
        axes.text(0.5, 0.5, 'not detected', ha='center', va='center', transform=axes.transAxes)
    _remove_frame(axes)


def _draw_pose(axes: Any, data: PlotData, frame: int, projection: Any, radius: float) -> None:
    joints = data.joints[frame]
    if data.truth is not None:
        truth = data.truth[frame]
        draw_bones(axes, projection(_centre(truth)), data.skeleton, TRUTH_COLOUR, linewidth=4)
    if np.isfinite(joints).all():
        points = projection(_centre(joints))
        draw_bones(axes, points, data.skeleton, linewidth=1.8)
        inferred = points[~data.seen[frame]]
        axes.scatter(inferred[:, 0], inferred[:, 1], s=16, color=INFERRED_COLOUR, zorder=3)
    else:
        axes.text(0.5, 0.5, 'no skeleton', ha='center', va='center', transform=axes.transAxes)
    axes.set_xlim(-radius, radius)
    axes.set_ylim(radius, -radius)
    _remove_frame(axes)


def _draw_error(axes: Any, data: PlotData, error_mm: Array, frames: Sequence[int]) -> None:
    (line,) = axes.plot(data.times, error_mm, color='black', linewidth=1, label='3D error')
    drawn = [axes.axvline(data.times[f], color=TRUTH_COLOUR, linewidth=1, label='frames above') for f in frames]
    if len(data.times) > 1:
        axes.set_xlim(data.times[0], data.times[-1])
    axes.set_ylim(0, None)
    axes.set_xlabel('time, s', fontsize=9)
    axes.set_ylabel('3D error, mm', fontsize=9)
    share_axes = axes.twinx()
    style: dict[str, Any] = {'color': INFERRED_COLOUR, 'alpha': 0.35, 'linewidth': 0}
    share_axes.fill_between(data.times, 0, (~data.seen).mean(axis=1), **style)
    share_axes.set_ylim(0, 1)
    share_axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    share_axes.set_ylabel('joints not seen', fontsize=9)
    handles = [line, Patch(label='joints not seen', **style), *drawn[:1]]
    place: dict[str, Any] = {'loc': 'lower left', 'bbox_to_anchor': (0, 0.97)}
    share_axes.legend(handles=handles, ncols=3, fontsize=8, frameon=False, **place)
    axes.set_zorder(share_axes.get_zorder() + 1)
    axes.patch.set_visible(False)
    for panel in (axes, share_axes):
        panel.tick_params(labelsize=8)
        panel.spines['top'].set_visible(False)


def _compute_error_mm(data: PlotData) -> Array | None:
    """Return (F,) mm, the mean error of the centred joints in each frame, or None without truth."""
    if data.truth is None:
        return None
    core = slice(None) if np.isfinite(data.truth).any(axis=(0, 2)).all() else slice(CORE_COUNT)
    error = np.linalg.norm(_centre(data.joints) - _centre(data.truth), axis=-1)
    return np.asarray(error[:, core].mean(axis=1) * 1e3)


def _centre(poses: Array) -> Array:
    return np.asarray(poses - poses[..., :CORE_COUNT, :].mean(axis=-2, keepdims=True))


def _remove_frame(axes: Any) -> None:
    axes.set_aspect('equal')
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(False)


def draw_corpus_figure(
    seconds: Mapping[str, float], cadences: Sequence[float], residuals: Sequence[float], work: Sequence[float]
) -> Figure:
    """Draw a run over many recordings.

    `seconds` are those of all people by kind of motion, `cadences` (Hz) those of appearances in periodic motion,
    `residuals` (px) those of all appearances, and `work` the CPU seconds of each recording.
    """
    figure = Figure(figsize=(9, 5.5), layout='constrained')
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 2)
    bars, cadence, residual, cost = axes.flat
    bars.barh(list(seconds), [s / 60 for s in seconds.values()], color=LEFT_COLOUR)
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
            panel.hist(np.asarray(values, float), bins=BINS, color=LEFT_COLOUR)
        else:
            panel.text(0.5, 0.5, 'none', ha='center', transform=panel.transAxes)
    return figure


def check_picture_format(path: Path, *others: str) -> None:
    """Check that the suffix of a path names a picture format; the error lists others as well."""
    formats = [f'.{name}' for name in sorted(FigureCanvasAgg.get_supported_filetypes().keys() - FORMATS_OF_OTHERS)]
    if path.suffix.lower() not in formats:
        raise InputError(f'{path}: unknown file type; expected {", ".join([*others, *formats])}')


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure in the picture format that the suffix of `path` names."""
    with warnings.catch_warnings():
        # a title may hold a file name in any script, and the font may lack its glyphs
        warnings.filterwarnings('ignore', 'Glyph .* missing from', UserWarning)
        figure.savefig(path, bbox_inches='tight', facecolor='white')
