"""Whole sequences: the category is chosen where several are offered."""

import numpy as np
from test_alternation import scene

from mocap_ros.base_poses import load_model
from mocap_ros.config import Config, with_values
from mocap_ros.offline import reconstruct_sequence
from mocap_ros.people import Intrinsics
from mocap_ros.skeleton import CMU15

CAMERA = Intrinsics(500.0, (320.0, 240.0), known=True)
CONFIG = with_values(Config(), {'solver.components': 12})


def test_the_likeliest_of_several_models_is_used() -> None:
    models = {name: load_model(name) for name in ('walk', 'jump', 'all')}
    _, _, points, times = scene(models['walk'])
    keypoints = np.concatenate([points, np.ones((*points.shape[:2], 1))], axis=-1)
    several = reconstruct_sequence(keypoints, CMU15.joints, times, CAMERA, models, CONFIG)
    assert several.category == 'walk'
    alone = reconstruct_sequence(keypoints, CMU15.joints, times, CAMERA, models['walk'], CONFIG)
    assert (alone.joints == several.joints).all()
    assert alone.joints[..., 2].mean() > 1


def test_swapped_frames_are_undone() -> None:
    model = load_model('walk')
    _, _, points, times = scene(model)
    keypoints = np.concatenate([points, np.ones((*points.shape[:2], 1))], axis=-1)
    disturbed = keypoints.copy()
    disturbed[10:14] = keypoints[10:14][:, list(CMU15.mirror)]
    whole, mended = (
        reconstruct_sequence(k, CMU15.joints, times, CAMERA, model, CONFIG) for k in (keypoints, disturbed)
    )
    assert (whole.joints == mended.joints).all()
