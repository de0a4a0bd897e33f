# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Points in another layout, order or axes than said are noticed, and so are joints that were never seen."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mocap_ros.demo.scene import make_recording
from mocap_ros.findings import SOUND, Fault, Finding, Grade
from mocap_ros.keypoints.keypoint_sequence import KeypointSequence
from mocap_ros.skeleton import CMU15, keypoint_layout
from mocap_ros.verdict import plausibility
from mocap_ros.verdict.plausibility import GIVEN, MIRROR_IMAGE, Reading, list_readings
from mocap_ros.verdict.seen_joints import SeenJoints

WALK = make_recording().sequence()
COCO17, H36M17 = (keypoint_layout(name) for name in ('coco17', 'h36m17'))
SOUND_SHARE = 0.02  # 1, residual over the body height
GOOD = Grade.GOOD, Fault.NONE


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
) -> Finding:
    keypoints = plausibility.hide_unsure(sequence.keypoints, 0.1)
    given = keypoints, sequence.joint_names, sequence.timestamps, sequence.intrinsics(0.75)
    upward = None if vertical is None else np.array(vertical)
    parts = map(plausibility.measure_all, plausibility.cut_stretches(*given, upward))
    return plausibility.judge(plausibility.average([*parts]), share, sequence.joint_names)


@pytest.mark.parametrize(
    ('sequence', 'share', 'expected'),
    [
        (edit(), SOUND_SHARE, GOOD),
        (edit(rows=slice(0, None, 4)), SOUND_SHARE, GOOD),
        (edit(rows=slice(60)), SOUND_SHARE, GOOD),
        (edit(WALK.keypoints * np.array([1e4, 1e4, 1])), SOUND_SHARE, GOOD),
        (edit(rows=slice(4)), SOUND_SHARE, (Grade.GOOD, Fault.UNKNOWN)),
        (edit(rows=slice(4)), 0.08, (Grade.DOUBTFUL, Fault.MISFIT)),
        (edit(rows=slice(4)), 0.12, (Grade.WRONG, Fault.MISFIT)),
        (edit(joint_names=H36M17.joints), 0.08, (Grade.WRONG, Fault.LAYOUT)),
        (edit(WALK.keypoints[:, ::-1]), 0.15, (Grade.WRONG, Fault.MISFIT)),
        (edit(np.roll(WALK.keypoints, 1, axis=1)), 0.12, (Grade.WRONG, Fault.MISFIT)),
        (edit(swap=True), SOUND_SHARE, (Grade.WRONG, Fault.AXES)),
        (edit(flip=(1, -1)), SOUND_SHARE, (Grade.WRONG, Fault.Y_UP)),
        (edit(flip=(-1, -1)), SOUND_SHARE, (Grade.WRONG, Fault.TURNED)),
        (edit(swap=True, flip=(1, -1)), SOUND_SHARE, (Grade.DOUBTFUL, Fault.TURNED)),
    ],
)  # fmt: skip
def test_points_are_judged_by_the_lifter(
    sequence: KeypointSequence, share: float, expected: tuple[Grade, Fault]
) -> None:
    assert judge_sequence(sequence, share)[:2] == expected


def test_the_layout_that_fits_is_named() -> None:
    words = judge_sequence(edit(joint_names=H36M17.joints), 0.08).words
    assert words.startswith('these look like coco17, not h36m17')


@pytest.mark.parametrize(
    ('hidden', 'is_judged'),
    [(('ankle',), True), (('knee',), False), (('hip', 'knee', 'ankle'), False), (('lhip', 'lknee'), False)],
)
def test_left_and_right_are_judged_by_whole_bodies(hidden: tuple[str, ...], *, is_judged: bool) -> None:
    keypoints = WALK.keypoints.copy()
    keypoints[:, [joint.endswith(hidden) for joint in COCO17.joints], 2] = 0
    readings = list_readings(plausibility.Stretch(keypoints, COCO17.joints, WALK.timestamps))
    assert set(readings) >= {GIVEN, *plausibility.TURNED}
    assert set(plausibility.MIRRORED) & set(readings) == (set(plausibility.MIRRORED) if is_judged else set())
    uncertainty = dict.fromkeys(readings, -1.5) | {Reading(turns=2): -1.9, MIRROR_IMAGE: -1.3}
    if not is_judged:
        del uncertainty[MIRROR_IMAGE]
    assert plausibility.judge(uncertainty, 0.02, COCO17.joints)[:2] == (Grade.WRONG, Fault.TURNED)


def test_a_turned_camera_whose_vertical_is_given_is_sound() -> None:
    assert judge_sequence(edit(flip=(-1, -1)), vertical=(0, 1, 0))[:2] == GOOD
    assert judge_sequence(edit(swap=True, flip=(1, -1)), vertical=(1, 0, 0))[:2] == GOOD
    assert judge_sequence(edit(swap=True, flip=(-1, 1)), vertical=(-1, 0, 0))[:2] == GOOD


