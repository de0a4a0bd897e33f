# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The lifter, its histories, features and network against the formulas: accuracy, invariances, missing joints.

Files of models: what is saved is read again, what ships is complete, and anything else is refused. What a pose
shows, and the networks of its motion: what they must not depend on, and where they do nothing.
"""

import io
import json
import math
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from mocap_ros.arrays import Array, Array32
from mocap_ros.engine.lifter import evaluate
from mocap_ros.engine.motion import describe_cores
from mocap_ros.errors import ModelError
from mocap_ros.geometry.rotations import centre_poses, rotation_from_vector
from mocap_ros.models import model_file
from mocap_ros.models.base_poses import PoseModel
from mocap_ros.models.joint_std import POSTURE_FACTORS, compute_joint_covariance, widen_by_posture
from mocap_ros.models.lifter import OUTPUT_COUNT, Lifter
from mocap_ros.models.lifter_input import FEATURE_COUNT, JOINT_COUNT, sample_histories
from mocap_ros.models.model_file import load_base_poses, load_motion_predictor, load_velocity_correction
from mocap_ros.models.motion_predictor import PAST_S, Displacements, Past
from mocap_ros.models.network import RoundedNetwork
from mocap_ros.models.upward_direction import MASSES, SUPPORT_AHEAD, Stances
from mocap_ros.models.velocity_correction import LEAST_PAST_S, MAX_CORRECTION, SPANS_S, VelocityPast
from mocap_ros.skeleton import CMU15, CORE_COUNT, HIPS
from mocap_ros.solvers.extremities import ExtremityEvidence
from mocap_ros.training.motion_library import MotionLibrary
from mocap_ros.training.synthesis import ExampleSynthesiser
from tests.support import plain_lifter
from tests.support.bodies import STANDING

PX_PER_M = 300.0


@pytest.fixture(scope='module')
def shipped() -> Lifter:
    return model_file.load_shipped_lifter()


@pytest.fixture
def walk(rng: np.random.Generator) -> tuple[Array, Array, Array, Array]:
    """Return poses (F, J, 3) in m in the camera's frame, image points in px, weights and times of a motion."""
    walk_model = model_file.load_base_poses('walk')
    t = np.arange(40) / 30
    phases = rng.uniform(0, 2 * np.pi, 6)
    theta = 1.2 * walk_model.std[:6] * np.sin(2 * np.pi * t[:, None] + phases)
    optical = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0.0]])
    rotation = optical @ rotation_from_vector(np.array([0, 0, 0.9]))
    poses = walk_model.poses(theta) @ rotation.T
    return poses, PX_PER_M * poses[..., :2] + [400, 300], np.ones(poses.shape[:2]), t


def test_lifted_poses_are_accurate(shipped: Lifter, walk: tuple[Array, ...]) -> None:
    poses, points, weight, times = walk
    lifted = shipped.lift_sequence(points, weight, times)
    core, truth = lifted.select_core(), centre_poses(poses)
    errors = core.joints / PX_PER_M - truth
    assert np.linalg.norm(errors, axis=-1).mean() < 1.1 * 0.0239  # m, measured
    assert core.joints.mean(axis=1) == pytest.approx(0, abs=1e-9)
    assert (np.abs(errors) <= 3 * core.std / PX_PER_M).all(), 'no error exceeds three standard deviations'


@pytest.mark.parametrize('focal', [np.inf, 900.0])
def test_lifted_poses_agree_with_the_formula(shipped: Lifter, rng: np.random.Generator, focal: float) -> None:
    points, weight = sample_histories(*make_sequence(rng, 30.0, outlier=9.0), np.array([3, 20, 59]))
    points *= PX_PER_M
    weight[1, 0, plain_lifter.MIN_SEEN_JOINTS - 1 : CORE_COUNT] = 0
    vertical, vertical_std = np.array([[0.0, -1, 0], [0, -0.8, -0.6], [np.nan] * 3]), np.array([0.1, 0.0, 0.1])
    lifted = shipped.lift(points, weight, focal, vertical, vertical_std)
    layers = plain_lifter.round_layers(shipped.layers)
    for n in range(3):
        known = (vertical[n], vertical_std[n]) if np.isfinite(vertical[n]).all() else None
        joints, std = plain_lifter.lift(layers, points[n], weight[n], focal, known)
        tolerance = 1e-5 * PX_PER_M  # px; the network computes in single precision
        assert lifted.joints[n] == pytest.approx(joints, abs=tolerance, nan_ok=True)
        assert lifted.std[n] == pytest.approx(std, abs=tolerance, nan_ok=True)
    assert np.isnan(lifted.joints[1]).all()


