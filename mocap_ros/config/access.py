# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Parameters by name: read them from a configuration, check new values and set them."""

from __future__ import annotations

import dataclasses
import difflib
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, cast, get_type_hints

from mocap_ros.config.defaults import Config, Value
from mocap_ros.errors import ConfigError

MAX_SHOWN_CHARACTERS = 60  # characters of a value in an error message; keeps the message on one readable line
# Numbers such as 1e-4, which YAML 1.1 and therefore PyYAML read as text because they have no decimal point. The
# exponent has at most three digits, which covers every float.
SCIENTIFIC_NOTATION = re.compile(r'[-+]?\d+(\.\d*)?[eE][-+]?\d{1,3}')


@dataclass(frozen=True)
class Parameter:
    """A parameter of the package as ROS, the parameter file and the command line see it.

    Attributes:
        name: `group.field`.
        kind: type of its value: bool, int, float or str.
        default: value unless the user sets it.
        description: meaning, beginning with the unit, if any.
        low: smallest valid value, or None.
        high: largest valid value, or None.
        choices: valid values of a text; empty if any text is valid.
        read_only: whether the value is fixed when the node starts.
        takes_numbers: whether a number may be given for a text.
        is_common: whether many users set it.
    """

    name: str
    kind: type
    default: Value
    description: str
    low: float | None
    high: float | None
    choices: tuple[str, ...]
    read_only: bool
    takes_numbers: bool
    is_common: bool

    def check(self, value: object) -> Value:
        """Return the value in the parameter's own type.

        Raises:
            ConfigError: the value has the wrong type or is out of range; the message names the parameter.
        """
        if self.kind is float and isinstance(value, str) and SCIENTIFIC_NOTATION.fullmatch(value):
            value = float(value)
        is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if self.takes_numbers and is_number:
            return repr(value)
        number = _to_float(value) if is_number else math.nan
        if type(value) is not self.kind and not (self.kind is float and is_number):
            article = 'an' if self.kind is int else 'a'
            raise ConfigError(f'{self.name} = {format_value(value)}: expected {article} {self.kind.__name__}')
        if isinstance(value, str) and self.choices and value not in self.choices:
            raise ConfigError(f'{self.name} = {format_value(value)}: expected {", ".join(self.choices)}')
        low = -math.inf if self.low is None else self.low
        high = math.inf if self.high is None else self.high
        if is_number and not (math.isfinite(number) and low <= number <= high):
            raise ConfigError(f'{self.name} = {format_value(value)}: expected {low:g} to {high:g}')
        return number if self.kind is float else cast(Value, value)


def _to_float(number: Any) -> float:
    """Return the number as a float, infinite if it is too large for one."""
    try:
        return float(number)
    except OverflowError:
        return math.inf if number > 0 else -math.inf


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
        group_type = type(getattr(Config(), group.name))
        types = get_type_hints(group_type)
        for field in dataclasses.fields(group_type):
            if not field.metadata:  # a constant
                continue
            name = f'{group.name}.{field.name}'
            yield Parameter(name, types[field.name], cast(Value, field.default), **field.metadata)


def with_values(config: Config, values: Mapping[str, object]) -> Config:
    """Return a copy of the configuration in which these parameters have these values.

    Args:
        config: the configuration to copy.
        values: new values by parameter name (`group.field`).

    Raises:
        ConfigError: a name is unknown, or a value has the wrong type or is out of range.
    """
    parameter_of = {parameter.name: parameter for parameter in parameters()}
    checked: dict[str, Value] = {}
    for name, value in values.items():
        if name not in parameter_of:
            in_group = next((known for known in parameter_of if known.startswith(f'{name}.')), '')
            if in_group:
                raise ConfigError(f'{name}: is a group of parameters; names are dotted, such as {in_group!r}')
            suggestion = suggest_parameter(name, parameter_of)
            raise ConfigError(f'unknown parameter {format_value(name)}; {suggestion}')
        checked[name] = parameter_of[name].check(value)
    return with_settings(config, checked)


def with_settings(config: Config, changes: Mapping[str, object]) -> Config:
    """Return a copy of the configuration in which these fields, also constants, have these values, unchecked.

    Args:
        config: the configuration to copy.
        changes: new values by name (`group.field`). Experiments and tests change constants by it.
    """
    for name, value in changes.items():
        group_name, field_name = name.split('.')
        group = dataclasses.replace(getattr(config, group_name), **{field_name: value})
        config = dataclasses.replace(config, **{group_name: group})
    return config


def suggest_parameter(unknown_name: str, names: Iterable[str], listed_by: str = '`mocap-ros config --all`') -> str:
    """Return a clause, for an error message, about what an unknown parameter name may have been meant for.

    Args:
        unknown_name: the name that is none of a parameter.
        names: names of the parameters.
        listed_by: command that lists them.
    """
    group = unknown_name.partition('.')[0]
    those_of_group_last = sorted(names, key=lambda name: name.partition('.')[0] == group)  # the last one counts
    name_of_field = {name.rpartition('.')[2]: name for name in those_of_group_last}
    close = difflib.get_close_matches(unknown_name.rpartition('.')[2], name_of_field, n=1)
    return f'did you mean {name_of_field[close[0]]!r}?' if close else f'{listed_by} lists all of them'


def values(config: Config) -> dict[str, Value]:
    """Return the value of every parameter, by name."""
    return {parameter.name: attrgetter(parameter.name)(config) for parameter in parameters()}


def settings(config: Config) -> dict[str, Value]:
    """Return the value of every parameter and of every constant, by name."""
    groups = dataclasses.asdict(config)
    return {f'{group}.{field}': value for group, fields in groups.items() for field, value in fields.items()}
