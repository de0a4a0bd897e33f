# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Make the shipped files of the demo again: `python -m mocap_ros.demo [BODY26.npz]`.

With a file of motion capture, the motions are first learned from it (`demo_motion.npz`). The recording
(`demo.npz`) is made from the learned motions alone.
"""

from __future__ import annotations

import sys
from importlib.resources import files
from pathlib import Path

from mocap_ros.demo import motions, scene
from mocap_ros.formats.mocap.trials import load_trials
from mocap_ros.formats.sequence_file import save_sequence
from mocap_ros.training.fit_base_poses import fit_base_poses

# CMU trial from which each motion is learned. The subjects differ, so that no single body is copied.
TRIAL_OF_MOTION = {'walk': '35_02', 'run': '09_01', 'jump': '13_32'}
# The text that the owner of the CMU database asks its users to publish.
ACKNOWLEDGEMENT = (
    'The data used in this project was obtained from mocap.cs.cmu.edu. '
    'The database was created with funding from NSF EIA-0196217.'
)


def learn_motions(path: Path) -> None:
    """Learn the base poses and the motions of the demo from motion capture, and save them."""
    poses = {trial.name: trial.poses for trial in load_trials(path)}
    model = fit_base_poses(
        [poses[trial] for trial in TRIAL_OF_MOTION.values()],
        name='demo',
        alignment='heading',
        mirror=True,
        provenance={'trials': list(TRIAL_OF_MOTION.values()), 'acknowledgement': ACKNOWLEDGEMENT},
    )
    learned = {
        'walk': motions.learn_gait(poses[TRIAL_OF_MOTION['walk']], model),
        'run': motions.learn_gait(poses[TRIAL_OF_MOTION['run']], model),
        'jump': motions.learn_action(poses[TRIAL_OF_MOTION['jump']], model),
    }
    motions.save_motions(model, learned, _path_of('demo_motion.npz'))


def _path_of(name: str) -> Path:
    return Path(str(files('mocap_ros') / 'demo' / name))


if __name__ == '__main__':
    for argument in sys.argv[1:2]:
        learn_motions(Path(argument))
    save_sequence(_path_of('demo.npz'), scene.make_recording().sequence(is_calibrated=True))
    print(f'made {_path_of("demo.npz")}')
