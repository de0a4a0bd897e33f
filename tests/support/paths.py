# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Paths of the repository."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