coordinates = st.floats(width=64) | st.sampled_from([0.0, np.nan, np.inf, -np.inf, 1e308])


@settings(max_examples=25)
@given(*(arrays(float, (5, JOINT_COUNT, *rest), elements=coordinates) for rest in ((2,), ())))
def test_any_input_gives_finite_poses_or_nan(points: Array, weight: Array) -> None:
    with np.errstate(all='ignore'):
        lifted = model_file.load_shipped_lifter().lift_sequence(points, weight, np.arange(5) / 30)
    finite = np.isfinite(lifted.joints).all(axis=(1, 2))
    assert (finite | np.isnan(lifted.joints).all(axis=(1, 2))).all()
    assert (np.isfinite(lifted.std).all(axis=(1, 2)) == finite).all()


def test_numpy_and_pytorch_agree(walk_model: PoseModel, rng: np.random.Generator) -> None:
    torch = pytest.importorskip('torch', reason='training is optional: pip install mocap_ros[train]')
    from mocap_ros.training.lifter import LifterNetwork

    torch.manual_seed(0)
    network = LifterNetwork(32, 2)
    theta = walk_model.std[:5] * np.sin(np.linspace(0, 12, 60)[:, None] + rng.uniform(0, 6, (3, 1, 5)))
    motions = MotionLibrary.from_trials([walk_model.poses(t) for t in theta], np.full(3, 1 / 3))
    batch = ExampleSynthesiser(motions, 0).make_batch(200)
    network(torch.from_numpy(batch.features))  # moves the statistics of the batch norms
    network.eval()
    with torch.no_grad():
        expected = network(torch.from_numpy(batch.features)).numpy()
    folded = network.fold_batch_norms({})
    assert plain_lifter.evaluate(folded.layers, batch.features) == pytest.approx(expected, abs=1e-4)
    found = evaluate(batch.features.reshape(100, 2, -1), *folded.network).reshape(expected.shape)
    assert found == pytest.approx(expected, abs=0.02), 'weights are rounded to integers'
    other = LifterNetwork(32, 2)
    other.start_from(folded)
    with torch.no_grad():
        assert other(torch.from_numpy(batch.features)).numpy() == pytest.approx(expected, abs=1e-4)


def make_sequence(
    rng: np.random.Generator, rate_hz: float, outlier: float = 2 * plain_lifter.MAX_COORDINATE
) -> tuple[Array, Array, Array]:
    """Return points (F, J, 2), weights (F, J) and times (F,), with gaps, outliers and joints not seen."""
    frames = 60
    times = 1e5 + np.cumsum(rng.choice([1, 1, 1, 2, 4], frames) / rate_hz)
    points = rng.normal(size=(frames, JOINT_COUNT, 2)) + [0.3, -0.1]
    weight = rng.uniform(0, 1.2, (frames, JOINT_COUNT)) * (rng.random((frames, JOINT_COUNT)) > 0.2)
    points[weight == 0] = np.nan
    points[rng.random(weight.shape) > 0.98] = outlier
    return points, weight, times


@pytest.mark.parametrize('rate_hz', [8.0, 24.0, 30.0, 60.0, 300.0])
def test_histories_agree_with_the_formula(rng: np.random.Generator, rate_hz: float) -> None:
    sequence = make_sequence(rng, rate_hz)
    frames = np.array([0, 1, 7, 30, 59])
    points, weight = sample_histories(*sequence, frames)
    for n, frame in enumerate(frames):
        expected_points, expected_weight = plain_lifter.sample_history(*sequence, frame)
        assert weight[n] == pytest.approx(expected_weight, abs=1e-12)
        assert points[n] == pytest.approx(expected_points, rel=1e-12, abs=1e-9)
    assert (weight > 0).any()


Layers = list[tuple[Array32, Array32]]


def make_layers(rng: np.random.Generator, sizes: list[int], scale: float = 1.0) -> Layers:
    def draw(*shape: int) -> Array32:
        return (scale * rng.normal(size=shape) / np.sqrt(shape[0])).astype(np.float32)

    return [(draw(inputs, outputs), draw(outputs)) for inputs, outputs in pairwise(sizes)]


