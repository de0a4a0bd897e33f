# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Points in another layout, order or axes than said are noticed, and sound ones are not."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mocap_ros.demo.scene import make_recording
from mocap_ros.evaluation.verdict import (
    GIVEN,
    MIRROR_IMAGE,
    Fault,
    Grade,
    Judgement,
    Reading,
    Walk,
    average,
    cut_stretches,
    judge,
    list_readings,
    measure_uncertainty,
)
from mocap_ros.formats.sequence_file import KeypointSequence
from mocap_ros.models.model_file import load_shipped_lifter
from mocap_ros.skeleton import CMU15, keypoint_layout

WALK = make_recording().sequence()
COCO17, H36M17 = (keypoint_layout(name) for name in ('coco17', 'h36m17'))
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


def judge_sequence(
    sequence: KeypointSequence, share: float = SOUND_SHARE, vertical: Sequence[float] | None = None
) -> Judgement:
    given = sequence.keypoints, sequence.joint_names, sequence.timestamps, sequence.intrinsics(0.75)
    upward = None if vertical is None else np.array(vertical)
    lifter = load_shipped_lifter()
    parts = [
        {reading: measure_uncertainty(stretch, reading, lifter, 0.1) for reading in list_readings(stretch.names)}
        for stretch in cut_stretches(*given, upward)
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
    assert judge_sequence(edit(flip=(-1, -1)), vertical=(0, 1, 0)) == GOOD
    assert judge_sequence(edit(swap=True, flip=(1, -1)), vertical=(1, 0, 0)) == GOOD
    assert judge_sequence(edit(swap=True, flip=(-1, 1)), vertical=(-1, 0, 0)) == GOOD


@pytest.mark.parametrize(
    ('mirrored', 'layout', 'share', 'size', 'is_backwards', 'expected'),
    [
        (-2.3, -1.2, 0.05, Grade.GOOD, False, GOOD),
        (-2.44, -1.2, 0.05, Grade.GOOD, False, GOOD),
        (-2.46, -1.2, 0.05, Grade.GOOD, False, Judgement(Grade.WRONG, Fault.MIRRORED)),
        (-2.34, -1.2, 0.05, Grade.GOOD, True, GOOD),
        (-2.36, -1.2, 0.05, Grade.GOOD, True, Judgement(Grade.DOUBTFUL, Fault.MIRRORED)),
        (-2.3, -3.0, 0.05, Grade.GOOD, False, GOOD),  # a layout that is hardly another one
        (-2.3, -1.2, 0.06, Grade.GOOD, False, GOOD),
        (-2.3, -1.2, 0.08, Grade.GOOD, False, Judgement(Grade.DOUBTFUL, Fault.MISFIT)),
        (-2.3, -1.2, 0.12, Grade.GOOD, False, Judgement(Grade.WRONG, Fault.MISFIT)),
        (-2.3, -1.2, 0.05, Grade.WRONG, False, Judgement(Grade.WRONG, Fault.SIZE)),
        (-2.3, -1.2, 0.05, Grade.DOUBTFUL, False, Judgement(Grade.DOUBTFUL, Fault.SIZE)),
        (-2.3, -1.2, np.nan, Grade.GOOD, False, GOOD),
    ],
)
def test_only_clear_differences_count(
    mirrored: float, layout: float, share: float, size: Grade, is_backwards: bool, expected: Judgement
) -> None:
    uncertainty = dict.fromkeys(list_readings(COCO17.joints), -1.5)
    uncertainty |= {GIVEN: -2.3, MIRROR_IMAGE: mirrored, Reading('h36m17'): layout}
    assert judge(uncertainty, share, size, is_backwards=is_backwards) == expected


def test_exchanged_sides_show_under_a_vertical_that_is_given() -> None:
    pitch, truth = np.radians(25.0), make_recording().truth
    turn = Rotation.from_euler('x', pitch).as_matrix()
    joints = (truth - truth.mean(axis=1, keepdims=True)) @ turn.T + [0.0, 0.0, 4.0]
    points = WALK.intrinsics(0.75).project(joints)
    keypoints = np.concatenate([points, np.ones_like(points[..., :1])], axis=-1)
    upward = turn @ [0.0, -1.0, 0.0]
    assert judge_sequence(edit(keypoints, CMU15.joints), vertical=upward) == GOOD
    exchanged = tuple({'l': 'r', 'r': 'l'}.get(name[0], name[0]) + name[1:] for name in CMU15.joints)
    found = judge_sequence(edit(keypoints, exchanged), vertical=upward)
    assert found == Judgement(Grade.WRONG, Fault.MIRRORED)


@pytest.mark.parametrize(
    ('turn', 'speed', 'has_strides', 'expected'),
    [
        (0.0, 1.2, True, False),
        (np.pi, 1.2, True, True),
        (np.pi / 2, 1.2, True, True),
        (np.pi, 0.5, True, False),
        (np.pi, 1.2, False, False),  # the camera drives
    ],
)
def test_who_walks_backwards_faces_away_from_where_the_hips_go(
    turn: float, speed: float, has_strides: bool, expected: bool
) -> None:
    walk, body = Walk(), np.zeros((15, 3))
    place = {'lhip': (0.1, 0.0), 'rhip': (-0.1, 0.0), 'lshoulder': (0.2, -0.5), 'rshoulder': (-0.2, -0.5)}
    for name, (across, height) in place.items():  # faces the camera, or is turned away from it
        body[CMU15.index(name)] = across * np.cos(turn), height, across * np.sin(turn)
    for frame in range(150):
        joints = body + [0.0, 0.0, 5.0 - speed * frame / 30]
        if has_strides:  # one ankle goes on for half a second while the other stays
            whole, part = divmod(frame, 15)
            ways = np.array([(whole + 1) // 2 + part / 15 * (whole % 2), whole // 2 + part / 15 * (1 - whole % 2)])
            joints[[CMU15.index('lankle'), CMU15.index('rankle')], 2] = 5.0 - speed * ways
        walk.add('anna', frame * 10**9 // 30, joints)
    assert walk.is_backwards is expected
