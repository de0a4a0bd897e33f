# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Examples of synthetic postures and detectors, with targets that know nothing of their errors; base poses."""

import numpy as np
import pytest

from mocap_ros.errors import ModelError
from mocap_ros.geometry import rotations
from mocap_ros.geometry.rotations import rotation_from_vector
from mocap_ros.models.base_poses import PoseModel, mirror_poses
from mocap_ros.models.lifter_input import HISTORY_SLOTS_S, JOINT_COUNT, MIRROR_PERMUTATION
from mocap_ros.skeleton import BODY26, CMU15, CORE_COUNT
from mocap_ros.training import synthesis
from mocap_ros.training.detector_errors import SWAP_SHARE, DetectorErrors
from mocap_ros.training.example_arrays import Array, RandomArrays, add_bones, find_trunks
from mocap_ros.training.fit_base_poses import fit_base_poses
from mocap_ros.training.motion_library import MotionLibrary, balance_trials
from mocap_ros.training.postures import KINDS, joint_indices, take_postures
from mocap_ros.training.synthesis import ExampleSynthesiser

EXAMPLES = 64


@pytest.fixture(scope='module')
def library(walk_model: PoseModel) -> MotionLibrary:
    theta = 0.2 * np.sin(np.linspace(0, 9, 90))[:, None] * walk_model.std[:6]
    still = np.repeat(walk_model.mean[None], 40, axis=0)
    return MotionLibrary.from_trials([walk_model.poses(theta), still], np.array([0.75, 0.25]))


def test_trials_are_drawn_by_their_shares(library: MotionLibrary) -> None:
    probability = np.diff(library.cumulative_probability, prepend=0)
    is_still = np.isin(library.first_frame, library.first_frame[len(library.first_frame) - 1 :])
    moving = np.abs(library.bone_vectors - library.bone_vectors[-1]).max(axis=(1, 2)) > 1e-6
    assert probability[~moving].sum() == pytest.approx(0.25, abs=0.02)
    assert not moving[is_still].any()


def test_offsets_are_fixed_to_the_trunk_and_alike_on_both_sides(library: MotionLibrary) -> None:
    synthesiser = ExampleSynthesiser(library, seed=0)
    vectors, _, _ = synthesiser._draw_motion(EXAMPLES)
    points = add_bones(vectors)
    offsets = synthesiser._draw_offsets(points)
    trunks = find_trunks(points)
    assert np.abs(np.swapaxes(trunks, -1, -2) @ trunks - np.eye(3)).max() < 1e-5
    local = offsets @ trunks
    assert np.abs(local - local[:, :1]).max() < 1e-5
    left, right = (list(side) for side in zip(*BODY26.left_right_pairs, strict=True))
    assert local[:, 0, left] == pytest.approx(local[:, 0, right] * [1, -1, 1], abs=1e-5)
    assert 0.01 < local[:, 0, BODY26.index('lknee')].std() < 0.04, 'm'


def test_trials_without_extremities_have_no_targets_for_them(walk_model: PoseModel) -> None:
    core = walk_model.poses(walk_model.std[:1] * np.sin(np.linspace(0, 9, 90))[:, None])
    body = np.concatenate([core, np.repeat(core[:, [11]], len(BODY26.joints) - CORE_COUNT, axis=1)], axis=1)
    motions = MotionLibrary.from_trials([core, body + 0.1], np.array([0.5, 0.5]))
    batch = ExampleSynthesiser(motions, seed=2).make_batch(EXAMPLES)
    of_body = batch.is_known[:, CORE_COUNT:]
    assert batch.is_known[:, :CORE_COUNT].all()
    assert (of_body.all(axis=1) | ~of_body.any(axis=1)).all()
    assert 0.3 < of_body.mean() < 0.7
    scores = batch.features[:, :-4].reshape(EXAMPLES, -1, len(BODY26.joints), 3)[..., 2]
    assert not scores[:, :, CORE_COUNT:][~of_body.all(axis=1)].any()
    assert scores[:, :, CORE_COUNT:][of_body.all(axis=1)].any()


def test_the_target_is_the_true_pose(library: MotionLibrary, monkeypatch: pytest.MonkeyPatch) -> None:
    batches = []
    for factor in (1e-6, 3.0):
        monkeypatch.setattr(synthesis, 'OFFSET_SIZE_RANGE', (factor, factor))
        batches.append(ExampleSynthesiser(library, seed=1).make_batch(EXAMPLES))
    small, large = batches
    true, same = (batch.target * batch.size[:, None, None] for batch in batches)
    assert true == pytest.approx(same, abs=1e-5)
    assert np.abs(large.newest - small.newest).max() > 0.01


def test_shares_follow_the_formula() -> None:
    shares = balance_trials(['golf', 'golf', 'golf', 'dance'], ['a', 'a', 'b', 'a'], [100, 300, 900, 2500])
    expected = np.array([20 / 4, 20 * 3 / 4, 30, 50])
    assert shares == pytest.approx(expected / expected.sum())


