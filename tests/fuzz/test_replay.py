# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What once failed under fuzz, and small inputs that ask for much, give a result or one clear error."""

import io
import json
import re
import signal
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer

from mocap_ros.formats.mocap import c3d
from mocap_ros.messages.cdr import encode
from mocap_ros.messages.foreign_types import OPENPOSE_POSES
from mocap_ros.messages.input_types import KEYPOINT_TYPES
from mocap_ros.messages.keypoints import KEYPOINTS
from tests.fuzz.examples import EXAMPLES
from tests.fuzz.targets import MESSAGE_READERS, TARGETS, check
from tests.support.bag_writing import make_keypoints
from tests.support.foreign_messages import create_blank_message

BOMB_BYTES = 140_000_000  # to which compressed content unpacks; above every limit of the readers


def _write_npz(**entries: bytes) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, 'w', zipfile.ZIP_DEFLATED) as archive:
        for key, content in entries.items():
            archive.writestr(f'{key}.npy', content)
    return stream.getvalue()


def _make_npy(dtype: str, count: int, content: bytes = b'') -> bytes:
    """Return an array in NumPy's form that states a count of elements."""
    stream = io.BytesIO()
    header = {'descr': dtype, 'fortran_order': False, 'shape': (count,)}
    np.lib.format.write_array_header_1_0(stream, header)
    return stream.getvalue() + content


def _make_type_within_itself() -> bytes:
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start('ros2', 'bomb')
    definition = f'a/B a\n{"=" * 80}\nMSG: a/B\na/B a\n'
    channel = writer.register_channel(
        '/keypoints', 'cdr', writer.register_schema(KEYPOINTS, 'ros2msg', definition.encode())
    )
    writer.add_message(channel, 1, make_keypoints(0), 1)
    writer.finish()  # type: ignore[no-untyped-call]
    return stream.getvalue()


def _make_bvh(frames: int, bones: int = 1900) -> bytes:
    """Return a BVH file of a joint with ends within ends."""
    ends = 'End Site\n{\n' * bones + '}\n' * bones
    hierarchy = f'HIERARCHY\nROOT a\n{{\nCHANNELS 1 Xposition\n{ends}}}\n'
    return f'{hierarchy}MOTION\nFrames: {frames}\nFrame Time: 0.1\n'.encode() + b'0\n' * frames


def _make_coco(names: int) -> bytes:
    """Return two people of many joints, at the first and at the last frame of a day."""
    joints = ['nose', 'leye', 'lhip', 'rhip', 'lknee'] + [f'j{i}' for i in range(names)]
    people = [{'image_id': i, 'keypoints': [5.0 * (i + 1), 9, 1] * len(joints)} for i in (0, 999_999)]
    return json.dumps({'categories': [{'keypoints': joints}], 'annotations': people}).encode()


def _make_crowd(number: int) -> bytes:
    """Return a message of a type that states more people than it may have, all of them empty."""
    raw = EXAMPLES['messages']()[number]
    name, _ = MESSAGE_READERS[number]
    empty = encode(create_blank_message(name), name)
    count = 1_000_000 // 4
    return raw[:1] + empty[: empty.rindex(bytes(4))] + count.to_bytes(4, 'little') + bytes(count * 4)


BOMBS: dict[str, tuple[str, Callable[[], bytes]]] = {
    'archive that unpacks to 400 times its size': (
        'npz',
        lambda: _write_npz(theta=_make_npy('<f8', BOMB_BYTES // 8, bytes(BOMB_BYTES))),
    ),
    'array that states a length': ('npz', lambda: _write_npz(timestamps=_make_npy('<f8', 10**9))),
    'thousands of joints in a million frames': ('json', lambda: _make_coco(3000)),
    'bones without motion': ('bvh', lambda: _make_bvh(30_000)),
    'people without keypoints': ('messages', lambda: _make_crowd(KEYPOINT_TYPES.index(OPENPOSE_POSES))),
    'type within itself': ('mcap', _make_type_within_itself),
}  # fmt: skip


FAILED = Path(__file__).parent / 'failed'
pytestmark = pytest.mark.filterwarnings('error')
KEPT = sorted(path for path in FAILED.rglob('*') if path.is_file())
PROCESS = Path('/proc/self')
# resident memory that an input may take; chunks of 128 MiB are read as they are, and then copied
MEMORY_KB = 500_000
CPU_S = 60.0  # s of processor time after which an input is taken as one that never ends; they take a second


class TooLong(BaseException):
    """An input took too long; it is no `Exception`, so that no reader takes it for damage."""


@contextmanager
def bound() -> Iterator[None]:
    """Bound what the code of the block takes.

    Raises:
        TooLong: the block took more than `CPU_S` of processor time.
        AssertionError: the block took more memory than `MEMORY_KB`.
    """

    def stop(*_: object) -> None:
        raise TooLong(f'more than {CPU_S:g} s')

    (PROCESS / 'clear_refs').write_text('5')  # the peak of the resident memory begins anew
    before = _read_kb('VmRSS')
    previous = signal.signal(signal.SIGVTALRM, stop)
    signal.setitimer(signal.ITIMER_VIRTUAL, CPU_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, previous)
    taken = _read_kb('VmHWM') - before
    assert taken < MEMORY_KB, f'{taken} kB'


def _read_kb(name: str) -> int:
    """Return a number of kB from the status of this process."""
    (number,) = re.findall(rf'^{name}:\s+(\d+) kB', (PROCESS / 'status').read_text(), re.MULTILINE)
    return int(number)


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
