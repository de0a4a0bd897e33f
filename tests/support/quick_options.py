# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Options that make a command fast where its result does not matter."""

QUICK_OPTIONS = ('--model', 'walk', '--set', 'solver.max_iterations=2')
