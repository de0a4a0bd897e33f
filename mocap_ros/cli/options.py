"""Options that several subcommands share."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any, TypeVar

import yaml
from tqdm import tqdm

from mocap_ros.base_poses import BasePoses, load_model, shipped_models
from mocap_ros.config import Config, from_yaml, with_values
from mocap_ros.errors import ConfigError

T = TypeVar('T')


def add_config_options(parser: argparse.ArgumentParser) -> None:
    """`--config FILE` and `--set NAME=VALUE`."""
    parser.add_argument('--config', type=Path, metavar='FILE', help='parameter file (default: none)')
    parser.add_argument(
        '--set',
        action='append',
        default=[],
        metavar='NAME=VALUE',
        help='one parameter, such as solver.components=20; may be repeated (defaults: see `mocap-ros config`)',
    )


def add_sequence_options(parser: argparse.ArgumentParser, **how: Any) -> None:
    """The sequence file, or several, and `--model`."""
    parser.add_argument(
        'input', type=Path, metavar='SEQUENCE.npz', help='sequence file: keypoints of one person over time', **how
    )
    parser.add_argument(
        '--model',
        metavar='NAME',
        help='base poses: a shipped name, a file, or auto for the likeliest (default: tracker.model)',
    )


def models_from(args: argparse.Namespace, config: Config) -> dict[str, BasePoses]:
    """The base poses of `--model`, by name; all shipped ones for `auto`.

    Raises:
        ModelError: there are none of that name.
    """
    name = args.model or config.tracker.model
    return {n: load_model(n) for n in (shipped_models() if name == 'auto' else (name,))}


def config_from(args: argparse.Namespace) -> Config:
    """The configuration that these options describe.

    Raises:
        ConfigError: unreadable file, unknown parameter or value out of range.
    """
    config = Config()
    if args.config is not None:
        try:
            text = args.config.read_text(encoding='utf-8')
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigError(f'{args.config}: {getattr(error, "strerror", None) or error}') from None
        config = from_yaml(text, str(args.config))
    for assignment in args.set:
        name, equals, value = assignment.partition('=')
        if not equals:
            raise ConfigError(f'--set {assignment}: expected NAME=VALUE')
        try:
            parsed = yaml.safe_load(value)
        except yaml.YAMLError:
            raise ConfigError(f'--set {assignment}: not a value') from None
        config = with_values(config, {name: parsed})
    return config


def progress(items: Iterable[T], description: str, total: int | None = None) -> Iterable[T]:
    """The items, with a progress bar on a terminal and none in a pipe."""
    return tqdm(items, desc=description, total=total, disable=not sys.stderr.isatty(), leave=False)