def make_features(rng: np.random.Generator, pairs: int, size: int) -> Array32:
    """Return features of which a third are 0, as those of joints that were not seen are."""
    return (rng.normal(size=(pairs, 2, size)) * (rng.random((pairs, 2, size)) > 1 / 3)).astype(np.float32)


@pytest.mark.parametrize('blocks', [0, 1, 3])
@pytest.mark.parametrize('scale', [1e-3, 1.0, 10.0])
def test_it_agrees_with_the_formula(rng: np.random.Generator, blocks: int, scale: float) -> None:
    layers = make_layers(rng, [37, *[26] * (1 + 2 * blocks), 11], scale)
    features = make_features(rng, 5, 37)
    layers[0][0][3] = layers[-1][0][5] = 0  # an input without weights has no scale
    expected = plain_lifter.evaluate(plain_lifter.round_layers(layers), features)
    found = evaluate(features, *RoundedNetwork.from_layers(layers))
    assert found == pytest.approx(expected, abs=2e-6 * np.abs(expected).max())


def test_a_row_does_not_depend_on_the_others(rng: np.random.Generator) -> None:
    network = RoundedNetwork.from_layers(make_layers(rng, [37, 26, 26, 26, 11]))
    features = make_features(rng, 6, 37)
    together = evaluate(features, *network)
    for pair in range(len(features)):
        assert (evaluate(features[pair : pair + 1], *network) == together[pair]).all()
        assert (evaluate(features[pair : pair + 1, ::-1].copy(), *network) == together[pair, ::-1]).all()
        with_another = np.stack([features[pair, 0], features[pair - 1, 1]])[None]
        assert (evaluate(with_another, *network)[0, 0] == together[pair, 0]).all()


SHAPES = (FEATURE_COUNT, 2), (2, OUTPUT_COUNT)
SMALL_LIFTER = Lifter(tuple((np.zeros(s, 'f4'), np.zeros(s[1], 'f4')) for s in SHAPES), {})


def test_models_are_saved_and_read(tmp_path: Path, walk_model: PoseModel) -> None:
    lifter = model_file.load_shipped_lifter()
    for name in 'ab':
        model_file.save_base_poses(walk_model, tmp_path / f'{name}.npz')
        model_file.save_lifter(lifter, tmp_path / f'lifter_{name}.npz')
    for kind in ('', 'lifter_'):
        assert (tmp_path / f'{kind}a.npz').read_bytes() == (tmp_path / f'{kind}b.npz').read_bytes()
    model, read = model_file.load_base_poses(tmp_path / 'a.npz'), model_file.load_lifter(tmp_path / 'lifter_a.npz')
    assert model.components == pytest.approx(walk_model.components, abs=1e-6)
    assert model.provenance == walk_model.provenance
    for layer, expected in zip(read.layers, lifter.layers, strict=True):
        assert all((a == b).all() for a, b in zip(layer, expected, strict=True))
    assert 'mocap.cs.cmu.edu' in str(read.provenance['acknowledgement'])


@pytest.mark.parametrize('name', ['walk', 'run', 'jump', 'all'])
def test_shipped_models_have_provenance_and_axes(name: str) -> None:
    model = model_file.load_base_poses(name)
    assert model.name == name
    assert len(model.std) >= 30
    assert 'mocap.cs.cmu.edu' in str(model.provenance['acknowledgement'])
    assert model.mean[CMU15.index('lshoulder')][1] > 0.1, 'left is +y'
    assert model.mean[CMU15.index('head')][2] > 0.4, 'up is +z'
    assert model.mean[CMU15.index('lknee')][0] > model.mean[CMU15.index('lankle')][0], 'front is +x'


@pytest.mark.parametrize('data', [b'', b'PK\x03\x04 not really', bytes(range(256)) * 8])
def test_files_that_are_not_models_are_refused(tmp_path: Path, data: bytes) -> None:
    (tmp_path / 'm.npz').write_bytes(data)
    with pytest.raises(ModelError, match=r'm\.npz'):
        model_file.load_base_poses(tmp_path / 'm.npz')
    with pytest.raises(ModelError, match=r"'zumba'.*all, jump, run, walk"):
        model_file.load_base_poses('zumba')


