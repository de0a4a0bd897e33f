# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A logger that keeps its lines."""

from __future__ import annotations


class LineLog:
    """Logger of a run; each line begins with its level."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def info(self, message: str) -> None:
        self.lines.append(f'info {message}')

    def warning(self, message: str) -> None:
        self.lines.append(f'warning {message}')

    def error(self, message: str) -> None:
        self.lines.append(f'error {message}')
