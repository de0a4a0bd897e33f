"""Pictures of the best, the median and the worst sequence under a detector: input, result, truth and error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import common
import matplotlib as mpl
import numpy as np
from reconstruction import Models, reconstruct

from experiments.detector_views import ViewOptions, make_view
from mocap_ros.config import Config
from mocap_ros.keypoints.joint_map import build_joint_map
from mocap_ros.skeleton import CMU15
from mocap_ros.viewing.plots import PlotData, draw_poses_figure, save_figure

mpl.use('Agg')
FRAMES = 6  # frames of a picture


def draw_cases(
    records: Sequence[Mapping[str, Any]],
    options: Sequence[ViewOptions],
    models: Models,
    config: Config,
    folder: Path,
) -> None:
    """Draw the best, the median and the worst case of some records, each of the view at its place in `options`."""
    folder.mkdir(parents=True, exist_ok=True)
    order = sorted(range(len(records)), key=lambda i: records[i]['mpjpe_mm'])
    for name, index in (('best', order[0]), ('median', order[len(order) // 2]), ('worst', order[-1])):
        record, chosen = records[index], options[index]
        seen = make_view(chosen)
        joints, truth = common.align_scale(reconstruct(record['way'], seen.view, models, config), seen.truth)
        k = seen.keypoints
        points, score = build_joint_map(seen.view.joint_names).apply(k[..., :2], k[..., 2])
        shown = np.concatenate([points, score[..., None]], axis=-1)
        data = PlotData(seen.times, joints, score > 0, CMU15, truth, shown, CMU15)
        frames = np.linspace(0, len(k) - 1, FRAMES + 2).astype(int)[1:-1].tolist()
        title = (
            f'{name} of {len(records)}: {chosen.trial} ({chosen.category}), {chosen.detector}, {record["way"]}: '
            f'{record["mpjpe_mm"]:.0f} mm'
        )
        labels = [f'{seen.times[f]:.1f} s' for f in frames]
        save_figure(draw_poses_figure(data, frames, title, labels), folder / f'{name}.png')
