# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Find message and service classes of rclpy at run time, and convert messages of other versions of a type."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from importlib import import_module
from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from mocap_ros.bags.rosbag2 import TypeDefinition
from mocap_ros.config import format_value
from mocap_ros.errors import ConfigError
from mocap_ros.messages.cdr import OutputMessage, typestore
from mocap_ros.messages.foreign_types import find_current_type
from mocap_ros.messages.versions import Convert, compare_versions, convert_or_keep, make_converter

TYPE_NAME = re.compile(r'[A-Za-z]\w*/(msg|srv|action)/[A-Za-z]\w*', re.ASCII)
# Names of basic types in .msg files, where rclpy's names of the same types differ.
MSG_FILE_NAMES = {'boolean': 'bool', 'octet': 'byte', 'float': 'float32', 'double': 'float64'}


def load_interface_class(kind: str) -> Any:
    """Import the class of a message or service type such as `sensor_msgs/msg/CameraInfo`."""
    if not TYPE_NAME.fullmatch(kind):  # names in bags are anybody's, and the import below runs a module
        raise ConfigError(f'{format_value(kind)} is not the name of a type')
    module, _, name = kind.rpartition('/')
    try:
        return getattr(import_module(module.replace('/', '.')), name)
    except (ImportError, AttributeError) as error:
        raise ConfigError(f'type {kind} is not installed ({error})') from None


class MessageVersions:
    """The installed versions of message types, and the conversion between them and this package's versions."""

    def __init__(self) -> None:
        self._readers: dict[str, Convert] = {}  # by message type; none where the versions are equal
        self._writers: dict[str, Convert] = {}  # likewise
        self.definitions: dict[str, TypeDefinition] = {}  # of the types whose installed versions differ, by name

    def add_input(self, kind: str) -> None:
        """Add a type of messages to receive."""
        installed = self._load_if_different(kind)
        if installed is not None:
            self._readers[kind] = convert_or_keep(
                make_converter(installed, typestore(), kind, find_current_type(kind))
            )

    def add_output(self, kind: str) -> list[str]:
        """Add a type of messages to publish; return the fields that they lose, which the installed type lacks."""
        installed = self._load_if_different(kind)
        if installed is None:
            return []
        left_out, changed = compare_versions(typestore(), installed, kind)
        if changed:
            raise ConfigError(
                f'the installed version of {kind} cannot hold the messages of this package: {", ".join(changed)} '
                'has another type; build the package of the message again, of the same release'
            )
        self._writers[kind] = make_converter(typestore(), installed, kind)
        return left_out

    def read(self, kind: str, raw: bytes) -> bytes:
        """Convert a received message to this package's version of its type; return invalid bytes as they are."""
        reader = self._readers.get(kind)
        return raw if reader is None else reader(raw)

    def write(self, kind: str, raw: bytes) -> bytes:
        """Convert a message of this package to the installed version of its type."""
        writer = self._writers.get(kind)
        return raw if writer is None else writer(raw)

    def write_output(self, output: OutputMessage) -> OutputMessage:
        """Convert an output likewise."""
        return replace(output, data=self.write(output.type, output.data)) if self._writers else output

    def _load_if_different(self, kind: str) -> Typestore | None:
        installed = load_installed_types(kind)
        type_hash = installed.hash_rihs01(kind)
        if kind in typestore().types and type_hash == typestore().hash_rihs01(kind):
            return None
        self.definitions[kind] = TypeDefinition(installed.generate_msgdef(kind, ros_version=2)[0], type_hash)
        return installed


def load_installed_types(kind: str) -> Typestore:
    """Return the installed versions of a message type and of all types that it contains."""
    store = get_typestore(Stores.EMPTY)
    try:
        for name, text in _interface_definitions(kind, set()):
            store.register(get_types_from_msg(text, name))
        store.hash_rihs01(kind)  # fails where the type of a field is not defined
    except ConfigError:
        raise
    except Exception as error:  # the parser raises many types of errors for definitions of other packages
        raise ConfigError(f'the fields of {kind} cannot be read ({error})') from None
    return store


def _interface_definitions(kind: str, visited: set[str]) -> Iterator[tuple[str, str]]:
    """Yield names and .msg texts of the installed version of a type and of those in it that were not visited."""
    visited.add(kind)
    lines = []
    for field, description in load_interface_class(kind).get_fields_and_field_types().items():
        element, brackets = _split_array(description)
        if '/' in element:
            package, name = element.split('/')
            element = f'{package}/msg/{name}'
            if element not in visited:
                yield from _interface_definitions(element, visited)
        lines.append(f'{MSG_FILE_NAMES.get(element, element)}{brackets} {field}')
    yield kind, '\n'.join(lines)


def _split_array(description: str) -> tuple[str, str]:
    """Return element type and brackets, in .msg syntax, of `sequence<double, 3>`, `float[3]`, `string<8>`, ..."""
    brackets = ''
    if sequence := re.fullmatch(r'sequence<(.+?)(?:, (\d+))?>', description):
        description = sequence[1]
        brackets = f'[<={sequence[2]}]' if sequence[2] else '[]'
    elif array := re.fullmatch(r'(.+)\[(\d+)\]', description):
        description = array[1]
        brackets = f'[{array[2]}]'
    return re.sub(r'^(w?string)<(\d+)>$', r'\1<=\2', description), brackets
