"""Entry point of `mocap_node`.

Exit codes: 0 ended by SIGINT or SIGTERM; 1 could not start, with one line that says why; 2 usage.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from mocap_ros.errors import MocapError
from mocap_ros.ros.usage import parser, without_ros_arguments


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    arguments = sys.argv[1:] if args is None else args
    parser().parse_args(without_ros_arguments(arguments))
    try:
        from mocap_ros.ros.node import run
    except ImportError as error:
        return _failed(f'needs ROS 2, and there is none for this Python ({error}); source it, or `make setup`')
    try:
        return 0 if run(arguments) else 1
    except MocapError as error:
        return _failed(str(error))


def _failed(message: str) -> int:
    print(f'mocap_node: {" ".join(message.split())}', file=sys.stderr)
    return 1


if __name__ == '__main__':
    sys.exit(main())
