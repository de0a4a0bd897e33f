# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What once failed under fuzz gives a result or one clear error again, with little memory and in little time."""

from __future__ import annotations

from pathlib import Path

import pytest

from mocap_ros.formats.mocap import c3d
from tests.fuzz.bombs import BOMBS
from tests.fuzz.examples import EXAMPLES
from tests.fuzz.limits import bound
from tests.fuzz.targets import TARGETS, check

FAILED = Path(__file__).parent / 'failed'
pytestmark = pytest.mark.filterwarnings('error')
KEPT = sorted(path for path in FAILED.rglob('*') if path.is_file())


def skip_without_reader(source: str) -> None:
    if source == 'c3d':
        pytest.importorskip('ezc3d')


@pytest.mark.parametrize('source', TARGETS)
def test_valid_inputs_are_read(source: str) -> None:
    """Otherwise a run starts from nothing, and the targets may refuse everything."""
    skip_without_reader(source)
    read = [check(source, data) for data in EXAMPLES[source]()]
    assert any(read), read


@pytest.mark.parametrize('path', KEPT, ids=lambda path: '/'.join(path.parts[-2:]))
def test_kept_input(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(c3d, 'TIME_S', 1)
    skip_without_reader(path.parent.name)
    with bound():
        check(path.parent.name, path.read_bytes())


@pytest.mark.parametrize('name', BOMBS)
def test_bomb_is_refused(name: str) -> None:
    source, make = BOMBS[name]
    data = make()
    with bound():
        assert not check(source, data)
