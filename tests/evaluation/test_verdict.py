# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Points in another layout, order or axes than said are noticed, and sound ones are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocap_ros.demo.scene import make_recording
from mocap_ros.evaluation.verdict import (
    GIVEN,
    Fault,
    Grade,
    Judgement,
    Reading,
    average,
    cut_stretches,
    judge,
    list_readings,
    measure_uncertainty,
)
from mocap_ros.formats.sequence_file import KeypointSequence
from mocap_ros.models.model_file import load_shipped_lifter
from mocap_ros.skeleton import keypoint_layout

WALK = make_recording().sequence()
COCO17, H36M17 = (keypoint_layout(name) for name in ('coco17', 'h36m17'))
SIDES_EXCHANGED = tuple(COCO17.joints[i] for i in COCO17.mirror)
SOUND_SHARE = 0.02  # 1, residual over the body height
GOOD = Judgement(Grade.GOOD)


def edit(
    keypoints: np.ndarray | None = None,
    joint_names: tuple[str, ...] = WALK.joint_names,
    rows: slice = slice(None),
    swap: bool = False,
    flip: tuple[int, int] = (1, 1),
) -> KeypointSequence:
    """Return the walk under other names, in some of its frames, with x and y exchanged or reversed."""
    found = WALK.keypoints[rows].copy() if keypoints is None else keypoints
    size = np.array(WALK.image_size)
    found[..., :2] = np.where(np.array(flip) < 0, size - found[..., :2], found[..., :2])
    found = found[..., [1, 0, 2]] if swap else found
    times = WALK.timestamps[rows]
    return replace(WALK, keypoints=found, joint_names=joint_names, timestamps=times, recorded_ns=(), truth=None)


def judge_sequence(sequence: KeypointSequence, share: float = SOUND_SHARE, turns: int = 0) -> Judgement:
    given = sequence.keypoints, sequence.joint_names, sequence.timestamps, sequence.intrinsics(0.75)
    lifter = load_shipped_lifter()
    parts = [
        {
            reading: measure_uncertainty(stretch, reading, turns, lifter, 0.1)
            for reading in list_readings(stretch.names)
        }
        for stretch in cut_stretches(*given)
    ]
    return judge(average(parts), share)


@pytest.mark.parametrize(
    ('sequence', 'share', 'expected'),
    [
        (edit(), SOUND_SHARE, GOOD),
        (edit(rows=slice(0, None, 4)), SOUND_SHARE, GOOD),
        (edit(rows=slice(60)), SOUND_SHARE, GOOD),
        (edit(WALK.keypoints * np.array([1e4, 1e4, 1])), SOUND_SHARE, GOOD),
        (edit(rows=slice(4)), SOUND_SHARE, Judgement(Grade.GOOD, Fault.UNKNOWN)),
        (edit(rows=slice(4)), 0.08, Judgement(Grade.DOUBTFUL, Fault.MISFIT)),
        (edit(rows=slice(4)), 0.12, Judgement(Grade.WRONG, Fault.MISFIT)),
        (edit(joint_names=H36M17.joints), 0.08, Judgement(Grade.WRONG, Fault.LAYOUT, 'coco17')),
        (edit(WALK.keypoints[:, ::-1]), 0.15, Judgement(Grade.WRONG, Fault.MISFIT)),
        (edit(np.roll(WALK.keypoints, 1, axis=1)), 0.12, Judgement(Grade.WRONG, Fault.MISFIT)),
        (edit(swap=True), SOUND_SHARE, Judgement(Grade.WRONG, Fault.AXES)),
        (edit(flip=(1, -1)), SOUND_SHARE, Judgement(Grade.WRONG, Fault.Y_UP)),
        (edit(flip=(-1, -1)), SOUND_SHARE, Judgement(Grade.DOUBTFUL, Fault.TURNED)),
    ],
)  # fmt: skip
def test_points_are_judged_by_how_they_look_to_the_lifter(
    sequence: KeypointSequence, share: float, expected: Judgement
) -> None:
    assert judge_sequence(sequence, share) == expected


def test_a_turned_camera_whose_vertical_is_given_is_sound() -> None:
    assert judge_sequence(edit(flip=(-1, -1)), turns=2) == GOOD
    assert judge_sequence(edit(swap=True, flip=(1, -1)), turns=3) == GOOD
    assert judge_sequence(edit(swap=True, flip=(-1, 1)), turns=1) == GOOD


@pytest.mark.parametrize(
    ('mirrored', 'layout', 'share', 'outside', 'expected'),
    [
        (-2.3, -1.2, 0.05, 0.0, GOOD),
        (-2.4, -1.2, 0.05, 0.0, GOOD),
        (-2.7, -1.2, 0.05, 0.0, Judgement(Grade.WRONG, Fault.MIRRORED)),
        (-2.3, -3.0, 0.05, 0.0, GOOD),  # a layout that is hardly another one
        (-2.3, -1.2, 0.06, 0.0, GOOD),
        (-2.3, -1.2, 0.08, 0.0, Judgement(Grade.DOUBTFUL, Fault.MISFIT)),
        (-2.3, -1.2, 0.12, 0.0, Judgement(Grade.WRONG, Fault.MISFIT)),
        (-2.3, -1.2, 0.05, 0.6, Judgement(Grade.WRONG, Fault.OUTSIDE)),
        (-2.3, -1.2, np.nan, 0.0, GOOD),
    ],
)
def test_only_clear_differences_count(
    mirrored: float, layout: float, share: float, outside: float, expected: Judgement
) -> None:
    uncertainty = dict.fromkeys(list_readings(COCO17.joints), -1.5)
    uncertainty |= {GIVEN: -2.3, Reading(is_mirrored=True): mirrored, Reading('h36m17'): layout}
    assert judge(uncertainty, share, outside) == expected
