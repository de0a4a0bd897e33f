"""Entry point of `mocap-ros`.

Exit codes: 0 for success; 1 for a failure, which one line on stderr describes; 2 for wrong usage.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from typing import Any

from mocap_ros.errors import MocapError
from mocap_ros.runtime.cpu_setup import configure_process


class _HelpFormatter(argparse.ArgumentDefaultsHelpFormatter):
    """Help formatter that appends the default of every option whose default is a value."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        has_default_value = action.default not in (None, [], '') and not isinstance(action.default, bool)
        return super()._get_help_string(action) if has_default_value else action.help


class _Parser(argparse.ArgumentParser):
    """Parser of the command and of its subcommands, which all use `_HelpFormatter`."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options, formatter_class=_HelpFormatter)


def build_parser() -> argparse.ArgumentParser:
    """Build the command-line parser with all subcommands."""
    from mocap_ros.cli import (
        config,
        demo,
        evaluate,
        keyframes,
        play,
        plot,
        reconstruct,
        recover,
        replay,
        train,
        train_lifter,
    )

    parser = _Parser(
        prog='mocap-ros', description='Reconstructs people in 3D from the 2D keypoints of one camera.'
    )
    subparsers = parser.add_subparsers(metavar='COMMAND', required=True)
    for command in (
        demo,
        reconstruct,
        replay,
        play,
        recover,
        keyframes,
        plot,
        evaluate,
        train,
        train_lifter,
        config,
    ):
        command.add_parser(subparsers)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run one subcommand and return the exit code."""
    configure_process()
    try:
        args = build_parser().parse_args(argv)
        return int(args.run(args))
    except MocapError as error:
        return _report_failure(str(error))
    except BrokenPipeError:  # the reader of stdout has gone; Python must not try to flush stdout at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:
        place = f'{error.filename}: ' if error.filename else ''
        return _report_failure(f'{place}{error.strerror or error}')
    except KeyboardInterrupt:
        return _report_failure('interrupted')


def _report_failure(message: str) -> int:
    """Print the message as one line on stderr and return the exit code of a failure."""
    print(f'mocap-ros: {" ".join(message.split())}', file=sys.stderr)
    return 1


if __name__ == '__main__':
    sys.exit(main())
