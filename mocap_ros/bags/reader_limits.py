# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Limits that the bag readers of rosbags lack: a small bag from a stranger could fill the memory or the disk.

rosbags unpacks whatever a file holds and compares with the stated size afterwards, it parses the QoS profiles of
every topic anew, and it takes most values of a metadata.yaml for what they should be. It also refuses the bags in
which rosbag2 states that it has found no definition of a type.
Its functions are replaced in its modules, because they are no parameters of its readers.
"""

from __future__ import annotations

import bz2
import io
from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from types import SimpleNamespace
from typing import IO, Any, BinaryIO

import apsw
import lz4.frame
import zstandard
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat, Qos
from rosbags.rosbag1 import reader as ros1_reader
from rosbags.rosbag2 import metadata, storage_mcap, storage_sqlite3
from rosbags.rosbag2 import reader as ros2_reader

from mocap_ros.bags.mcap_layout import MAX_CHUNK_BYTES
from mocap_ros.bags.metadata_check import check_description, check_qos_profiles
from mocap_ros.bags.rosbag2 import BAG_INFORMATION, METADATA
from mocap_ros.config import load_yaml
from mocap_ros.errors import ConfigError, describe_parse_error

UNPACKED_FILE_BYTES = 1 << 26  # of a compressed file of a bag, of any size
UNPACKED_PER_BYTE = 100  # bytes that a byte of a larger compressed file may unpack to; bags pack to a tenth
PIECE_BYTES = 1 << 20  # that are unpacked at a time, and above which a stated length is compared with the file
MAX_QOS_CHARACTERS = 16_384  # of the QoS profiles of a topic, which are YAML; a profile has some 500
MAX_QOS_TEXTS = 256  # different QoS profiles that are remembered; most topics of a bag have the same


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
    """Unpack a chunk or a message.

    Args:
        data: the compressed bytes.
        compression: `zstd`, `lz4` or `bz2`.
        max_bytes: largest number of bytes to unpack to.

    Raises:
        ValueError: there would be more bytes, or the compressed bytes are cut off.
        Exception: the libraries raise exceptions of many types for damaged bytes.
    """
    limit = min(max_bytes, MAX_CHUNK_BYTES)
    decompressor: Any = None  # which knows whether it has reached the end
    if compression == 'zstd':
        with zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True) as stream:
            unpacked = b''.join(_read_pieces(stream, limit + 1))
    else:
        decompressor = lz4.frame.LZ4FrameDecompressor() if compression == 'lz4' else bz2.BZ2Decompressor()
        unpacked = bytes(decompressor.decompress(data, max_length=limit + 1))
    if len(unpacked) > limit:
        raise ValueError(f'{len(data)} bytes of {compression} unpack to more than {limit} bytes')
    if not (decompressor.eof if decompressor else _is_whole_zstd(data, len(unpacked))):
        raise ValueError(f'{len(data)} bytes of {compression} are cut off')
    return unpacked


def _is_whole_zstd(data: bytes, unpacked_bytes: int) -> bool:
    """Return whether bytes of Zstandard reach the end of their first frame.

    Args:
        data: the compressed bytes.
        unpacked_bytes: number of bytes that they unpack to.
    """
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


def _unpack_mcap(compression: str) -> Callable[[bytes, int], bytes]:
    """Return a function that unpacks a chunk of MCAP to its stated size."""
    return lambda data, size: unpack(data, compression, size)


def parse_qos(profiles: Any) -> list[Qos]:
    """Parse QoS profiles of any version of rosbag2: YAML, or what a metadata.yaml holds.

    Raises:
        ConfigError: the text is not YAML.
        ValueError: there is too much text, or it holds something else.
    """
    return list(_parse_qos_text(profiles)) if isinstance(profiles, str) else _parse_qos_list(profiles)


@lru_cache(MAX_QOS_TEXTS)
def _parse_qos_text(text: str) -> tuple[Qos, ...]:
    if len(text) > MAX_QOS_CHARACTERS:
        raise ValueError(f'QoS profiles of {len(text)} characters, more than {MAX_QOS_CHARACTERS}')
    return tuple(_parse_qos_list(load_yaml(text, 'QoS profiles')))


def _parse_qos_list(profiles: Any) -> list[Qos]:
    """Parse QoS profiles that are no text; None stands for none."""
    if profiles is not None:
        check_qos_profiles(profiles)
    return metadata.parse_qos(profiles)


def parse_description(text: str, make_parser: Callable[[], Any]) -> Any:
    """Parse a metadata.yaml and check it.

    Args:
        text: the YAML text.
        make_parser: function that returns a parser of YAML.

    Raises:
        ValueError: the content is not what a bag has; the message names the file and the value.
    """
    try:
        content = make_parser().load(text)
    except RecursionError:
        raise ValueError(f'{METADATA}: nested too deep') from None
    except (ValueError, LookupError, TypeError):
        raise ValueError(f'{METADATA}: a number, a date or a tag in it has no meaning') from None
    try:
        check_description(content)
        for index, topic in enumerate(content[BAG_INFORMATION]['topics_with_message_count']):
            _check_topic_qos(topic['topic_metadata'], f'topics_with_message_count[{index}]')
    except ValueError as error:
        raise ValueError(f'{METADATA}: {error}') from None
    return content


def _check_topic_qos(topic: Mapping[str, Any], place: str) -> None:
    """Raise ValueError, which names the place, if the QoS profiles of a topic cannot be parsed."""
    try:
        parse_qos(topic.get('offered_qos_profiles'))
    except (ConfigError, ValueError) as error:
        raise ValueError(f'{place} ({topic["name"]}): {error}') from None


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
    """A database of a bag, without the definitions of message types in languages that rosbags does not know."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
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
    reader.YAML = lambda **_: SimpleNamespace(load=partial(parse_description, make_parser=make_parser))
    reader.zstd = SimpleNamespace(
        open=lambda file, _mode: LimitedFile(file), decompress=partial(unpack, compression='zstd')
    )
