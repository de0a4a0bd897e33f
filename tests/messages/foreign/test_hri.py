# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Messages of ROS4HRI."""

from __future__ import annotations

import pytest

from mocap_ros.errors import InputError
from mocap_ros.messages.foreign.hri import decode_body
from tests.support.foreign_messages import LIMITS, encode_body, make_header, make_people


def test_normalised_coordinates_need_the_image_size() -> None:
    (person, _), header = make_people(0), make_header(0)
    with pytest.raises(InputError, match=r'^skeleton: .*node\.image_width'):
        decode_body(encode_body(person, header), person.id, (0, 0), LIMITS)
