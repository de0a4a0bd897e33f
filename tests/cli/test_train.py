# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The command `train`."""

from __future__ import annotations

from pathlib import Path
from typing import cast

import numpy as np
import pytest

from mocap_ros.cli.main import main
from mocap_ros.formats.bvh import save_bvh
from mocap_ros.formats.export.armature import build_armature
from mocap_ros.formats.mocap.joint_maps import map_to_model
from mocap_ros.models.model_file import load_base_poses
from mocap_ros.training.fit_base_poses import fit_base_poses
from tests.support.evaluation_data import shared
from tests.support.motion_files import Z_UP_TO_Y_UP, make_poses


def test_train_on_motion_capture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = shared('data/cmu/cmu15_30fps.npz')
    model = tmp_path / 'm.npz'
    arguments = ['train', str(data), '--category', 'run', '--without-subject', '35', '-o', str(model)]
    assert main(arguments) == 0
    assert 'base poses from' in capsys.readouterr().out
    trained = load_base_poses(model)
    assert trained.name == 'run'
    trials = [str(t) for t in cast('list[object]', trained.provenance['trials'])]
    assert '09_01' in trials
    assert not any(t.startswith('35_') for t in trials)


def test_train_on_bvh_files_gives_the_model_of_their_poses(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bvh = build_armature(make_poses() @ Z_UP_TO_Y_UP.T, 30.0)
    positions = np.moveaxis(bvh.compute_positions() / 100, 1, 0)
    expected = fit_base_poses([map_to_model(dict(zip(bvh.names, positions, strict=True))) @ Z_UP_TO_Y_UP])
    for name in ('one_1.bvh', 'one_2.bvh'):
        save_bvh(tmp_path / name, bvh)
    options = ['-o', str(tmp_path / 'm.npz')]
    assert main(['train', str(tmp_path), *options]) == 0
    assert '2 trials, 80 poses' in capsys.readouterr().out
    model = load_base_poses(tmp_path / 'm.npz')
    assert model.mean == pytest.approx(expected.mean, abs=1e-4)
    assert model.std[:4] == pytest.approx(expected.std[:4], rel=1e-3)
    assert main(['train', str(tmp_path), '--every', '4', *options]) == 0
    assert '2 trials, 20 poses' in capsys.readouterr().out
    assert main(['train', str(tmp_path), '--category', 'swim', *options]) == 1
    assert 'the options select no trial' in capsys.readouterr().err


@pytest.mark.parametrize(
    ('options', 'name', 'alignment', 'mirror', 'bodies'),
    [([], 'all', 'rotation', False, 0), (['--category', 'walk'], 'walk', 'heading', True, 2)],
)
def test_one_category_has_other_defaults_than_all(
    tmp_path: Path, options: list[str], name: str, alignment: str, mirror: bool, bodies: int
) -> None:
    (tmp_path / 'walk').mkdir()
    save_bvh(tmp_path / 'walk' / 'one_1.bvh', build_armature(make_poses() @ Z_UP_TO_Y_UP.T, 30.0))
    source = ['--source', 'a test', '--acknowledgement', 'with thanks']
    assert main(['train', str(tmp_path / 'walk'), *options, *source, '-o', str(tmp_path / 'm.npz')]) == 0
    model = load_base_poses(tmp_path / 'm.npz')
    keys = 'alignment', 'mirror', 'bodies', 'source', 'acknowledgement'
    assert [model.provenance[key] for key in keys] == [alignment, mirror, bodies, 'a test', 'with thanks']
    assert model.name == name
