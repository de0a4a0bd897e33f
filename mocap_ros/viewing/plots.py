"""Pictures of sequences and reconstructions (matplotlib, no display needed)."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import PercentFormatter
from numpy.typing import NDArray

from mocap_ros.errors import InputError
from mocap_ros.skeleton import Skeleton

Array = NDArray[np.float64]

LEFT, RIGHT, MIDDLE, TRUTH = '#1f77b4', '#d62728', '#444444', '#b8b8b8'
FILLED = '#ff9f1c'


@dataclass(frozen=True, eq=False)
class Result:
    """A reconstruction beside its input.

    Attributes:
        times: (F,) s.
        keypoints: (F, Jk, 3) px and score, of the layout `keypoint_skeleton`.
        joints: (F, J, 3) m, camera optical frame, NaN where there is no result.
        seen: (F, J) False where a joint was filled in.
        truth: (F, J, 3) m, or None.
    """

    times: Array
    keypoints: Array
    keypoint_skeleton: Skeleton
    joints: Array
    seen: NDArray[np.bool_]
    skeleton: Skeleton
    truth: Array | None = None


def side_colour(joint: str) -> str:
    """Blue left, red right, grey middle."""
    return {'l': LEFT, 'r': RIGHT}.get(joint[0], MIDDLE)


def draw_bones(axes: Any, points: Array, skeleton: Skeleton, colour: str | None = None, **style: Any) -> None:
    """One skeleton; `points` (J, 2), NaN where a joint is missing."""
    for parent, child in skeleton.bones:
        axes.plot(
            points[[parent, child], 0],
            points[[parent, child], 1],
            color=colour or side_colour(skeleton.joints[child]),
            solid_capstyle='round',
            **style,
        )


def from_the_side(joints: Array) -> Array:
    """(..., J, 3) camera frame -> (..., J, 2) as seen from the person's left of the image: depth to the right."""
    return np.stack([joints[..., 2], joints[..., 1]], axis=-1)


def poses_figure(result: Result, frames: Sequence[int], title: str, labels: Sequence[str]) -> Figure:
    """Some frames: the 2D input above, the 3D result from the camera and from the side below.

    Args:
        result: what to draw.
        frames: indices of the frames.
        title: of the figure.
        labels: one a frame, shown above its column.
    """
    error = _error_mm(result)
    rows = 3 + (error is not None)
    figure = Figure(figsize=(2.1 * len(frames) + 0.6, 2.35 * rows + 0.4), dpi=110)
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(rows, len(frames), hspace=0.08, wspace=0.05, top=0.88)
    radius = _radius(result, frames)
    for column, frame in enumerate(frames):
        top = figure.add_subplot(grid[0, column])
        _draw_input(top, result, frame)
        top.set_title(labels[column], fontsize=9)
        views = (
            (lambda j: j[..., :2], 'from the camera'),
            (from_the_side, 'from the side'),
        )
        for row, (view, name) in enumerate(views, start=1):
            axes = figure.add_subplot(grid[row, column])
            _draw_pose(axes, result, frame, view, radius)
            if column == 0:
                axes.set_ylabel(f'3D, {name}', fontsize=9)
        if column == 0:
            top.set_ylabel('2D input', fontsize=9)
    if error is not None:
        _draw_error(figure.add_subplot(grid[3, :]), result, error, frames)
    figure.suptitle(title, fontsize=11, y=0.97, parse_math=False)
    figure.legend(
        handles=_legend(result),
        loc='upper center',
        bbox_to_anchor=(0.5, 0.955),
        ncols=5,
        fontsize=9,
        frameon=False,
    )
    return figure


def _legend(result: Result) -> list[Line2D]:
    """What the colours of the skeletons mean."""
    bones = {'left': LEFT, 'right': RIGHT, 'middle': MIDDLE}
    handles = [Line2D([], [], color=colour, linewidth=1.8, label=side) for side, colour in bones.items()]
    if result.truth is not None:
        handles.append(Line2D([], [], color=TRUTH, linewidth=4, label='truth'))
    label = 'not seen, filled in by the model'
    handles.append(Line2D([], [], linestyle='', marker='o', markersize=4, color=FILLED, label=label))
    return handles


