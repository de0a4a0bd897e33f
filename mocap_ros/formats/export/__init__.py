# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Writers of files for animation and biomechanics."""