@pytest.mark.parametrize('kind', ['bend', 'chair'])
def test_what_is_left_out_changes_the_examples(library: MotionLibrary, kind: str) -> None:
    whole, less = (ExampleSynthesiser(library, 1, without).make_batch(EXAMPLES) for without in ((), (kind,)))
    assert np.isfinite(whole.features).all()
    assert not np.array_equal(whole.features, less.features)
    assert kind in KINDS


DRAWN_POSTURES = 2000


@pytest.fixture(scope='module')
def standing(walk_model: PoseModel) -> Array:
    """Bone vectors of the same standing person in all examples."""
    root = BODY26.parents.index(-1)
    parents = [root if p < 0 else p for p in BODY26.parents]
    body = np.pad(walk_model.mean, [(0, len(parents) - CORE_COUNT), (0, 0)])
    for side in 'lr':
        body[BODY26.index(side + 'toe')] = body[BODY26.index(side + 'ankle')] + [0.15, 0, -0.05]
        body[BODY26.index(side + 'hand')] = body[BODY26.index(side + 'wrist')] + [0, 0, -0.08]
    vectors = (body - body[parents]).astype(np.float32)
    return np.broadcast_to(vectors, (DRAWN_POSTURES, len(HISTORY_SLOTS_S), *vectors.shape)).copy()


def take(standing: Array, kind: str) -> tuple[Array, Array]:
    """Return the bone vectors (M, T, J, 3) and joints (M, J, 3) of those in a kind of posture."""
    without = {*KINDS} - {kind}
    vectors = take_postures(standing, RandomArrays(3), without)
    vectors = vectors[(np.abs(vectors - standing) > 1e-4).any(axis=(1, 2, 3))]
    assert len(vectors) > 5
    return vectors, add_bones(vectors[:, 0])


def test_nothing_is_changed_where_all_is_left_out(standing: Array) -> None:
    vectors = take_postures(standing, RandomArrays(3), {*KINDS})
    np.testing.assert_array_equal(vectors, standing)


@pytest.mark.parametrize('kind', KINDS)
def test_bones_keep_their_lengths_and_knees_bend_one_way(standing: Array, kind: str) -> None:
    vectors, _ = take(standing, kind)
    longer = np.linalg.norm(vectors, axis=-1) - np.linalg.norm(standing[0, 0], axis=-1)
    assert np.abs(longer).max() < 1e-4
    thigh, shank, foot = (vectors[:, 0, joint_indices('l' + j, 'r' + j)] for j in ('knee', 'ankle', 'toe'))
    hinge, toes = np.cross(shank, thigh), np.cross(shank, foot)  # both to the right, for somebody who stands
    bent = np.linalg.norm(hinge, axis=-1) > 0.05
    assert ((hinge * toes)[bent].sum(axis=-1) > 0).mean() > 0.9, 'the toes point to where the knee does'


@pytest.mark.parametrize(
    ('kind', 'lowest'),
    [('floor', ('hip', 'ankle')), ('kneel', ('knee',)), ('fours', ('wrist',)), ('handstand', ('wrist',))],
)
def test_bodies_rest_on_the_ground(standing: Array, kind: str, lowest: tuple[str, ...]) -> None:
    _, joints = take(standing, kind)
    ground = joints[:, :CORE_COUNT, 2].min(axis=1)
    for joint in lowest:
        height = joints[:, joint_indices('l' + joint, 'r' + joint), 2].min(axis=1) - ground
        assert np.quantile(height, 0.9) < 0.15, 'm'


@pytest.mark.parametrize(
    ('kind', 'up'), [('chair', 0.8), ('recline', 0.8), ('lie', 0.0), ('handstand', -0.9), ('hang', 0.9)]
)
def test_trunks_are_upright_or_lie(standing: Array, kind: str, up: float) -> None:
    _, joints = take(standing, kind)
    assert np.median(find_trunks(joints[:, None])[:, 0, 2, 2]) == pytest.approx(up, abs=0.2)


DETECTIONS = 400
SLOTS = len(HISTORY_SLOTS_S)
LIMBS = tuple(name for name in CMU15.joints if name not in ('head', 'neck', 'pelvis'))


@pytest.fixture
def errors() -> DetectorErrors:
    return DetectorErrors(RandomArrays(0))


def test_a_swap_exchanges_points_with_their_scores(errors: DetectorErrors) -> None:
    number = np.broadcast_to(np.arange(JOINT_COUNT, dtype=np.float32), (DETECTIONS, SLOTS, JOINT_COUNT))
    image, score = errors._swap_sides(np.stack([number, -number], axis=-1), number / np.float32(100))
    np.testing.assert_array_equal(image[..., 0], -image[..., 1])
    np.testing.assert_allclose(score, image[..., 0] / 100, rtol=1e-6)
    swapped = image[..., 0] != number
    assert np.isin(image[..., 0], number).all()
    np.testing.assert_array_equal(image[..., 0], np.where(swapped, MIRROR_PERMUTATION, number))
    share = swapped.any(axis=(1, 2)).mean()
    assert 0.75 * SWAP_SHARE < share < 1.25 * SWAP_SHARE


