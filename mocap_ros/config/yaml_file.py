# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Parameter files: configurations from YAML and to YAML."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Mapping
from typing import Any

import yaml

from mocap_ros.config.access import Parameter, format_value, parameters, values, with_values
from mocap_ros.config.defaults import Config
from mocap_ros.errors import ConfigError, describe_parse_error, name_errors

COMMENT_WIDTH = 90  # characters of a comment line, so that a line with its indentation stays below 100
MAX_DEPTH = 50  # levels of a YAML text; parameter files have 4
MAX_NODES = 200_000  # keys and values of a YAML text; they take some seconds and 200 MB
ANY_NODE = '/**'  # name in a ROS parameter file that stands for each node that is given the file, in any namespace
TEXT_TAG = 'tag:yaml.org,2002:str'  # tag of texts in YAML, written as !!str

HEADER = """\
# Parameters of the node with their values. `mocap-ros config` prints those that many users set, with `--all` all.
# The comment of a parameter gives its unit first, if it has one, and its range or choices last, in brackets.
"""


class _StrictLoader(yaml.SafeLoader):
    """A YAML loader that refuses repeated keys, and what strangers may use to make a small file expensive.

    These are aliases, which can make it huge, deep nesting, very many values, and tags, which name how a value is
    to be read and for which PyYAML raises almost any exception.
    """

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._depth = self._count = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Compose a node as the base class does, and refuse what the class refuses."""
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        self._count += 1
        for is_refused, problem in (
            (isinstance(event, yaml.AliasEvent), 'aliases are not allowed'),
            (getattr(event, 'tag', None) not in (None, TEXT_TAG), 'tags are not allowed'),
            (self._depth >= MAX_DEPTH, 'nested too deep'),
            (self._count > MAX_NODES, f'more than {MAX_NODES} keys and values'),
        ):
            if is_refused:
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        """Construct a mapping as the base class does, and refuse keys that are repeated or not text."""
        seen = set()
        for key, _ in node.value:
            name = key.value if key.tag == TEXT_TAG else None
            if name is None or name in seen:
                problem = 'a key is not text' if name is None else f'the key {format_value(name)} occurs twice'
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=key.start_mark)
            seen.add(name)
        return super().construct_mapping(node, deep)


def load_yaml(text: str, source: str) -> Any:
    """Return the content of a YAML text without aliases, in which each key is text and occurs once.

    Errors begin with `source`, such as the path of the file.
    """
    try:
        return yaml.load(text, _StrictLoader)  # noqa: S506, the loader is a SafeLoader
    except yaml.MarkedYAMLError as error:
        line = f'line {error.problem_mark.line + 1}: ' if error.problem_mark else ''
        raise ConfigError(f'{source}: not YAML: {line}{error.problem}') from None
    except (yaml.YAMLError, ValueError) as error:  # also numbers and dates that Python refuses
        raise ConfigError(f'{source}: not YAML: {describe_parse_error(error)}') from None


def from_yaml(text: str, source: str) -> Config:
    """Return the configuration of a ROS parameter file (of any node name) or of a plain nested mapping.

    Parameters that it does not set have their defaults. Errors begin with `source`.
    """
    tree = load_yaml(text, source)
    if isinstance(tree, dict) and len(tree) == 1:
        (content,) = tree.values()
        if isinstance(content, dict) and 'ros__parameters' in content:
            tree = content['ros__parameters']
    if not isinstance(tree, dict | None):
        raise ConfigError(f'{source}: expected a mapping of parameters')
    groups = {parameter.name.partition('.')[0] for parameter in parameters()}
    given = {name: value for name, value in (tree or {}).items() if value is not None or name not in groups}
    with name_errors(source, ConfigError):
        return with_values(Config(), dict(_flatten(given)))


def _flatten(tree: Mapping[object, object], prefix: str = '') -> Iterator[tuple[str, object]]:
    for key, value in tree.items():
        name = f'{prefix}{key}'
        if isinstance(value, dict):
            yield from _flatten(value, name + '.')
        else:
            yield name, value


def to_yaml(config: Config, *, shows_all: bool = True) -> str:
    """Return a commented ROS parameter file of all parameters, or of those that many set or that are changed."""
    lines = [*HEADER.splitlines(), f'{ANY_NODE}:', '  ros__parameters:']
    value_of, previous_group = values(config), ''
    for parameter in parameters():
        value = value_of[parameter.name]
        if not (shows_all or parameter.is_common or value != parameter.default):
            continue
        group, _, field = parameter.name.partition('.')
        lines += [f'    {group}:'] if group != previous_group else []
        previous_group = group
        comment = textwrap.wrap(_describe(parameter), COMMENT_WIDTH, break_on_hyphens=False)
        lines += ['      # ' + line for line in comment]
        style = '"' if isinstance(value, str) and not value.isprintable() else None
        scalar = yaml.safe_dump(value, default_style=style, width=math.inf).split('\n')[0]
        lines.append(f'      {field}: {scalar}')
    return '\n'.join(lines) + '\n'


def _describe(parameter: Parameter) -> str:
    low, high = (v if isinstance(v, int) else format(v, 'g') for v in (parameter.low, parameter.high))
    limits = [', '.join(parameter.choices)]
    if parameter.low != -math.inf:
        limits.append(f'at least {low}' if parameter.high == math.inf else f'{low} to {high}')
    in_brackets = [limit for limit in limits if limit] + ['read-only'] * parameter.read_only
    return parameter.description + (f' [{"; ".join(in_brackets)}]' if in_brackets else '')
