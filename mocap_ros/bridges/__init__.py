# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What robots take in, made from the topics `skeletons` and `predictions`: a consumer a file."""
