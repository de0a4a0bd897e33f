# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Training of base poses and of the lifter; only the lifter's needs PyTorch (`pip install -e '.[train]'`)."""
