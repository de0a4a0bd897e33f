# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Messages are converted between two versions of their type: between distributions of ROS, and made-up ones."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from mocap_ros.errors import InputError
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.cdr import CDR_ALIGNMENT_BYTES, Header, decode, typestore
from mocap_ros.messages.markers import MARKERS, MarkerEncoder
from mocap_ros.messages.versions import compare_versions, make_converter
from tests.support.camera_infos import camera_info
from tests.support.people import make_person_3d

BOX = 'test_msgs/msg/Box'
ITEM = 'test_msgs/msg/Item'


def make_store(box: str, item: str = 'float64 x') -> Typestore:
    """Return a store with a message Box, which may contain an Item."""
    store = get_typestore(Stores.EMPTY)
    store.register({**get_types_from_msg(box, BOX), **get_types_from_msg(item, ITEM)})
    return store


def test_markers_of_kilted_become_markers_of_foxy_with_the_same_content() -> None:
    foxy = get_typestore(Stores.ROS2_FOXY)
    people = [make_person_3d('a'), make_person_3d('b')]
    raw = MarkerEncoder().encode_update(Header(123_000_000_456, 'camera'), people, lifetime_s=0.5)
    converted = make_converter(typestore(), foxy, MARKERS)(raw)
    assert len(converted) < len(raw)
    assert len(converted) % CDR_ALIGNMENT_BYTES == 0
    before, after = decode(raw, MARKERS).markers, foxy.deserialize_cdr(converted, MARKERS).markers  # type: ignore[attr-defined]
    assert len(after) == 4
    fields = [name for name, _ in foxy.fielddefs['visualization_msgs/msg/Marker'][1]]
    for old, new in zip(before, after, strict=True):
        assert {f: repr(getattr(new, f)) for f in fields} == {f: repr(getattr(old, f)) for f in fields}
    left_out = [
        f'visualization_msgs/msg/Marker.{field}'
        for field in ('texture_resource', 'texture', 'uv_coordinates', 'mesh_file')
    ]
    assert compare_versions(typestore(), foxy, MARKERS) == (left_out, [])
    assert compare_versions(foxy, typestore(), MARKERS) == ([], [])


def test_a_camera_of_ros_1_is_that_of_ros_2() -> None:
    raw = camera_info(1280, 960, 900.0, d=(0.1, -0.2, 0.0, 0.0, 0.0))
    message, ros1 = decode(raw, CAMERA_INFO), get_typestore(Stores.ROS1_NOETIC)
    values = {name.lower(): value for name, value in vars(message).items()}
    header = ros1.types['std_msgs/msg/Header'](seq=1, stamp=message.header.stamp, frame_id='camera')
    fields = {name: values[name.lower()] for name, _ in ros1.fielddefs[CAMERA_INFO][1]}
    old = ros1.types[CAMERA_INFO](**{**fields, 'header': header})
    convert_camera = make_converter(ros1, typestore(), CAMERA_INFO, is_ros1=True)
    assert convert_camera(bytes(ros1.serialize_ros1(old, CAMERA_INFO))) == raw


def convert(source: Typestore, target: Typestore, **fields: Any) -> object:
    """Return a Box of the target that was converted from one of the source."""
    raw = bytes(source.serialize_cdr(source.types[BOX](**fields), BOX))
    return target.deserialize_cdr(make_converter(source, target, BOX)(raw), BOX)


def test_a_field_is_not_taken_for_another_of_the_same_type() -> None:
    source = make_store('string id\nint32 n\nItem[] items')
    target = make_store('int64 n\nstring title\nItem[] items')
    item, other_item = source.types[ITEM], target.types[ITEM]
    converted = convert(source, target, id='anna', n=-7, items=[item(x=1.5), item(x=2.5)])
    assert repr(converted) == repr(target.types[BOX](n=-7, title='', items=[other_item(x=1.5), other_item(x=2.5)]))
    with pytest.raises(InputError, match=f'not a {BOX}'):
        make_converter(source, target, BOX)(bytes(20))


def test_arrays_keep_their_numbers_and_others_are_zero() -> None:
    source, target = (
        make_store('float32[3] a\nuint8[<=5] b\nint32 c'),
        make_store('float64[] a\nint32[4] b\nItem c'),
    )
    message = convert(source, target, a=np.array([1, 2, 3], 'f4'), b=np.array([255], 'u1'), c=3)
    assert (message.a.tolist(), message.b.tolist(), message.c.x) == ([1, 2, 3], [255, 0, 0, 0], 0)  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ('source', 'target', 'item', 'differences'),
    [
        ('int32 a\nint32 b', 'int32 b', 'float64 x', ([f'{BOX}.a'], [])),
        ('int32 a', 'string a', 'float64 x', ([], [f'{BOX}.a'])),
        ('float64[] a', 'float64[3] a', 'float64 x', ([], [f'{BOX}.a'])),
        ('Item[] a', 'Item[] a', 'string x', ([], [f'{ITEM}.x'])),
        ('Item a', 'Item a', 'float64 y', ([f'{ITEM}.x'], [])),
        ('Item a', 'Item a', 'float64 x', ([], [])),
    ],
)
def test_fields_that_another_version_does_not_have_are_named(
    source: str, target: str, item: str, differences: tuple[list[str], list[str]]
) -> None:
    assert compare_versions(make_store(source), make_store(target, item), BOX) == differences
