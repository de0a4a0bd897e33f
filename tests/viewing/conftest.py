# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Chromium without a window, for the tests that look at pages; skipped, visibly, where it is missing."""

import shutil
from collections.abc import Iterator
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


@pytest.fixture(scope='module')
def browser() -> Iterator[Any]:
    sync_api = pytest.importorskip('playwright.sync_api', reason='playwright is not installed')
    program = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        pytest.skip('Chromium is not installed')
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=list(OPTIONS))
        yield browser
        browser.close()


@pytest.fixture
def page(browser: Any) -> Iterator[Any]:
    """A page of Playwright without a network, whose errors fail the test."""
    errors: list[str] = []
    page = browser.new_page(viewport=WINDOW)
    page.set_default_timeout(TIMEOUT_MS)
    page.on('pageerror', lambda error: errors.append(str(error)))
    page.on('console', lambda message: errors.append(message.text) if message.type == 'error' else None)
    page.context.set_offline(True)
    yield page
    page.context.close()
    assert not errors
