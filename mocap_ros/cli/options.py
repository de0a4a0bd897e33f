# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Options that several subcommands share, and the configuration that they load.

This module imports neither NumPy nor anything slow, so that `mocap-ros config --help` is fast.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

from mocap_ros.config import Config, Value, format_value, from_yaml, load_yaml, values, with_values
from mocap_ros.errors import ConfigError
from mocap_ros.formats.text_files import read_text

MAX_DIGITS = 20  # characters of a whole number; guards int() against thousands of digits
MAX_CONFIG_BYTES = 1 << 20  # bytes; guards against reading a huge file as parameters (the full file has 10 kB)


def add_config_options(parser: argparse.ArgumentParser) -> None:
    """Add the options `--config FILE` and `--set NAME=VALUE`."""
    parser.add_argument('--config', type=Path, metavar='FILE', help='parameter file to read (default: none)')
    parser.add_argument(
        '--set',
        action='append',
        default=[],
        metavar='NAME=VALUE',
        help='value of one parameter, such as tracker.body_height=1.8; may be repeated '
        '(defaults: see `mocap-ros config`)',
    )


def add_strict_option(parser: argparse.ArgumentParser) -> None:
    """Add the option `--strict`."""
    parser.add_argument(
        '--strict', action='store_true', help='exit with 1 if the input turns out to be wrong (default: with 0)'
    )


def derive_output_stem(input_path: Path) -> str:
    """Return the stem of the names of files that are made from this input; a folder may hold dots in its name."""
    if input_path.is_dir():
        return input_path.name if input_path.name not in ('', '..') else input_path.resolve().name
    return input_path.stem


def name_bag(bag: Path) -> str:
    """Return the name of a bag: of its folder, which may hold dots, or of its file without the suffix."""
    path = bag.resolve()
    return path.name if bag.is_dir() else path.stem


def parse_positive(text: str) -> float:
    """Parse a positive, finite number for argparse."""
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f'{text!r} is not a number') from None
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f'{text} is not positive and finite')
    return value


def parse_count(text: str, low: int = 1, high: int = sys.maxsize) -> int:
    """Parse a whole number in a range for argparse."""
    if not text.isdecimal() or len(text) > MAX_DIGITS or not low <= int(text) <= high:
        kind = 'positive whole number' if low == 1 else f'whole number from {low}'
        raise argparse.ArgumentTypeError(f'{text!r} is not a {kind}')
    return int(text)


def load_config(args: argparse.Namespace) -> Config:
    """Load the configuration that the options of `add_config_options` describe: `--set` on top of `--config`.

    Raises:
        InputError: the parameter file cannot be read.
        ConfigError: a parameter is unknown, or its value is wrong.
    """
    return with_values(load_config_file(args) or Config(), parse_changes(args))


def load_config_file(args: argparse.Namespace) -> Config | None:
    """Load the parameter file of the option `--config`; None if it is not given."""
    if args.config is None:
        return None
    return from_yaml(read_text(args.config, max_bytes=MAX_CONFIG_BYTES), str(args.config))


def parse_changes(args: argparse.Namespace) -> dict[str, Value]:
    """Return the values that the options `--set` give, by the names of the parameters."""
    changes: dict[str, Value] = {}
    for assignment in args.set:
        name, equals, value = assignment.partition('=')
        if not equals:
            raise ConfigError(f'--set {format_value(assignment)}: expected NAME=VALUE')
        config = with_values(Config(), {name: load_yaml(value, f'--set {name}')})
        changes[name] = values(config)[name]
    return changes
