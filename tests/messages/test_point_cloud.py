# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The joints of all people as a PointCloud2."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap_ros.messages.cdr import Header, decode
from mocap_ros.messages.point_cloud import POINT_DTYPE, POINTS, encode_points
from tests.support.people import make_person_3d


def test_every_point_names_its_person_and_joint() -> None:
    anna, bob = make_person_3d('anna'), replace(make_person_3d('bob', 7.0), std=np.linspace(0.1, 0.2, 15))
    cloud = decode(encode_points(Header(5, 'camera'), [anna, bob]), POINTS)
    read = np.frombuffer(cloud.data.tobytes(), POINT_DTYPE)
    assert (cloud.width, cloud.height, cloud.row_step) == (30, 1, 30 * cloud.point_step)
    np.testing.assert_array_equal(read['person'], np.repeat([0, 1], 15))
    np.testing.assert_array_equal(read['joint'], np.tile(np.arange(15), 2))
    np.testing.assert_array_equal(read['inferred'], np.concatenate([anna.inferred, bob.inferred]))
    np.testing.assert_allclose(read['std'], np.concatenate([anna.std, bob.std]), rtol=1e-6)
    for axis, name in enumerate('xyz'):
        np.testing.assert_array_equal(read[name], np.concatenate([anna.joints, bob.joints])[:, axis])


def test_nobody_gives_an_empty_cloud() -> None:
    cloud = decode(encode_points(Header(5, 'camera'), []), POINTS)
    assert (cloud.width, len(cloud.data)) == (0, 0)
