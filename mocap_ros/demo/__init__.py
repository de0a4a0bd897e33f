# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The demo recording, which is synthesised from learned motions and therefore comes with its true 3D poses."""
