# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Options that several subcommands share, and the configuration that they load.

This module imports neither NumPy nor anything slow, so that `mocap-ros config --help` is fast.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

from mocap_ros.config import Config, Value, format_value, from_yaml, load_yaml, values, with_values
from mocap_ros.errors import ConfigError, suggest
from mocap_ros.formats.text_files import read_text

MAX_DIGITS = 20  # characters of a whole number; guards int() against thousands of digits
MAX_CONFIG_BYTES = 1 << 20  # bytes; guards against reading a huge file as parameters (the full file has 10 kB)


def derive_output_stem(input_path: Path) -> str:
    """Return the stem of the names of files that are made from this input; a folder may hold dots in its name."""
    if input_path.is_dir():
        return input_path.name if input_path.name not in ('', '..') else input_path.resolve().name
    return input_path.stem


def parse_positive(text: str, limits: tuple[float, float] = (0.0, math.inf)) -> float:
    """Parse a positive, finite number or fraction, such as 30000/1001, in a range for argparse."""
    try:
        numerator, slash, denominator = text.partition('/')
        value = float(numerator) / float(denominator if slash else 1)
    except (ValueError, ZeroDivisionError):
        raise argparse.ArgumentTypeError(f'{text!r} is not a number') from None
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f'{text} is not positive and finite')
    if not limits[0] <= value <= limits[1]:
        raise argparse.ArgumentTypeError(f'{text}; expected {limits[0]:g} to {limits[1]:g}')
    return value


def parse_count(text: str, low: int = 1, high: int = sys.maxsize) -> int:
    """Parse a whole number in a range for argparse."""
    if not text.isdecimal() or len(text) > MAX_DIGITS or not low <= int(text) <= high:
        kind = 'positive whole number' if low == 1 else f'whole number from {low}'
        raise argparse.ArgumentTypeError(f'{text!r} is not a {kind}')
    return int(text)


CAMERA_HEIGHT_RANGE_M = 0.0, 100.0  # as of `tracker.camera_height`
# What turns the text of a value into it, by what the help calls the value; any other value is a path.
TEXTS = (
    'ADDRESS',
    'DEG',
    'FOLDER|GLOB|LIST',
    'ID',
    'KIND',
    'NAME',
    'NAME=VALUE',
    'CAMERA|NAMESPACE',
    'NAMESPACE',
    'SIZE',
    'TEXT',
)
TYPES: Mapping[str, Callable[[str], object]] = {
    **dict.fromkeys(TEXTS, str),
    **dict.fromkeys(('FACTOR', 'HZ', 'M', 'PX', 'S'), parse_positive),
    'H': partial(parse_positive, limits=CAMERA_HEIGHT_RANGE_M),
    'N': parse_count,
}
# Options and arguments of a command: the line of each in the help, alone or with settings of `argparse`, by its
# names and what the help calls its value, such as `-o --output FILE`. One without a value is a switch.
Options: TypeAlias = Mapping[str, 'str | tuple[str, Mapping[str, Any]]']


def option(description: str, **settings: Any) -> tuple[str, Mapping[str, Any]]:
    """Return an option that has settings of `argparse`.

    `choices` are named where another value is given, and of options with the same `group` only one may be given.
    """
    return description, settings


CONFIG_OPTIONS: Options = {
    '--config FILE': 'parameter file to read (default: none)',
    '--set NAME=VALUE': option(
        'value of one parameter, such as tracker.body_height=1.8; may be repeated (defaults: see `mocap-ros '
        'config`)',
        action='append',
        default=[],
    ),
    '--pitch DEG': 'degrees by which the camera looks down, such as 10 (default: the parameter tracker.vertical)',
}
STRICT_OPTIONS: Options = {'--strict': 'exit with 1 if the input turns out to be wrong (default: with 0)'}


def add_options(parser: argparse.ArgumentParser, options: Options) -> None:
    """Add options and arguments to a command."""
    groups: dict[str, argparse._MutuallyExclusiveGroup] = {}
    for form, entry in options.items():
        description, settings = option(entry) if isinstance(entry, str) else entry
        settings = {**settings, 'help': description}
        *names, value = form.split()
        target: argparse._ActionsContainer = parser
        if group := settings.pop('group', ''):
            target = groups[group] = groups.get(group) or parser.add_mutually_exclusive_group()
        if value.startswith('-'):
            target.add_argument(*names, value, action='store_true', **settings)
            continue
        if (choices := settings.get('choices')) and 'nargs' not in settings:
            settings |= {'choices': None, 'type': partial(_choose, choices)}
            value = f'{{{",".join(choices)}}}'
        target.add_argument(*names, **{'type': TYPES.get(value, Path), 'metavar': value, **settings})


def _choose(choices: Sequence[str], text: str) -> str:
    if text not in choices:
        raise argparse.ArgumentTypeError(f'no {text!r}; {suggest(text, choices)}')
    return text


def load_config(args: argparse.Namespace) -> Config:
    """Load the configuration that the options of `CONFIG_OPTIONS` describe: `--set` on top of `--config`."""
    return with_values(load_config_file(args) or Config(), parse_changes(args))


def load_config_file(args: argparse.Namespace) -> Config | None:
    """Load the parameter file of the option `--config`; None if it is not given."""
    if args.config is None:
        return None
    return from_yaml(read_text(args.config, max_bytes=MAX_CONFIG_BYTES), str(args.config))


def parse_changes(args: argparse.Namespace) -> dict[str, Value]:
    """Return the values that the options `--set` and `--pitch` give, by the names of the parameters."""
    changes: dict[str, Value] = {} if args.pitch is None else {'tracker.vertical': args.pitch}
    for assignment in args.set:
        name, equals, value = assignment.partition('=')
        if not equals:
            raise ConfigError(f'--set {format_value(assignment)}: expected NAME=VALUE')
        config = with_values(Config(), {name: load_yaml(value, f'--set {name}')})
        changes[name] = values(config)[name]
    return changes
