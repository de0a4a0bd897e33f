"""Whole sequences: the most probable base poses are chosen, swaps are undone, and the learned prior helps."""

import numpy as np

from mocap_ros.config import Config, with_values
from mocap_ros.evaluation.metrics import scale_to_reference
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.geometry.rotations import centre_poses
from mocap_ros.models.base_poses import BasePoses
from mocap_ros.models.model_file import load_base_pose_models, load_base_poses, load_shipped_lifter
from mocap_ros.offline.whole_sequence import reconstruct_sequence
from mocap_ros.skeleton import CMU15
from tests.support.synthetic_walk import make_walk

CAMERA = Intrinsics(500.0, (320.0, 240.0), is_focal_known=True)
CONFIG = with_values(Config(), {'solver.components': 12, 'solver.prior': 'pca'})


def test_the_most_probable_of_several_models_is_used() -> None:
    models = {name: load_base_poses(name) for name in ('walk', 'jump', 'all')}
    _, _, points, times = make_walk(models['walk'])
    keypoints = np.concatenate([points, np.ones((*points.shape[:2], 1))], axis=-1)
    several = reconstruct_sequence(keypoints, CMU15.joints, times, CAMERA, models, CONFIG)
    assert several.category == 'walk'
    alone = reconstruct_sequence(keypoints, CMU15.joints, times, CAMERA, models['walk'], CONFIG)
    assert (alone.joints == several.joints).all()
    assert alone.joints[..., 2].mean() > 1


def test_swapped_frames_are_undone() -> None:
    model = load_base_poses('walk')
    _, _, points, times = make_walk(model)
    keypoints = np.concatenate([points, np.ones((*points.shape[:2], 1))], axis=-1)
    swapped = keypoints.copy()
    swapped[10:14] = keypoints[10:14][:, list(CMU15.mirror)]
    whole, corrected = (
        reconstruct_sequence(k, CMU15.joints, times, CAMERA, model, CONFIG) for k in (keypoints, swapped)
    )
    assert (whole.joints == corrected.joints).all()


def test_the_learned_prior_is_better_than_the_base_poses_alone(walk_model: BasePoses) -> None:
    theta, cameras, points, times = make_walk(walk_model, frames=45)
    truth = walk_model.poses(theta) @ np.swapaxes(cameras.rotation, -1, -2)
    points = points + np.random.default_rng(0).normal(size=points.shape)
    keypoints = np.concatenate([points, np.ones((*points.shape[:2], 1))], axis=-1)
    unknown = Intrinsics(20_000.0, (320.0, 240.0), is_focal_known=False)  # the scene is orthographic
    models = load_base_pose_models('auto')

    def error_mm(joints: np.ndarray) -> float:
        return float(np.linalg.norm(scale_to_reference(centre_poses(joints), truth) - truth, axis=-1).mean() * 1e3)

    both, alone = (
        reconstruct_sequence(
            keypoints, CMU15.joints, times, unknown, m, with_values(Config(), {'solver.prior': p})
        )
        for m, p in ((models, 'learned'), (models['all'], 'pca'))
    )
    assert both.category == 'all'
    network = load_shipped_lifter().lift_sequence(points, np.ones(points.shape[:2]), times)
    assert error_mm(both.joints) < 0.85 * error_mm(alone.joints)
    assert error_mm(both.joints) < 1.2 * error_mm(network.joints)
