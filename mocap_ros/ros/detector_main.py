# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Entry point of `detector_node`; `ros.main` describes the exit codes."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from mocap_ros.ros.main import run_node


def main(args: Sequence[str] | None = None) -> int:
    """Run `detector_node` until it is ended by a signal; return the exit code."""
    return run_node('detector_node', 'mocap_ros.ros.detector_help', 'mocap_ros.ros.detector_node', args)


if __name__ == '__main__':
    sys.exit(main())
