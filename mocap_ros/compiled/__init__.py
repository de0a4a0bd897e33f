# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Compiled inner loops: the decorator of kernels, and BLAS and LAPACK inside them."""
