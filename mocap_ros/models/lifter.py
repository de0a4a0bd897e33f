"""The lifter: a small network that estimates a 3D pose from 2D joints, as start value and prior of the solvers.

    h_0 = relu(W_0 x + b_0),   h_(i+1) = h_i + relu(W'_i relu(W_i h_i + b_i) + b'_i),   y = W h + b

This is the network of Martinez et al. ("A simple yet effective baseline for 3D human pose estimation", ICCV 2017),
extended by a history and by its own standard deviations. The features x hold the image points of a person's last
0.8 s at fixed times before the newest frame (`HISTORY_SLOTS_S`), to which frames of any rate are interpolated. The
output y holds the newest pose in the camera's axes, as a difference from the newest image points, and the
logarithms of the standard deviations. Image points are given relative to the centroid of each frame and in units
of the window's mean distance from it; poses are returned in the same unit, so they do not depend on the person's
position and size in the image. Inference needs only NumPy.

Shapes: N histories, T slots, J joints of `skeleton.CMU15`, F frames.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap_ros.geometry.virtual_camera import rotate_rays, rotation_to_optical_axis
from mocap_ros.skeleton import CMU15

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

# s before the newest frame at which a history is sampled; dense for recent frames, sparse for older ones. A lifter
# can only be used with the slots that it was trained with.
HISTORY_SLOTS_S = np.array([0, 1, 2, 3, 4, 6, 8, 10, 13, 16, 20, 24]) / 30

MAX_INTERPOLATION_GAP_S = 0.15  # s; points in longer gaps between frames count as not seen, as in training
TIME_TOLERANCE_S = 0.004  # s; a frame this near to a slot is taken as it is, an eighth of a frame at 30 fps
MAX_FEATURE = 5.0  # mean distances from the centroid; bounds the effect of gross outliers on the network
MAX_COORDINATE = 1e12  # units of the input; larger coordinates count as not seen, their squares could overflow
ANGULAR_SIZE_UNIT_RAD = 0.1  # rad; brings the angular size of a person at usual distances to the order of 1
LOG_STD_RANGE = -7.0, 1.0  # log of the output unit; bounds standard deviations to 0.001 and 2.7 mean distances
MIN_SEEN_JOINTS = 3  # joints of the newest frame; with fewer the pose is NaN
EPSILON = 1e-9  # guards divisions by sums of weights and logarithms of bone lengths
SIZE_SMOOTHING_S = 0.25  # s, standard deviation of the Gaussian that averages the size of the bones over time
BONE_SUM_PER_STATURE = 2.36  # 1, sum of all bone lengths over stature; mean of the CMU trials (2.32 to 2.41)

JOINT_COUNT = len(CMU15.joints)  # joints
MIRROR_PERMUTATION = list(CMU15.mirror)  # joint indices with left and right exchanged
FEATURE_COUNT = 3 * JOINT_COUNT * len(HISTORY_SLOTS_S) + 1  # x, y and score of each joint and slot; angular size
OUTPUT_COUNT = 5 * JOINT_COUNT  # x, y and z of each joint; log standard deviations of x and y together, and of z


@dataclass(frozen=True, eq=False)
class LiftedPoses:
    """3D poses of N frames along the axes of the camera's optical frame (x right, y down, z forward).

    Attributes:
        joints: (N, J, 3) joint positions relative to the mean of each pose's joints, in the unit of the image
            points; NaN for frames with too few seen joints.
        std: (N, J, 3) standard deviations of the coordinates in the same unit; x and y share one value.
    """

    joints: Array
    std: Array

    def select_frames(self, frames: NDArray[np.intp] | slice) -> LiftedPoses:
        """Return the poses of the given frames."""
        return LiftedPoses(self.joints[frames], self.std[frames])

    def scale_by(self, factor: float) -> LiftedPoses:
        """Return the poses multiplied by a factor, for example to convert their unit."""
        return LiftedPoses(self.joints * factor, self.std * factor)


def concatenate_lifted(parts: Sequence[LiftedPoses]) -> LiftedPoses:
    """Concatenate the frames of all parts."""
    return LiftedPoses(np.concatenate([p.joints for p in parts]), np.concatenate([p.std for p in parts]))


@dataclass(frozen=True, eq=False)
class Lifter:
    """The trained network, with its batch normalisation folded into the layers.

    Attributes:
        layers: (in, out) weights and (out,) biases of each layer: the first layer, then the two layers of each
            residual block, then the last layer.
        provenance: training data and settings.
    """

    layers: tuple[tuple[Array32, Array32], ...]
    provenance: Mapping[str, object]

    def lift(
        self, points: Array, weight: Array, focal: float = float('inf'), *, use_mirror_image: bool = True
    ) -> LiftedPoses:
        """Estimate the pose of the newest frame of each history.

        Args:
            points: (N, T, J, 2) image points at `HISTORY_SLOTS_S` before the newest frame, in any unit; ignored
                where the weight is 0. If `focal` is finite they are relative to the optical axis.
            weight: (N, T, J) confidence scores in [0, 1], 0 for joints that were not seen.
            focal: focal length of the camera in the unit of the points; infinite if unknown.
            use_mirror_image: lift the mirror image as well and return the mean, which is more accurate and takes
                longer.
        """
        rotation = None
        if np.isfinite(focal):
            points, rotation = view_from_facing_camera(points, weight, focal)
        features, newest, size = encode_features(points, weight, focal)
        is_liftable = (features[:, 2 : 3 * JOINT_COUNT : 3] > 0).sum(axis=1) >= MIN_SEEN_JOINTS
        if use_mirror_image:
            features = np.concatenate([features, mirror_features(features)])
        out = self.forward(features)
        joints = out[:, : 3 * JOINT_COUNT].reshape(-1, JOINT_COUNT, 3).astype(float)
        log_std = out[:, 3 * JOINT_COUNT :].reshape(-1, JOINT_COUNT, 2).astype(float)
        if use_mirror_image:
            count = len(newest)
            joints = (joints[:count] + joints[count:, MIRROR_PERMUTATION] * [-1, 1, 1]) / 2
            log_std = (log_std[:count] + log_std[count:, MIRROR_PERMUTATION]) / 2
        joints[..., :2] += newest
        joints -= joints.mean(axis=1, keepdims=True)
        if rotation is not None:
            joints = joints @ rotation
        std = np.exp(np.clip(log_std, *LOG_STD_RANGE))
        unit = np.where(is_liftable, size, np.nan)[:, None, None]
        return LiftedPoses(joints * unit, std[..., [0, 0, 1]] * unit)

    def forward(self, features: Array32) -> Array32:
        """Evaluate the network: features (N, FEATURE_COUNT) to outputs (N, OUTPUT_COUNT).

        The outputs are the pose, with the newest image points subtracted from x and y, and the logarithms of the
        standard deviations.
        """
        (first, bias), *hidden, (last, last_bias) = self.layers
        x = np.maximum(features @ first + bias, 0)
        for (a, b), (c, d) in zip(hidden[::2], hidden[1::2], strict=True):
            x = x + np.maximum(np.maximum(x @ a + b, 0) @ c + d, 0)
        return np.asarray(x @ last + last_bias)

    def lift_sequence(
        self,
        points: Array,
        weight: Array,
        times: Array,
        focal: float = float('inf'),
    ) -> LiftedPoses:
        """Estimate the pose of every frame of a sequence from the frame itself and the frames before it.

        Args:
            points: (F, J, 2) image points; ignored where the weight is 0.
            weight: (F, J) confidence scores, 0 for joints that were not seen.
            times: (F,) s, increasing.
            focal: focal length in the unit of the points; infinite if unknown.
        """
        histories = sample_histories(points, weight, times, np.arange(len(times)))
        return self.lift(*histories, focal)


def view_from_facing_camera(points: Array, weight: Array, focal: float) -> tuple[Array, Array]:
    """Convert histories to the image of a virtual camera that faces the person in the newest frame.

    The lifter is trained on such images.

    Args:
        points: (N, T, J, 2) image points relative to the optical axis; ignored where the weight is 0.
        weight: (N, T, J) confidence scores.
        focal: focal length in the unit of the points.

    Returns:
        (N, T, J, 2) points in the images of the N virtual cameras, and (N, 3, 3) rotations from the camera's frame
        to those of the virtual cameras.
    """
    seen = (weight > 0) & (np.abs(points) < MAX_COORDINATE).all(axis=-1)
    clean = np.where(seen[..., None], points, 0.0)
    newest_weight = np.where(seen[:, 0], weight[:, 0], 0.0)
    total = np.maximum(newest_weight.sum(axis=-1), EPSILON)[:, None]
    rotation = rotation_to_optical_axis(np.einsum('nj,njd->nd', newest_weight, clean[:, 0]) / total / focal)
    return np.where(seen[..., None], focal * rotate_rays(clean / focal, rotation[:, None]), points), rotation


def scale_to_metres(lifted: LiftedPoses, times: Array, height: float) -> LiftedPoses:
    """Scale the poses of one person to metres, given the person's height.

    The image of a person who comes nearer grows, but the person's bones do not. Each frame is therefore scaled by
    the sum of its bone lengths, averaged over neighbouring frames with a Gaussian of `SIZE_SMOOTHING_S`.

    Args:
        lifted: poses of N frames in px.
        times: (N,) s.
        height: m, height of the person.
    """
    bone_sum = CMU15.bone_lengths(lifted.joints).sum(axis=1)
    is_lifted = np.isfinite(bone_sum)
    kernel = np.exp(-0.5 * ((times[:, None] - times[is_lifted]) / SIZE_SMOOTHING_S) ** 2) + EPSILON
    size = np.exp(kernel @ np.log(np.maximum(bone_sum[is_lifted], EPSILON)) / kernel.sum(axis=1))
    factor = (BONE_SUM_PER_STATURE * height / size)[:, None, None]
    return LiftedPoses(lifted.joints * factor, lifted.std * factor)


def sample_histories(points: Array, weight: Array, times: Array, frames: NDArray[np.intp]) -> tuple[Array, Array]:
    """Sample a sequence at T slots for each of N frames: at the frame's time minus `HISTORY_SLOTS_S`.

    A frame within `TIME_TOLERANCE_S` of a slot is taken as it is. At other slots, the point and the score of a
    joint are interpolated between the frames before and after the slot if the joint was seen in both and they are
    at most `MAX_INTERPOLATION_GAP_S` apart. Otherwise the joint counts as not seen.

    Args:
        points: (F, J, 2) image points in any unit; ignored where the weight is 0.
        weight: (F, J) confidence scores, 0 for joints that were not seen.
        times: (F,) s, increasing.
        frames: (N,) indices of the newest frame of each history.

    Returns:
        (N, T, J, 2) image points and (N, T, J) confidence scores, newest slot first; both are 0 for joints that
        were not seen.
    """
    weight = np.where(weight > 0, weight, 0.0)
    points = np.where(weight[..., None] > 0, points, 0.0)
    sampled = times[frames][:, None] - HISTORY_SLOTS_S
    after = np.minimum(times.searchsorted(sampled - TIME_TOLERANCE_S), frames[:, None])
    before = np.maximum(after - 1, 0)
    to_after, to_before = times[after] - sampled, sampled - times[before]
    share = to_before / np.maximum(to_after + to_before, TIME_TOLERANCE_S)
    share[to_after <= TIME_TOLERANCE_S] = 1.0
    share[np.abs(to_before) <= TIME_TOLERANCE_S] = 0.0
    is_frame = (share == 0) | (share == 1)
    is_short_gap = (share > 0) & (share < 1) & (to_after + to_before <= MAX_INTERPOLATION_GAP_S)
    share = share[..., None]
    w0, w1 = weight[before], weight[after]
    seen = (is_frame | is_short_gap)[..., None] & ((w0 > 0) | (share == 1)) & ((w1 > 0) | (share == 0))
    mixed_weight = np.where(seen, (1 - share) * w0 + share * w1, 0.0)
    share = share[..., None]
    mixed_points = (1 - share) * points[before] + share * points[after]
    return np.where(seen[..., None], mixed_points, 0.0), mixed_weight


def encode_features(
    points: Array | Array32, weight: Array | Array32, focal: float | Array = float('inf')
) -> tuple[Array32, Array, Array]:
    """Convert histories to the features of the network.

    Args:
        points: (N, T, J, 2) image points, as in `Lifter.lift`.
        weight: (N, T, J) confidence scores, as in `Lifter.lift`.
        focal: focal length in the unit of the points, one value or (N,); infinite if unknown.

    Returns:
        (N, FEATURE_COUNT) features; (N, J, 2) newest points as in the features, 0 for joints not seen; and (N,)
        the unit of these points, the mean distance from the centroid, in the unit of the image points.
    """
    weight = np.where((np.abs(points) < MAX_COORDINATE).all(axis=-1) & (weight > 0), np.minimum(weight, 1), 0)
    seen = weight > 0
    clean = np.where(seen[..., None], points, 0)
    total = np.maximum(weight.sum(axis=-1, keepdims=True), EPSILON)
    centroid = np.einsum('ntj,ntjd->ntd', weight, clean) / total
    centred = np.where(seen[..., None], clean - centroid[:, :, None], 0)
    distance = np.sqrt(np.einsum('ntjd,ntjd->ntj', centred, centred))
    size = (weight * distance).sum(axis=(1, 2)) / np.maximum(weight.sum(axis=(1, 2)), EPSILON)
    size = np.where(size > 0, size, 1.0)
    relative = np.clip(centred / size[:, None, None, None], -MAX_FEATURE, MAX_FEATURE)
    features = np.empty((len(points), FEATURE_COUNT), np.float32)
    block = features[:, :-1].reshape(*weight.shape, 3)
    block[..., :2] = relative
    block[..., 2] = weight
    features[:, -1] = np.minimum(size / focal / ANGULAR_SIZE_UNIT_RAD, MAX_FEATURE)
    return features, relative[:, 0], size


def mirror_features(features: Array32) -> Array32:
    """Return the features (N, FEATURE_COUNT) of the mirror image: x negated, left and right joints exchanged."""
    out = np.empty_like(features)
    block = features[:, :-1].reshape(len(features), -1, JOINT_COUNT, 3)
    mirrored = block[:, :, MIRROR_PERMUTATION] * np.array([-1, 1, 1], np.float32)
    out[:, :-1] = mirrored.reshape(len(features), -1)
    out[:, -1] = features[:, -1]
    return out
