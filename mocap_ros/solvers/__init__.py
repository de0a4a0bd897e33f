# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""From a window of keypoints to 3D poses and cameras."""
