# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Images of all encodings and their CameraInfo; the place of a camera from transforms; versions of messages."""

import io
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore
from scipy.spatial.transform import Rotation

from mocap_ros.bags.reader import Bag
from mocap_ros.config import NodeConfig
from mocap_ros.errors import ConfigError, InputError
from mocap_ros.geometry.rigid_transform import RigidTransform
from mocap_ros.messages.camera_info import decode_camera_info
from mocap_ros.messages.cdr import CDR_ALIGNMENT_BYTES, MOCAP_ROS_MSGS, Header, decode, typestore
from mocap_ros.messages.foreign_types import OPENPOSE_POSES
from mocap_ros.messages.images import COMPRESSED_IMAGE, ENCODINGS, IMAGE, decode_image
from mocap_ros.messages.markers import MARKERS, MarkerEncoder
from mocap_ros.messages.skeletons import SKELETONS, decode_skeletons, encode_skeletons
from mocap_ros.messages.transform_tree import HISTORY_S, MAX_FRAMES, TransformTree, is_of_people_only
from mocap_ros.messages.transforms import TRANSFORMS, encode_transforms
from mocap_ros.messages.versions import compare_versions, make_converter
from mocap_ros.ros import message_types
from mocap_ros.ros.message_types import MessageVersions, load_interface_class
from mocap_ros.units import NS_PER_S
from tests.support.bodies import gather, make_person_3d, make_standing_person
from tests.support.camera_messages import (
    camera_info,
    create_header,
    create_message,
    encode,
    encode_pixels,
    make_transforms,
)
from tests.support.paths import ROOT, load_module

HEADER = Header(5_000_000_007, 'optical')
LIMITS = NodeConfig()


def make_image() -> np.ndarray:
    """Return an image (10, 12, 3) of colours that change little inside squares of 2 x 2 px."""
    squares = np.random.default_rng(0).integers(0, 256, (5, 6, 3))
    squares[0, 0] = 255
    return squares.repeat(2, axis=0).repeat(2, axis=1).astype(np.uint8)


def encode_message(msgtype: str = IMAGE, **fields: Any) -> bytes:
    fields['data'] = np.frombuffer(fields['data'], np.uint8)
    return encode(create_message(msgtype, header=create_header(HEADER), **fields), msgtype)


@pytest.mark.parametrize('encoding', ENCODINGS)
@pytest.mark.parametrize(('padding', 'is_bigendian'), [(0, False), (5, True)])
def test_every_encoding_gives_red_green_and_blue(encoding: str, padding: int, is_bigendian: bool) -> None:
    image = make_image()
    fields = encode_pixels(image, encoding, padding, is_bigendian)
    header, pixels = decode_image(encode_message(**fields), IMAGE, LIMITS)
    assert header == HEADER
    assert pixels.dtype == np.uint8
    is_grey = encoding in ('mono8', '8UC1', 'mono16', '16UC1')
    expected = image.mean(axis=-1, keepdims=True).repeat(3, axis=-1) if is_grey else image
    tolerance = 3 if encoding.startswith(('yu', 'uy')) else 1
    assert np.abs(pixels.astype(float) - expected).max() <= tolerance


def test_an_infrared_png_is_stretched_as_the_plain_image_is() -> None:
    grey = np.linspace(0, 4000, 12 * 10).reshape(12, 10).astype(np.uint16)
    file = io.BytesIO()
    Image.fromarray(grey).save(file, 'PNG')
    fields: dict[str, Any] = {'height': 12, 'width': 10, 'encoding': 'mono16', 'is_bigendian': 0, 'step': 20}
    plain = decode_image(encode_message(**fields, data=grey.astype('<u2').tobytes()), IMAGE, LIMITS)[1]
    message = encode_message(COMPRESSED_IMAGE, format='mono16; png compressed', data=file.getvalue())
    found = decode_image(message, COMPRESSED_IMAGE, LIMITS)[1]
    assert (found == plain).all()
    assert len(np.unique(found)) > 100


def test_an_odd_image_of_a_bayer_pattern_keeps_its_size() -> None:
    image = make_image()[:9, :11]
    _, pixels = decode_image(encode_message(**encode_pixels(image, 'bayer_grbg8')), IMAGE, LIMITS)
    assert pixels.shape == (9, 11, 3)
    assert np.abs(pixels[:8, :10].astype(int) - image[:8, :10]).max() <= 1  # the colour of the rest is not known


