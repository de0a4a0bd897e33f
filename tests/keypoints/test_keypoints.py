# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Keypoints: joints that a detector lacks, faults, points that are not seen, rays, and the size of the image."""

import re

import numpy as np
import pytest

from mocap_ros.arrays import Array
from mocap_ros.errors import SkeletonError
from mocap_ros.findings import SOUND
from mocap_ros.geometry.distortion import Distortion
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.image_size import UNKNOWN_SIZE, ImageSize, resolve_image_size
from mocap_ros.keypoints.joint_map import JointMap, build_joint_map
from mocap_ros.keypoints.left_right import PARTS, BodySides, exchange_sides
from mocap_ros.keypoints.rays import Extremities, convert_to_rays, join_body
from mocap_ros.keypoints.validation import PointPlaces, find_border_points, mark_unseen
from mocap_ros.skeleton import BODY26, CMU15, CORE_COUNT, LAYOUT_NAMES, keypoint_layout

PINHOLE = Intrinsics(500.0, (320.0, 240.0), is_focal_known=True)


@pytest.mark.parametrize('name', LAYOUT_NAMES)
def test_every_layout_gives_all_model_joints(name: str) -> None:
    joints = keypoint_layout(name).joints
    rng = np.random.default_rng(0)
    points, score = build_joint_map(joints).apply(rng.normal(size=(len(joints), 2)), np.ones(len(joints)))
    assert np.isfinite(points).all()
    assert (score > 0).all()


def test_missing_joints_are_derived_in_order_of_precision() -> None:
    joints = keypoint_layout('coco17').joints
    points, score, at = np.zeros((len(joints), 2)), np.full(len(joints), 0.8), joints.index

    def derive(name: str) -> tuple[Array, float]:
        mapped, mapped_score = build_joint_map(joints).apply(points, score)
        return mapped[CMU15.index(name)], mapped_score[CMU15.index(name)]

    points[at('lshoulder')], points[at('rshoulder')] = (10, 100), (-10, 100)
    points[at('lear')], points[at('rear')] = (4, 80), (-4, 80)
    points[at('nose')] = (0, 80)
    assert derive('neck')[0] == pytest.approx([0, 100])
    assert derive('head')[0] == pytest.approx([0, 74])
    assert derive('head')[1] == pytest.approx(0.4)
    score[at('lear')] = 0
    points[at('leye')] = points[at('reye')] = (0, 82)
    assert derive('head')[0] == pytest.approx([0, 100 + 1.2 * (82 - 100)])
    score[[at('leye'), at('reye'), at('rear')]] = 0
    assert derive('head')[0] == pytest.approx([0, 100 + 1.3 * (80 - 100)])
    score[at('lshoulder')] = 0
    assert np.isnan(derive('neck')[0]).all()
    assert derive('neck')[1] == 0


@pytest.mark.parametrize(
    ('layout', 'derived'), [('coco17', {'neck', 'pelvis'}), ('body25', set()), ('mediapipe33', {'neck', 'pelvis'})]
)
def test_joints_between_others_are_no_evidence_but_where_little_is_seen(layout: str, derived: set[str]) -> None:
    names = keypoint_layout(layout).joints
    points, score = 600 * np.random.default_rng(0).normal(size=(3, len(names), 2)), np.ones((3, len(names)))
    score[1, [i for i, j in enumerate(names) if j[0] in 'lr' and not j.endswith('shoulder')]] = 0
    if 'neck' in names:
        middle = points[2, [names.index('lshoulder'), names.index('rshoulder')]].mean(axis=0)
        points[2, names.index('neck')] = middle + [1, -1]  # in whole pixels
    _, _, (enough, few, midway), _ = convert_to_rays(points, score, names, PINHOLE, 0.1)
    assert {j for j, e in zip(CMU15.joints, enough, strict=True) if not e} == derived
    assert {j for j, e in zip(CMU15.joints, midway, strict=True) if not e} == derived | {'neck'}
    assert few.all()


def test_too_few_or_repeated_joints_are_refused() -> None:
    with pytest.raises(SkeletonError, match=r'fewer than four .*; known: head, neck, lshoulder, .*nose'):
        build_joint_map(('nose', 'lear', 'rear'))
    with pytest.raises(SkeletonError, match='repeat'):
        build_joint_map(('lknee', 'left_knee', 'rknee', 'lhip', 'rhip', 'lankle'))


