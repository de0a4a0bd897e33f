# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The inner loops, compiled ahead of time with Cython; the .pyi beside a .pyx file has its types for Python."""
