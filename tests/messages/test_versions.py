# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Messages are converted between versions of their type: of distributions of ROS, installed, and made-up ones."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from mocap_ros.bags.reader import Bag
from mocap_ros.errors import ConfigError, InputError
from mocap_ros.messages.camera_info import CAMERA_INFO
from mocap_ros.messages.cdr import CDR_ALIGNMENT_BYTES, MOCAP_ROS_MSGS, Header, decode, typestore
from mocap_ros.messages.foreign_types import OPENPOSE_POSES
from mocap_ros.messages.markers import MARKERS, MarkerEncoder
from mocap_ros.messages.skeletons import SKELETONS, decode_skeletons, encode_skeletons
from mocap_ros.messages.versions import compare_versions, make_converter
from mocap_ros.ros import message_types
from mocap_ros.ros.message_types import MessageVersions, load_interface_class
from tests.support.camera_infos import camera_info, encode_ros1_camera_info
from tests.support.people import make_person_3d

BOX = 'test_msgs/msg/Box'
ITEM = 'test_msgs/msg/Item'


@pytest.mark.parametrize('contact', [[0.9, 0.25], [0.9, np.nan], [np.nan, np.nan]])
def test_skeletons_have_contacts_but_for_those_of_older_bags(tmp_path: Path, contact: list[float]) -> None:
    older = get_typestore(Stores.ROS2_JAZZY)
    text = typestore().generate_msgdef(SKELETONS)[0]
    older.register(get_types_from_msg(text.replace('float32[] contact\n', ''), SKELETONS))
    assert 'contact' not in dict(older.fielddefs[MOCAP_ROS_MSGS + 'Skeleton3D'][1])
    assert compare_versions(typestore(), older, SKELETONS) == ([MOCAP_ROS_MSGS + 'Skeleton3D.contact'], [])
    person = replace(make_person_3d('anna'), contact=np.array(contact))
    raw = encode_skeletons(Header(1, 'camera'), [person])
    for name, store, expected in (('new', typestore(), contact), ('old', older, [np.nan, np.nan])):
        with Rosbag2Writer(tmp_path / name, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            connection = writer.add_connection('/skeletons', SKELETONS, typestore=store)
            writer.write(connection, 1, make_converter(typestore(), store, SKELETONS)(raw))
        with Bag(tmp_path / name) as bag:
            (message,) = bag.messages(['/skeletons'])
        (read,) = decode_skeletons(message.raw).people
        assert read.contact == pytest.approx(expected, nan_ok=True)
        assert read.joints == pytest.approx(person.joints)


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
    ros1 = get_typestore(Stores.ROS1_NOETIC)
    convert_camera = make_converter(ros1, typestore(), CAMERA_INFO, is_ros1=True)
    assert convert_camera(encode_ros1_camera_info(ros1, raw)) == raw


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


MARKER = 'visualization_msgs/msg/Marker'


@pytest.fixture
def fields(monkeypatch: pytest.MonkeyPatch) -> dict[str, dict[str, str]]:
    """Return the fields of the types of which other versions count as installed, to which a test adds its own."""
    others: dict[str, dict[str, str]] = {}

    def load(kind: str) -> Any:
        fields = others.get(kind) or load_interface_class(kind).get_fields_and_field_types()
        return type('Installed', (), {'get_fields_and_field_types': staticmethod(lambda: fields)})

    monkeypatch.setattr(message_types, 'load_interface_class', load)
    return others


def test_an_input_whose_installed_fields_cannot_be_read_is_refused(fields: dict[str, dict[str, str]]) -> None:
    fields[OPENPOSE_POSES] = {'header': 'wstring?'}
    with pytest.raises(ConfigError, match=f'fields of {OPENPOSE_POSES} cannot be read'):
        MessageVersions().add_input(OPENPOSE_POSES)


@pytest.mark.ros
def test_an_output_that_the_installed_version_cannot_hold_is_refused(fields: dict[str, dict[str, str]]) -> None:
    fields[MARKER] = dict(load_interface_class(MARKER).get_fields_and_field_types())
    del fields[MARKER]['mesh_file']
    assert MessageVersions().add_output(MARKERS) == [f'{MARKER}.mesh_file'], 'it is left out'
    fields[MARKER] |= {'points': 'sequence<geometry_msgs/Vector3, 8>', 'ns': 'int32'}
    with pytest.raises(ConfigError, match=rf'{MARKERS} cannot .*{MARKER}\.ns, {MARKER}\.points'):
        MessageVersions().add_output(MARKERS)


@pytest.mark.parametrize('kind', ['', '__schemaless__', 'antigravity/x', 'os.path/msg/join', 'a/msg/b/c'])
def test_a_name_in_a_bag_that_names_no_type_is_not_imported(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('mocap_ros.ros.message_types.import_module', pytest.fail)
    with pytest.raises(ConfigError, match='is not the name of a type'):
        load_interface_class(kind)