@pytest.mark.parametrize(
    ('changes', 'reason'),
    [
        ({'encoding': 'rgb9'}, "encoding: 'rgb9', expected one of rgb8, "),
        ({'step': 35}, 'step: 35 bytes, less than a row of 12 pixels in rgb8'),
        ({'height': 11}, 'data: 360 bytes, expected 396'),
        ({'width': 0}, 'width, height: 0 x 10 px'),
        ({'height': 0}, 'width, height: 12 x 0 px'),
        ({'width': 2**20, 'height': 2**20}, 'width, height: 1048576 x 1048576 px'),
        ({'encoding': 'uyvy', 'width': 11}, 'width: 11 is odd'),
        ({'encoding': 'bayer_rggb8', 'height': 1}, 'width, height: 12 x 1 px, less than a Bayer pattern'),
        ({'data': b''}, 'data: 0 bytes, expected 360'),
    ],
)
def test_fields_that_do_not_fit_are_named(changes: dict[str, Any], reason: str) -> None:
    fields = {**encode_pixels(make_image(), 'rgb8'), **changes}
    with pytest.raises(InputError, match='^' + reason):
        decode_image(encode_message(**fields), IMAGE, LIMITS)


@pytest.mark.parametrize('rectified', [False, True])
@pytest.mark.parametrize('binning', [(1, 1), (2, 2), (4, 2)])
@pytest.mark.parametrize('region', [(0, 0, 0, 0), (100, 40, 800, 600)])
def test_a_binned_part_of_the_image_shows_the_same_rays(
    rng: np.random.Generator, region: tuple[int, int, int, int], binning: tuple[int, int], rectified: bool
) -> None:
    p = (900.0, 0, 650, 0, 0, 900, 470, 0, 0, 0, 1, 0)
    part_info = camera_info(1280, 960, 900.0, p=p, binning=binning, region=region)
    whole = decode_camera_info(camera_info(1280, 960, 900.0, p=p), rectified=rectified)
    part = decode_camera_info(part_info, rectified=rectified)
    width, height = region[2:] if region[2] else (1280, 960)
    assert part.size == (width // binning[0], height // binning[1])
    points = rng.uniform(-1, 1, (20, 3)) + [0, 0, 4]
    expected = (whole.intrinsics.project(points) - region[:2]) / binning
    assert part.intrinsics.project(points) == pytest.approx(expected)


def test_an_unknown_size_stays_unknown() -> None:
    camera = decode_camera_info(camera_info(0, 0, binning=(2, 2)))
    assert (camera.size, camera.intrinsics.image_size) == ((0, 0), None)


OPENCV = (0.1, -0.2, 0.001, 0.002, 0.03, 0.04, 0.05, 0.06)


@pytest.mark.parametrize(
    ('model', 'd', 'used'),
    [
        ('plumb_bob', OPENCV[:5], ('plumb_bob', 5)),
        ('Plumb Bob', OPENCV[:4], ('plumb_bob', 4)),
        ('radtan', OPENCV[:4], ('plumb_bob', 4)),
        ('plumb_bob', OPENCV, ('rational_polynomial', 8)),
        ('rational_polynomial', (*OPENCV, *[0.0] * 6), ('rational_polynomial', 8)),  # as DepthAI sends them
        ('fisheye', OPENCV[:4], ('equidistant', 4)),
        ('kannala_brandt4', OPENCV[:4], ('equidistant', 4)),
        ('', OPENCV[:5], ('plumb_bob', 5)),
        ('unknown', (0.0,) * 5, ('plumb_bob', 0)),
        ('none', (), ('plumb_bob', 0)),
    ],
)
def test_models_of_lenses_have_several_names(model: str, d: tuple[float, ...], used: tuple[str, int]) -> None:
    camera = decode_camera_info(camera_info(model=model, d=d))
    distortion = camera.intrinsics.distortion
    assert (distortion.model, distortion.coefficients, camera.note) == (used[0], d[: used[1]], '')


@pytest.mark.parametrize(
    ('fields', 'used', 'note'),
    [
        ({'model': 'double_sphere', 'd': OPENCV[:5]}, (640, 480, 600.0), "distortion model 'double_sphere'"),
        ({'model': 'equidistant', 'd': OPENCV[:3]}, (640, 480, 600.0), 'takes 4 coefficients, not 3'),
        ({'model': 'rational_polynomial', 'd': (*OPENCV, 0, 0, 0, 0.1)}, (640, 480, 600.0), 'not 12'),
        ({'d': (math.nan, 0, 0, 0, 0)}, (640, 480, 600.0), 'not finite'),
        ({'d': (1.0, -1e300, 0, 0)}, (640, 480, 600.0), r'^d: -1e\+300, more than a lens has'),
        ({'focal': 0.0}, (640, 480, None), 'k: .*not calibrated: its image size of 640 x 480 px'),
        ({'centre': 1.0}, (640, 480, 600.0), 'k: principal point 640, 480 px .* for another size'),
        ({'focal': math.nan}, (640, 480, None), 'k: .*not calibrated'),
        ({'focal': 1.0}, (640, 480, None), 'k: focal length of 1 px in an image 640 px wide; .*not calibrated'),
        ({'focal': 0.0, 'binning': (2, 2), 'd': OPENCV[:5]}, (320, 240, None), '320 x 240 px'),
    ],
)
def test_bad_fields_leave_others(fields: dict[str, Any], used: tuple[int, int, float | None], note: str) -> None:
    camera = decode_camera_info(camera_info(**{'focal': 600.0, **fields}))
    intrinsics = camera.intrinsics
    assert (*camera.size, intrinsics.focal if intrinsics.is_focal_known else None) == used
    assert not intrinsics.distortion.coefficients
    assert re.search(note, camera.note)


CAMERA = np.array([0.1, 0.0, 0.4])  # m, of the camera in base
TURN = Rotation.from_euler('z', 90, degrees=True)  # of odom in map


def make_tree() -> TransformTree:
    """Return map -> odom (static, turned) -> base (drives along x at 1 m/s) -> camera, and map -> dock."""
    tree = TransformTree()
    odom, dock = ('map', 'odom', 0, (5, 0, 0), TURN.as_quat()), ('map', 'dock', 0, (0, 7, 0))
    tree.add(make_transforms(odom, dock, ('base', 'camera', 0, CAMERA)), is_static=True)
    for tenth in range(11):
        tree.add(make_transforms(('odom', 'base', tenth * NS_PER_S // 10, (tenth / 10, 0, 0))), is_static=False)
    return tree


@given(st.integers(0, NS_PER_S))
def test_a_moving_camera_is_where_it_was_at_the_time_of_the_image(stamp_ns: int) -> None:
    x = stamp_ns / NS_PER_S
    found = make_tree().find('map', 'camera', stamp_ns, 0.0)
    np.testing.assert_allclose(found.translation, [5, x + 0.1, 0.4], atol=1e-9)
    np.testing.assert_allclose(found.rotation, TURN.as_matrix(), atol=1e-9)


def test_the_way_leads_up_and_down_and_slashes_of_old_names_do_not_count() -> None:
    found = make_tree().find('/dock', '/base', NS_PER_S // 2, 0.0)
    np.testing.assert_allclose(found.translation, [5, 0.5 - 7, 0], atol=1e-9)
    assert make_tree().find('odom', 'odom', 7, 0.0).translation.tolist() == [0, 0, 0]


def test_an_image_after_the_newest_transform_is_placed_only_within_the_tolerance() -> None:
    tree = make_tree()
    late_ns = NS_PER_S + NS_PER_S // 20
    np.testing.assert_allclose(tree.find('odom', 'base', late_ns, 0.1).translation, [1, 0, 0])
    with pytest.raises(InputError, match=r'the newest transform of base is 0\.05 s older than the image'):
        tree.find('odom', 'base', late_ns, 0.04)
    with pytest.raises(InputError, match=r'the oldest transform of base is 0\.20 s newer than the image'):
        tree.find('odom', 'base', -NS_PER_S // 5, 0.1)


def test_frames_without_a_way_between_them_are_named() -> None:
    tree = make_tree()
    tree.add(make_transforms(('other', 'arm', 0, (0, 0, 0))), is_static=True)
    with pytest.raises(InputError, match="from 'camera' to 'arm': they are not connected"):
        tree.find('arm', 'camera', 0, 0.0)
    with pytest.raises(InputError, match="from 'eye' to 'map': no transform names 'eye'"):
        tree.find('map', 'eye', 0, 0.0)


def test_old_transforms_are_forgotten_and_time_that_goes_back_begins_anew() -> None:
    tree = make_tree()
    later_ns = round((HISTORY_S + 1.5) * NS_PER_S)
    tree.add(make_transforms(('odom', 'base', later_ns, (9, 0, 0))), is_static=False)
    with pytest.raises(InputError, match='oldest'):
        tree.find('odom', 'base', NS_PER_S // 2, 0.0)
    tree.add(make_transforms(('odom', 'base', 5, (2, 0, 0))), is_static=False)
    np.testing.assert_allclose(tree.find('odom', 'base', 5, 0.0).translation, [2, 0, 0])


@pytest.mark.parametrize(
    ('transform', 'message'),
    [
        (('map', '', 0, (0, 0, 0)), r"transforms\[1\]: child_frame_id '' in header.frame_id 'map'"),
        (('map', '/map', 0, (0, 0, 0)), r"transforms\[1\]: child_frame_id 'map' in header.frame_id 'map'"),
        (('map', 'b', -NS_PER_S, (0, 0, 0)), r'transforms\[1\]: header.stamp: -1 s'),
        (('map', 'b', 0, (0, np.inf, 0)), r'transforms\[1\]: .*not finite'),
        (('map', 'b', 0, (0, 0, 0), (0, 0, 0, 0)), r'transforms\[1\]: .*unit length'),
    ],
)
def test_a_message_with_an_invalid_transform_adds_nothing(transform: Any, message: str) -> None:
    tree = TransformTree()
    with pytest.raises(InputError, match=message):
        tree.add(make_transforms(('map', 'good', 0, (0, 0, 0)), transform), is_static=False)
    assert not tree._links


def test_names_that_never_end_fill_no_memory() -> None:
    tree = TransformTree()
    for second in range(0, 60, 20):  # people who come and go
        names = [f'body_{second}_{i}' for i in range(MAX_FRAMES // 2)]
        tree.add(make_transforms(*(('map', n, second * NS_PER_S, (0, 0, 0)) for n in names)), is_static=False)
    with pytest.raises(InputError, match=f'more than {MAX_FRAMES} frames'):
        tree.add(make_transforms(*(('map', f'c{i}', 0, (0, 0, 0)) for i in range(MAX_FRAMES + 1))), is_static=True)


def test_transforms_of_people_are_known_by_their_names() -> None:
    people = [make_standing_person(i) for i in ('anna', 'b/ob')]
    own = encode_transforms(Header(1, 'camera'), gather(people), 'left_')
    assert is_of_people_only(own, 'left_')
    assert not is_of_people_only(own, '')
    nobody = encode_transforms(Header(1, 'camera'), gather([]))
    assert is_of_people_only(nobody, 'left_')
    world = encode_transforms(Header(1, 'camera'), gather([]), 'left_', None, RigidTransform.identity())
    assert is_of_people_only(world, 'left_')
    assert not is_of_people_only(world, '')
    assert not is_of_people_only(nobody[:-1], 'left_')
    message = decode(own, TRANSFORMS)
    message.transforms[3].child_frame_id = 'base'
    assert not is_of_people_only(encode(message, TRANSFORMS), 'left_')
    assert not is_of_people_only(b'no message', '')


@pytest.mark.parametrize('child', ['head_camera', 'torso_lift_link', 'body_camera', 'l_hand_camera'])
def test_frames_of_robots_are_none_of_people_though_their_names_begin_as_those_do(child: str) -> None:
    robot = make_transforms(('base', child, 1, (0, 0, 1)))
    assert not is_of_people_only(robot, '')
    message = decode(encode_transforms(Header(1, 'camera'), gather([make_standing_person('anna')])), TRANSFORMS)
    message.transforms += decode(robot, TRANSFORMS).transforms
    assert not is_of_people_only(encode(message, TRANSFORMS), '')


def test_a_time_before_a_late_transform_is_that_before_the_newest_of_each_frame() -> None:
    tree = TransformTree()
    for stamp_ns in range(0, NS_PER_S + 1, NS_PER_S // 10):
        seconds = stamp_ns / NS_PER_S
        tree.add(make_transforms(('map', 'odom', stamp_ns // 2, (seconds, 0, 0))), is_static=False)
        tree.add(make_transforms(('odom', 'base', stamp_ns, (0, seconds, 0))), is_static=False)
    image = 'map', 'base', NS_PER_S, 0.5
    np.testing.assert_allclose(tree.find(*image).translation, [1, 1, 0])
    np.testing.assert_allclose(tree.find(*image, 0.2).translation, [1 - 0.4, 1 - 0.2, 0])
    with pytest.raises(InputError, match=r'oldest transform of odom is 0\.10 s newer'):
        tree.find(*image, 0.6)
    with pytest.raises(InputError, match=r'newest transform of base is 0\.80 s older'):
        tree.find('odom', 'base', 2 * NS_PER_S, 0.5, 0.2)


BOX = 'test_msgs/msg/Box'
ITEM = 'test_msgs/msg/Item'
MARKER = 'visualization_msgs/msg/Marker'


@pytest.mark.parametrize('contact', [[0.9, 0.25], [0.9, np.nan], [np.nan, np.nan]])
def test_skeletons_have_contacts_and_postures_but_for_those_of_older_bags(
    tmp_path: Path, contact: list[float]
) -> None:
    older = get_typestore(Stores.ROS2_JAZZY)
    text = typestore().generate_msgdef(SKELETONS)[0]
    for field in ('float32[] contact\n', 'uint8 posture\n', 'float32 posture_probability\n'):
        text = text.replace(field, '')
    older.register(get_types_from_msg(text, SKELETONS))
    assert 'contact' not in dict(older.fielddefs[MOCAP_ROS_MSGS + 'Skeleton3D'][1])
    newer = [f'{MOCAP_ROS_MSGS}Skeleton3D.{field}' for field in ('contact', 'posture', 'posture_probability')]
    assert compare_versions(typestore(), older, SKELETONS) == (newer, [])
    person = replace(make_person_3d('anna'), contact=np.array(contact), posture=4, posture_probability=0.75)
    raw = encode_skeletons(Header(1, 'camera'), gather([person]))
    stores = (('new', typestore(), contact, (4, 0.75)), ('old', older, [np.nan, np.nan], (0, 0.0)))
    for name, store, expected, posture in stores:
        with Rosbag2Writer(tmp_path / name, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            connection = writer.add_connection('/skeletons', SKELETONS, typestore=store)
            writer.write(connection, 1, make_converter(typestore(), store, SKELETONS)(raw))
        with Bag(tmp_path / name) as bag:
            (message,) = bag.messages(['/skeletons'])
        (read,) = decode_skeletons(message.raw).people
        assert read.contact == pytest.approx(expected, nan_ok=True)
        assert (read.posture, read.posture_probability) == posture
        assert read.joints == pytest.approx(person.joints)


def make_store(box: str, item: str = 'float64 x') -> Typestore:
    store = get_typestore(Stores.EMPTY)
    store.register({**get_types_from_msg(box, BOX), **get_types_from_msg(item, ITEM)})
    return store


def test_markers_of_kilted_become_markers_of_foxy_with_the_same_content() -> None:
    foxy = get_typestore(Stores.ROS2_FOXY)
    people = [make_person_3d('a'), make_person_3d('b')]
    raw = MarkerEncoder().encode_update(Header(123_000_000_456, 'camera'), gather(people), lifetime_s=0.5)
    converted = make_converter(typestore(), foxy, MARKERS)(raw)
    assert len(converted) < len(raw)
    assert len(converted) % CDR_ALIGNMENT_BYTES == 0
    before, after = decode(raw, MARKERS).markers, foxy.deserialize_cdr(converted, MARKERS).markers  # type: ignore[attr-defined]
    assert len(after) == 4
    fields = [name for name, _ in foxy.fielddefs[MARKER][1]]
    for old, new in zip(before, after, strict=True):
        assert {f: repr(getattr(new, f)) for f in fields} == {f: repr(getattr(old, f)) for f in fields}
    left_out = [f'{MARKER}.{field}' for field in ('texture_resource', 'texture', 'uv_coordinates', 'mesh_file')]
    assert compare_versions(typestore(), foxy, MARKERS) == (left_out, [])
    assert compare_versions(foxy, typestore(), MARKERS) == ([], [])


def convert(source: Typestore, target: Typestore, **fields: Any) -> object:
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
    texts = 'float32[3] a\nuint8[<=5] b\nint32 c', 'float64[] a\nint32[4] b\nItem c'
    source, target = map(make_store, texts)
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


def test_types_of_ros_that_setup_builds_have_the_fields_of_ros() -> None:
    own, ros = load_module(ROOT / 'config' / 'env' / 'build_messages.py').OF_ROS, get_typestore(Stores.ROS2_JAZZY)
    for name, text in own.items():
        assert get_types_from_msg(text, name)[name][1] == ros.fielddefs[name][1]