def _draw_input(axes: Any, result: Result, frame: int) -> None:
    keypoints = result.keypoints[frame]
    points = np.where(keypoints[:, 2:] > 0, keypoints[:, :2], np.nan)
    draw_bones(axes, points, result.keypoint_skeleton, linewidth=1.6)
    axes.scatter(points[:, 0], points[:, 1], s=5, color='black', zorder=3)
    seen = points[np.isfinite(points).all(axis=1)]
    if len(seen):
        centre = (seen.min(axis=0) + seen.max(axis=0)) / 2
        half = max(np.ptp(seen, axis=0).max(), 1.0) * 0.6
        axes.set_xlim(centre[0] - half, centre[0] + half)
        axes.set_ylim(centre[1] + half, centre[1] - half)
    else:
        axes.text(0.5, 0.5, 'not detected', ha='center', va='center', transform=axes.transAxes)
    _bare(axes)


def _draw_pose(axes: Any, result: Result, frame: int, view: Any, radius: float) -> None:
    joints = result.joints[frame]
    if result.truth is not None:
        truth = result.truth[frame]
        draw_bones(axes, view(truth - truth.mean(axis=0)), result.skeleton, TRUTH, linewidth=4)
    if np.isfinite(joints).all():
        points = view(joints - joints.mean(axis=0))
        draw_bones(axes, points, result.skeleton, linewidth=1.8)
        filled = points[~result.seen[frame]]
        axes.scatter(filled[:, 0], filled[:, 1], s=16, color=FILLED, zorder=3)
    axes.set_xlim(-radius, radius)
    axes.set_ylim(radius, -radius)
    _bare(axes)


def _draw_error(axes: Any, result: Result, error: Array, frames: Sequence[int]) -> None:
    (line,) = axes.plot(result.times, error, color='black', linewidth=1, label='3D error')
    marks = [axes.axvline(result.times[f], color=TRUTH, linewidth=1, label='frames above') for f in frames]
    if len(result.times) > 1:
        axes.set_xlim(result.times[0], result.times[-1])
    axes.set_ylim(0, None)
    axes.set_xlabel('time, s', fontsize=9)
    axes.set_ylabel('3D error, mm', fontsize=9)

    share = axes.twinx()
    missing = (~result.seen).mean(axis=1)
    share.fill_between(result.times, 0, missing, color=FILLED, alpha=0.35, linewidth=0)
    band = Patch(color=FILLED, alpha=0.35, linewidth=0, label='joints not seen')
    share.set_ylim(0, 1)
    share.yaxis.set_major_formatter(PercentFormatter(1.0))
    share.set_ylabel('joints not seen', fontsize=9)
    share.legend(
        handles=[line, band, *marks[:1]],
        loc='lower left',
        bbox_to_anchor=(0, 0.97),
        ncols=3,
        fontsize=8,
        frameon=False,
    )
    axes.set_zorder(share.get_zorder() + 1)
    axes.patch.set_visible(False)
    for each in (axes, share):
        each.tick_params(labelsize=8)
        each.spines['top'].set_visible(False)


def _error_mm(result: Result) -> Array | None:
    if result.truth is None:
        return None
    centred = result.joints - result.joints.mean(axis=1, keepdims=True)
    truth = result.truth - result.truth.mean(axis=1, keepdims=True)
    return np.asarray(np.linalg.norm(centred - truth, axis=-1).mean(axis=1) * 1e3)


def _radius(result: Result, frames: Sequence[int]) -> float:
    chosen = result.joints[list(frames)] if result.truth is None else result.truth[list(frames)]
    centred = chosen - chosen.mean(axis=1, keepdims=True)
    return float(np.nanmax(np.abs(centred), initial=0.5)) * 1.03


def _bare(axes: Any) -> None:
    axes.set_aspect('equal')
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(False)


def check_ending(path: Path) -> None:
    """Refuse a path whose ending is no format of pictures.

    Raises:
        InputError: it is none; lists them.
    """
    known = sorted(FigureCanvasAgg.get_supported_filetypes())
    if path.suffix.removeprefix('.').lower() not in known:
        raise InputError(f'{path}: no picture; can write {", ".join("." + ending for ending in known)}')


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure; the ending of `path` chooses the format.

    Raises:
        InputError: it is no format of pictures.
        OSError: it cannot be written.
    """
    check_ending(path)
    with warnings.catch_warnings():
        warnings.filterwarnings('ignore', 'Glyph .* missing from', UserWarning)  # file names in any script
        figure.savefig(path, bbox_inches='tight', facecolor='white')
