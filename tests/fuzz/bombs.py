# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Inputs that are small and ask for much: memory, time or disk. Each of them once took too much of it."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable

import numpy as np
from mcap.writer import CompressionType, Writer

from mocap_ros.messages.cdr import encode
from mocap_ros.messages.foreign_types import OPENPOSE_POSES
from mocap_ros.messages.input_types import KEYPOINT_TYPES
from mocap_ros.messages.keypoints import KEYPOINTS
from tests.fuzz.examples import EXAMPLES
from tests.fuzz.targets import FILE_SEPARATOR, MESSAGE_READERS, pack_arrays
from tests.support.bag_writing import make_keypoints
from tests.support.foreign_messages import create_blank_message

BOMB_BYTES = 140_000_000  # to which compressed content unpacks; above every limit of the readers
FULL_BODY = [5.0, 9.0, 1.0] * 17  # keypoints of coco17
HEADER_TYPES = f"""{'=' * 80}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{'=' * 80}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def _write_npz(compression: int = zipfile.ZIP_STORED, **entries: bytes) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, 'w', compression) as archive:
        for key, content in entries.items():
            archive.writestr(f'{key}.npy', content)
    return stream.getvalue()


def _make_npy(dtype: str, count: int, content: bytes = b'') -> bytes:
    """Return an array in NumPy's form that states a count of elements."""
    stream = io.BytesIO()
    header = {'descr': dtype, 'fortran_order': False, 'shape': (count,)}
    np.lib.format.write_array_header_1_0(stream, header)
    return stream.getvalue() + content


def _make_wide_model() -> bytes:
    """Return base poses whose count is the square root of what their products take."""
    count = 60_000
    arrays = {
        'components': np.full((count, 15, 3), 0.15, np.float16),
        'std': np.ones(count, np.float16),
        'explained': np.ones(count, np.float16),
    }
    stream = io.BytesIO()
    with np.load(io.BytesIO(EXAMPLES['npz']()[3])) as model:
        np.savez_compressed(stream, **{**model, **arrays})
    return stream.getvalue()


def _make_mcap(definition: str, message: bytes) -> bytes:
    stream = io.BytesIO()
    writer = Writer(stream, chunk_size=2 * BOMB_BYTES, compression=CompressionType.ZSTD)
    writer.start('ros2', 'bomb')
    schema = writer.register_schema(KEYPOINTS, 'ros2msg', definition.encode())
    channel = writer.register_channel('/keypoints', 'cdr', schema)
    writer.add_message(channel, 1, message, 1)
    writer.finish()  # type: ignore[no-untyped-call]
    return stream.getvalue()


def _define(fields: str, other_type: str = '') -> bytes:
    """Return a bag whose keypoints have another definition, in which counts are the largest numbers."""
    definition = f'std_msgs/Header header\n{fields}\n' + HEADER_TYPES
    if other_type:
        definition += f'{"=" * 80}\nMSG: a/B\n{other_type}\n'
    return _make_mcap(definition, make_keypoints(0)[:20] + b'\xff' * 8)


def _make_bvh(name: str, frames: int, bones: int = 1900) -> bytes:
    """Return a BVH file of a joint with ends within ends."""
    ends = 'End Site\n{\n' * bones + '}\n' * bones
    hierarchy = f'HIERARCHY\nROOT {name}\n{{\nCHANNELS 1 Xposition\n{ends}}}\n'
    return f'{hierarchy}MOTION\nFrames: {frames}\nFrame Time: 0.1\n'.encode() + b'0\n' * frames


def _make_asf(bones: int, frames: int) -> bytes:
    """Return a chain of bones in the order that takes longest."""
    data = ''.join(f'begin\nname b{i}\ndirection 1 0 0\nlength 1\nend\n' for i in range(bones))
    hierarchy = ''.join(f'b{i - 1} b{i}\n' for i in reversed(range(1, bones)))
    skeleton = f':root\norder TX\n:bonedata\n{data}:hierarchy\n{hierarchy}root b0\n'
    return skeleton.encode() + FILE_SEPARATOR + b'1\n' * frames


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
    count = 3_500_000 // 4
    return raw[:1] + empty[: empty.rindex(bytes(4))] + count.to_bytes(4, 'little') + bytes(count * 4)


BOMBS: dict[str, tuple[str, Callable[[], bytes]]] = {
    'archive that unpacks to 400 times its size': (
        'npz',
        lambda: _write_npz(zipfile.ZIP_DEFLATED, theta=_make_npy('<f8', BOMB_BYTES // 8, bytes(BOMB_BYTES))),
    ),
    'array that states a length': ('npz', lambda: _write_npz(timestamps=_make_npy('<f8', 10**9))),
    'array of texts without characters': ('npz', lambda: _write_npz(joint_names=_make_npy('<U0', 10**8))),
    'archive in a compression with a dictionary': (
        'npz', lambda: _write_npz(zipfile.ZIP_LZMA, timestamps=_make_npy('<f8', 1, bytes(8)))
    ),
    'base poses by the ten thousand': ('npz', _make_wide_model),
    'names of characters that do not exist': (
        'arrays', lambda: pack_arrays({
            'timestamps': np.array([0.0]), 'joint_names': np.full(1, 0x7FFFFFFF, np.uint32).view('<U1')
        })
    ),
    'frame of 30 digits': (
        'json', lambda: json.dumps([{'image_id': i, 'keypoints': FULL_BODY} for i in (0, 10**30)]).encode()
    ),
    'frames of a thousand years': (
        'json', lambda: json.dumps([{'image_id': i, 'keypoints': FULL_BODY} for i in (0, 10**17)]).encode()
    ),
    'images of one number': (
        'json', lambda: json.dumps({
            'images': [{'id': i, 'file_name': '1.jpg'} for i in range(30_000)], 'annotations': []
        }).encode()
    ),
    'thousands of joints in a million frames': ('json', lambda: _make_coco(3000)),
    'JSON of brackets': ('json', lambda: b'[' * 100_000),
    'end of a bone of a huge name': ('bvh', lambda: _make_bvh('x' * 1_000_000, 1)),
    'bones without motion': ('bvh', lambda: _make_bvh('a', 30_000)),
    'chain of bones in reverse': ('asf', lambda: _make_asf(3000, 1)),
    'frames without bones': ('asf', lambda: _make_asf(1500, 30_000)),
    'people without keypoints': ('messages', lambda: _make_crowd(KEYPOINT_TYPES.index(OPENPOSE_POSES))),
    'YAML of brackets': ('yaml', lambda: b'a: ' + b'[' * 10_000),
    'type within itself': ('mcap', lambda: _define('a/B a', 'a/B a')),
    'definition of a megabyte': ('mcap', lambda: _define('int8 a\n' * 150_000)),
}  # fmt: skip
