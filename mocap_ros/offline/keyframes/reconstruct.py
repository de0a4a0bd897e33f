"""Reconstruction of a long sequence by keyframes, from 2D to 3D (Loy et al. 2004, figure 1)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mocap_ros.config import Config, KeyframesConfig
from mocap_ros.errors import InputError
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.rotations import rotation_to
from mocap_ros.geometry.weak_perspective import Cameras
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.offline.keyframes.body_halves import half_poses, halves, torso_lengths
from mocap_ros.offline.keyframes.detector_offsets import joint_offsets, without_offsets
from mocap_ros.offline.keyframes.filters import bridged
from mocap_ros.offline.keyframes.gradient_fit import Placed, fitted, placed
from mocap_ros.offline.keyframes.interpolation import limb_directions, misfits, pose_of, slerp, thinned
from mocap_ros.offline.keyframes.key_poses import adapted, choose, key_directions, limb_lengths, proposals
from mocap_ros.offline.keyframes.keyframe_set import Keyframes, summarised
from mocap_ros.offline.keyframes.observations import Observed, observe, sections
from mocap_ros.offline.keyframes.outliers import jumps, outliers
from mocap_ros.offline.keyframes.taylor import Choice
from mocap_ros.offline.whole_sequence import SequenceResult
from mocap_ros.skeleton import CMU15
from mocap_ros.solvers.window import Reconstruction

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]

SECTION, MARGIN = 60.0, 1.0
FILL_TIME, FILL_TRUST = 1.0, 0.5
BRIDGE = 0.5
TORSO = 0.5


@dataclass(frozen=True, eq=False)
class KeyframeResult:
    """A sequence reconstructed by keyframes.

    Attributes:
        result: 3D joints; joints that were not seen or called outliers are not `seen` in it.
        keyframes: of the upper and the lower half.
        controls: for each half, the frames taken for their key poses.
        motion: (F, J, 3) m, virtual camera's axes: the interpolation between key poses, before the fit.
        outliers: (F, J) image points that were seen and not believed.
        error: m^2, mean squared reprojection error before each step of the fit and at the end.
    """

    result: SequenceResult
    keyframes: tuple[Keyframes, Keyframes]
    controls: tuple[Indices, Indices]
    motion: Array
    outliers: Mask
    error: tuple[float, ...]


def summarise(
    observed: Observed, config: KeyframesConfig, progress: Callable[[str], None] = lambda _: None
) -> tuple[Keyframes, Keyframes]:
    """The keyframes of both halves of the body in a sequence.

    Args:
        observed: believable image points.
        config: when poses are alike, and when there are keyframes enough.
        progress: told what is done next.
    """
    out = []
    for half in halves(CMU15):
        progress(f'keyframes, {half.name} body')
        poses = half_poses(observed.points, observed.weight, observed.times, half, BRIDGE)
        out.append(summarised(poses, half, len(observed.times), config))
    return out[0], out[1]


def reconstruct(
    keypoints: Array,
    joint_names: tuple[str, ...],
    times: Array,
    intrinsics: Intrinsics,
    models: Mapping[str, BasePoses],
    config: Config,
    choices: Sequence[Choice] = (),
    progress: Callable[[str], None] = lambda _: None,
) -> KeyframeResult:
    """Reconstruct a long sequence of one person's keypoints by keyframes.

    Args:
        keypoints: (F, J, 3) x, y in px and score; NaN or score 0 where not seen.
        joint_names: (J,) any names that `skeleton.joint_map` knows.
        times: (F,) s, increasing.
        intrinsics: of the camera.
        models: base poses by name, for the solver that makes key poses.
        config: `keyframes`; `solver` and `tracker` as in `offline.reconstruct_sequence`.
        choices: for keyframes whose poses are to be made by Taylor's method.
        progress: told what is done next.

    Raises:
        SkeletonError: too few of the model's joints can be had from these names.
        InputError: no frame has four seen joints, no 3D pose can be made of any, or a choice does not fit the
            keyframes.
    """
    settings = config.keyframes
    observed = observe(keypoints, joint_names, times, intrinsics, config.tracker)
    plausible = observed.without(suspects(observed))
    keyframes = summarise(plausible, settings, progress)
    progress('key poses')
    frames = np.concatenate([half.frames for half in keyframes])
    category, poses = proposals(plausible, frames, intrinsics, models, config)
    lengths = limb_lengths(poses, config.tracker.body_height)
    progress('interpolation')
    keys = tuple(key_directions(half, poses, settings.beta) for half in keyframes)
    for choice in choices:
        choose(choice, keyframes, keys, plausible, lengths)
    if not any(np.isfinite(k).all(axis=(1, 2)).any() for k in keys):
        raise InputError('no key poses: too little is seen, or alike (keyframes.beta)')
    motion, controls = interpolated(plausible, keyframes, keys, poses, lengths, settings)
    start = placed(motion, plausible.points, plausible.weight, times, observed.focal)
    wrong = outliers(_displacement(start, observed), observed.weight > 0, times)
    believed = observed.without(wrong)
    start = placed(motion, believed.points, believed.weight, times, observed.focal)
    model = models[category].rescaled(config.tracker.body_height / models[category].stature)
    offsets = _offsets(poses, lengths, believed, model.mean)
    believed = replace(
        believed, points=without_offsets(offsets, start, believed.points, believed.focal, model.mean)
    )
    start = placed(motion, believed.points, believed.weight, times, observed.focal)
    progress('fit')
    points, weight = filled(start, believed)
    descent = fitted(
        start,
        points,
        weight,
        times,
        lengths,
        CMU15,
        focal=observed.focal,
        step=settings.step,
        smoothing=settings.smoothing,
        iterations=settings.iterations,
    )
    result = _result(descent.placed, believed, category, model, descent.error)
    return KeyframeResult(result, keyframes, controls, motion, wrong, descent.error)


def suspects(observed: Observed) -> Mask:
    """(F, J) points that jump in the image: left out of distances and key poses, judged again in 3D."""
    out = np.zeros(observed.weight.shape, bool)
    torso = torso_lengths(observed.points, observed.weight, observed.times)
    in_metres = observed.points / torso[:, None, None] * TORSO
    for wide, own in sections(observed.times, SECTION, MARGIN):
        found = jumps(in_metres[wide], observed.weight[wide] > 0, observed.times[wide])
        out[own] = found[own.start - wide.start : own.stop - wide.start]
    return out


def interpolated(
    observed: Observed,
    keyframes: tuple[Keyframes, Keyframes],
    keys: Sequence[Array],
    poses: Array,
    lengths: Array,
    config: KeyframesConfig,
) -> tuple[Array, tuple[Indices, Indices]]:
    """The motion between key poses (section 6.1).

    Args:
        observed: believable image points.
        keyframes: of both halves.
        keys: (K, B, 3) limb directions of the key poses of each.
        poses: (F, J, 3) proposals of any size, NaN where unknown.
        lengths: (B,) m.
        config: `gap` and `frame_pose_share` apply.

    Returns:
        (F, J, 3) m, and each half's control points.
    """
    times = observed.times
    in_torsos = observed.points / torso_lengths(observed.points, observed.weight, times)[:, None, None]
    directions = np.zeros((len(times), len(CMU15.bones), 3))
    number = {bone: i for i, bone in enumerate(CMU15.bones)}
    torso = lengths[number[CMU15.index('pelvis'), CMU15.index('neck')]]
    some = np.flatnonzero(np.isfinite(poses).all(axis=(1, 2)))
    proposed = slerp(limb_directions(poses[some], CMU15.bones), times[some], times)
    controls = []
    for half, limbs in zip(keyframes, keys, strict=True):
        known = np.asarray(np.isfinite(limbs).all(axis=(1, 2)))
        bones = [number[b] for b in half.half.bones]
        if not known.any():
            directions[:, bones] = proposed[:, bones]
            controls.append(half.frames[:0])
            continue
        whole = np.zeros((len(limbs), len(CMU15.bones), 3))
        whole[:, bones] = limbs
        flat = pose_of(whole, lengths / torso, CMU15)[..., :2]
        joints = list(half.half.joints)
        at: Indices = np.where(known[half.nearest], half.assigned, -1)
        misfit = np.full(len(times), np.inf)
        some = np.flatnonzero(at >= 0)
        misfit[some] = misfits(
            flat[at[some]][:, joints], in_torsos[some][:, joints], observed.weight[some][:, joints] > 0
        )
        control = thinned(at, np.nan_to_num(misfit, nan=np.inf), times, config.gap)
        controls.append(control)
        mixed = adapted(limbs[at[control]], proposed[control][:, bones], config.frame_pose_share)
        directions[:, bones] = slerp(mixed, times[control], times)
    return pose_of(directions, lengths, CMU15), (controls[0], controls[1])


def _offsets(poses: Array, lengths: Array, observed: Observed, body: Array) -> Array:
    """(J, 3) m, offsets of the detector's joints from the model's by the frames with a proposed pose."""
    at = np.flatnonzero(np.isfinite(poses).all(axis=(1, 2)))
    proposed = pose_of(limb_directions(poses[at], CMU15.bones), lengths, CMU15)
    points, weight = observed.points[at], observed.weight[at]
    motion = placed(proposed, points, weight, observed.times[at], observed.focal)
    return joint_offsets(motion, points, weight, observed.focal, body)


def _displacement(motion: Placed, observed: Observed) -> Array:
    """(F, J, 2) m, of the image points from where the motion has them, at the depth of their joints."""
    return motion.lifted(observed.points, observed.focal) - motion.joints[..., :2]


def filled(motion: Placed, observed: Observed) -> tuple[Array, Array]:
    """Image points (F, J, 2) px and weights (F, J); what is not seen is interpolated beside the motion."""
    seen = observed.weight > 0
    moved, known = bridged(_displacement(motion, observed), seen, observed.times, FILL_TIME)
    joints = motion.joints.copy()
    joints[..., :2] += np.where(known[..., None], moved, 0.0)
    guess = Placed(joints, motion.scale, motion.translation).image(observed.focal)
    points = np.where(seen[..., None], observed.points, guess)
    return points, np.where(seen, observed.weight, FILL_TRUST)


def _result(
    motion: Placed, observed: Observed, category: str, model: BasePoses, error: tuple[float, ...]
) -> SequenceResult:
    """The fitted motion in the form of all solvers; what was not believed is not seen."""
    joints, translation = motion.joints, motion.translation
    seen = observed.weight > 0
    rotation = rotation_to(np.broadcast_to(model.mean, joints.shape), joints)
    cameras = Cameras(motion.scale, rotation)
    missed = ((motion.image(observed.focal) - observed.points) ** 2).sum(axis=-1)
    with np.errstate(invalid='ignore'):
        residual = np.sqrt((missed * seen).sum(axis=1) / seen.sum(axis=1))
    solution = Reconstruction(
        joints=joints,
        theta=model.weights(joints @ rotation),
        cameras=cameras,
        translation=translation,
        residual=residual,
        objective=error,
        iterations=len(error) - 1,
        converged=True,
        noise=float('nan'),
        spread=np.full(joints.shape[1], np.nan),
    )
    view = observed.view
    in_camera = view.to_camera(joints) + view.roots(cameras, translation)[:, None]
    return SequenceResult(in_camera, seen, CMU15, category, solution)
