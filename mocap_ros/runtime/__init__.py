# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Convert the bytes of input messages into the bytes of output messages, for the live node and for replays."""
