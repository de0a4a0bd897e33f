# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap-ros config`: print a parameter file."""

from __future__ import annotations

import argparse

from mocap_ros.cli.options import add_config_options, load_config
from mocap_ros.cli.terminal import end_loading
from mocap_ros.config import to_yaml


def add_options(parser: argparse.ArgumentParser) -> None:
    """Describe the subcommand and add its options."""
    parser.description = (
        'Prints the parameters that many users set, with meanings, ranges and values, as a ROS parameter file. '
        'Pass the file to `mocap_node --ros-args --params-file` or to the option `--config` of the other '
        'commands.'
    )
    parser.add_argument(
        '--all', action='store_true', help='print every parameter (default: those that many users set)'
    )
    add_config_options(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print the effective configuration as a ROS parameter file."""
    text = to_yaml(load_config(args), shows_all=args.all)
    end_loading()
    print(text, end='')
    return 0
