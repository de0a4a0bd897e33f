# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Describe the software, models and parameters that produced a recording, as attachments of its bag."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Iterable, Mapping
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap_ros.bags.mcap_file import Attachment
from mocap_ros.config import Config, to_yaml
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.models.model_file import load_prior_lifter

# Packages whose installed versions are recorded: those that compute or encode the outputs.
RECORDED_PACKAGES = ('mocap_ros', 'numpy', 'scipy', 'mcap', 'rosbags', 'rclpy')


def provenance_attachments(config: Config, models: Mapping[str, PoseModel]) -> tuple[Attachment, ...]:
    """Return the parameters of a run (a parameter file), and package versions and model origins (JSON)."""
    versions: dict[str, str | None] = {'python': platform.python_version(), **dict.fromkeys(RECORDED_PACKAGES)}
    for package in RECORDED_PACKAGES:
        with suppress(PackageNotFoundError):
            versions[package] = version(package)
    provenance: dict[str, object] = {
        'versions': versions,
        'models': {
            name: {'stature': m.stature, **_describe_origin((m.mean, m.components, m.std), m.provenance)}
            for name, m in models.items()
        },
    }
    lifter = load_prior_lifter(config.solver.prior, next(iter(models.values())).skeleton)
    if lifter is not None:
        weights = (np.asarray(array, np.float32) for layer in lifter.layers for array in layer)
        provenance['lifter'] = _describe_origin(weights, lifter.provenance)
    return (
        Attachment('mocap_ros.yaml', 'application/yaml', to_yaml(config).encode()),
        Attachment('provenance.json', 'application/json', json.dumps(provenance, indent=1).encode()),
    )


def _describe_origin(arrays: Iterable[NDArray[Any]], provenance: Mapping[str, Any]) -> dict[str, object]:
    digest = hashlib.sha256()
    for array in arrays:  # one by one: a lifter has 13 MB
        digest.update(array.tobytes())
    return {'sha256': digest.hexdigest(), 'provenance': dict(provenance)}
