# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Parameters by name: read them from a configuration, check new values and set them."""

from __future__ import annotations

import dataclasses
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from math import inf
from operator import attrgetter
from typing import Any, cast, get_type_hints

from mocap_ros.config.defaults import Config, Value
from mocap_ros.errors import ConfigError, suggest

MAX_SHOWN_CHARACTERS = 60  # characters of a value in an error message; keeps the message on one readable line
# Numbers such as 1e-4, which YAML 1.1 and therefore PyYAML read as text because they have no decimal point. The
# exponent has at most three digits, which covers every float.
SCIENTIFIC_NOTATION = re.compile(r'[-+]?\d+(\.\d*)?[eE][-+]?\d{1,3}')


def parse_numbers(text: str) -> tuple[float, ...]:
    """Return the numbers in a text, separated by blanks or commas; none if there is anything else."""
    with suppress(ValueError):
        return tuple(float(word) for word in text.replace(',', ' ').split())
    return ()


@dataclass(frozen=True)
class Parameter:
    """A parameter as ROS, the parameter file and the command line see it."""

    name: str  # `group.field`
    kind: type  # type of its value: bool, int, float or str
    default: Value  # value unless the user sets it
    description: str  # meaning, beginning with the unit, if any
    low: float = -inf  # smallest valid value
    high: float = inf  # largest valid value
    choices: tuple[str, ...] = ()  # valid values of a text; empty if any text is valid
    read_only: bool = False  # whether the value is fixed when the node starts
    takes_numbers: bool = False  # whether a number may be given for a text
    is_common: bool = False  # whether many users set it, so that `mocap-ros config` prints it without `--all`

    def check(self, value: object) -> Value:
        """Return the value in the parameter's own type."""
        if self.kind is float and isinstance(value, str) and SCIENTIFIC_NOTATION.fullmatch(value):
            value = float(value)
        expected = ''
        if isinstance(value, int | float) and not isinstance(value, bool):
            if self.takes_numbers:
                return repr(value)
            if not (self.low <= value <= self.high and abs(value) <= sys.float_info.max):
                expected = f'{self.low:g} to {self.high:g}'
            elif self.kind is float:
                return float(value)
        elif isinstance(value, str) and self.choices and value not in self.choices:
            expected = ', '.join(self.choices)
        if type(value) is not self.kind and not (self.kind is float and expected):
            expected = f'{"an" if self.kind is int else "a"} {self.kind.__name__}'
        if expected:
            raise ConfigError(f'{self.name} = {format_value(value)}: expected {expected}')
        return cast(Value, value)


def format_value(value: object) -> str:
    """Return a value for an error message: on one line, and cut off after `MAX_SHOWN_CHARACTERS`."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # integers of thousands of digits, and deeply nested values
        return 'a huge value'
    return text if len(text) <= MAX_SHOWN_CHARACTERS else text[:MAX_SHOWN_CHARACTERS] + '...'


def parameters() -> Iterator[Parameter]:
    """Yield every parameter, in the order of the dataclasses."""
    for group in dataclasses.fields(Config):
        group_type = type(cast(Any, group.default))
        types = get_type_hints(group_type)
        for field in dataclasses.fields(group_type):
            if field.metadata:  # no constant
                name = f'{group.name}.{field.name}'
                yield Parameter(name, types[field.name], cast(Value, field.default), **field.metadata)


def with_values(config: Config, values: Mapping[str, object]) -> Config:
    """Return a copy of the configuration with the `values` of parameters, by name (`group.field`), checked."""
    parameter_of = {parameter.name: parameter for parameter in parameters()}
    for name in values:
        if name not in parameter_of:
            if in_group := next((known for known in parameter_of if known.startswith(f'{name}.')), ''):
                raise ConfigError(f'{name}: is a group of parameters; names are dotted, such as {in_group!r}')
            raise ConfigError(f'unknown parameter {format_value(name)}; {suggest_parameter(name, parameter_of)}')
    return with_settings(config, {name: parameter_of[name].check(value) for name, value in values.items()})


def with_settings(config: Config, changes: Mapping[str, object]) -> Config:
    """Return a copy with the `changes` of fields, also constants, by name (`group.field`), unchecked.

    Experiments and tests change constants by it.
    """
    for name, value in changes.items():
        group_name, field_name = name.split('.')
        group = dataclasses.replace(getattr(config, group_name), **{field_name: value})
        config = dataclasses.replace(config, **{group_name: group})
    return config


def suggest_parameter(unknown_name: str, names: Iterable[str], listed_by: str = '`mocap-ros config --all`') -> str:
    """Return a clause about which of `names`, all listed by the command `listed_by`, an unknown name may mean."""
    group = unknown_name.partition('.')[0]
    those_of_group_last = sorted(names, key=lambda name: name.partition('.')[0] == group)  # the last one counts
    name_of_field = {name.rpartition('.')[2]: name for name in those_of_group_last}
    return suggest(unknown_name.rpartition('.')[2], name_of_field, f'{listed_by} lists all of them')


def values(config: Config) -> dict[str, Value]:
    """Return the value of every parameter, by name."""
    return {parameter.name: attrgetter(parameter.name)(config) for parameter in parameters()}


def settings(config: Config) -> dict[str, Value]:
    """Return the value of every parameter and of every constant, by name."""
    groups = dataclasses.asdict(config)
    return {f'{group}.{field}': value for group, fields in groups.items() for field, value in fields.items()}
