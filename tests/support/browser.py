# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Chromium without a window, for the tests that look at pages; skipped, visibly, where it is missing."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

PROGRAMS = ('chromium', 'chromium-browser', 'google-chrome')
# Software WebGL, and nothing that would reach a network.
OPTIONS = (
    '--no-sandbox', '--disable-gpu', '--disable-quic', '--no-first-run', '--disable-background-networking',
    '--disable-component-update', '--disable-sync', '--use-angle=swiftshader', '--enable-unsafe-swiftshader',
)  # fmt: skip
WINDOW = {'width': 1280, 'height': 800}  # px
TIMEOUT_MS = 60_000  # ms; a busy machine takes seconds


@contextmanager
def open_browser() -> Iterator[Any]:
    """Start Chromium without a network, and yield a Playwright page whose errors fail the test."""
    sync_api = pytest.importorskip('playwright.sync_api', reason='playwright is not installed')
    program = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        pytest.skip('Chromium is not installed')
    errors: list[str] = []
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=list(OPTIONS))
        page = browser.new_page(viewport=WINDOW)
        page.set_default_timeout(TIMEOUT_MS)
        page.on('pageerror', lambda error: errors.append(str(error)))
        page.on('console', lambda message: errors.append(message.text) if message.type == 'error' else None)
        page.context.set_offline(True)
        yield page
        browser.close()
    assert not errors


def count_colours(png: bytes) -> int:
    """Return the number of different colours in a picture, which is 1 where nothing was drawn."""
    from io import BytesIO

    import numpy as np
    from PIL import Image

    return len(np.unique(np.asarray(Image.open(BytesIO(png)).convert('RGB')).reshape(-1, 3), axis=0))


def write_and_open(page: Any, path: Path, text: str) -> None:
    """Write a page to a file and open it as a user would, without a server."""
    path.write_text(text, encoding='utf-8')
    page.goto(path.as_uri())
