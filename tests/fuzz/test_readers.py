# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What once failed, inputs of the right structure with any content, and small ones that ask for much.

All give a result or one clear error.
"""

import io
import json
import re
import signal
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays_of
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from mocap_ros.bags.rosbag2 import encode_yaml, make_topic
from mocap_ros.errors import InputError
from mocap_ros.formats.mocap import c3d
from mocap_ros.messages.foreign_types import OPENPOSE_POSES
from mocap_ros.messages.input_types import KEYPOINT_TYPES
from mocap_ros.messages.keypoints import KEYPOINTS
from tests.fuzz.targets import (
    EXAMPLES,
    FILE_SEPARATOR,
    MESSAGE_READERS,
    TARGETS,
    check,
    make_arrays,
    make_databases,
    make_mcap,
    make_ros1_bags,
)
from tests.support.camera_messages import encode
from tests.support.foreign_messages import create_blank_message

TYPE_WITHIN_ITSELF = f'a/B a\n{"=" * 80}\nMSG: a/B\na/B a\n'
BOMB_BYTES = 140_000_000  # to which compressed content unpacks; above every limit of the readers


def _make_npz(key: str, count: int, content: bytes = b'') -> bytes:
    """Return an archive of one array that states a count of numbers."""
    array, archive = io.BytesIO(), io.BytesIO()
    header = {'descr': '<f8', 'fortran_order': False, 'shape': (count,)}
    np.lib.format.write_array_header_1_0(array, header)
    with zipfile.ZipFile(archive, 'w', zipfile.ZIP_DEFLATED) as file:
        file.writestr(f'{key}.npy', array.getvalue() + content)
    return archive.getvalue()


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


def _make_chunk(compression: CompressionType, stated_bytes: int = 0) -> bytes:
    """Return an MCAP file whose chunk states its size, or another one if that is given."""
    data = bytearray(make_mcap(compression, messages=[bytes(BOMB_BYTES)]))
    (chunk,) = make_reader(io.BytesIO(data)).get_summary().chunk_indexes  # type: ignore[union-attr]
    at = data.index(chunk.uncompressed_size.to_bytes(8, 'little'), chunk.chunk_start_offset)
    data[at : at + 8] = (stated_bytes or chunk.uncompressed_size).to_bytes(8, 'little')
    return bytes(data)


def _make_overlapping_chunks() -> bytes:
    """Return an MCAP file of chunks that all last until the end, each smaller than what a chunk may have."""
    stream = io.BytesIO()
    writer = McapWriter(stream, chunk_size=1 << 40)
    writer.start('ros2', 'fuzz')
    channel = writer.register_channel('/keypoints', 'cdr', writer.register_schema(KEYPOINTS, 'ros2msg', b''))
    for number in range(12):
        for time_ns in (number, 10**9):
            writer.add_message(channel, time_ns, bytes(20_000_000), time_ns)
        writer.flush()  # type: ignore[no-untyped-call]
    writer.finish()  # type: ignore[no-untyped-call]
    return stream.getvalue()


BOMBS: dict[str, tuple[str, Callable[[], bytes]]] = {
    'archive that unpacks to 400 times its size': (
        'npz',
        lambda: _make_npz('theta', BOMB_BYTES // 8, bytes(BOMB_BYTES)),
    ),
    'array that states a length': ('npz', lambda: _make_npz('timestamps', 10**9)),
    'thousands of joints in a million frames': ('json', lambda: _make_coco(3000)),
    'bones without motion': ('bvh', lambda: _make_bvh(30_000)),
    'people without keypoints': ('messages', lambda: _make_crowd(KEYPOINT_TYPES.index(OPENPOSE_POSES))),
    'type within itself': ('mcap', lambda: make_mcap(CompressionType.NONE, TYPE_WITHIN_ITSELF)),
}  # fmt: skip


PACKED = zstandard.ZstdCompressor().compress(bytes(BOMB_BYTES))
QOS = {'offered_qos_profiles': encode_yaml([dict(q) for q in make_topic('/keypoints', KEYPOINTS).qos])}


def _make_packed_folder(mode: str, content: bytes) -> bytes:
    metadata, _, _ = EXAMPLES['folder']()[1].partition(FILE_SEPARATOR)
    return metadata.replace(b'mode: FILE', f'mode: {mode}'.encode()) + FILE_SEPARATOR + content


UNPACKED: dict[str, tuple[str, Callable[[], bytes]]] = {
    'chunks that overlap': ('mcap', _make_overlapping_chunks),
    'chunk of ROS 1, BZ2': ('ros1', lambda: make_ros1_bags(bytes(BOMB_BYTES))[1]),
    'chunk of ROS 1, LZ4': ('ros1', lambda: make_ros1_bags(bytes(BOMB_BYTES))[2]),
    'message of SQLite, recovered': ('recovery', lambda: make_databases([PACKED])[0]),
    'message of MCAP, recovered': ('recovery', lambda: make_mcap(CompressionType.NONE, messages=[PACKED])),
    'message': (
        'folder',
        lambda: _make_packed_folder('MESSAGE', make_mcap(CompressionType.NONE, '', QOS, [PACKED])),
    ),
    'file': ('folder', lambda: _make_packed_folder('FILE', PACKED)),
    'file, recovered': ('recovery', lambda: PACKED),
}
for _packing, _stated, _source in product(('ZSTD', 'LZ4'), (0, 100), ('mcap', 'recovery')):
    _name = f'chunk, {_packing}, {_source}{", with another size" * bool(_stated)}'
    UNPACKED[_name] = _source, partial(_make_chunk, CompressionType[_packing], _stated)


FAILED = Path(__file__).parent / 'failed'
pytestmark = pytest.mark.filterwarnings('error', 'ignore:Stored array in format 3.0')
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


@pytest.mark.parametrize('source', TARGETS)
def test_valid_inputs_are_read(source: str) -> None:
    """Otherwise a run starts from nothing, and the targets may refuse everything."""
    if source == 'c3d':
        pytest.importorskip('ezc3d')
    read = [check(source, data) for data in EXAMPLES[source]()]
    assert any(read), read


@pytest.mark.parametrize('path', KEPT, ids=lambda path: '/'.join(path.parts[-2:]))
def test_kept_input(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(c3d, 'TIME_S', 1)
    if path.parent.name == 'c3d':
        pytest.importorskip('ezc3d')
    with bound():
        check(path.parent.name, path.read_bytes())


@pytest.mark.parametrize('name', BOMBS)
def test_bomb_is_refused(name: str) -> None:
    source, make = BOMBS[name]
    data = make()
    with bound():
        assert not check(source, data)


@pytest.mark.parametrize('name', UNPACKED)
def test_bags_unpack_to_no_more_than_a_limit(name: str, tmp_path: Path) -> None:
    source, make = UNPACKED[name]
    data = make()
    with bound(), pytest.raises(InputError, match=r'more than \d+ MiB unpacked'):
        TARGETS[source](data, tmp_path)


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


pieces = st.binary(min_size=1, max_size=4) | st.sampled_from([b'\xff' * 4, b'\x7f' + b'\xff' * 7])
DAMAGED = 'messages', 'json', 'tables', 'bvh', 'npz', 'yaml', 'mcap', 'db3', 'ros1', 'recovery', 'folder'
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
        piece = data.draw(pieces)
        content[start : start + len(piece)] = piece
    check(source, bytes(content[: data.draw(st.just(len(content)) | st.integers(0, len(content)))]))
