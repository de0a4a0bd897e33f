"""Entry point of `mocap_node`.

Exit codes: 0 after SIGINT or SIGTERM; 1 if the node could not start, with the reason in one line on stderr; 2 for
wrong usage. A node that has started but cannot be configured or activated logs the reason and waits for the next
lifecycle transition.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from mocap_ros.runtime.cpu_setup import configure_process


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until it is ended by a signal; return the exit code."""
    try:
        return _run(sys.argv[1:] if args is None else args)
    except KeyboardInterrupt:  # SIGINT arrived before the node had installed its signal handler
        return 0


def _run(arguments: Sequence[str]) -> int:
    configure_process()

    # imported here, so that a SIGINT during the import ends the program without a traceback
    from mocap_ros.errors import MocapError
    from mocap_ros.ros.help import build_parser, remove_ros_arguments

    build_parser().parse_args(remove_ros_arguments(arguments))
    try:
        from mocap_ros.ros.node import run
    except ImportError as error:
        return _report_failure(
            f'needs ROS 2, which this Python does not find ({error}); source ROS 2 or run `make setup`'
        )
    try:
        run(arguments)
    except MocapError as error:
        return _report_failure(str(error))
    return 0


def _report_failure(message: str) -> int:
    print(f'mocap_node: {" ".join(message.split())}', file=sys.stderr)
    return 1


if __name__ == '__main__':
    sys.exit(main())
