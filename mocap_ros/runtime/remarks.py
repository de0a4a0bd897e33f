# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Kinds of remarks, so that the same mistake in many messages is told once or a few times."""

from __future__ import annotations

import re

# Parts of a remark that may differ between remarks of one kind: addresses, numbers and quoted names.
VARIABLE_PARTS = re.compile(r"0x\w+|[\d.]*\d|'.*'|\".*\"", re.DOTALL)


def find_kind(remark: str) -> str:
    """Return what remarks that differ only in numbers, addresses and quoted names have in common."""
    return VARIABLE_PARTS.sub('#', remark)
