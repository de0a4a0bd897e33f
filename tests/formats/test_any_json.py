"""Any JSON is read or refused with an error of this package."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocap_ros.errors import MocapError
from mocap_ros.runtime.load_keypoints import load_input
from tests.support.keypoint_files import LIMITS, VIDEO

json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4)
    | st.dictionaries(
        st.sampled_from(
            ['image_id', 'keypoints', 'frame_id', 'instances', 'annotations', 'images', 'id', 'idx', 'score',
             'people', 'pose_keypoints_2d', 'person_id', 'x', 'y', 'visible', 'keypoint_scores', 'categories']
        ),
        inner,
        max_size=4,
    ),
    max_leaves=12,
)  # fmt: skip


@settings(max_examples=150, deadline=None)
@given(content=json_values)
def test_any_json_is_read_or_refused(tmp_path_factory: pytest.TempPathFactory, content: object) -> None:
    folder = tmp_path_factory.mktemp('any')
    for path in (folder / 'a.json', folder / 'a_0_keypoints.json'):
        path.write_text(json.dumps(content))
    check_read_or_refused(folder / 'a.json')
    check_read_or_refused(folder)


def check_read_or_refused(path: Path) -> None:
    try:
        sequence, _ = load_input(path, VIDEO, LIMITS)
    except MocapError as error:
        assert str(path) in str(error)  # noqa: PT017
    else:
        assert len(sequence) > 0
