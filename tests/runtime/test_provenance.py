# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A recorded bag names the versions, models and parameters that produced it."""

from __future__ import annotations

import hashlib
import json
import platform
from importlib import metadata
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader

from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.config import Config, RecorderConfig, from_yaml, with_values
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.models.model_file import load_base_poses
from mocap_ros.runtime.provenance import RECORDED_PACKAGES
from mocap_ros.runtime.replay import ReplayOptions, replay
from tests.support.pipeline_inputs import FAST_CONFIG, encode_demo_frames


def replay_and_read_attachments(folder: Path, config: Config) -> tuple[Config, dict[str, Any]]:
    """Replay a bag of two frames into a folder; return the parameters and the provenance that its bag holds."""
    with Recorder(folder / 'bag', RecorderConfig()) as recorder:
        for stamp_ns, raw in enumerate(encode_demo_frames(2)):
            recorder.write('/keypoints', KEYPOINTS, raw, stamp_ns, stamp_ns)
    with Bag(folder / 'bag') as bag:
        replay(bag, folder / 'out', ReplayOptions(config))
    with (folder / 'out' / 'out_0.mcap').open('rb') as file:
        attachments = {a.name: a for a in make_reader(file).iter_attachments()}
    assert {name: a.media_type for name, a in attachments.items()} == {
        'mocap_ros.yaml': 'application/yaml',
        'provenance.json': 'application/json',
    }
    parameters = from_yaml(attachments['mocap_ros.yaml'].data.decode(), 'mocap_ros.yaml')
    return parameters, json.loads(attachments['provenance.json'].data)


def digest_arrays(path: Path, *names: str) -> str:
    """Return the SHA-256 of arrays of a model's file."""
    with np.load(path) as archive:
        return hashlib.sha256(b''.join(archive[name].astype(float).tobytes() for name in names)).hexdigest()


def test_a_bag_names_versions_models_and_parameters(tmp_path: Path) -> None:
    config = with_values(FAST_CONFIG, {'solver.max_iterations': 7, 'solver.prior': 'learned'})
    parameters, provenance = replay_and_read_attachments(tmp_path, config)
    assert parameters == config

    versions = provenance['versions']
    assert versions.keys() >= {'python', *RECORDED_PACKAGES}
    assert versions['python'] == platform.python_version()
    for package in ('mocap_ros', 'numpy', 'scipy', 'mcap', 'rosbags'):
        assert versions[package] == metadata.version(package)

    shipped = files('mocap_ros') / 'models' / 'shipped'
    (name,) = provenance['models']
    walk = provenance['models'][name]
    model = load_base_poses('walk')
    assert name == 'walk'
    assert walk['sha256'] == digest_arrays(Path(str(shipped / 'walk.npz')), 'mean', 'components', 'std')
    assert walk['stature'] == model.stature
    assert walk['provenance'] == json.loads(json.dumps(dict(model.provenance)))
    assert 'mocap.cs.cmu.edu' in provenance['lifter']['provenance']['acknowledgement']
    assert len(bytes.fromhex(provenance['lifter']['sha256'])) == hashlib.sha256().digest_size
