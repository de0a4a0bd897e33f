# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Entry point of `mocap_node`, and what the entry points of all nodes share.

Exit codes: 0 after SIGINT or SIGTERM; 1 if the node could not start, with the reason in one line on stderr; 2 for
wrong usage. A `mocap_node` that has started but cannot be configured or activated logs the reason and waits for
the next lifecycle transition.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module

from mocap_ros.runtime.cpu_setup import configure_process


def main(args: Sequence[str] | None = None) -> int:
    """Run `mocap_node` until it is ended by a signal; return the exit code."""
    return run_node('mocap_node', 'mocap_ros.ros.help', 'mocap_ros.ros.node', args)


def run_node(name: str, help_module: str, node_module: str, args: Sequence[str] | None) -> int:
    """Run a node until it is ended by a signal.

    Args:
        name: name of the program.
        help_module: module with the function `build_parser`, which does not import rclpy.
        node_module: module with the function `run`, which takes the arguments and runs the node.
        args: arguments of the command line; None for those of this process.

    Returns:
        The exit code.
    """
    try:
        return _run(name, help_module, node_module, sys.argv[1:] if args is None else args)
    except KeyboardInterrupt:  # SIGINT before the node has its handler, or a signal during the compilation
        return 0


def _run(name: str, help_module: str, node_module: str, arguments: Sequence[str]) -> int:
    configure_process()

    # imported here, so that a SIGINT during the import ends the program without a traceback
    from mocap_ros.errors import MocapError
    from mocap_ros.ros.help import remove_ros_arguments

    import_module(help_module).build_parser().parse_args(remove_ros_arguments(arguments))
    try:
        run = import_module(node_module).run
    except ImportError as error:
        return _report_failure(
            name, f'needs ROS 2, which this Python does not find ({error}); source ROS 2 or run `make setup`'
        )
    try:
        run(arguments)
    except MocapError as error:
        return _report_failure(name, str(error))
    return 0


def _report_failure(name: str, message: str) -> int:
    print(f'{name}: {" ".join(message.split())}', file=sys.stderr)
    return 1


if __name__ == '__main__':
    sys.exit(main())
