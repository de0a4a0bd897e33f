# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Checks of a metadata.yaml and of QoS profiles, so that the error about a damaged one names the damaged value.

The parsers of rosbags take each value as it is and fail later, or not at all.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from datetime import date
from pathlib import PurePath
from typing import Any, NamedTuple

from mocap_ros.bags.rosbag2 import BAG_INFORMATION, METADATA_VERSION
from mocap_ros.config import format_value


class _Kind(NamedTuple):
    """What a single value must be.

    Attributes:
        name: name of the kind for error messages.
        accepts: function that returns whether a value is of the kind.
    """

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
_DESCRIPTION: _Form = {
    'storage_identifier': _TEXT,
    'relative_file_paths': [_FILE],
    'starting_time': {'nanoseconds_since_epoch': _NANOSECONDS},
    'duration': {'nanoseconds': _NANOSECONDS},
    'message_count': _COUNT,
    'compression_format?': _TEXT_OR_EMPTY,
    'compression_mode?': _TEXT,
    'topics_with_message_count': [
        {
            'topic_metadata': {
                'name': _TEXT,
                'type': _TEXT,
                'serialization_format': _CDR,
                'offered_qos_profiles?': _TEXT_OR_LIST_OR_EMPTY,
                'type_description_hash?': _TEXT_OR_EMPTY,
            },
            'message_count': _COUNT,
        }
    ],
    'files?': _LIST,
}


def check_description(content: object) -> None:
    """Check the parts of a metadata.yaml that readers use, except QoS profiles.

    Args:
        content: what the YAML text holds.

    Raises:
        ValueError: the version of the layout is later than `METADATA_VERSION`, a value is missing or has another
            form, or a file is named twice, so that its messages would be read twice; the message names the value.
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


def check_qos_profiles(content: object) -> None:
    """Check the QoS profiles of a topic.

    Args:
        content: what `offered_qos_profiles` holds, or what its text holds as YAML.

    Raises:
        ValueError: a value is missing or has another form; the message names it.
    """
    _check(content, _QOS_PROFILES, 'offered_qos_profiles')


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
