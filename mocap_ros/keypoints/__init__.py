# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""People in 2D images: keypoints and their checks, association, left-right swaps; layouts are in `skeleton.py`."""
