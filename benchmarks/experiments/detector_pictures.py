# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Pictures of single sequences under a detector: input, result, truth and error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import common
import matplotlib as mpl
import numpy as np
from common import View
from numpy.typing import NDArray
from reconstruction import Models, reconstruct

from experiments.detector_views import ViewOptions, make_view
from mocap_ros.config import Config
from mocap_ros.keypoints.joint_map import build_joint_map
from mocap_ros.skeleton import CMU15
from mocap_ros.viewing.plots import PlotData, draw_poses_figure, save_figure

mpl.use('Agg')
Array = NDArray[np.float64]
FRAMES = 6  # frames of a picture


def draw_case(view: View, joints: Array, title: str, path: Path) -> None:
    """Draw some frames of a result, (F, 15, 3) m, beside the truth and the keypoints."""
    keypoints, times = view.sequence['keypoints'].astype(float), view.sequence['timestamps']
    names = tuple(str(name) for name in view.sequence['joints3d_names'])
    known = np.isfinite(view.truth).all(axis=-1).astype(float)
    truth, weight = build_joint_map(names).apply(view.truth, known)
    unknown = np.asarray(~(weight > 0).all(axis=1))
    joints, truth = (np.where(unknown[:, None, None], np.nan, p) for p in (joints, truth))
    joints, truth = common.align_scale(joints, truth)
    points, score = build_joint_map(view.joint_names).apply(keypoints[..., :2], keypoints[..., 2])
    shown = np.concatenate([points, score[..., None]], axis=-1)
    data = PlotData(times, joints, score > 0, CMU15, truth, shown, CMU15)
    usable = np.flatnonzero(np.isfinite(joints).all(axis=(1, 2)))
    frames = usable[np.linspace(0, len(usable) - 1, FRAMES + 2).astype(int)[1:-1]].tolist()
    path.parent.mkdir(parents=True, exist_ok=True)
    labels = [f'{times[f] - times[0]:.1f} s' for f in frames]
    save_figure(draw_poses_figure(data, frames, title, labels), path)


def draw_cases(
    records: Sequence[Mapping[str, Any]],
    options: Sequence[ViewOptions],
    models: Models,
    config: Config,
    folder: Path,
) -> None:
    """Draw the median and the worst case of some records, each of the view at its place in `options`."""
    order = sorted(range(len(records)), key=lambda i: records[i]['mpjpe_mm'])
    for name, index in (('median', order[len(order) // 2]), ('worst', order[-1])):
        record, chosen = records[index], options[index]
        seen = make_view(chosen)
        title = (
            f'{name} of {len(records)}: {chosen.trial} ({chosen.category}), {chosen.detector}, {record["way"]}: '
            f'{record["mpjpe_mm"]:.0f} mm'
        )
        joints = reconstruct(record['way'], seen.view, models, config)
        draw_case(seen.view, joints, title, folder / f'{name}.png')