def test_joints_of_mediapipe_are_moved_to_where_motion_capture_has_them() -> None:
    joints = keypoint_layout('mediapipe33').joints
    points, score, at = np.zeros((len(joints), 2)), np.full(len(joints), 0.9), joints.index

    def move(name: str) -> Array:
        """Return by how many m a joint is moved, by the length of the trunk."""
        mapped, mapped_score = build_joint_map(joints).apply(points, score)
        assert mapped_score[CMU15.index(name)] == 0.9, 'the trunk decides nothing about its score'
        return (mapped[CMU15.index(name)] - points[at(name)]) * 0.51 / 120

    points[at('lshoulder')], points[at('rshoulder')] = (40, 0), (-40, 0)  # px, seen from behind, y down
    points[at('lhip')], points[at('rhip')] = (20, 120), (-20, 120)
    points[at('lankle')], points[at('lelbow')] = (20, 300), (50, 60)
    score[at('rshoulder')] = 0.1
    assert move('lankle') == pytest.approx([-0.006, 0.024], abs=0.001), 'MediaPipe sees it higher and outwards'
    assert move('lelbow') == pytest.approx([0.013, 0.014], abs=0.001), 'MediaPipe sees it higher and inwards'
    assert move('lhip') == pytest.approx([0, 0])
    points[at('rhip')], score[at('rhip')] = np.nan, 0
    assert move('lankle') == pytest.approx([0, 0]), 'without the trunk as it is'


def test_scores_of_a_person_are_divided_by_the_largest_of_those_seen_if_it_exceeds_one() -> None:
    points = np.full((3, 4, 2), 50.0)
    points[2, 3] = 0.0
    given = np.array([[0.2, 0.9, 1.0, np.nan], [0.5, 2.0, 4.0, -1e-4], [0.5, 1.0, 2.0, 8.0]])
    expected = [[0.2, 0.9, 1.0, 0], [0.125, 0.5, 1.0, 0], [0.25, 0.5, 1.0, 0]]
    np.testing.assert_array_equal(mark_unseen(points, given)[1], expected)
    logits = np.array([-900.0, -2.0, 0.0, 3.0])
    np.testing.assert_allclose(mark_unseen(points[0], logits)[1], [0, 0.1192, 0.5, 0.9526], atol=1e-4)
    for shape in ((0, 4), (3, 0), (0,)):
        assert mark_unseen(np.zeros((*shape, 2), np.float32), np.zeros(shape, np.float32))[1].shape == shape


@pytest.mark.parametrize(
    ('point', 'is_on'),
    [
        ((0, 50), True), ((0.5, 50), True), ((0.6, 50), False), ((-0.5, 50), True), ((-3, 50), False),
        ((639, 50), True), ((640, 50), True), ((638, 50), False), ((641, 50), False), ((np.nan, np.nan), False),
        ((50, 0), True), ((50, 478), False), ((50, 479), True), ((50, 480), True), ((50, 640), False),
    ],
)  # fmt: skip
def test_detectors_put_points_beyond_the_image_on_its_border(point: tuple[float, float], *, is_on: bool) -> None:
    points = np.array([point, (50, 50)], float)
    assert find_border_points(points, (640, 480)).tolist() == [is_on, False]
    assert not find_border_points(points, UNKNOWN_SIZE).any()


def test_points_and_scores_of_other_shapes_are_refused() -> None:
    for p, s in ((10, 17), (17, 10), (10, 10)):
        with pytest.raises(ValueError, match='10'):
            convert_to_rays(np.ones((1, p, 2)), np.ones((1, s)), keypoint_layout('coco17').joints, PINHOLE, 0.1)
    with pytest.raises(ValueError, match='10'):
        mark_unseen(np.ones((1, 17, 2)), np.ones((1, 10)))


@pytest.mark.parametrize(
    ('place', 'size', 'fault'),
    [
        ((640, 340), (1280, 720), ''),
        ((320, 250), (1280, 720), ''),  # in a corner, but not in one half of both
        ((640, 340), (2560, 1440), 'upper left quarter of 2560 x 1440 px: the images look smaller'),
        ((640, 340), (3840, 2160), 'upper left quarter of 3840 x 2160 px: the images look smaller'),
        ((640, 340), (720, 1280), 'as in an image of 1280 x 720 px: width and height look transposed'),
        ((360, 600), (1280, 720), '5% of .* and the others towards .*: the images look larger|transposed'),
        ((640, 340), (853, 480), 'of the seen keypoints lie outside 853 x 480 px, and .*: the images look larger'),
        ((640, 340), (320, 180), '100% of the seen keypoints lie outside 320 x 180 px'),
    ],
)
def test_people_show_another_size_of_image(place: tuple[float, float], size: tuple[int, int], fault: str) -> None:
    places, offsets = PointPlaces(), np.random.default_rng(0).uniform(-150, 150, (50, 17, 2)) * [0.5, 1.0]
    for points in place + offsets:
        places.add(points, np.ones(17), size)
    found = places.judge()
    assert re.search(fault, found.words) if fault else found == SOUND


