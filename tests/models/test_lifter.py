"""The lifter: NumPy does what PyTorch trained, in any place and size, from whatever was seen; and its prior."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mocap_ros.errors import ModelError
from mocap_ros.geometry.rotations import centred, small_rotation
from mocap_ros.models import lifter, model_file
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.lifter import JOINTS, SLOTS, Lifted, Lifter
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.joint.lifted_pose import LiftedTerm, lifted_start
from mocap_ros.solvers.window import Window
from mocap_ros.training.synthesis import Motions, Synthesis

PX_PER_M = 300.0


@pytest.fixture(scope='module')
def shipped() -> Lifter:
    return model_file.shipped_lifter()


@pytest.fixture
def walk(
    walk_model: BasePoses, rng: np.random.Generator
) -> tuple[lifter.Array, lifter.Array, lifter.Array, lifter.Array]:
    """Poses (F, J, 3) m, camera's frame, their image px, weights and times of somebody who moves."""
    t = np.arange(40) / 30
    phases = rng.uniform(0, 2 * np.pi, 6)
    theta = 1.2 * walk_model.std[:6] * np.sin(2 * np.pi * t[:, None] + phases)
    optical = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0.0]])
    turn = optical @ small_rotation(np.array([0, 0, 0.9]))
    poses = walk_model.poses(theta) @ turn.T
    return poses, PX_PER_M * poses[..., :2] + [400, 300], np.ones((40, JOINTS)), t


def error_mm(lifted: lifter.Array, truth: lifter.Array) -> float:
    return float(np.linalg.norm(lifted / PX_PER_M - centred(truth), axis=-1).mean() * 1e3)


def test_it_lifts(shipped: Lifter, walk: tuple[lifter.Array, ...]) -> None:
    poses, points, weight, times = walk
    lifted = shipped.lift_sequence(points, weight, times)
    assert error_mm(lifted.joints, poses) < 60
    assert lifted.joints.mean(axis=1) == pytest.approx(0, abs=1e-9)
    far = np.abs(lifted.joints / PX_PER_M - centred(poses)) > 3 * lifted.spread / PX_PER_M
    assert far.mean() < 0.1, 'its own uncertainty says how far it is off'


def test_place_and_size_are_the_callers(shipped: Lifter, walk: tuple[lifter.Array, ...]) -> None:
    _, points, weight, times = walk
    here = shipped.lift_sequence(points, weight, times)
    there = shipped.lift_sequence(0.25 * points + [70, -900], weight, times)
    assert there.joints == pytest.approx(0.25 * here.joints, abs=1e-2)
    assert there.spread == pytest.approx(0.25 * here.spread, abs=1e-2)


def test_a_camera_that_looks_past_the_person_sees_the_same_pose(
    shipped: Lifter, walk: tuple[lifter.Array, ...]
) -> None:
    _, points, weight, times = walk
    focal = 900.0
    turn = small_rotation(np.array([0.0, 0.4, 0.0]))
    rays = np.concatenate([points - points.mean(axis=(0, 1)), np.full_like(points[..., :1], focal)], axis=-1)
    past = rays @ turn.T
    facing, turned = (
        shipped.lift_sequence(focal * r[..., :2] / r[..., 2:], weight, times, focal).joints for r in (rays, past)
    )
    size = np.linalg.norm(facing, axis=-1).mean()
    assert np.linalg.norm(turned - facing @ turn.T, axis=-1).mean() < 0.02 * size


def test_a_mirror_image_is_lifted_to_the_mirror_image(shipped: Lifter, walk: tuple[lifter.Array, ...]) -> None:
    _, points, weight, times = walk
    mirror = list(CMU15.mirror)
    weight[:, CMU15.index('lwrist')] = 0
    here = shipped.lift_sequence(points, weight, times)
    there = shipped.lift_sequence(points[:, mirror] * [-1, 1], weight[:, mirror], times)
    assert there.joints[:, mirror] * [-1, 1, 1] == pytest.approx(here.joints, abs=0.05)


def test_one_frame_is_enough(shipped: Lifter, walk: tuple[lifter.Array, ...]) -> None:
    poses, points, weight, times = walk
    lifted = shipped.lift_sequence(points[:1], weight[:1], times[:1])
    assert error_mm(lifted.joints, poses[:1]) < 90


def test_people_do_not_disturb_each_other(shipped: Lifter, walk: tuple[lifter.Array, ...]) -> None:
    _, points, weight, times = walk
    parts = [lifter.histories(points, weight, times, np.array([f])) for f in (3, 20, 39)]
    together = shipped.lift(np.concatenate([p for p, _ in parts]), np.concatenate([w for _, w in parts]))
    for (p, w), joints in zip(parts, together.joints, strict=True):
        assert shipped.lift(p, w).joints[0] == pytest.approx(joints, abs=0.05)