def change_file(data: bytes, meta: dict[str, Any], arrays: dict[str, Any]) -> bytes:
    """Return the bytes of a model's file with entries replaced, or taken out where they are None."""
    with np.load(io.BytesIO(data)) as archive:
        content: dict[str, Any] = dict(archive)
    content['meta'] = np.array(json.dumps(json.loads(str(content['meta'])) | meta))
    out = io.BytesIO()
    np.savez_compressed(out, **{n: a for n, a in {**content, **arrays}.items() if a is not None})
    return out.getvalue()


def encode(save: Callable[..., None], model: Any) -> bytes:
    buffer = io.BytesIO()
    save(model, buffer)
    return buffer.getvalue()


BAD_MODELS: dict[str, tuple[dict[str, Any], Callable[[PoseModel], dict[str, Any]], str]] = {
    'format': ({'format': 'x'}, lambda _: {}, "format 'x'"),
    'provenance': ({'provenance': [1]}, lambda _: {}, 'provenance: '),
    'stature': ({'stature': 170}, lambda _: {}, 'stature: '),
    'stature not a number': ({'stature': math.nan}, lambda _: {}, 'stature: '),
    'skeleton': ({'skeleton': 'coco17'}, lambda _: {}, 'skeleton: '),
    'mean': ({}, lambda m: {'mean': m.mean * 1000}, 'mean: '),
    'fewer': ({}, lambda m: {'std': m.std[:3]}, 'std: '),
    'none': ({}, lambda m: {'std': m.std[:0], 'components': m.components[:0], 'explained': m.std[:0]}, 'shape'),
    'infinite': ({}, lambda m: {'std': m.std / 0.0}, 'std: '),
    'long': ({}, lambda m: {'components': m.components * 2}, 'components: '),
    'oblique': ({}, lambda m: {'components': m.components[:1].repeat(len(m.std), 0)}, 'components'),
    'integers': ({}, lambda m: {'mean': m.mean.astype(int)}, 'mean: '),
    'objects': ({}, lambda m: {'mean': m.mean.astype(object)}, 'holds Python objects'),
    'bomb': ({}, lambda _: {'more': np.zeros(1 << 22)}, 'holds more than 16 MiB'),
}


@pytest.mark.parametrize('case', BAD_MODELS)
def test_every_value_of_a_model_is_checked(walk_model: PoseModel, case: str) -> None:
    meta, arrays, message = BAD_MODELS[case]
    with np.errstate(divide='ignore'):
        data = change_file(encode(model_file.save_base_poses, walk_model), meta, arrays(walk_model))
    with pytest.raises(ModelError, match=rf'm\.npz: not a base-pose model \(.*{message}'):
        model_file.decode_base_poses(data, 'm.npz')


def end_with(array: np.ndarray, value: float) -> np.ndarray:
    return np.append(array.astype(float).ravel()[:-1], value).reshape(array.shape)


BAD_LIFTERS: dict[str, tuple[dict[str, Any], Callable[[dict[str, Any]], dict[str, Any]], str]] = {
    'format': ({'format': 'x'}, lambda _: {}, "format 'x'"),
    'other times of the history': ({'slots': [0.0, 1.0]}, lambda _: {}, ''),
    'provenance': ({'provenance': [1]}, lambda _: {}, 'provenance: '),
    'integers': ({}, lambda a: {'w0': a['w0'].astype(int)}, 'w0: '),
    'no weights': ({}, lambda _: {'b0': None}, 'no b0'),
    'one layer': ({}, lambda _: {'w1': None, 'b1': None}, '1 layers, expected an even number of at least 2'),
    'other outputs': ({}, lambda a: {'b1': a['b1'][1:]}, r'layer 1: '),
    'not a number': ({}, lambda a: {'w1': end_with(a['w1'], np.nan)}, 'w1: '),
    'huge': ({}, lambda a: {'b1': end_with(a['b1'], 1e6)}, 'layer 1: '),
}


@pytest.mark.parametrize('case', BAD_LIFTERS)
def test_every_value_of_a_lifter_is_checked(case: str) -> None:
    meta, change, message = BAD_LIFTERS[case]
    data = encode(model_file.save_lifter, SMALL_LIFTER)
    with np.load(io.BytesIO(data)) as archive:
        arrays = change(dict(archive))
    model_file.decode_lifter(change_file(data, {}, {}), 'x')
    with pytest.raises(ModelError, match=rf'^x: not a lifter \(.*{message}'):
        model_file.decode_lifter(change_file(data, meta, arrays), 'x')


