# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Methods of others that the project is compared with, each written from its paper."""
