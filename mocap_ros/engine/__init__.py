# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The inner loops, compiled ahead of time with Cython; the .pyi beside a .pyx file has its types for Python."""

import sys
from importlib import import_module
from types import ModuleType

import scipy


def _import_blas() -> None:
    """Import SciPy's BLAS and LAPACK for Cython without the package they are in.

    Importing `scipy.linalg` itself needs 0.2 s and 22 MB, for 200 modules that the engine does not use. It can
    still be imported afterwards.
    """
    name = 'scipy.linalg'
    if name not in sys.modules:
        sys.modules[name] = package = ModuleType(name)
        package.__path__ = [f'{folder}/linalg' for folder in scipy.__path__]
        try:
            import_module(f'{name}.cython_blas')
            import_module(f'{name}.cython_lapack')
        finally:
            del sys.modules[name]


_import_blas()