UP = np.array([0.0, 0.0, 1.0])
UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # turns y down into z up
FORWARD = np.array([0.0, -1.0, 0.0])  # where the body then faces
TIMES = np.array([0.2, 0.4, 0.6, 1.0])


def make_past(speed: float = 0.0, std: float = 0.02, place: tuple[float, float, float] = (3.0, 1.0, 0.0)) -> Past:
    """Return one upright person in a frame with z up who moves ahead at a speed in m/s, limbs at rest."""
    joints = STANDING @ UPRIGHT.T + place
    velocity = np.tile(speed * FORWARD, (15, 1))
    earlier = joints - np.array(PAST_S)[:, None, None] * velocity
    past = joints, velocity, np.full(15, std), earlier, FORWARD, UP
    return Past(*(values[None] for values in past))


def predict_one(past: Past, times: np.ndarray) -> Displacements:
    return Displacements(*(values[0] for values in load_motion_predictor().predict(past, times[None])))


def test_who_stands_stays_and_who_walks_goes_on() -> None:
    standing, walking = (predict_one(make_past(speed), TIMES).joints for speed in (0.0, 1.3))
    assert np.linalg.norm(standing, axis=2).max() < 0.2
    np.testing.assert_allclose((walking - standing).mean(axis=1) @ FORWARD, 1.3 * TIMES, rtol=0.5)


@given(st.integers(0, 2**31), st.floats(0.0, 3.0))
@settings(max_examples=30)
def test_a_prediction_turns_with_the_axes_of_the_camera(seed: int, speed: float) -> None:
    turn = Rotation.random(random_state=np.random.default_rng(seed)).as_matrix()
    past = make_past(speed)
    turned = Past(*(value if i == 2 else value @ turn.T for i, value in enumerate(past)))
    one, other = (predict_one(p, TIMES) for p in (past, turned))
    np.testing.assert_allclose(one.joints @ turn.T, other.joints, atol=1e-9)
    np.testing.assert_allclose(turn @ one.root_covariance @ turn.T, other.root_covariance, atol=1e-9)
    np.testing.assert_allclose(one.std, other.std, atol=1e-12)


def test_between_its_times_a_prediction_is_continuous_and_begins_with_the_newest_frame() -> None:
    past = make_past(1.3)
    at_zero = predict_one(past, np.zeros(1))
    np.testing.assert_allclose(at_zero.joints, 0, atol=1e-12)
    np.testing.assert_allclose(at_zero.std, past.std)
    np.testing.assert_allclose(at_zero.root_covariance, 0)
    dense = predict_one(past, np.linspace(0, 1, 101))
    assert np.abs(np.diff(dense.joints, axis=0)).max() < 0.05, 'less than 5 m/s'
    deviations = np.trace(dense.root_covariance, axis1=1, axis2=2)
    assert (np.diff(deviations) > 0).all()
    assert (np.diff(dense.std, axis=0) >= 0).all()
    last, beyond = (predict_one(past, np.array([t])) for t in (1.0, 1.5))
    np.testing.assert_allclose(beyond.joints, last.joints)
    np.testing.assert_allclose(beyond.root_covariance, 2.25 * last.root_covariance)


def test_people_are_predicted_together_as_alone() -> None:
    pasts = [make_past(0.0), make_past(1.3, 0.05, (4.0, -2.0, 0.1)), make_past(0.7, np.nan)]
    times = np.array([TIMES, TIMES + 0.05, TIMES / 3])
    together = load_motion_predictor().predict(Past(*map(np.concatenate, zip(*pasts, strict=True))), times)
    for n, past in enumerate(pasts):
        alone = predict_one(past, times[n])
        for ours, own in zip(together, alone, strict=True):
            np.testing.assert_allclose(ours[n], own, atol=1e-12)


SPANS = np.array(SPANS_S)


def make_velocity_past(seed: int, jitter_m: float = 0.02) -> VelocityPast:
    """Return an upright person in an optical frame, 4 m away, whose earlier positions have this jitter."""
    rng = np.random.default_rng(seed)
    joints = STANDING + [0.5, 0.0, 4.0]
    velocity = rng.normal(0, 1, 3) + rng.normal(0, 0.3, (15, 3))
    earlier = joints - SPANS[:, None, None] * velocity + rng.normal(0, jitter_m, (len(SPANS), 15, 3))
    axes = Rotation.random(random_state=rng).as_matrix()
    past = velocity, rng.uniform(0.1, 0.8, 15), joints, earlier, axes
    return VelocityPast(*(values[None] for values in past))


