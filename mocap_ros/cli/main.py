# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Entry point of `mocap-ros`.

Exit codes: 0 for success; 1 for a failure, which one line on stderr describes, also of a parameter that is
unknown or an output of unknown type; 2 for options that a command does not have or cannot parse, after its usage;
3 for a bag that `recover` could recover in part; 130 for an interrupt by Ctrl-C, as shells expect it.
"""

from __future__ import annotations

import argparse
import gc
import io
import os
import re
import sys
from collections.abc import Collection, Sequence
from importlib import import_module
from typing import Any, NoReturn

from mocap_ros.cli.terminal import end_loading, is_interrupt, print_note, show_loading
from mocap_ros.errors import MocapError, make_printable_line, suggest
from mocap_ros.runtime.cpu_setup import configure_process

INTERRUPTED = 130  # exit code: 128 and the number of SIGINT
# The line of each subcommand in the help, by its name, which is also the name of its module in this folder.
COMMANDS = {
    'demo': 'run the live node on the embedded recording',
    'reconstruct': 'reconstruct a whole sequence in 3D',
    'merge': 'merge the people whom several cameras saw',
    'detect': 'find 2D keypoints in a video or the images of a camera',
    'replay': 'run the live pipeline over bags',
    'batch': 'replay or reconstruct many recordings, on the cores of a machine or on a cluster',
    'play': 'publish recorded keypoints at the recorded pace',
    'recover': 'recover the messages of a bag that was cut off or damaged',
    'cameras': 'find where cameras are from the people whom they see',
    'keyframes': 'summarise a long sequence by a few poses',
    'view': 'show any recording or result in 3D, as a page for any browser or as a picture',
    'evaluate': 'print the errors of a reconstruction against the truth',
    'train': 'train base poses or the lifter from motion capture',
    'config': 'print a parameter file',
}


class _HelpFormatter(argparse.ArgumentDefaultsHelpFormatter):
    """Help formatter that appends the default of every option whose default is a value."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        has_default_value = action.default not in (None, [], '') and not isinstance(action.default, bool)
        return super()._get_help_string(action) if has_default_value else action.help


class _Parser(argparse.ArgumentParser):
    def __init__(self, **options: Any) -> None:
        super().__init__(**options, formatter_class=_HelpFormatter)

    def print_help(self, file: Any = None) -> None:
        """Print the help in place of the line that says that the command loads."""
        end_loading()
        super().print_help(file)

    def error(self, message: str) -> NoReturn:
        """Print the usage and a message, which may hold any argument, and exit."""
        end_loading()
        super().error(make_printable_line(message))


class _PrintVersion(argparse.Action):
    """Option that prints the version, which takes longer to look up than the help."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import version

        print(f'mocap-ros {version("mocap_ros")}')
        parser.exit()


def build_parser(selected: Collection[str] = tuple(COMMANDS)) -> argparse.ArgumentParser:
    """Build the parser; only the selected subcommands have options, because all modules are slow to import."""
    parser = _Parser(
        prog='mocap-ros', description='Reconstructs people in 3D from the 2D keypoints of one camera.'
    )
    parser.add_argument('--version', action=_PrintVersion, nargs=0, help='print the version and exit')
    subparsers = parser.add_subparsers(metavar='COMMAND', required=True)
    for name, summary in COMMANDS.items():
        command = subparsers.add_parser(name, help=summary)
        if name in selected:
            from mocap_ros.cli.options import add_options  # which the help of all commands waits for in vain

            module = import_module(f'mocap_ros.cli.{name}')
            command.description = module.DESCRIPTION
            add_options(command, module.OPTIONS)
            command.set_defaults(command=command, run=module.run)
    return parser


def explain_missing_command(arguments: Sequence[str]) -> str:
    """Explain why the first argument is no subcommand; return an empty string if it is one or asks for help."""
    first = arguments[0] if arguments else '--help'
    if first in COMMANDS or first in ('-h', '--help', '--version'):
        return ''
    later = next((argument for argument in arguments if argument in COMMANDS), '')
    if later:
        return f'{first!r} comes before the command; write: mocap-ros {later} ...'
    return f'no command {first!r}; {suggest(first, list(COMMANDS))}'


def describe_unknown_arguments(unknown: Sequence[str], command: argparse.ArgumentParser) -> str:
    """Return a line about arguments that a command does not have."""
    options = re.findall(r'--[a-z-]+', command.format_usage())
    advice = suggest(unknown[0].partition('=')[0], options, f'{command.prog} --help lists all')
    return f'unrecognized arguments: {" ".join(unknown)}; {advice}'


def main(argv: Sequence[str] | None = None) -> int:
    """Run one subcommand and return the exit code."""
    configure_process()
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == 'strict':
        sys.stdout.reconfigure(errors='backslashreplace')  # names of files may hold what a terminal cannot show
    try:
        arguments = sys.argv[1:] if argv is None else list(argv)
        if arguments[:1] and arguments[0] in COMMANDS:
            show_loading(f'mocap-ros {arguments[0]}')
        parser = build_parser(arguments[:1])
        if reason := explain_missing_command(arguments):
            parser.error(reason)
        args, unknown = parser.parse_known_args(arguments)
        if unknown:
            args.command.error(describe_unknown_arguments(unknown, args.command))
        gc.freeze()  # collections of garbage need not look at all imported libraries
        return int(args.run(args))
    except MocapError as error:
        return _report_failure(str(error))
    except BrokenPipeError:  # the reader of stdout has gone; Python must not try to flush stdout at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:
        place = f'{error.filename}: ' if error.filename else ''
        return _report_failure(f'{place}{error.strerror or error}')
    except (KeyboardInterrupt, SystemError) as error:
        if not is_interrupt(error):
            raise
        print_note('interrupted')
        return INTERRUPTED
    finally:
        end_loading()


def _report_failure(message: str) -> int:
    print_note(message)
    return 1


if __name__ == '__main__':
    sys.exit(main())