def test_detections_are_near_the_truth_where_they_are_seen(errors: DetectorErrors) -> None:
    image, no_depth = np.zeros((DETECTIONS, SLOTS, JOINT_COUNT, 2)), np.zeros((DETECTIONS, JOINT_COUNT))
    always, all_joints = np.ones((DETECTIONS, SLOTS), bool), np.ones((DETECTIONS, JOINT_COUNT), bool)
    given = image.astype(np.float32), no_depth.astype(np.float32), always, all_joints, np.zeros(DETECTIONS, bool)
    found, score = errors.detect(*given)
    seen = score > 0
    assert found.shape == image.shape
    assert ((score >= 0) & (score <= 1)).all()
    assert 0.6 < seen[..., joint_indices(*LIMBS)].mean() < 0.95
    assert 0.01 < np.median(np.abs(found[seen])) < 0.03, 'm'


def test_a_state_is_kept_from_slot_to_slot(errors: DetectorErrors) -> None:
    share, length = 0.3, 0.5
    shares = np.full((20 * DETECTIONS, JOINT_COUNT), share, np.float32)
    inside = errors._draw_times(shares, np.full((20 * DETECTIONS, 1), length, np.float32))
    newer, older = inside[:, 0], inside[:, -1]
    keep = np.exp(-HISTORY_SLOTS_S[-1] / (length * (1 - share)))
    assert older[newer].mean() == pytest.approx(share + (1 - share) * keep, abs=0.01)
    assert older[~newer].mean() == pytest.approx(share - share * keep, abs=0.01)


def test_random_bodies_have_equal_left_and_right_bones(walk_model: PoseModel) -> None:
    standing = (walk_model.mean + mirror_poses(walk_model.mean, CMU15)) / 2
    direction = (walk_model.components[0] + mirror_poses(walk_model.components[0], CMU15)) / 2
    poses = standing + 0.2 * np.sin(np.linspace(0, 6, 30))[:, None, None] * direction
    model = fit_base_poses([poses], alignment='heading', bodies=6)
    assert model.mean == pytest.approx(mirror_poses(model.mean, CMU15), abs=1e-6)
    for component in model.components:
        assert component == pytest.approx(mirror_poses(component, CMU15), abs=1e-4)
    assert len(model.std) > 3, 'the bodies differ'


def test_a_share_counts_as_often_as_the_trial_were_there(walk_model: PoseModel, rng: np.random.Generator) -> None:
    one, other = (walk_model.poses(rng.normal(0, 0.1, (20, 5))) for _ in range(2))
    weighted = fit_base_poses([one, other], shares=[3, 1], alignment='heading', mirror=True, bodies=1)
    repeated = fit_base_poses([one, one, one, other], alignment='heading', mirror=True)
    plain = fit_base_poses([one, other], shares=[3, 1], alignment='heading', mirror=True)
    assert plain.mean == pytest.approx(repeated.mean, abs=1e-6)
    assert plain.std == pytest.approx(repeated.std, rel=1e-4)
    assert plain.stature == pytest.approx(repeated.stature)
    assert weighted.std[: len(plain.std)] != pytest.approx(plain.std, rel=1e-4), 'the bodies differ'


@pytest.mark.parametrize('alignment', ['rotation', 'heading'])
def test_fit_spans_the_training_poses(rng: np.random.Generator, walk_model: PoseModel, alignment: str) -> None:
    theta = rng.normal(size=(400, 3)) * walk_model.std[:3]
    turns = rotation_from_vector(rng.uniform(-3, 3, (400, 1)) * [0, 0, 1])
    poses = walk_model.poses(theta) @ np.swapaxes(turns, -1, -2) + rng.normal(size=(400, 1, 3))
    model = fit_base_poses([poses], alignment=alignment)
    align = rotations.fit_rotation if alignment == 'rotation' else rotations.fit_heading_rotation
    body = rotations.centre_poses(poses)
    body = body @ np.swapaxes(align(body, model.mean), -1, -2)
    assert np.abs(model.poses(model.weights(body)) - body).max() < 1e-3
    flat = model.components.reshape(len(model.std), -1)
    assert flat @ flat.T == pytest.approx(np.eye(len(flat)), abs=1e-9)
    assert (np.diff(model.std) <= 0).all()
    assert model.explained[2] > 0.99


def test_invalid_training_data_is_refused_by_name(walk_model: PoseModel) -> None:
    good = np.repeat(walk_model.mean[None], 5, axis=0)
    bad = good.copy()
    bad[2, 3, 1] = np.nan
    for trials, message in (
        ([], 'at least two'),
        ([good[:1]], 'at least two'),
        ([good, good[:, :14]], 'trial b has shape'),
        ([bad], 'trial a'),
        ([good], 'do not vary'),
        ([good, good * 0], 'trial b: a body 0 m tall'),
        ([good * 1e160], 'trial a: joints more than 6 m apart'),
    ):
        with pytest.raises(ModelError, match=message):
            fit_base_poses(trials, labels=['a', 'b'][: len(trials)])