def find_correction(past: VelocityPast) -> np.ndarray:
    """Return what the network adds to velocities; deviations and covariances follow by the formulas."""
    velocity, std = past.velocity.copy(), past.std.copy()
    covariance, before = np.diag([0.1, 0.2, 0.3])[None].repeat(len(velocity), 0), np.diag([0.1, 0.2, 0.3])
    load_velocity_correction().correct(past._replace(velocity=velocity, std=std), covariance)
    added = velocity - past.velocity
    if added.any():
        expected = np.hypot(0.7 * past.std, 0.7 * np.linalg.norm(added, axis=-1))
        np.testing.assert_allclose(std, expected, rtol=1e-9)
        root = 0.7 * (added[0, HIPS[0]] + added[0, HIPS[1]]) / 2
        np.testing.assert_allclose(covariance[0], 1.69 * (0.49 * before + np.outer(root, root)), atol=1e-12)
    return np.asarray(added)


@given(st.integers(0, 2**31))
@settings(max_examples=30)
def test_a_correction_turns_with_the_axes_of_the_camera(seed: int) -> None:
    past, turn = make_velocity_past(seed), Rotation.random(random_state=np.random.default_rng(seed)).as_matrix()
    joints, earlier = past.joints @ turn.T, past.earlier @ turn.T
    turned = VelocityPast(past.velocity @ turn.T, past.std, joints, earlier, turn @ past.axes)
    one, other = map(find_correction, (past, turned))
    assert np.abs(one).max() > 0
    np.testing.assert_allclose(one @ turn.T, other, atol=1e-4)


def test_without_a_past_nothing_is_corrected() -> None:
    past = make_velocity_past(0)
    assert find_correction(past).any()
    for n, span in enumerate(SPANS):
        earlier = past.earlier.copy()
        earlier[:, n:] = np.nan
        correction = find_correction(past._replace(earlier=earlier))
        assert np.isfinite(correction).all()
        assert bool(correction.any()) == (span > LEAST_PAST_S)
    unknown = np.full((1, 15, 3), np.nan)
    load_velocity_correction().correct(
        past._replace(velocity=unknown, std=unknown[..., 0].copy()), np.zeros((1, 3, 3))
    )
    assert np.isnan(unknown).all()


@pytest.mark.parametrize('jitter', [0.05, 1e30])
def test_a_correction_is_limited_by_what_the_filter_does_not_know(jitter: float) -> None:
    for seed in range(20):
        past = make_velocity_past(seed, jitter)
        correction = np.linalg.norm(find_correction(past), axis=2)
        assert (correction <= MAX_CORRECTION * past.std * (1 + 1e-9)).all()


WALK = load_base_poses('walk')  # aligned by heading: z is up in every pose


def find_upward_plainly(pose: np.ndarray) -> np.ndarray:
    at = {name: pose[i] for i, name in enumerate(CMU15.joints)}
    lever = MASSES @ pose - (at['lankle'] + at['rankle']) / 2
    ahead = np.cross(at['lhip'] - at['rhip'] + at['lshoulder'] - at['rshoulder'], lever)
    legs = [np.linalg.norm(at[s + a] - at[s + b]) for s in 'lr' for a, b in (('hip', 'knee'), ('knee', 'ankle'))]
    length = np.linalg.norm(at['neck'] - at['pelvis']) + sum(legs) / 2
    upward = lever - SUPPORT_AHEAD * length * ahead / np.linalg.norm(ahead)
    return upward / np.linalg.norm(upward)


def test_the_kernel_computes_the_formula(rng: np.random.Generator) -> None:
    poses = rng.normal(size=(5, 15, 3))
    assert Stances.of(poses).upward == pytest.approx(np.array([find_upward_plainly(p) for p in poses]), abs=1e-12)


def test_walkers_show_the_vertical(rng: np.random.Generator) -> None:
    poses = WALK.poses(0.7 * rng.normal(size=(20, len(WALK.std))) * WALK.std)
    angles = np.degrees(np.arccos(Stances.of(poses).upward[:, 2]))
    assert np.median(angles) < 4, 'degrees; 3.2 over all motions of the training persons'

    assert np.isnan(Stances.of(np.full((1, 15, 3), np.nan)).upward).all()
    assert Stances.of(np.zeros((0, 15, 3))).upward.shape == (0, 3)


