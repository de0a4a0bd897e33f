"""Fit of the motion predictor (`models/motion_predictor.py`) to what the tracker saw, and what people then did.

The place of the root at the newest frame counts as right: that a person is nearer or farther than thought is no
error of the prediction, and is in the covariance of the root already.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from mocap_ros.models.motion_predictor import MotionPredictor, Past, compute_features
from mocap_ros.people import HIPS
from mocap_ros.skeleton import CMU15

Array = NDArray[np.float64]

TIMES_S = (0.2, 0.4, 0.6, 1.0)  # s ahead, for which a predictor is fitted
DIRECTIONS = 30  # principal directions of the limbs' features; 60 are 2 % worse on others than those fitted to
ROOT_RIDGE = 3e-2  # of the number of samples; features are scaled to a mean square of 1
LIMB_RIDGE = 0.3  # likewise
TURNED_SHARE = 0.2  # of a sample, for which its copy with a wrong heading counts; 1 % worse where it is right
NEAR_M = 0.05  # m; nearer predictions count alike, for the truth is not known better
WITHIN_95 = 7.815  # 1; squared Mahalanobis distance in three dimensions that 95 of 100 normal errors are below
ROUNDS = 4  # of a fit, each weighted by the errors or the variances of the one before
MIRRORED = np.array([1.0, -1.0, 1.0])  # of the axes of the body


def fit_predictor(pasts: Sequence[Past], future: Array) -> MotionPredictor:
    """Return the predictor that is fitted to N samples.

    Args:
        pasts: what was known of the motion.
        future: (N, K, J, 3) m, true joints at the `TIMES_S` after, moved so that the root was right at the newest
            frame; NaN where not known.
    """
    features = [compute_features(past) for past in pasts]
    gates = np.array([f.gates for f in features])
    turned = [compute_features(past) for past in _turn_headings(pasts)]
    root_features = np.array([[f.root, g.root] for f, g in zip(features, turned, strict=True)])
    root_features = np.concatenate(
        [root_features, *(g[:, None, None, None] * root_features for g in gates.T)], axis=3
    )
    sights, bodies = (np.array([getattr(f, name) for f in features]) for name in ('line_of_sight', 'body'))
    now = np.array([past.joints for past in pasts])
    root, future_root = _centre(now), _centre(future)
    moved = (future_root - root[:, None]) @ sights
    about = now - root[:, None]
    changed = (future - future_root[:, :, None] - about[:, None]) @ bodies[:, None]
    limb_features = np.array([f.limbs for f in features])
    both = np.concatenate([limb_features, _mirror(limb_features)])
    mean = both.mean(axis=0)
    directions = np.linalg.eigh(np.cov((both - mean).T))[1][:, ::-1][:, :DIRECTIONS]
    z = (both - mean) @ directions
    z = np.concatenate([z, np.tile(gates[:, 1], 2)[:, None] * z], axis=1)
    root_weights, limb_weights = [], []
    for k in range(len(TIMES_S)):
        known = np.isfinite(future[:, k]).all(axis=(1, 2))
        along = np.moveaxis(moved[known, k], -1, 0)[:, :, None]
        seen = np.concatenate([root_features[known, 0], root_features[known, 1]])
        count = np.repeat([1.0, TURNED_SHARE], known.sum())
        twice = np.concatenate([along, along], axis=1)
        fitted = _fit_robustly(np.moveaxis(seen, 1, 0), twice, ROOT_RIDGE, count)
        root_weights.append(fitted[:, :, 0])
        flat = changed[known, k].reshape(known.sum(), -1)
        both_flat = np.concatenate([flat, _mirror(flat)])
        limb_weights.append(_fit_robustly(z[np.tile(known, 2)][None], both_flat[None], LIMB_RIDGE)[0])
    joints = len(CMU15.joints)
    unknown = np.zeros((len(TIMES_S), 3, 4)), np.zeros((len(TIMES_S), joints, 4))
    draft = MotionPredictor(
        np.array(TIMES_S), np.array(root_weights), mean, directions, np.array(limb_weights), *unknown
    )
    predicted = np.array([draft.predict(past, np.array(TIMES_S)).joints for past in pasts]) + now[:, None]
    root_variance, limb_variance = _fit_variances(
        predicted,
        future,
        sights,
        np.array([past.std for past in pasts]),
        np.array([f.root_squares for f in features]),
        np.array([f.limb_squares for f in features]),
    )
    return MotionPredictor(
        draft.times, draft.root, draft.mean, draft.directions, draft.limbs, root_variance, limb_variance
    )


def _fit_variances(
    predicted: Array, future: Array, sights: Array, std: Array, root_squares: Array, limb_squares: Array
) -> tuple[Array, Array]:
    """Return the variances (K, 3, 4) of the root and (K, J, 4) of the joints.

    Args:
        predicted: (N, K, J, 3) m.
        future: (N, K, J, 3) m.
        sights: (N, 3, 3) axes of the line of sight, in columns.
        std: (N, J) m, standard deviations at the newest frame.
        root_squares: (N, 4), on which the variances of the root depend.
        limb_squares: (N, J, 4), on which those of the joints depend.
    """
    error = predicted - future
    root_error = (_centre(error) @ sights) ** 2
    limb_error = ((error - _centre(error)[:, :, None]) ** 2).sum(axis=3)
    root_variance, limb_variance = [], []
    for k in range(error.shape[1]):
        known = np.isfinite(error[:, k]).all(axis=(1, 2))
        own = np.array([_fit_squares(root_squares[known], root_error[known, k, a]) for a in range(3)])
        distance = (root_error[known, k] / (root_squares[known] @ own.T)).sum(axis=1)
        root_variance.append(own * np.quantile(distance, 0.95) / WITHIN_95)
        fitted = []
        for j in range(error.shape[2]):
            squares, squared = limb_squares[known, j], limb_error[known, k, j]
            before = std[known, j] ** 2
            weights = _fit_squares(squares, squared, before)
            fitted.append(weights * _find_factor(squares @ weights, squared, before))
        limb_variance.append(fitted)
    return np.array(root_variance), np.array(limb_variance)


def _fit_squares(squares: Array, squared: Array, before: Array | float = 0.0) -> Array:
    """Return the weights (S,), none negative, with which squares (N, S) explain squared errors (N,)."""
    weight = np.ones(len(squared))
    out = np.zeros(squares.shape[1])
    for _ in range(ROUNDS):
        out = nnls(squares * weight[:, None], (squared - before) * weight)[0]
        variance = squares @ out + before
        weight = 1 / np.maximum(variance, np.quantile(variance, 0.05))
    return np.asarray(out)


def _find_factor(growth: Array, squared: Array, before: Array) -> float:
    """Return the factor on the growth (N,) so that 95 of 100 squared errors (N,) are within the ellipsoid."""
    low, high = 0.0, 10.0
    for _ in range(30):
        factor = (low + high) / 2
        is_enough = (squared * 3 <= WITHIN_95 * (before + factor * growth)).mean() >= 0.95
        low, high = (low, factor) if is_enough else (factor, high)
    return high


def _fit_robustly(features: Array, values: Array, share: float, count: Array | float = 1.0) -> Array:
    """Return the weights (F, P) by which features (G, N, F) give values (G, N, P), one set for each of G groups.

    They have the least mean distance, not the least squares, by which few fast motions would outweigh all others.

    Args:
        features: (G, N, F); the groups are axes whose errors are those of one place, or one group.
        values: (G, N, P) m.
        share: ridge as a share of N.
        count: (N,) how much each sample counts.
    """
    weight = np.ones(features.shape[1]) * count
    for _ in range(ROUNDS):
        weights = [_fit_ridge(f, v, share, weight) for f, v in zip(features, values, strict=True)]
        errors = np.stack([f @ w - v for f, w, v in zip(features, weights, values, strict=True)])
        distance = np.sqrt((errors**2).sum(axis=(0, 2)) * 3 / (errors.shape[0] * errors.shape[2]))
        weight = count / np.maximum(distance, NEAR_M)
        weight /= weight.mean()
    return np.array(weights)


def _fit_ridge(features: Array, values: Array, share: float, weight: Array) -> Array:
    """Return the weights (F, V) by which features (N, F) give values (N, V), held small by a share of N."""
    scale = np.maximum(np.sqrt((weight[:, None] * features**2).mean(axis=0)), 1e-3)
    scaled = features / scale
    weighted = scaled * weight[:, None]
    normal = scaled.T @ weighted + share * len(scaled) * np.eye(scaled.shape[1])
    return np.asarray(np.linalg.solve(normal, weighted.T @ values) / scale[:, None])


def _turn_headings(pasts: Sequence[Past]) -> list[Past]:
    """Return samples whose bodies seem to face anywhere, as they do when they are seen the wrong way round."""
    rng = np.random.default_rng(0)
    return [past._replace(heading=rng.standard_normal(3)) for past in pasts]


def _mirror(flat: Array) -> Array:
    """Return places (N, M * 3 J) in the axes of the body with left and right exchanged."""
    shaped = flat.reshape(len(flat), -1, len(CMU15.joints), 3)
    return np.asarray((shaped[:, :, list(CMU15.mirror)] * MIRRORED).reshape(flat.shape))


def _centre(places: Array) -> Array:
    """Return the middle (..., 3) between the hips of places (..., J, 3)."""
    return np.asarray((places[..., HIPS[0], :] + places[..., HIPS[1], :]) / 2)
