# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Inputs of the right structure with any content give a result or one clear error."""

from __future__ import annotations

import json
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays_of

from mocap_ros.config import Config, values
from mocap_ros.skeleton import CMU15
from tests.fuzz.examples import EXAMPLES
from tests.fuzz.targets import ARRAY_KEYS, FILE_SEPARATOR, check, pack_arrays

pytestmark = pytest.mark.filterwarnings('error', 'ignore:Stored array in format 3.0')
QUICK = settings(max_examples=40)

numbers = st.integers() | st.floats() | st.integers(-3, 30)
texts = st.text(max_size=6) | st.sampled_from(['a_1.jpg', '7', 'nose', '\x1b[2J', '\ud800'])
JSON_KEYS = (
    'image_id', 'keypoints', 'frame_id', 'instances', 'annotations', 'images', 'id', 'idx', 'score', 'people',
    'pose_keypoints_2d', 'person_id', 'x', 'y', 'visible', 'keypoint_scores', 'categories', 'width', 'height',
    'file_name', 'instance_info', 'track_id',
)  # fmt: skip
full_bodies = st.lists(numbers, min_size=51, max_size=51)
json_values = st.recursive(
    st.none() | st.booleans() | numbers | texts | full_bodies,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from(JSON_KEYS), inner, max_size=4),
    max_leaves=12,
)
people = st.fixed_dictionaries(
    {'image_id': numbers | texts, 'keypoints': full_bodies}, optional={'score': numbers, 'idx': json_values}
)


@QUICK
@given(json_values | st.lists(people, max_size=3))
def test_json(content: object) -> None:
    check('json', json.dumps(content).encode())


dtypes = arrays_of.scalar_dtypes() | arrays_of.unicode_string_dtypes(max_len=4) | arrays_of.array_dtypes()
shapes = st.sampled_from([(), (0,), (1,), (2,), (15,), (3, 3), (2, 15, 3), (2, 2), (0, 15, 3)])
any_arrays = st.builds(arrays_of.arrays, dtypes, shapes).flatmap(lambda strategy: strategy)


@QUICK
@given(st.data(), st.integers(0, 3))
def test_arrays(data: st.DataObject, file: int) -> None:
    """Some arrays of a valid file are replaced by any others."""
    packed = EXAMPLES['arrays']()[file]
    replaced = data.draw(st.dictionaries(st.sampled_from(ARRAY_KEYS), any_arrays, max_size=2))
    check('arrays', pack_arrays(replaced) + packed)  # of several arrays with one key the first counts


words = st.sampled_from([
    'ROOT a', 'JOINT b', 'End Site', '{', '}', 'OFFSET 0 1 0', 'OFFSET inf 1 x', 'CHANNELS 1 Xrotation',
    'CHANNELS 2 xposition ZROTATION', 'CHANNELS 1 x', 'MOTION', 'Frames: 2', 'Frames: 1e400', 'Frame Time: 0.1',
    '1 2', '3', 'nan', 'HIERARCHY', '',
])  # fmt: skip


@QUICK
@given(st.lists(words, max_size=25))
def test_bvh(lines: list[str]) -> None:
    check('bvh', '\n'.join(lines).encode())


asf_lines = st.sampled_from([
    ':root', 'order TX RX', 'order rq', 'axis XYZ', ':units', 'angle rad', 'angle', ':bonedata', 'begin',
    'name a', 'name b', 'direction 1 0 0', 'direction 1', 'length 3', 'length 1e308', 'axis 1 2 3 XYZ',
    'axis 1 2 3 ABC', 'dof rx ry', 'dof', 'end', ':hierarchy', 'root a', 'a b', 'b a', 'a a',
])  # fmt: skip
amc_lines = st.sampled_from(
    [':DEGREES', ':RADIANS', '1', '2', '-1', 'root 1 2', 'root 1 x', 'a 1 2', 'a', 'b 1', '#', '9' * 20]
)


@QUICK
@given(st.lists(asf_lines, max_size=25), st.lists(amc_lines, max_size=8))
def test_asf(skeleton: list[str], motion: list[str]) -> None:
    check('asf', '\n'.join(skeleton).encode() + FILE_SEPARATOR + '\n'.join(motion).encode())


yaml_values = st.recursive(
    st.none() | st.booleans() | numbers | st.text(max_size=5) | st.dates(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=5,
)
names = st.sampled_from([*values(Config()), *CMU15.joints, 'tracker', 'ros__parameters'])


@QUICK
@given(st.dictionaries(names, yaml_values, max_size=4), st.sampled_from(['', '!!int ', '&a ', '*a', '? ']))
def test_yaml(content: dict[str, Any], mark: str) -> None:
    check('yaml', (f'{mark}{yaml.safe_dump(content)}').encode())


def list_places(content: Any) -> list[tuple[Any, Any]]:
    """Return every mapping or list in a content with each of its keys or indices."""
    keys = content if isinstance(content, dict) else range(len(content)) if isinstance(content, list) else ()
    places = [(content, key) for key in keys]
    return places + [place for key in keys for place in list_places(content[key])]


@QUICK
@given(st.data(), yaml_values)
def test_metadata(data: st.DataObject, value: object) -> None:
    """A value of the description of a bag is replaced or missing."""
    text, _, messages = EXAMPLES_BY_SOURCE['folder'][0].partition(FILE_SEPARATOR)
    content = yaml.safe_load(text)
    place, key = data.draw(st.sampled_from(list_places(content)))
    if data.draw(st.booleans()):
        del place[key]
    else:
        place[key] = value
    check('folder', yaml.safe_dump(content).encode() + FILE_SEPARATOR + messages)


@pytest.mark.parametrize('source', ['messages', 'mcap', 'db3', 'ros1', 'recovery', 'folder', 'npz'])
@settings(max_examples=25)
@given(data=st.data())
def test_damaged_bytes(source: str, data: st.DataObject) -> None:
    """Some bytes of a valid input are replaced, and its end may be missing."""
    examples = EXAMPLES_BY_SOURCE[source]
    content = bytearray(examples[data.draw(st.integers(0, len(examples) - 1))])
    for _ in range(data.draw(st.integers(1, 4))):
        start = data.draw(st.integers(0, len(content) - 1))
        piece = data.draw(
            st.binary(min_size=1, max_size=4) | st.sampled_from([b'\xff' * 4, b'\x7f' + b'\xff' * 7])
        )
        content[start : start + len(piece)] = piece
    check(source, bytes(content[: data.draw(st.just(len(content)) | st.integers(0, len(content)))]))


EXAMPLES_BY_SOURCE = {
    source: EXAMPLES[source]() for source in ('messages', 'mcap', 'db3', 'ros1', 'recovery', 'folder', 'npz')
}
