"""Make the demo's shipped data again: `python -m mocap_ros.demo [CMU15.npz]`.

With motion capture, the motions are learned from it first; the recording follows from the motions alone.
"""

from __future__ import annotations

import sys
from importlib.resources import files
from pathlib import Path

from mocap_ros.demo import gait, scene
from mocap_ros.formats.mocap.trials import load_trials
from mocap_ros.formats.sequence_file import save_sequence
from mocap_ros.training.base_poses import fit_base_poses

ACTORS = {'walk': '35_02', 'run': '09_01', 'jump': '13_32'}
ACKNOWLEDGEMENT = (
    'The data used in this project was obtained from mocap.cs.cmu.edu. '
    'The database was created with funding from NSF EIA-0196217.'
)


def learn(path: Path) -> None:
    """Learn the demo's basis and motions from motion capture."""
    poses = {t.name: t.poses for t in load_trials(path)}
    basis = fit_base_poses(
        [poses[trial] for trial in ACTORS.values()],
        name='demo',
        alignment='heading',
        mirror=True,
        provenance={'trials': list(ACTORS.values()), 'acknowledgement': ACKNOWLEDGEMENT},
    )
    motions = {
        'walk': gait.learn_gait(poses[ACTORS['walk']], basis),
        'run': gait.learn_gait(poses[ACTORS['run']], basis),
        'jump': gait.learn_action(poses[ACTORS['jump']], basis),
    }
    gait.save(basis, motions, _data('demo_motion.npz'))


def _data(name: str) -> Path:
    return Path(str(files('mocap_ros') / 'demo' / name))


if __name__ == '__main__':
    for argument in sys.argv[1:2]:
        learn(Path(argument))
    save_sequence(_data('demo.npz'), scene.make_recording().sequence())
    print(f'made {_data("demo.npz")}')
