# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Lines that the commands print: whatever names they hold, a terminal obeys none of them."""

from __future__ import annotations

import sys

from mocap_ros.errors import make_printable_line


def print_result(line: object, *, flush: bool = False) -> None:
    """Print a line on stdout, made printable; at once also where stdout is a pipe, if `flush` is set."""
    print(make_printable_line(str(line)), flush=flush)


def print_remark(line: object) -> None:
    """Print a line about the input or the work on stderr, made printable and with the name of the program."""
    print(make_printable_line(f'mocap-ros: {line}'), file=sys.stderr)
