"""The defaults against fixed models: what is gained by knowing which model suits a person and a motion."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from typing import Any

import common

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


def summarise_fixed(records: Sequence[Mapping[str, Any]]) -> list[list[object]]:
    """Return the rows of a table, one for each detector and way.

    A group is one person and one category of motion. Its best fixed model, which may be that of the defaults,
    is the one with the smallest mean error over its views.

    Returns:
        Detector; way; groups; mean errors of the defaults and of the best fixed models; geometric mean of the
        ratios; number of groups with a ratio above `WORSE`; the worst group.
    """
    rows: list[list[object]] = []
    for detector, way in dict.fromkeys((r['detector'], r['way']) for r in records):
        groups: dict[str, dict[str, list[float]]] = {}
        for r in records:
            if (r['detector'], r['way']) == (detector, way):
                by_model = groups.setdefault(f'{r["person"]}, {r["category"]}', {})
                by_model.setdefault(r['model'], []).append(r['mpjpe_mm'])
        means = {g: {m: statistics.mean(e) for m, e in found.items()} for g, found in groups.items()}
        best = {g: min(found.values()) for g, found in means.items()}
        ratios = {g: found[DEFAULTS] / best[g] for g, found in means.items()}
        worst = max(ratios, key=ratios.__getitem__)
        rows.append(
            [
                detector,
                way,
                len(groups),
                f'{statistics.mean(m[DEFAULTS] for m in means.values()):.1f}',
                f'{statistics.mean(best.values()):.1f}',
                f'{math.exp(statistics.mean(map(math.log, ratios.values()))):.2f}',
                sum(r > WORSE for r in ratios.values()),
                f'{ratios[worst]:.2f} ({worst})',
            ]
        )
    return rows