POSTERIOR_STD = np.array([[0.01, 0.01, 0.05]])  # m
SEEN = np.array([[1.0, 0.0, 1.0]])  # scores
LIFTER_STD = np.array([[[0.02, 0.03, 0.06], [0.02, 0.03, 0.06], [np.nan] * 3]])  # m; 0.07 m together
UNLIFTED = np.full((1, 3, 3), np.nan)


def estimate_joint_std(posterior: np.ndarray, lifted_std: np.ndarray, noise: float = 0.0) -> np.ndarray:
    joints, size = np.ones((1, 3, 3)), np.array([[1.0, 0.0, 0.0]])
    seen = ExtremityEvidence(joints, joints, lifted_std, joints, SEEN, np.full(1, noise))
    return np.asarray(describe_cores(posterior, seen, joints, size, np.zeros((1, 3)), np.array([0, 1]))[0][0])


def test_the_lifter_decides_where_it_lifted_and_noise_and_hiding_make_joints_less_certain() -> None:
    posterior = estimate_joint_std(POSTERIOR_STD, UNLIFTED)
    seen, inferred, not_lifted = estimate_joint_std(POSTERIOR_STD, LIFTER_STD)
    noisy = estimate_joint_std(POSTERIOR_STD, LIFTER_STD, 0.03)
    assert posterior[1] > posterior[0] > 0.011
    assert inferred > seen
    assert (seen, inferred) == pytest.approx((0.65 * 0.06 * 1.5**0.5, 0.8 * 0.07))
    assert not_lifted == posterior[2]
    assert noisy[0] > seen
    assert noisy[1:].tolist() == [inferred, not_lifted], 'the image says nothing of it, and the posterior knows it'
    assert estimate_joint_std(np.zeros((1, 3)), UNLIFTED) == pytest.approx(0.011)


def test_published_deviations_follow_posture_visibility_and_size() -> None:
    up, std, sure = np.array([0.0, -1.0, 0.0]), np.full((2, 15), 0.05), np.zeros(2)
    seated = STANDING.copy()
    for side in 'lr':
        hip, knee, ankle = (CMU15.index(side + joint) for joint in ('hip', 'knee', 'ankle'))
        seated[knee] = seated[hip] + [0, 0, -np.linalg.norm(STANDING[knee] - STANDING[hip])]
        seated[ankle] = seated[knee] + STANDING[ankle] - STANDING[knee]
    joints, is_seen = np.stack([STANDING, seated]), np.ones((2, 15), bool)
    is_seen[:, CMU15.index('lwrist')] = False
    *legs, no_legs = (np.where(is_seen[0], *factors) for factors in POSTURE_FACTORS)
    of_posture = np.array(legs)
    np.testing.assert_allclose(widen_by_posture(std, joints, is_seen, up, sure), 0.05 * of_posture)
    lying = widen_by_posture(std, joints, is_seen, up[[0, 2, 1]], sure)
    np.testing.assert_allclose(lying, 0.05 * of_posture[[1, 1]])
    share = np.array([0.0, 0.1])
    reach = 0.1 * np.linalg.norm(seated - seated.mean(axis=0), axis=1)
    sized = widen_by_posture(std, joints, is_seen, up, share)
    np.testing.assert_allclose(sized, of_posture * np.hypot(std, [0 * reach, reach]))
    is_seen[:, [CMU15.index(s + j) for s in 'lr' for j in ('knee', 'ankle')]] = False
    without_legs = widen_by_posture(std, joints, is_seen, up, sure)
    no_legs[~is_seen[0]] = POSTURE_FACTORS[2, 1]
    np.testing.assert_allclose(without_legs, 0.05 * np.stack([no_legs, no_legs]))


def test_covariances_are_longest_along_the_line_of_sight(rng: np.random.Generator) -> None:
    position = rng.normal(size=(4, 3))
    covariance = compute_joint_covariance(np.full(4, 0.3), position)
    values, vectors = np.linalg.eigh(covariance)
    assert values.sum(axis=1) == pytest.approx(np.full(4, 0.09))
    assert np.abs((vectors[..., 2] * position).sum(axis=1)) == pytest.approx(np.linalg.norm(position, axis=1))
