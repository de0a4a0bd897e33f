# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Errors with base poses of the very person: given to the defaults, given alone, and not given."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import common
import numpy as np

from mocap_ros.models.base_poses import BasePoses

OWN, ALONE, NOT_GIVEN = 'own base poses', 'own base poses, pca', 'base poses of all motions'
MAX_TRIALS = 25  # trials of the person's base poses; more make them no better


def train_own_base_poses(trial: str) -> BasePoses | None:
    """Return base poses of the other trials of a trial's person and category; None if there are none."""
    by_name = {t.name: t for t in common.list_trials()}
    shown = by_name[trial]
    others = [
        name
        for name, t in by_name.items()
        if (t.subject, t.category) == (shown.subject, shown.category) and name != trial
    ]
    if not others:
        return None
    dropped = (trial, *others[MAX_TRIALS:])
    return common.train_base_poses(shown.category, only_subjects=(shown.subject,), without_trials=dropped)


def summarise_own(records: Sequence[Mapping[str, Any]]) -> list[list[object]]:
    """Return the rows of a table: detector, way, views, mean errors, and the mean ratio to those of `pca`."""
    rows: list[list[object]] = []
    for detector, way in dict.fromkeys((r['detector'], r['way']) for r in records):
        mine = [r for r in records if (r['detector'], r['way']) == (detector, way)]
        error = {g: np.array([r['mpjpe_mm'] for r in mine if r['given'] == g]) for g in (OWN, ALONE, NOT_GIVEN)}
        ratio = float(np.exp(np.mean(np.log(error[OWN] / error[ALONE]))))
        rows.append([detector, way, len(error[OWN]), *(f'{e.mean():.1f}' for e in error.values()), f'{ratio:.2f}'])
    return rows
