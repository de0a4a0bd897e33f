# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Entry points of the nodes.

Exit codes: 0 after SIGINT or SIGTERM; 1 if the node could not be started, configured or activated, as where the
value of a parameter is wrong, with the reason in one line on stderr; 2 for wrong usage.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module

from mocap_ros.runtime.cpu_setup import configure_process


def main(args: Sequence[str] | None = None) -> int:
    """Run `mocap_node` until it is ended by a signal; return the exit code."""
    return _run('mocap_node', 'node:MocapNode', args)


def bridge_main(args: Sequence[str] | None = None) -> int:
    """Run `mocap_bridge` likewise."""
    return _run('mocap_bridge', 'bridge_node:BridgeNode', args)


def detector_main(args: Sequence[str] | None = None) -> int:
    """Run `detector_node` likewise."""
    return _run('detector_node', 'detector_node:DetectorNode', args)


def depth_main(args: Sequence[str] | None = None) -> int:
    """Run `depth_node` likewise."""
    return _run('depth_node', 'depth_node:DepthNode', args)


def merge_main(args: Sequence[str] | None = None) -> int:
    """Run `mocap_merge` likewise."""
    return _run('mocap_merge', 'merge_node:MergeNode', args)


def _run(name: str, node_class: str, args: Sequence[str] | None) -> int:
    """Run the node of a `module:class`; imports are here, so that a SIGINT during one ends without a traceback."""
    arguments = sys.argv[1:] if args is None else args
    try:
        configure_process()
        from mocap_ros.errors import MocapError
        from mocap_ros.ros.help import build_parser, remove_ros_arguments

        build_parser(name).parse_args(remove_ros_arguments(arguments))
        try:
            from mocap_ros.ros.nodes import run_node

            module, _, class_name = node_class.partition(':')
            make_node = getattr(import_module(f'mocap_ros.ros.{module}'), class_name)
        except ImportError as error:
            advice = 'source ROS 2 or run `make setup`'
            return _report_failure(name, f'needs ROS 2, which this Python does not find ({error}); {advice}')
        try:
            run_node(arguments, make_node)
        except MocapError as error:
            return _report_failure(name, str(error))
    except KeyboardInterrupt:  # SIGINT before the node has its handler, or a signal during the compilation
        pass
    return 0


def _report_failure(name: str, message: str) -> int:
    print(f'{name}: {" ".join(message.split())}', file=sys.stderr)
    return 1


if __name__ == '__main__':
    sys.exit(main())
