# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Describe the software, models and parameters that produced a recording, as attachments of its bag."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Iterable, Mapping
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from numpy.typing import NDArray

from mocap_ros.bags.mcap_file import Attachment
from mocap_ros.config import Config, to_yaml
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.model_file import load_prior_lifter

# Packages whose installed versions are recorded: those that compute or encode the outputs.
RECORDED_PACKAGES = ('mocap_ros', 'numpy', 'scipy', 'mcap', 'rosbags', 'rclpy')


def provenance_attachments(config: Config, models: Mapping[str, BasePoses]) -> tuple[Attachment, ...]:
    """Return the effective parameters (a parameter file), and package versions and model origins (JSON).

    Args:
        config: The parameters of the run.
        models: The base poses that the run uses, by name.
    """
    provenance: dict[str, object] = {
        'versions': {
            'python': platform.python_version(),
            **{package: _find_version(package) for package in RECORDED_PACKAGES},
        },
        'models': {name: _describe_model(model) for name, model in models.items()},
    }
    lifter = load_prior_lifter(config.solver.prior, next(iter(models.values())).skeleton)
    if lifter is not None:
        weights = [array for layer in lifter.layers for array in layer]
        provenance['lifter'] = {'sha256': _compute_sha256(weights), 'provenance': dict(lifter.provenance)}
    return (
        Attachment('mocap_ros.yaml', 'application/yaml', to_yaml(config).encode()),
        Attachment('provenance.json', 'application/json', json.dumps(provenance, indent=1).encode()),
    )


def _describe_model(model: BasePoses) -> dict[str, object]:
    return {
        'stature': model.stature,
        'sha256': _compute_sha256((model.mean, model.components, model.std)),
        'provenance': dict(model.provenance),
    }


def _compute_sha256(arrays: Iterable[NDArray[Any]]) -> str:
    return hashlib.sha256(b''.join(a.tobytes() for a in arrays)).hexdigest()


def _find_version(package: str) -> str | None:
    """Return the installed version of a package, or None if the package is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None
