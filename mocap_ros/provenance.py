"""What a recording was made with, to be put into its bag."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version

from mocap_ros.base_poses import BasePoses
from mocap_ros.config import Config, to_yaml
from mocap_ros.io.mcap_file import Attachment

PACKAGES = ('mocap_ros', 'numpy', 'scipy', 'mcap', 'rosbags', 'rclpy')


def attachments(config: Config, models: Mapping[str, BasePoses]) -> tuple[Attachment, ...]:
    """The effective parameters as a parameter file, and versions and the origin of the models as JSON."""
    told = {
        'versions': {'python': platform.python_version(), **{p: _version(p) for p in PACKAGES}},
        'models': {name: _origin(model) for name, model in models.items()},
    }
    return (
        Attachment('mocap_ros.yaml', 'application/yaml', to_yaml(config).encode()),
        Attachment('provenance.json', 'application/json', json.dumps(told, indent=1).encode()),
    )


def _origin(model: BasePoses) -> dict[str, object]:
    numbers = b''.join(a.tobytes() for a in (model.mean, model.components, model.std))
    return {
        'stature': model.stature,
        'sha256': hashlib.sha256(numbers).hexdigest(),
        'provenance': dict(model.provenance),
    }


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
