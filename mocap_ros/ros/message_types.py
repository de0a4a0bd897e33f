"""Find message and service classes of rclpy at run time, and convert messages of other versions of a type."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from importlib import import_module
from typing import Any

from rosbags.convert.converter import migrate_bytes
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mocap_ros.errors import ConfigError, InputError
from mocap_ros.messages.cdr import CDR_ALIGNMENT_BYTES, typestore

# Names of basic types in .msg files, where rclpy's names of the same types differ.
MSG_FILE_NAMES = {'boolean': 'bool', 'octet': 'byte', 'float': 'float32', 'double': 'float64'}

# A function that converts a message, as CDR, from the installed version of its type to the package's version.
Convert = Callable[[bytes], bytes]


def load_interface_class(kind: str) -> Any:
    """Import the class of a message or service type such as `sensor_msgs/msg/CameraInfo`.

    Raises:
        ConfigError: The package of the type is not installed or does not contain the type.
    """
    module, _, name = kind.rpartition('/')
    try:
        return getattr(import_module(module.replace('/', '.')), name)
    except (ImportError, AttributeError) as error:
        raise ConfigError(f'type {kind} is not installed ({error})') from None


def build_converter(kind: str) -> Convert | None:
    """Return a function that converts messages of the installed version of a type to the package's version.

    Fields are matched by name. The function raises InputError for bytes that are not a message of the installed
    version.

    Returns:
        The function, or None if the two versions are equal.

    Raises:
        ConfigError: The type is not installed, or the definitions of its fields cannot be parsed.
    """
    store = get_typestore(Stores.EMPTY)
    try:
        for name, text in interface_definitions(kind, set()):
            store.register(get_types_from_msg(text, name))
        if store.hash_rihs01(kind) == typestore().hash_rihs01(kind):
            return None
    except ConfigError:
        raise
    except Exception as error:  # the parser raises many types of errors for definitions of other packages
        raise ConfigError(f'the fields of {kind} cannot be read ({error})') from None
    cache: dict[str, object] = {}

    def convert(raw: bytes) -> bytes:
        try:
            data = bytes(migrate_bytes(store, typestore(), kind, kind, cache, raw, src_is2=True, dst_is2=True))
        except Exception as error:  # the decoder raises many types of errors for invalid bytes
            raise InputError(f'not a {kind} ({error})') from None
        return data + bytes(-len(data) % CDR_ALIGNMENT_BYTES)

    return convert


def interface_definitions(kind: str, visited: set[str]) -> Iterator[tuple[str, str]]:
    """Yield names and .msg texts of the installed version of a type and of the types that it contains.

    Args:
        kind: Name of the message type.
        visited: Names of the types that need not be yielded again; the function adds to it.
    """
    visited.add(kind)
    lines = []
    for field, description in load_interface_class(kind).get_fields_and_field_types().items():
        element, brackets = _split_array(description)
        if '/' in element:
            package, name = element.split('/')
            element = f'{package}/msg/{name}'
            if element not in visited:
                yield from interface_definitions(element, visited)
        lines.append(f'{MSG_FILE_NAMES.get(element, element)}{brackets} {field}')
    yield kind, '\n'.join(lines)


def _split_array(description: str) -> tuple[str, str]:
    """Return element type and array brackets, in .msg syntax, of rclpy's description of a field.

    Examples of such descriptions are `sequence<double, 3>`, `float[3]` and `string<8>`.
    """
    sequence = re.fullmatch(r'sequence<(.+?)(?:, (\d+))?>', description)
    if sequence:
        return _convert_string_bound(sequence[1]), f'[<={sequence[2]}]' if sequence[2] else '[]'
    array = re.fullmatch(r'(.+)\[(\d+)\]', description)
    return (
        (_convert_string_bound(array[1]), f'[{array[2]}]') if array else (_convert_string_bound(description), '')
    )


def _convert_string_bound(description: str) -> str:
    """Convert `string<8>` to `string<=8>`; leave any other type as it is."""
    return re.sub(r'^(w?string)<(\d+)>$', r'\1<=\2', description)
