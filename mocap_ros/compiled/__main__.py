# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`python -m mocap_ros.compiled`: compile the inner loops now, which otherwise the first run does.

`NUMBA_CACHE_DIR` names another folder for what is compiled.
"""

from __future__ import annotations

import sys
from importlib import import_module

from mocap_ros.compiled.kernel import CompilationReport, compile_kernels

# Modules that, together with what they import, declare all kernels.
DECLARING_MODULES = (
    'mocap_ros.tracking.tracker',
    'mocap_ros.offline.keyframes.keyframe_method',
)


def compile_all() -> CompilationReport:
    """Compile all kernels that are not in the cache, and say on stderr that this takes time."""
    for module in DECLARING_MODULES:
        import_module(module)
    return compile_kernels(lambda line: print(line, file=sys.stderr))


if __name__ == '__main__':
    print(compile_all())