STATED, CAMERA, CONFIGURED, UNKNOWN = (1920, 1080), (640, 480), (1280, 720), (640, 0)


@pytest.mark.parametrize(
    ('known', 'point', 'size'),
    [
        ((STATED, CAMERA, CONFIGURED), (2000, 100), STATED),
        ((None, CAMERA, CONFIGURED), (2000, 100), CAMERA),
        (((0, 0), UNKNOWN, CONFIGURED), (2000, 100), CONFIGURED),
        ((None, None, UNKNOWN), (2000, 100), (2560, 1440)),
        ((None, None, None), (640, 480), (640, 480)),
        ((None, None, None), (10, 481), (1280, 720)),
        ((None, None, None), (8000, 10), (7680, 4320)),
        ((None, None, None), None, UNKNOWN_SIZE),
    ],
)
def test_the_size_of_the_image_is_that_of_message_camera_user_or_the_smallest_that_holds_the_keypoints(
    known: tuple[ImageSize | None, ...], point: tuple[float, float] | None, size: ImageSize
) -> None:
    stated, camera, configured = known
    keypoints = None if point is None else np.array([[(*point, 0.9), (9000.0, 9000.0, 0.0)]])  # one is not seen
    found = resolve_image_size(stated=stated, camera=camera, configured=configured, keypoints=keypoints)
    assert found == size


@pytest.mark.parametrize(
    ('left', 'top', 'right', 'bottom', 'size'),
    [
        (330, 540, 800, 1560, (1080, 1920)),
        (200, 300, 520, 1150, (720, 1280)),
        (330, 540, 1500, 1060, (1920, 1080)),
        (250, 200, 1000, 1000, (1920, 1080)),
        (60, 100, 420, 470, (640, 480)),
    ],
)
def test_an_upright_size_is_assumed_of_people_far_from_the_middle_of_others(
    left: float, top: float, right: float, bottom: float, size: ImageSize
) -> None:
    x, y = np.meshgrid(np.linspace(left, right, 9), np.linspace(top, bottom, 9))
    assert resolve_image_size(keypoints=np.stack([x, y, np.ones_like(x)], axis=-1)) == size


NAMES = keypoint_layout('coco17').joints
MIN_SCORE = 0.3
MAX_POINT_PX = 1e7  # coordinates beyond it count as not seen
LENSES = [
    Distortion(),
    Distortion('plumb_bob', (-0.28, 0.07, 0.0002, 0.00002)),
    Distortion('equidistant', (-0.01, 0.02, -0.02, 0.005)),
]


def draw_keypoints(rng: np.random.Generator, frames: int) -> tuple[Array, Array]:
    """Return points (F, 17, 2) px and scores (F, 17); some are missing, not numbers or far out of range."""
    points, score = rng.uniform(0, 640, (frames, 17, 2)), rng.uniform(0, 1.5, (frames, 17))
    for array, value in ((points, np.nan), (points, 2 * MAX_POINT_PX), (score, np.nan), (score, 0.0)):
        array[rng.random(array.shape) < 0.05] = value
    return points, score


def map_plainly(joint_map: JointMap, points: Array, score: Array) -> tuple[Array, Array]:
    """Return points (Jt, D), NaN where no alternative can be used, and scores (Jt,) of one frame."""
    out, out_score = np.full((len(joint_map.target.joints), points.shape[-1]), np.nan), np.zeros(15)
    seen = (score > 0) & np.isfinite(points).all(axis=-1)
    for joint in range(len(out)):
        for weights, factor in zip(joint_map.weights[:, joint], joint_map.score_factor[:, joint], strict=True):
            used = weights != 0
            if factor > 0 and seen[used].all():
                out[joint], out_score[joint] = weights[used] @ points[used], factor * score[used].min()
                break
    return out, out_score


