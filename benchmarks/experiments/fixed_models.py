# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The defaults against fixed models: what is gained by knowing which model suits a person and a motion."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping

import common
from report import Records, group

from mocap_ros.models.base_poses import ALL_MOTIONS, BasePoses
from mocap_ros.models.model_file import LEARNED, PCA

DEFAULTS = 'defaults'
CATEGORIES = ('walk', 'run', 'jump')  # of the base poses that are shipped beside those of all motions
FIXED = [(LEARNED, c) for c in CATEGORIES] + [(PCA, c) for c in (ALL_MOTIONS, *CATEGORIES)]
WORSE = 1.1  # times the best fixed model, the target of every group


def load_fixed_models() -> Mapping[str, BasePoses]:
    """Return base poses by name, trained without the tested people."""
    return {
        name: common.train_base_poses(
            name if name in CATEGORIES else '', without_subjects=common.HELD_OUT_SUBJECTS
        )
        for name in (ALL_MOTIONS, *CATEGORIES)
    }


def summarise_fixed(records: Records) -> list[list[object]]:
    """Return the rows of a table, one for each detector.

    A group is one person and one category of motion. Its best fixed model, which may be that of the defaults,
    is the one with the smallest mean error over its views.

    Returns:
        Detector; groups; mean errors of the defaults and of the best fixed models; geometric mean of the ratios;
        number of groups with a ratio above `WORSE`; the worst group.
    """
    rows: list[list[object]] = []
    for (detector,), mine in group(records, 'detector').items():
        means = {
            f'{person}, {category}': {
                model: statistics.mean(r['mpjpe_mm'] for r in of_model)
                for (model,), of_model in group(views, 'model').items()
            }
            for (person, category), views in group(mine, 'person', 'category').items()
        }
        best = {g: min(found.values()) for g, found in means.items()}
        ratios = {g: found[DEFAULTS] / best[g] for g, found in means.items()}
        worst = max(ratios, key=ratios.__getitem__)
        rows.append(
            [
                detector,
                len(means),
                f'{statistics.mean(m[DEFAULTS] for m in means.values()):.1f}',
                f'{statistics.mean(best.values()):.1f}',
                f'{math.exp(statistics.mean(map(math.log, ratios.values()))):.2f}',
                sum(r > WORSE for r in ratios.values()),
                f'{ratios[worst]:.2f} ({worst})',
            ]
        )
    return rows
