# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Inputs of the right structure with any content give a result or one clear error."""

import io
import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays_of

from tests.fuzz.examples import EXAMPLES, make_arrays
from tests.fuzz.targets import check

pytestmark = pytest.mark.filterwarnings('error', 'ignore:Stored array in format 3.0')
QUICK = settings(max_examples=25)

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


ARRAY_KEYS = sorted({key for arrays in make_arrays() for key in arrays})


@QUICK
@given(st.data(), st.integers(0, 3))
def test_arrays(data: st.DataObject, file: int) -> None:
    """Some arrays of a valid file are replaced by any others."""
    replaced = data.draw(st.dictionaries(st.sampled_from(ARRAY_KEYS), any_arrays, max_size=2))
    stream = io.BytesIO()
    contents: dict[str, Any] = {**make_arrays()[file], **replaced}
    np.savez(stream, **contents)
    check('npz', stream.getvalue())


DAMAGED = 'messages', 'json', 'bvh', 'npz', 'yaml', 'mcap', 'db3', 'ros1', 'recovery', 'folder'
EXAMPLES_BY_SOURCE = {source: EXAMPLES[source]() for source in DAMAGED}


@pytest.mark.parametrize('source', DAMAGED)
@QUICK
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