@pytest.mark.parametrize('lens', LENSES, ids=['pinhole', 'plumb_bob', 'equidistant'])
def test_rays_are_those_of_the_formula(lens: Distortion, rng: np.random.Generator) -> None:
    camera = Intrinsics(640.0, (310.0, 250.0), True, 1.1, lens)
    points, score = draw_keypoints(rng, 60)
    points.flags.writeable = score.flags.writeable = False
    rays, weight, _, _ = convert_to_rays(points, score, NAMES, camera, MIN_SCORE)
    assert (rays.shape, weight.shape) == ((60, 15, 2), (60, 15))
    joint_map, seen_count = build_joint_map(NAMES), 0
    for index in range(60):
        with np.errstate(invalid='ignore'):
            is_used = (np.abs(points[index]) < MAX_POINT_PX).all(axis=-1) & (score[index] >= MIN_SCORE)
        used_score = np.where(is_used, np.minimum(score[index], 1), 0)
        expected, expected_weight = map_plainly(joint_map, points[index], used_score)
        seen = expected_weight > 0
        seen_count += int(seen.sum())
        assert weight[index] == pytest.approx(expected_weight)
        assert (rays[index][~seen] == 0).all()
        assert rays[index][seen] == pytest.approx(camera.pixels_to_rays(expected[seen]), abs=1e-12)
    assert 200 < seen_count < 800, 'some joints are seen and some are not'


@pytest.mark.parametrize(
    ('part', 'exchanged'),
    [
        ('legs', {'lhip', 'lknee', 'lankle', 'ltoe', 'lheel'}),
        ('arms', {'lelbow', 'lwrist', 'lhand'}),
        ('shoulders', {'lshoulder', 'leye', 'lear'}),
    ],
)
def test_feet_hands_and_face_go_with_their_limbs(part: str, exchanged: set[str], rng: np.random.Generator) -> None:
    points, weight = rng.normal(size=(3, 26, 2)), rng.uniform(0.1, 1, (3, 26))
    is_swapped = np.zeros((3, len(PARTS)), bool)
    is_swapped[1, PARTS.index(part)] = True
    core = points[:, :CORE_COUNT].copy(), weight[:, :CORE_COUNT].copy()
    others = Extremities(points[:, CORE_COUNT:].copy(), weight[:, CORE_COUNT:].copy())
    body = *exchange_sides(*core, is_swapped, BodySides.of(CMU15)), others.exchange_sides(is_swapped)
    new_points, new_weight = join_body(*body)
    assert (new_points[[0, 2]] == points[[0, 2]]).all()
    for i, (joint, twin) in enumerate(zip(BODY26.joints, BODY26.mirror, strict=True)):
        source = twin if 'l' + joint[1:] in exchanged and joint[0] in 'lr' else i
        assert (new_points[1, i] == points[1, source]).all(), joint
        assert new_weight[1, i] == weight[1, source]


@pytest.mark.parametrize(
    ('layout', 'toe', 'hand'), [('body25', 'lbigtoe', None), ('mediapipe33', 'lfoot_index', ('lindex', 'lpinky'))]
)
def test_detectors_name_feet_and_hands_differently(
    layout: str, toe: str, hand: tuple[str, str] | None, rng: np.random.Generator
) -> None:
    names = keypoint_layout(layout).joints
    points = rng.uniform(280, 320, (len(names), 2))
    points[names.index('rhip')] = 0  # px; the person is large
    *_, found = convert_to_rays(points[None], np.ones((1, len(names))), names, PINHOLE, 0.1)
    rays = dict(zip(BODY26.joints[CORE_COUNT:], found.rays[0], strict=True))
    seen = dict(zip(BODY26.joints[CORE_COUNT:], found.weight[0] > 0, strict=True))
    assert rays['ltoe'] == pytest.approx((points[names.index(toe)] - [320, 240]) / 500)
    assert [seen[name] for name in ('nose', 'rear', 'lhand')] == [True, True, hand is not None]
    if hand is not None:
        middle = (points[names.index(hand[0])] + points[names.index(hand[1])]) / 2
        assert rays['lhand'] == pytest.approx((middle - [320, 240]) / 500)


@pytest.mark.parametrize(('name', 'joint'), [('lbigtoe', 'ltoe'), *((n, n) for n in ('rheel', 'nose', 'lear'))])
def test_a_point_far_from_its_body_does_not_count_as_seen(name: str, joint: str, rng: np.random.Generator) -> None:
    names = keypoint_layout('body25').joints
    points = 300 + 10 * rng.standard_normal((len(names), 2))
    points[names.index('neck'), 1], points[names.index('pelvis'), 1] = 240, 400  # px; how large the person is
    index, wrong = BODY26.index(joint) - CORE_COUNT, names.index(name)
    both = np.array([points, points])
    both[1, wrong] = 0
    *_, found = convert_to_rays(both, np.ones(both.shape[:2]), names, PINHOLE, 0.1)
    near, far = found.weight
    assert near[index] > 0
    assert far[index] == 0
    assert (np.delete(far, index) == np.delete(near, index)).all()
