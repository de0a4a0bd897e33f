# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The inner loops, compiled ahead of time with Cython; the .pyi beside a .pyx file has its types for Python."""

import sys
from importlib.machinery import PathFinder
from importlib.util import module_from_spec

import scipy

# SciPy's BLAS and LAPACK for Cython are imported without `scipy.linalg`, which they are in: that needs 0.2 s and
# 22 MB, for 200 modules that the engine does not use.
for _name in ('scipy.linalg.cython_blas', 'scipy.linalg.cython_lapack'):
    _spec = PathFinder.find_spec(_name, [f'{folder}/linalg' for folder in scipy.__path__])
    if _name not in sys.modules and _spec is not None and _spec.loader is not None:
        sys.modules[_name] = module_from_spec(_spec)
        _spec.loader.exec_module(sys.modules[_name])
