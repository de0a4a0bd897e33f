# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`mocap-ros compile`: compile the inner loops now, which otherwise the first run does."""

from __future__ import annotations

import argparse
import sys
from importlib import import_module

from mocap_ros.compiled.kernel import CompilationReport, compile_kernels

# Modules that, together with what they import, declare all kernels.
DECLARING_MODULES = (
    'mocap_ros.tracking.tracker',
    'mocap_ros.offline.keyframes.reconstruct',
    'mocap_ros.messages.robots.bodies',
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Describe the subcommand."""
    parser.description = (
        'Compiles the inner loops for this processor, which takes one to two minutes and otherwise happens at the '
        'first run. Run it as the owner of the package if the package is in a folder that its users cannot write. '
        'NUMBA_CACHE_DIR names another folder for what is compiled.'
    )
    parser.set_defaults(run=run)


def run(_: argparse.Namespace) -> int:
    """Compile all kernels, and print how many were compiled and how long it took."""
    print(compile_all())
    return 0


def compile_all() -> CompilationReport:
    """Compile all kernels that are not in the cache, and say on stderr that this takes time."""
    for module in DECLARING_MODULES:
        import_module(module)
    return compile_kernels(lambda line: print(line, file=sys.stderr))
