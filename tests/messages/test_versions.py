# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Messages are converted between two versions of their type: between distributions of ROS 2, and made-up ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from mocap_ros.errors import InputError
from mocap_ros.messages.cdr import CDR_ALIGNMENT_BYTES, Header, decode, typestore
from mocap_ros.messages.markers import MARKERS, MarkerEncoder
from mocap_ros.messages.skeletons import SKELETONS, encode_skeletons
from mocap_ros.messages.versions import VersionConverter
from tests.support.people import make_person_3d

BOX = 'test_msgs/msg/Box'
ITEM = 'test_msgs/msg/Item'


def make_store(box: str, item: str = 'float64 x') -> Typestore:
    """Return a store with a message Box, which may contain an Item."""
    store = get_typestore(Stores.EMPTY)
    store.register({**get_types_from_msg(box, BOX), **get_types_from_msg(item, ITEM)})
    return store


def find_unconvertible(source: str, target: str) -> list[str]:
    return VersionConverter(make_store(source), make_store(target), BOX).unconvertible


def test_markers_of_kilted_become_markers_of_foxy_with_the_same_content() -> None:
    foxy = get_typestore(Stores.ROS2_FOXY)
    people = [make_person_3d('a'), make_person_3d('b')]
    raw = MarkerEncoder().encode_update(Header(123_000_000_456, 'camera'), people, lifetime_s=0.5)
    convert = VersionConverter(typestore(), foxy, MARKERS)
    converted = convert(raw)
    assert len(converted) < len(raw)
    assert len(converted) % CDR_ALIGNMENT_BYTES == 0
    before, after = decode(raw, MARKERS).markers, foxy.deserialize_cdr(converted, MARKERS).markers  # type: ignore[attr-defined]
    assert len(after) == 4
    fields = [name for name, _ in foxy.fielddefs['visualization_msgs/msg/Marker'][1]]
    for old, new in zip(before, after, strict=True):
        assert {f: repr(getattr(new, f)) for f in fields} == {f: repr(getattr(old, f)) for f in fields}
    assert convert.left_out == [
        f'visualization_msgs/msg/Marker.{field}'
        for field in ('texture_resource', 'texture', 'uv_coordinates', 'mesh_file')
    ]
    assert convert.unconvertible == []
    back = VersionConverter(foxy, typestore(), MARKERS)
    assert (back.left_out, convert(back(converted))) == ([], converted)


def test_a_field_is_not_taken_for_another_of_the_same_type() -> None:
    source = make_store('string id\nint32 n\nItem[] items')
    target = make_store('int64 n\nstring title\nItem[] items')
    convert = VersionConverter(source, target, BOX)
    item = source.types[ITEM]
    raw = bytes(source.serialize_cdr(source.types[BOX](id='anna', n=-7, items=[item(x=1.5), item(x=2.5)]), BOX))
    converted = target.deserialize_cdr(convert(raw), BOX)
    assert repr(converted) == repr(
        target.types[BOX](n=-7, title='', items=[target.types[ITEM](x=1.5), target.types[ITEM](x=2.5)])
    )
    assert convert.left_out == [f'{BOX}.id']
    with pytest.raises(InputError, match=f'not a {BOX}'):
        convert(raw[:20])


