# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap-ros config`: print a parameter file."""

from __future__ import annotations

import argparse

from mocap_ros.cli.options import CONFIG_OPTIONS, Options, load_config
from mocap_ros.cli.terminal import end_loading
from mocap_ros.config import to_yaml

DESCRIPTION = (
    'Prints the parameters that many users set, with meanings, ranges and values, as a ROS parameter file. Pass '
    'the file to `mocap_node --ros-args --params-file` or to the option `--config` of the other commands.'
)
OPTIONS: Options = {'--all': 'print every parameter (default: those that many users set)', **CONFIG_OPTIONS}


def run(args: argparse.Namespace) -> int:
    """Print the effective configuration as a ROS parameter file."""
    text = to_yaml(load_config(args), shows_all=args.all)
    end_loading()
    print(text, end='')
    return 0
