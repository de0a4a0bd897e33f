# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Pictures, pages for a browser and recordings for Rerun, of sequences, reconstructions and keyframes."""