def test_arrays_keep_their_numbers_in_wider_types() -> None:
    source, target = make_store('float32[3] a\nuint8[<=5] b'), make_store('float64[] a\nint32[<=9] b')
    message = source.types[BOX](a=np.array([1, 2, 3], np.float32), b=np.array([255], np.uint8))
    convert = VersionConverter(source, target, BOX)
    assert convert.unconvertible == []
    converted = target.deserialize_cdr(convert(bytes(source.serialize_cdr(message, BOX))), BOX)
    assert (converted.a.tolist(), converted.b.tolist()) == ([1, 2, 3], [255])  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ('source', 'target', 'difference'),
    [
        ('int32 a', 'string a', 'string instead of int32'),
        ('int64 a', 'int32 a', 'int32 instead of int64'),
        ('float64 a', 'int64 a', 'int64 instead of float64'),
        ('float64 a', 'float64[] a', 'float64[] instead of float64'),
        ('float64[] a', 'float64[3] a', 'float64[3] instead of float64[]'),
        ('float64[4] a', 'float64[3] a', 'float64[3] instead of float64[4]'),
        ('string a', 'string<=8 a', 'string<=8 instead of string'),
        ('string[] a', 'float64[] a', 'float64[] instead of string[]'),
        ('Item a', 'float64 a', 'float64 instead of test_msgs/msg/Item'),
        ('float64 a', 'Item a', 'test_msgs/msg/Item instead of float64'),
    ],
)
def test_a_field_that_cannot_hold_the_content_is_named(source: str, target: str, difference: str) -> None:
    assert find_unconvertible(source, target) == [f'{BOX}.a is {difference}']


@pytest.mark.parametrize(
    ('source', 'target'),
    [
        ('float64 a', 'float32 a'),
        ('int32 a', 'float64 a'),
        ('uint8 a', 'byte a'),
        ('float64[3] a', 'float64[] a'),
        ('string<=8 a', 'string<=9 a'),
        ('Item a', 'Item a'),
        ('int32 a\nint32 b', 'int32 b'),
    ],
)
def test_a_field_that_can_hold_the_content_is_accepted(source: str, target: str) -> None:
    assert find_unconvertible(source, target) == []


def test_a_nested_type_that_cannot_hold_the_content_is_named() -> None:
    source, target = make_store('Item[] a', 'float64 x'), make_store('Item[] a', 'string x')
    convert = VersionConverter(source, target, BOX)
    assert convert.unconvertible == [f'{ITEM}.x is string instead of float64']


def test_skeletons_recorded_before_there_was_a_flag_for_tentative_people_are_of_certain_people() -> None:
    text, _ = typestore().generate_msgdef(SKELETONS, ros_version=2)
    assert 'bool tentative\n' in text
    old = get_typestore(Stores.EMPTY)
    for part in text.replace('bool tentative\n', '').split('=' * 80 + '\n'):
        first, _, rest = part.partition('\n')
        is_nested = first.startswith('MSG: ')
        name = first.removeprefix('MSG: ').replace('/', '/msg/') if is_nested else SKELETONS
        old.register(get_types_from_msg(rest if is_nested else part, name))
    people = [make_person_3d('a'), make_person_3d('b')]
    flagged = [replace(p, tentative=True) for p in people]
    to_old = VersionConverter(typestore(), old, SKELETONS)
    assert to_old.unconvertible == []
    assert to_old.left_out == ['mocap_ros_msgs/msg/Skeleton3D.tentative']
    header = Header(7, 'camera')
    recorded = to_old(encode_skeletons(header, flagged))
    assert VersionConverter(old, typestore(), SKELETONS)(recorded) == encode_skeletons(header, people)


def test_skeletons_recorded_before_the_vertical_was_published_have_none() -> None:
    old = get_typestore(Stores.EMPTY)
    text, _ = typestore().generate_msgdef(SKELETONS, ros_version=2)
    for line in ('geometry_msgs/Vector3 vertical\n', 'float32 vertical_std\n'):
        assert line in text
        text = text.replace(line, '')
    for part in text.split('=' * 80 + '\n'):
        first, _, rest = part.partition('\n')
        is_nested = first.startswith('MSG: ')
        name = first.removeprefix('MSG: ').replace('/', '/msg/') if is_nested else SKELETONS
        old.register(get_types_from_msg(rest if is_nested else part, name))
    people, header = [make_person_3d('a')], Header(7, 'camera')
    recorded = VersionConverter(typestore(), old, SKELETONS)(encode_skeletons(header, people))
    message = decode(VersionConverter(old, typestore(), SKELETONS)(recorded), SKELETONS)
    assert [message.vertical.x, message.vertical.y, message.vertical.z] == [0, 0, 0]
    assert message.people[0].id == 'a'
