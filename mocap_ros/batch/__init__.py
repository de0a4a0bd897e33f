# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Many recordings, on the cores of one machine or on a cluster (Dask): docs/recording.md."""
