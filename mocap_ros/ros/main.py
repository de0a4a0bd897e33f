"""Entry point of `mocap_node`.

Exit codes: 0 ended by SIGINT or SIGTERM; 1 could not start, with one line that says why; 2 usage. A node that runs
but cannot be configured or activated says why and waits to be told to try again.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from mocap_ros.runtime.cpu_setup import prepare


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    try:
        return _run(sys.argv[1:] if args is None else args)
    except KeyboardInterrupt:  # before the node was there to take it
        return 0


def _run(arguments: Sequence[str]) -> int:
    prepare()

    # imported here, where a SIGINT meanwhile is no traceback
    from mocap_ros.errors import MocapError
    from mocap_ros.ros.help import parser, without_ros_arguments

    parser().parse_args(without_ros_arguments(arguments))
    try:
        from mocap_ros.ros.node import run
    except ImportError as error:
        return _failed(f'needs ROS 2, and there is none for this Python ({error}); source it, or `make setup`')
    try:
        run(arguments)
    except MocapError as error:
        return _failed(str(error))
    return 0


def _failed(message: str) -> int:
    print(f'mocap_node: {" ".join(message.split())}', file=sys.stderr)
    return 1


if __name__ == '__main__':
    sys.exit(main())
