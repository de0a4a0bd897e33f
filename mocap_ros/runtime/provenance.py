"""What a recording was made with, to be put into its bag."""

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
from mocap_ros.models.model_file import lifter_for_prior

PACKAGES = ('mocap_ros', 'numpy', 'scipy', 'mcap', 'rosbags', 'rclpy')


def attachments(config: Config, models: Mapping[str, BasePoses]) -> tuple[Attachment, ...]:
    """The effective parameters as a parameter file, and versions and the origin of the models as JSON."""
    told: dict[str, object] = {
        'versions': {'python': platform.python_version(), **{p: _version(p) for p in PACKAGES}},
        'models': {name: _origin(model) for name, model in models.items()},
    }
    lifter = lifter_for_prior(config.solver.prior, next(iter(models.values())).skeleton)
    if lifter is not None:
        numbers = [array for layer in lifter.layers for array in layer]
        told['lifter'] = {'sha256': _digest(numbers), 'provenance': dict(lifter.provenance)}
    return (
        Attachment('mocap_ros.yaml', 'application/yaml', to_yaml(config).encode()),
        Attachment('provenance.json', 'application/json', json.dumps(told, indent=1).encode()),
    )


def _origin(model: BasePoses) -> dict[str, object]:
    return {
        'stature': model.stature,
        'sha256': _digest((model.mean, model.components, model.std)),
        'provenance': dict(model.provenance),
    }


def _digest(arrays: Iterable[NDArray[Any]]) -> str:
    return hashlib.sha256(b''.join(a.tobytes() for a in arrays)).hexdigest()


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
