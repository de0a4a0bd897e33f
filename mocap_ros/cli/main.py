"""Entry point of `mocap-ros`.

Exit codes: 0 done; 1 failed, with one line on stderr that says what and where; 2 usage.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from typing import Any

from mocap_ros.errors import MocapError
from mocap_ros.runtime.cpu_setup import prepare


class _HelpWithDefaults(argparse.ArgumentDefaultsHelpFormatter):
    """Adds the default to the help of every option that has one worth showing."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        shown = action.default not in (None, [], '') and not isinstance(action.default, bool)
        return super()._get_help_string(action) if shown else action.help


class _Parser(argparse.ArgumentParser):
    """Of the command and of all its subcommands."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options, formatter_class=_HelpWithDefaults)


def parser() -> argparse.ArgumentParser:
    """The command line of all subcommands."""
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

    top = _Parser(prog='mocap-ros', description='People in 3D from one camera and a 2D keypoint detector.')
    subparsers = top.add_subparsers(metavar='COMMAND', required=True)
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
    return top


def main(argv: Sequence[str] | None = None) -> int:
    """Run one subcommand."""
    prepare()
    try:
        args = parser().parse_args(argv)
        return int(args.run(args))
    except MocapError as error:
        return _failed(str(error))
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:
        where = f'{error.filename}: ' if error.filename else ''
        return _failed(f'{where}{error.strerror or error}')
    except KeyboardInterrupt:
        return _failed('interrupted')


def _failed(message: str) -> int:
    print(f'mocap-ros: {" ".join(message.split())}', file=sys.stderr)
    return 1


if __name__ == '__main__':
    sys.exit(main())
