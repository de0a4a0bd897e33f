# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""2D keypoint detectors that run on images; `detectors.detector` chooses the one that a model file is for."""
