# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Limits and checks that the bag readers of rosbags lack: a small bag from a stranger could fill memory or disk.

rosbags unpacks whatever a file holds and compares with the stated size afterwards, it parses the QoS profiles of
every topic anew, runs views in databases, and takes most values of a metadata.yaml for what they should be. It
also refuses the bags in which rosbag2 states that it has found no definition of a type.
Its functions are replaced in its modules, because they are no parameters of its readers.
"""

from __future__ import annotations

import bz2
import io
from collections import Counter
from collections.abc import Callable, Mapping
from datetime import date
from functools import lru_cache, partial
from pathlib import PurePath
from types import SimpleNamespace
from typing import IO, Any, BinaryIO, NamedTuple

import apsw
import lz4.frame
import zstandard
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat, Qos
from rosbags.rosbag1 import reader as ros1_reader
from rosbags.rosbag2 import metadata, storage_mcap, storage_sqlite3
from rosbags.rosbag2 import reader as ros2_reader

from mocap_ros.bags.rosbag2 import BAG_INFORMATION, METADATA, METADATA_VERSION
from mocap_ros.config import format_value, load_yaml
from mocap_ros.errors import ConfigError, describe_parse_error

MAX_CHUNK_BYTES = 2**27  # guards the memory, also against bombs; the largest messages, images of 4K, have 25 MB
UNPACKED_FILE_BYTES = 1 << 26  # of a compressed file of a bag, of any size
UNPACKED_PER_BYTE = 100  # bytes that a byte of a larger compressed file may unpack to; bags pack to a tenth
PIECE_BYTES = 1 << 20  # that are read at a time, and above which a stated length is compared with the file
MAX_QOS_CHARACTERS = 16_384  # of the QoS profiles of a topic, which are YAML; a profile has some 500
MAX_QOS_TEXTS = 256  # different QoS profiles that are remembered; most topics of a bag have the same
TABLES = ('schema', 'metadata', 'topics', 'messages', 'message_definitions')  # of a bag in SQLite3


def describe_error(error: Exception) -> str:
    """Return in one line why a file cannot be read.

    A reader that believes a damaged length may ask for more memory than there is; its MemoryError has no text.
    """
    if isinstance(error, MemoryError):
        return 'a length in it is damaged, or there is too little memory'
    if isinstance(error, UnicodeDecodeError):
        return f'not UTF-8 at byte {error.start} of a text in it'
    return describe_parse_error(error).rstrip('.') or type(error).__name__


def unpack(data: bytes, compression: str, max_bytes: int = MAX_CHUNK_BYTES) -> bytes:
    """Unpack a chunk or a message in `zstd`, `lz4` or `bz2`.

    Raises:
        ValueError: There would be more than `max_bytes`, or the compressed bytes are cut off.
        Exception: The libraries raise exceptions of many types for damaged bytes.
    """
    limit = min(max_bytes, MAX_CHUNK_BYTES)
    if compression == 'zstd':
        with zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True) as stream:
            unpacked = b''.join(_read_pieces(stream, limit + 1))
        is_whole = _is_whole_zstd(data, len(unpacked))
    elif compression in ('lz4', 'bz2'):
        decompressor: Any = lz4.frame.LZ4FrameDecompressor() if compression == 'lz4' else bz2.BZ2Decompressor()
        unpacked = bytes(decompressor.decompress(data, max_length=limit + 1))
        is_whole = decompressor.eof
    else:
        raise ValueError(f'unknown compression {compression!r}')
    if len(unpacked) > limit:
        raise ValueError(f'{len(data)} bytes of {compression} unpack to more than {limit} bytes')
    if not is_whole:
        raise ValueError(f'{len(data)} bytes of {compression} are cut off')
    return unpacked


def _is_whole_zstd(data: bytes, unpacked_bytes: int) -> bool:
    """Return whether bytes of Zstandard, which unpack to so many, reach the end of their first frame."""
    stated_bytes = zstandard.frame_content_size(data)
    if stated_bytes >= 0:
        return unpacked_bytes >= stated_bytes
    decompressor = zstandard.ZstdDecompressor().decompressobj()
    decompressor.decompress(data)
    return decompressor.eof


def _read_pieces(stream: IO[bytes], size: int) -> list[bytes]:
    """Read at most `size` bytes, so that no more memory is taken than there are bytes."""
    pieces = []
    while size > 0 and (piece := stream.read(min(size, PIECE_BYTES))):
        pieces.append(piece)
        size -= len(piece)
    return pieces


class LimitedFile(io.RawIOBase):
    """A compressed file that is open for reading, and that raises ValueError once it has unpacked to too much."""

    def __init__(self, file: IO[bytes]) -> None:
        packed = file.seek(0, io.SEEK_END)
        file.seek(0)
        self._left = UNPACKED_FILE_BYTES + UNPACKED_PER_BYTE * packed
        self._stream = zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True)

    def read(self, size: int = -1) -> bytes:
        """Read at most `size` bytes."""
        content = bytes(self._stream.read(size))
        self._left -= len(content)
        if self._left < 0:
            raise ValueError(f'a file of the bag unpacks to more than {UNPACKED_PER_BYTE} times its size')
        return content


class _Kind(NamedTuple):
    """What a single value of a metadata.yaml must be: its name for error messages, and the check."""

    name: str
    accepts: Callable[[Any], bool]


_TEXT = _Kind('text', lambda value: isinstance(value, str))
_TEXT_OR_EMPTY = _Kind('text', lambda value: value is None or isinstance(value, str))
_CDR = _Kind("'cdr'", lambda value: value == 'cdr')
_FILE = _Kind('the name of a file', lambda value: isinstance(value, str) and bool(PurePath(value).name))
_LIST = _Kind('a list', lambda value: isinstance(value, list))
_MAPPING = _Kind('a mapping', lambda value: isinstance(value, dict))
_BOOL = _Kind('true or false', lambda value: isinstance(value, bool))
# Messages, versions and depths of queues have 64 bits without a sign.
_COUNT = _Kind('an integer from 0 to 2**64 - 1', lambda value: type(value) is int and 0 <= value < 1 << 64)
# ns; times have 64 bits with a sign in rosbag2, and without one in MCAP.
_NANOSECONDS = _Kind(
    'an integer from -2**63 to 2**64 - 1', lambda value: type(value) is int and -1 << 63 <= value < 1 << 64
)
_POLICY = _Kind('the name or the number of a policy', lambda value: type(value) in (str, int))
_TEXT_OR_LIST_OR_EMPTY = _Kind('text or a list', lambda value: value is None or isinstance(value, (str, list)))

# The form of a value: its kind; for a list, the form of each of its items; for a mapping, the form of each value
# by key. A key with a question mark may be missing, as it is in older versions of the layout.
_Form = _Kind | list['_Form'] | dict[str, '_Form']

_TIME: _Form = {'sec': _COUNT, 'nsec': _COUNT}
_QOS_PROFILES: _Form = [
    {
        **dict.fromkeys(('history?', 'reliability?', 'durability?', 'liveliness?'), _POLICY),
        'depth': _COUNT,
        **dict.fromkeys(('deadline', 'lifespan', 'liveliness_lease_duration'), _TIME),
        'avoid_ros_namespace_conventions': _BOOL,
    }
]
_TOPIC: _Form = {
    'name': _TEXT,
    'type': _TEXT,
    'serialization_format': _CDR,
    'offered_qos_profiles?': _TEXT_OR_LIST_OR_EMPTY,
    'type_description_hash?': _TEXT_OR_EMPTY,
}
_DESCRIPTION: _Form = {
    'storage_identifier': _TEXT,
    'relative_file_paths': [_FILE],
    'starting_time': {'nanoseconds_since_epoch': _NANOSECONDS},
    'duration': {'nanoseconds': _NANOSECONDS},
    'message_count': _COUNT,
    'compression_format?': _TEXT_OR_EMPTY,
    'compression_mode?': _TEXT,
    'topics_with_message_count': [{'topic_metadata': _TOPIC, 'message_count': _COUNT}],
    'files?': _LIST,
}


def _check(value: Any, form: _Form, place: str = '') -> None:
    """Raise ValueError unless a value has a form; the message names the place of what has not."""
    kind = _LIST if isinstance(form, list) else _MAPPING if isinstance(form, dict) else form
    if not kind.accepts(value):
        shown = 'empty' if value is None else str(value) if isinstance(value, date) else format_value(value)
        raise ValueError(f'{place} is {shown}, expected {kind.name}')
    if isinstance(form, list):
        for index, item in enumerate(value):
            _check(item, form[0], f'{place}[{index}]')
    elif isinstance(form, dict):
        for key, part in form.items():
            name = key.removesuffix('?')
            part_place = f'{place}.{name}' if place else name
            if name in value:
                _check(value[name], part, part_place)
            elif name == key:
                raise ValueError(f'{part_place} is missing')


def _check_description(content: Any) -> None:
    """Raise ValueError, which names the value, unless a metadata.yaml holds what readers use.

    The version of the layout must be known, and no file may be named twice: its messages would be read twice.
    """
    bag = content.get(BAG_INFORMATION) if isinstance(content, dict) else None
    if not isinstance(bag, dict):
        raise ValueError(f'expected a mapping with the key {BAG_INFORMATION}')
    _check(bag, {'version': _COUNT})
    if bag['version'] > METADATA_VERSION:
        raise ValueError(f'version is {bag["version"]}, and versions up to {METADATA_VERSION} are known')
    _check(bag, _DESCRIPTION)
    if bag.get('compression_mode', '').lower() not in ('', 'none') and bag.get('compression_format') != 'zstd':
        raise ValueError(f"compression_format is {format_value(bag.get('compression_format'))}, expected 'zstd'")
    names = Counter(PurePath(path).name for path in bag['relative_file_paths'])
    for name, count in names.most_common(1):
        if count > 1:
            raise ValueError(f'relative_file_paths: {format_value(name)} occurs {count} times')
    for index, topic in enumerate(bag['topics_with_message_count']):
        _check_topic_qos(topic['topic_metadata'], f'topics_with_message_count[{index}]')


def _check_topic_qos(topic: Mapping[str, Any], place: str) -> None:
    try:
        parse_qos(topic.get('offered_qos_profiles'))
    except (ConfigError, ValueError) as error:
        raise ValueError(f'{place} ({topic["name"]}): {error}') from None


def parse_qos(profiles: Any) -> list[Qos]:
    """Parse QoS profiles of any version of rosbag2: YAML, or what a metadata.yaml holds.

    Raises:
        ConfigError: The text is not YAML.
        ValueError: There is too much text, or it holds something else; the message names it.
    """
    return list(_parse_qos_text(profiles)) if isinstance(profiles, str) else _parse_qos_list(profiles)


@lru_cache(MAX_QOS_TEXTS)
def _parse_qos_text(text: str) -> tuple[Qos, ...]:
    if len(text) > MAX_QOS_CHARACTERS:
        raise ValueError(f'QoS profiles of {len(text)} characters, more than {MAX_QOS_CHARACTERS}')
    return tuple(_parse_qos_list(load_yaml(text, 'QoS profiles')))


def _parse_qos_list(profiles: Any) -> list[Qos]:
    if profiles is not None:
        _check(profiles, _QOS_PROFILES, 'offered_qos_profiles')
    return metadata.parse_qos(profiles)


def _parse_description(text: str, make_parser: Callable[[], Any]) -> Any:
    """Parse a metadata.yaml and check it; ValueError names the file and the value."""
    try:
        content = make_parser().load(text)
    except RecursionError:
        raise ValueError(f'{METADATA}: nested too deep') from None
    except (ValueError, LookupError, TypeError):
        raise ValueError(f'{METADATA}: a number, a date or a tag in it has no meaning') from None
    try:
        _check_description(content)
    except ValueError as error:
        raise ValueError(f'{METADATA}: {error}') from None
    return content


def _unpack_mcap(compression: str) -> Callable[[bytes, int], bytes]:
    """Return a function that unpacks a chunk of MCAP to its stated size."""
    return lambda data, size: unpack(data, compression, size)


def _limit_length(read: Callable[[BinaryIO, int], bytes]) -> Callable[[BinaryIO, int], bytes]:
    """Return a function that reads bytes, without asking for memory for more than there are."""

    def read_at_most_all(stream: BinaryIO, size: int) -> bytes:
        if size > PIECE_BYTES:
            start = stream.tell()
            left = stream.seek(0, io.SEEK_END) - start
            stream.seek(start)
            if size > left:
                raise ValueError(f'{size} bytes are stated at byte {start}, and {left} are left')
        return read(stream, size)

    return read_at_most_all


def _allow_unknown(get_definition: Callable[[Any], MessageDefinition]) -> Callable[[Any], MessageDefinition]:
    """Return a function that returns the definition of a schema, none where its language is unknown."""

    def get_known_definition(schema: Any) -> MessageDefinition:
        try:
            return get_definition(schema)
        except KeyError:  # rosbag2 writes `unknown` where it has found no definition
            return MessageDefinition(MessageDefinitionFormat.NONE, '')

    return get_known_definition


class _Database(apsw.Connection):
    """A database of a bag, without the definitions of message types in languages that rosbags does not know.

    A view or a generated column is a program that may never end, and a virtual table runs an extension: a database
    whose tables are no tables of data is refused with ValueError.
    """

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        query = 'SELECT lower(name), type, lower(sql) FROM main.sqlite_master WHERE lower(name) IN (?, ?, ?, ?, ?)'
        for name, kind, sql in self.execute(query, TABLES).fetchall():
            columns = self.execute(f'PRAGMA main.table_xinfo({name})').fetchall()  # the last value is 0 for data
            is_virtual = str(sql).split()[:2] == ['create', 'virtual']
            if kind != 'table' or is_virtual or any(column[-1] for column in columns):
                raise ValueError(f'{name!r} is no table of data')
        # SQLite looks for a name among what is temporary first, also in a database that is read only.
        self.execute(
            'CREATE TEMP VIEW message_definitions AS SELECT * FROM main.message_definitions '
            "WHERE encoding IN ('ros2msg', 'ros2idl')"
        )


def limit_readers() -> None:
    """Give the readers of rosbags their limits; once in a process, because they wrap what they replace."""
    storage: Any = storage_mcap
    storage.read_exact = _limit_length(storage_mcap.read_exact)
    storage.get_msgdef = _allow_unknown(storage_mcap.get_msgdef)
    storage = storage_sqlite3
    storage.apsw = SimpleNamespace(**{**vars(apsw), 'Connection': _Database})
    storage = ros1_reader
    storage.read_bytes = _limit_length(ros1_reader.read_bytes)
    storage_mcap.DECOMPRESSORS.update({name: _unpack_mcap(name) for name in ('zstd', 'lz4')})
    ros1_reader.decompressors.update({name: partial(unpack, compression=name) for name in ('bz2', 'lz4')})
    reader: Any = ros2_reader
    modules: tuple[Any, ...] = (storage_mcap, storage_sqlite3, reader)
    for module in modules:
        module.parse_qos = parse_qos
    make_parser = partial(reader.YAML, typ='safe')
    reader.YAML = lambda **_: SimpleNamespace(load=partial(_parse_description, make_parser=make_parser))
    reader.zstd = SimpleNamespace(
        open=lambda file, _mode: LimitedFile(file), decompress=partial(unpack, compression='zstd')
    )


limit_readers()
