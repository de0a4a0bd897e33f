# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Pictures and pages for a browser, of sequences, reconstructions and keyframes."""
