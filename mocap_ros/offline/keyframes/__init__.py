# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Long sequences by keyframes (Loy, Eriksson, Sullivan, Carlsson, ECCV 2004)."""