@pytest.mark.parametrize(
    ('mirrored', 'layout', 'share', 'size', 'is_backwards', 'expected'),
    [
        (-2.3, -1.2, 0.05, Grade.GOOD, False, GOOD),
        (-2.44, -1.2, 0.05, Grade.GOOD, False, GOOD),
        (-2.46, -1.2, 0.05, Grade.GOOD, False, (Grade.WRONG, Fault.MIRRORED)),
        (-2.34, -1.2, 0.05, Grade.GOOD, True, GOOD),
        (-2.36, -1.2, 0.05, Grade.GOOD, True, (Grade.DOUBTFUL, Fault.MIRRORED)),
        (-2.3, -3.0, 0.05, Grade.GOOD, False, GOOD),  # a layout that is hardly another one
        (-2.3, -1.2, 0.06, Grade.GOOD, False, GOOD),
        (-2.3, -1.2, 0.08, Grade.GOOD, False, (Grade.DOUBTFUL, Fault.MISFIT)),
        (-2.3, -1.2, 0.12, Grade.GOOD, False, (Grade.WRONG, Fault.MISFIT)),
        (-2.3, -1.2, 0.05, Grade.WRONG, False, (Grade.WRONG, Fault.SIZE_OUTSIDE)),
        (-2.3, -1.2, 0.05, Grade.DOUBTFUL, False, (Grade.DOUBTFUL, Fault.SIZE_OUTSIDE)),
        (-2.3, -1.2, np.nan, Grade.GOOD, False, GOOD),
    ],
)
def test_only_clear_differences_count(
    mirrored: float, layout: float, share: float, size: Grade, is_backwards: bool, expected: tuple[Grade, Fault]
) -> None:
    stretch = plausibility.Stretch(WALK.keypoints, COCO17.joints, WALK.timestamps)
    uncertainty = dict.fromkeys(list_readings(stretch), -1.5)
    uncertainty |= {GIVEN: -2.3, MIRROR_IMAGE: mirrored, Reading('h36m17'): layout}
    places = SOUND if size is Grade.GOOD else Fault.SIZE_OUTSIDE.found(size, outside=0.6, width=640, height=480)
    found = plausibility.judge(uncertainty, share, COCO17.joints, places, is_backwards=is_backwards)
    assert found[:2] == expected


def test_exchanged_sides_show_under_a_vertical_that_is_given() -> None:
    pitch, truth = np.radians(25.0), make_recording().truth
    turn = Rotation.from_euler('x', pitch).as_matrix()
    joints = (truth - truth.mean(axis=1, keepdims=True)) @ turn.T + [0.0, 0.0, 4.0]
    points = WALK.intrinsics(0.75).project(joints)
    keypoints = np.concatenate([points, np.ones_like(points[..., :1])], axis=-1)
    upward = turn @ [0.0, -1.0, 0.0]
    assert judge_sequence(edit(keypoints, CMU15.joints), vertical=upward)[:2] == GOOD
    exchanged = tuple({'l': 'r', 'r': 'l'}.get(name[0], name[0]) + name[1:] for name in CMU15.joints)
    found = judge_sequence(edit(keypoints, exchanged), vertical=upward)
    assert found[:2] == (Grade.WRONG, Fault.MIRRORED)


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
def test_who_walks_backwards_faces_away(turn: float, speed: float, has_strides: bool, expected: bool) -> None:
    walk, body = plausibility.Walk(), np.zeros((15, 3))
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


def hides(*ends: str) -> np.ndarray:
    """Return whether each of the joints of COCO is seen where those with these ends are hidden."""
    return np.array([not joint.endswith(ends) for joint in COCO17.joints])


@pytest.mark.parametrize(
    ('hidden', 'words'),
    [
        ((), ''),
        (('hip', 'knee', 'ankle'), 'hips and legs'),
        (('knee', 'ankle'), 'legs'),
        (('ankle',), 'ankles'),
        (('relbow', 'rwrist', 'lankle'), 'right arm and left ankle'),
        (('nose', 'eye'), ''),  # the ears show the head
        (('nose', 'eye', 'ear', 'shoulder', 'wrist'), 'head, shoulders and wrists'),
    ],
)
def test_parts_that_are_hardly_ever_seen_are_named(hidden: tuple[str, ...], words: str) -> None:
    joints, is_seen = SeenJoints(), np.tile(hides(*hidden) if hidden else np.ones(17, bool), (100, 1))
    is_seen[0] = True
    joints.add(COCO17.joints, is_seen)
    joints.add(COCO17.joints, np.zeros((100, 17), bool))  # somebody else, of whom nothing was seen
    assert joints.name_unseen() == words
    joints.add(COCO17.joints, np.ones((5, 17), bool))
    assert joints.name_unseen() == ''
    assert SeenJoints().name_unseen() == ''
