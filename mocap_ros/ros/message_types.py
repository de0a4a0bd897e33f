"""Message and service classes of rclpy by name, found at run time; messages of other versions made ours."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from importlib import import_module
from typing import Any

from rosbags.convert.converter import migrate_bytes
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mocap_ros.errors import ConfigError, InputError
from mocap_ros.messages.cdr import WORD, typestore

BASE_TYPES = {'boolean': 'bool', 'octet': 'byte', 'float': 'float32', 'double': 'float64'}

Convert = Callable[[bytes], bytes]


def interface_class(kind: str) -> Any:
    """The class of a type such as `sensor_msgs/msg/CameraInfo` or `std_srvs/srv/Trigger`.

    Raises:
        ConfigError: its package is not installed, or has no such type.
    """
    module, _, name = kind.rpartition('/')
    try:
        return getattr(import_module(module.replace('/', '.')), name)
    except (ImportError, AttributeError) as error:
        raise ConfigError(f'type {kind} is not installed ({error})') from None


def converter(kind: str) -> Convert | None:
    """What makes CDR of the installed version of a type that of ours; None where they are the same.

    What it returns raises InputError for what is no such message.

    Raises:
        ConfigError: the type is not installed, or its fields cannot be read.
    """
    store = get_typestore(Stores.EMPTY)
    try:
        for name, text in _definitions(kind, set()):
            store.register(get_types_from_msg(text, name))
        if store.hash_rihs01(kind) == typestore().hash_rihs01(kind):
            return None
    except ConfigError:
        raise
    except Exception as error:  # whatever the parser makes of a stranger's fields
        raise ConfigError(f'the fields of {kind} cannot be read ({error})') from None
    cache: dict[str, object] = {}

    def convert(raw: bytes) -> bytes:
        try:
            data = bytes(migrate_bytes(store, typestore(), kind, kind, cache, raw, src_is2=True, dst_is2=True))
        except Exception as error:  # bytes of a stranger: any reader error ends up here
            raise InputError(f'not a {kind} ({error})') from None
        return data + bytes(-len(data) % WORD)

    return convert


def _definitions(kind: str, done: set[str]) -> Iterator[tuple[str, str]]:
    """Names and texts of a type and of those it uses, as they are installed."""
    done.add(kind)
    lines = []
    for field, described in interface_class(kind).get_fields_and_field_types().items():
        inside, array = _plain(described)
        if '/' in inside:
            package, name = inside.split('/')
            inside = f'{package}/msg/{name}'
            if inside not in done:
                yield from _definitions(inside, done)
        lines.append(f'{BASE_TYPES.get(inside, inside)}{array} {field}')
    yield kind, '\n'.join(lines)


def _plain(described: str) -> tuple[str, str]:
    """Type and array brackets of what rclpy calls `sequence<double, 3>`, `float[3]` or `string<8>`."""
    sequence = re.fullmatch(r'sequence<(.+?)(?:, (\d+))?>', described)
    if sequence:
        return _bounded(sequence[1]), f'[<={sequence[2]}]' if sequence[2] else '[]'
    array = re.fullmatch(r'(.+)\[(\d+)\]', described)
    return (_bounded(array[1]), f'[{array[2]}]') if array else (_bounded(described), '')


def _bounded(described: str) -> str:
    return re.sub(r'^(w?string)<(\d+)>$', r'\1<=\2', described)