def test_the_future_does_not_matter(shipped: Lifter, walk: tuple[lifter.Array, ...]) -> None:
    _, points, weight, times = walk
    whole = shipped.lift_sequence(points, weight, times)
    part = shipped.lift_sequence(points[:20], weight[:20], times[:20])
    assert part.joints == pytest.approx(whole.joints[:20], abs=0.05)


def test_some_joints_tell_of_the_others(shipped: Lifter, walk: tuple[lifter.Array, ...]) -> None:
    poses, points, weight, times = walk
    hidden = [CMU15.index(j) for j in ('head', 'neck', 'pelvis', 'lwrist', 'rankle')]
    weight[:, hidden] = 0
    points[:, hidden] = np.nan
    lifted = shipped.lift_sequence(points, weight, times)
    assert error_mm(lifted.joints, poses) < 120
    assert lifted.spread[:, hidden].mean() > lifted.spread.mean()


def test_too_little_seen_is_nan(shipped: Lifter, walk: tuple[lifter.Array, ...]) -> None:
    _, points, weight, times = walk
    weight[5] = 0
    lifted = shipped.lift_sequence(points, weight, times)
    assert np.isnan(lifted.joints[5]).all()
    assert np.isfinite(np.delete(lifted.joints, 5, axis=0)).all()


def test_size_comes_from_the_bones(walk: tuple[lifter.Array, ...]) -> None:
    poses, _, _, times = walk
    nearer = np.exp(times)[:, None, None]
    joints = 500 * nearer * centred(poses)
    joints[3] = np.nan
    found = lifter.metric(Lifted(joints, np.ones_like(joints)), times, 1.7)
    good = np.arange(16, 24)
    size, true = (np.linalg.norm(p[good], axis=-1).sum(axis=1) for p in (found.joints, centred(poses)))
    ratio = size / true
    assert ratio == pytest.approx(ratio.mean(), rel=0.02)
    assert ratio.mean() == pytest.approx(1, abs=0.1)
    assert np.isnan(found.joints[3]).all()


def test_histories_interpolate_but_bridge_no_gap(rng: np.random.Generator) -> None:
    times = np.sort(rng.uniform(0, 1, 40))
    times = times[np.diff(times, prepend=-1) > 0.006]
    times = times[(times < 0.3) | (times > 0.55)]
    points = np.broadcast_to(times[:, None, None], (len(times), JOINTS, 2)) * 100
    weight = np.ones((len(times), JOINTS))
    found, seen = lifter.histories(points, weight, times, np.array([len(times) - 1]))
    wanted = times[-1] - SLOTS
    known = seen[0, :, 0] > 0
    assert known[0]
    assert found[0, known, 0, 0] == pytest.approx(100 * wanted[known], abs=100 * lifter.SAME_TIME)
    inside = (wanted > 0.31) & (wanted < 0.54)
    assert not known[inside].any()
    assert not known[wanted < times[0] - lifter.SAME_TIME].any()


coordinates = st.floats(width=64) | st.sampled_from([0.0, np.nan, np.inf, -np.inf, 1e308])


@settings(max_examples=25, deadline=None)
@given(arrays(float, (5, JOINTS, 2), elements=coordinates), arrays(float, (5, JOINTS), elements=coordinates))
def test_garbage_gives_numbers_or_nothing(points: lifter.Array, weight: lifter.Array) -> None:
    with np.errstate(all='ignore'):
        lifted = model_file.shipped_lifter().lift_sequence(points, weight, np.arange(5) / 30)
    finite = np.isfinite(lifted.joints).all(axis=(1, 2))
    assert (finite | np.isnan(lifted.joints).all(axis=(1, 2))).all()
    assert (np.isfinite(lifted.spread).all(axis=(1, 2)) == finite).all()


def test_save_and_load(tmp_path: Path, shipped: Lifter) -> None:
    model_file.save_lifter(shipped, tmp_path / 'a.npz')
    model_file.save_lifter(shipped, tmp_path / 'b.npz')
    assert (tmp_path / 'a.npz').read_bytes() == (tmp_path / 'b.npz').read_bytes()
    assert (tmp_path / 'a.npz').stat().st_size < 4 << 20
    back = model_file.load_lifter(tmp_path / 'a.npz')
    for mine, theirs in zip(back.layers, shipped.layers, strict=True):
        assert all((a == b).all() for a, b in zip(mine, theirs, strict=True))
    assert 'mocap.cs.cmu.edu' in str(back.provenance['acknowledgement'])


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 1 << 30), st.integers(0, 255))
def test_what_is_no_lifter_is_refused(place: int, byte: int) -> None:
    small = Lifter(tuple((np.zeros(s, 'f4'), np.zeros(s[1], 'f4')) for s in ((541, 2), (2, 75))), {})
    buffer = io.BytesIO()
    model_file.save_lifter(small, buffer)
    data = bytearray(buffer.getvalue())
    data[place % len(data)] = byte
    with contextlib.suppress(ModelError):
        model_file.lifter_from_bytes(bytes(data), 'x')
    with pytest.raises(ModelError, match='x: not a lifter'):
        model_file.lifter_from_bytes(bytes(data[: place % len(data)]), 'x')


