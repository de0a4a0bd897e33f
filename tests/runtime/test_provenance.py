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

import numpy as np
from mcap.reader import make_reader

from mocap_ros.bags.reader import Bag
from mocap_ros.config import from_yaml, with_values
from mocap_ros.models.model_file import load_base_poses
from mocap_ros.runtime.provenance import RECORDED_PACKAGES
from mocap_ros.runtime.replay import ReplayOptions, replay
from tests.support.pipeline_inputs import FAST_CONFIG, encode_demo_frames, write_keypoints_bag


def test_a_bag_names_versions_models_and_parameters(tmp_path: Path) -> None:
    config = with_values(FAST_CONFIG, {'solver.max_iterations': 7, 'solver.prior': 'learned'})
    with Bag(write_keypoints_bag(tmp_path / 'bag', encode_demo_frames(2))) as bag:
        replay(bag, tmp_path / 'out', ReplayOptions(config))
    with (tmp_path / 'out' / 'out_0.mcap').open('rb') as file:
        attachments = {a.name: a for a in make_reader(file).iter_attachments()}
    kinds = {name: a.media_type for name, a in attachments.items()}
    assert kinds == {'mocap_ros.yaml': 'application/yaml', 'provenance.json': 'application/json'}
    assert from_yaml(attachments['mocap_ros.yaml'].data.decode(), 'mocap_ros.yaml') == config

    provenance = json.loads(attachments['provenance.json'].data)
    versions = provenance['versions']
    assert versions.keys() >= {'python', *RECORDED_PACKAGES}
    assert versions['python'] == platform.python_version()
    for package in ('mocap_ros', 'numpy', 'scipy', 'mcap', 'rosbags'):
        assert versions[package] == metadata.version(package)
    walk, model = provenance['models']['walk'], load_base_poses('walk')
    with np.load(str(files('mocap_ros') / 'models' / 'shipped' / 'walk.npz')) as archive:
        arrays = b''.join(archive[name].astype(float).tobytes() for name in ('mean', 'components', 'std'))
    assert (walk['sha256'], walk['stature']) == (hashlib.sha256(arrays).hexdigest(), model.stature)
    assert walk['provenance'] == json.loads(json.dumps(dict(model.provenance)))
    assert 'mocap.cs.cmu.edu' in provenance['lifter']['provenance']['acknowledgement']
    assert len(bytes.fromhex(provenance['lifter']['sha256'])) == hashlib.sha256().digest_size
