# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""People as messages that other packages' planners and monitors take in; a parameter switches each of them on."""