def trials(model: BasePoses, rng: np.random.Generator) -> list[lifter.Array]:
    t = np.arange(60)[:, None] / 30
    return [model.poses(model.std[:5] * np.sin(2 * np.pi * t + rng.uniform(0, 6, 5))) for _ in range(3)]


def test_examples_are_people_and_repeat(walk_model: BasePoses, rng: np.random.Generator) -> None:
    motions = Motions.of(trials(walk_model, rng))
    a, b = (Synthesis(motions, 3).batch(64) for _ in range(2))
    assert (a.features == b.features).all()
    assert np.isfinite(a.features).all()
    assert np.isfinite(a.target).all()
    body = np.linalg.norm(a.target, axis=-1).mean(axis=1) * a.size
    assert 0.2 < body.min() <= body.max() < 1.0, 'm, mean distance of the joints from their centre'


def test_numpy_does_what_pytorch_does(walk_model: BasePoses, rng: np.random.Generator) -> None:
    torch = pytest.importorskip('torch', reason='training is optional: pip install mocap_ros[train]')
    from mocap_ros.training.lifter import Network

    torch.manual_seed(0)
    network = Network(32, 2, 0.1)
    batch = Synthesis(Motions.of(trials(walk_model, rng)), 0).batch(200)
    network(torch.from_numpy(batch.features))  # moves the statistics of the batch norms
    network.eval()
    with torch.no_grad():
        expected = network(torch.from_numpy(batch.features)).numpy()
    found = network.folded({}).forward(batch.features)
    assert found == pytest.approx(expected, abs=1e-4)
    assert network.folded({}).forward(batch.features[:1]) == pytest.approx(expected[:1], abs=1e-4)


def test_training_repeats_and_learns(walk_model: BasePoses, rng: np.random.Generator) -> None:
    torch = pytest.importorskip('torch', reason='training is optional: pip install mocap_ros[train]')
    from mocap_ros.training.lifter import Training, train

    torch.set_num_threads(1)

    data = trials(walk_model, rng)
    few, more = (Training(steps=n, batch=64, width=32) for n in (3, 60))
    first, again, longer = (train(data, s, {'source': 'test'}) for s in (few, few, more))
    assert all((a[0] == b[0]).all() for a, b in zip(first.layers, again.layers, strict=True))
    assert longer.provenance['source'] == 'test'
    errors = [float(str(x.provenance['error_mm'])) for x in (first, longer)]
    assert errors[1] < errors[0]


def test_start_from_a_lifted_pose(walk_model: BasePoses, walk: tuple[lifter.Array, ...]) -> None:
    poses, points, weight, times = walk
    joints = PX_PER_M * centred(poses)
    joints[7] = np.nan
    lifted = Lifted(joints, np.full_like(joints, 0.01 * PX_PER_M))
    start = lifted_start(lifted, Window(points, weight, times), walk_model)
    cameras = start.cameras
    back = cameras.scale[:, None, None] * walk_model.poses(start.theta) @ np.swapaxes(cameras.rotation, -1, -2)
    good = np.arange(len(times)) != 7
    assert error_mm(back[good], poses[good]) < 10
    assert cameras.scale[good] == pytest.approx(PX_PER_M, rel=0.1)


def test_rows_of_the_term_are_its_derivatives(walk_model: BasePoses, rng: np.random.Generator) -> None:
    frames, k = 3, 7
    model = walk_model.truncated(k)
    theta = rng.normal(size=(frames, k)) * model.std
    rotation = small_rotation(rng.normal(size=(frames, 3)))
    log_scale = 0.1 * rng.normal(size=frames)
    precision = rng.uniform(0, 2000, (frames, JOINTS, 3)) * (rng.random((frames, JOINTS, 1)) > 0.2)
    term = LiftedTerm(0.3 * rng.normal(size=(frames, JOINTS, 3)), precision, 1e-4, 3.0)

    def turned(step: lifter.Array) -> tuple[lifter.Array, lifter.Array]:
        scaled = np.exp(log_scale + step[:, -1])[:, None, None] * (small_rotation(step[:, k : k + 3]) @ rotation)
        return model.poses(theta + step[:, :k]) @ np.swapaxes(scaled, -1, -2), scaled

    here = np.zeros((frames, k + 4))
    residual, jacobian = term.rows(*turned(here), np.moveaxis(model.components, 0, -1))
    gradient = 2 * np.einsum('nrk,nr->nk', jacobian, residual)
    for column in range(k + 4):
        step = here.copy()
        step[:, column] = 1e-6
        numerical = (term.cost(turned(step)[0]) - term.cost(turned(-step)[0])) / 2e-6
        assert gradient[:, column] == pytest.approx(numerical, rel=1e-5, abs=1e-9)
