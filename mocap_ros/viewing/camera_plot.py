# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A picture from above of cameras and the paths of the people whom they see."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mocap_ros.arrays import Array
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.viewing.plots import make_printable

FRUSTUM_M = 0.8  # m; length of the drawn part of a field of view


def draw_cameras_figure(
    names: Sequence[str], poses: Array, intrinsics: Sequence[Intrinsics], paths: Sequence[Sequence[Array]]
) -> Figure:
    """Draw cameras from above.

    Args:
        names: of the C cameras.
        poses: (C, 4, 4) m, from each optical frame to a frame with z up.
        intrinsics: of each camera; where no image size is known, the field of view is left out.
        paths: of each camera, the places (F, 3) m of the roots of its people in that frame.
    """
    figure = Figure(figsize=(7, 7), dpi=110, layout='constrained')
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for index, (name, pose, camera, own) in enumerate(zip(names, poses, intrinsics, paths, strict=True)):
        colour, place = f'C{index % 10}', pose[:3, 3]
        for path in own:
            axes.plot(*path[:, :2].T, color=colour, linewidth=1, alpha=0.6)
        if camera.image_size is not None:
            sides = camera.pixels_to_rays(
                np.array([[0.0, camera.center[1]], [camera.image_size[0], camera.center[1]]])
            )
            edges = np.column_stack([sides, np.ones(2)]) @ pose[:3, :3].T * FRUSTUM_M + place
            axes.fill(*np.vstack([place, edges])[:, :2].T, color=colour, alpha=0.25, linewidth=0)
        axes.plot(*place[:2], 'o', color=colour, label=make_printable(f'{name}, {place[2]:.2f} m high'))
    axes.set_aspect('equal', adjustable='datalim')
    axes.grid(alpha=0.3)
    axes.set_xlabel('x, m')
    axes.set_ylabel('y, m')
    legend = axes.legend(fontsize=8)
    for text in legend.get_texts():
        text.set_parse_math(False)
    return figure
