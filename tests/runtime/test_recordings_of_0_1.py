# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A bag that version 0.1 recorded live is replayed with its parameters, by the tracker of today."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from mocap_ros.bags.journal import Journal, read_run
from mocap_ros.bags.reader import Bag
from mocap_ros.bags.recorder import Recorder
from mocap_ros.config import REMOVED_SINCE_0_1, RENAMED_SINCE_0_1, Config, RecorderConfig, Value, values
from mocap_ros.errors import InputError
from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.runtime.replay import replay
from tests.support.paths import ROOT
from tests.support.pipeline_inputs import encode_demo_frames

BAG = ROOT / 'tests' / 'data' / 'recorded_by_0_1'
FRAMES = 40
MEAN_DIFFERENCE_M = 0.05  # m, of joints about their mean; the models have other wrists: 39 mm were measured then
START_NS = 1_700_000_000_000_000_000  # since the epoch


def read_people(bag: Path) -> list[dict[str, np.ndarray]]:
    """Return the joints (15, 3) of `CMU15` in m of all people in each message on /skeletons, by id."""
    with AnyReader([bag]) as reader:
        connections = [c for c in reader.connections if c.topic == '/skeletons']
        messages: list[Any] = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages(connections)]
    return [{p.id: np.array([[j.x, j.y, j.z] for j in p.joints[:15]]) for p in m.people} for m in messages]


def test_it_replays_with_the_parameters_it_was_recorded_with(tmp_path: Path) -> None:
    with Bag(BAG) as recording:
        result = replay(recording, tmp_path / 'out')
    assert result.counters.accepted == FRAMES
    with Bag(tmp_path / 'out') as bag:
        used = read_run(bag).parameters
    assert used['tracker.refine_seconds'] == 0.2
    assert used['solver.lifter_flip_factor'] == 0.3
    assert used['tracker.window'] == 1.0
    recorded, replayed = read_people(BAG), read_people(tmp_path / 'out')
    assert len(recorded) == len(replayed) == FRAMES
    for before, after in zip(recorded, replayed, strict=True):
        assert before.keys() == after.keys()
        for person in before:
            assert np.isfinite(after[person]).all()
            poses = [joints[person] - joints[person].mean(axis=0) for joints in (before, after)]
            assert np.linalg.norm(poses[1] - poses[0], axis=1).mean() < MEAN_DIFFERENCE_M


def test_every_renamed_parameter_exists() -> None:
    assert set(RENAMED_SINCE_0_1.values()) <= set(values(Config()))
    assert not set(RENAMED_SINCE_0_1) & set(values(Config()))


def test_every_removed_parameter_is_in_the_recording_and_in_no_configuration() -> None:
    with Bag(BAG) as recording:
        recorded = read_run(recording).parameters
    assert recorded.items() >= REMOVED_SINCE_0_1.items()
    assert not set(REMOVED_SINCE_0_1) & set(values(Config()))


@pytest.mark.parametrize(('name', 'value'), [('solver.norm', 'frobenius'), ('solver.relative_bones', True)])
def test_a_recording_that_used_a_removed_variant_is_refused(tmp_path: Path, name: str, value: Value) -> None:
    with Bag(BAG) as recording:
        recorded = {**read_run(recording).parameters, name: value}
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        recorder.write(*Journal('/mocap_node/journal').make_parameters_record(recorded, START_NS))
        recorder.write('/keypoints', KEYPOINTS, encode_demo_frames(1)[0], START_NS, START_NS)
    with (
        Bag(tmp_path / 'bag') as bag,
        pytest.raises(InputError, match=rf'{name} = {value!r}: version 0\.2 removed it .* in benchmarks/'),
    ):
        replay(bag, tmp_path / 'out')
