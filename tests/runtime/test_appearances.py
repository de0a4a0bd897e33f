# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Who was seen, from when to when, and in which motion."""

import numpy as np

from mocap_ros.people import Motion, MotionKind, Person3D
from mocap_ros.runtime.appearances import AppearanceLog
from mocap_ros.units import NS_PER_S

NAN = float('nan')
WALK = Motion(MotionKind.PERIODIC, 'walk', 0.01, 0.9)
OTHER = Motion(MotionKind.NON_PERIODIC, 'all', 0.1, NAN)
STRANGE = Motion(MotionKind.UNKNOWN, '', NAN, NAN)


def person(name: str, motion: Motion = WALK, residual: float = 2.0, **flags: bool) -> Person3D:
    joints = np.zeros((15, 3))
    return Person3D(
        name, joints, np.zeros(15), np.zeros(15, bool), 1.0, np.eye(3), np.zeros(2), motion, residual, True,
        flags.get('predicted', False), flags.get('tentative', False),
    )  # fmt: skip


def test_times_motions_cadence_and_residual_are_added_up() -> None:
    log = AppearanceLog(absence_s=5, gap_s=4)
    for second, motion in enumerate([STRANGE, WALK, WALK, OTHER]):
        log.add(second * NS_PER_S, [person('ann', motion, residual=1.0 + second)])
    log.add(4 * NS_PER_S, [person('ann', OTHER, residual=NAN, predicted=True)])
    (ann,) = log.list_all()
    assert (ann.person, ann.from_ns, ann.to_ns) == ('ann', 0, 4 * NS_PER_S)
    assert ann.seconds == {'unknown': 0.0, 'periodic': 2.0, 'non_periodic': 2.0}
    assert (ann.cadence, ann.residual) == (0.9, 2.5)


def test_who_was_away_for_long_appears_anew() -> None:
    log = AppearanceLog(absence_s=5, gap_s=4)
    for second in (0, 4, 10, 11):
        log.add(second * NS_PER_S, [person('ann'), person('ghost', tentative=True)])
    log.add(12 * NS_PER_S, [person('ben', STRANGE, NAN)])
    assert log.list_all()[0].seconds['periodic'] == 4.0, 'the time away is no motion'
    spans = [(a.person, a.from_ns // NS_PER_S, a.to_ns // NS_PER_S) for a in log.list_all()]
    assert spans == [('ann', 0, 4), ('ann', 10, 11), ('ben', 12, 12)]
