# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Is the input sound, what does a result rest on, and how far is it from the truth?"""
