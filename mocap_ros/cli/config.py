"""`mocap-ros config`: print a parameter file with every parameter."""

from __future__ import annotations

import argparse
from typing import Any

from mocap_ros.cli.options import add_config_options, config_from
from mocap_ros.config import to_yaml


def add_parser(subparsers: Any) -> None:
    """Register the subcommand."""
    p = subparsers.add_parser(
        'config',
        help='print a parameter file with every parameter',
        description='Prints every parameter with its meaning, range and value as a ROS parameter file, for '
        '`mocap_node --ros-args --params-file` and `--config`.',
    )
    add_config_options(p)
    p.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print the effective configuration as a ROS parameter file."""
    print(to_yaml(config_from(args)), end='')
    return 0
