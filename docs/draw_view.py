# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Make the pictures of docs/img/view from pages that `mocap-ros view` and `make demo` wrote.

.venv/bin/pip install playwright          # and Chromium, e.g. `apt install chromium`
.venv/bin/python docs/draw_view.py demo_output/demo.html page.png 3.1
.venv/bin/python docs/draw_view.py balance_openpose_cam2.html real.png 0.9 --panels
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

from playwright.sync_api import ViewportSize, sync_playwright

FOLDER = Path(__file__).resolve().parent / 'img' / 'view'
WINDOW: ViewportSize = {'width': 1280, 'height': 700}  # px
OPTIONS = ['--no-sandbox', '--disable-gpu', '--use-angle=swiftshader', '--enable-unsafe-swiftshader']


def main() -> None:
    """Open the page, show the time, and photograph the page or its two panels."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('page', type=Path)
    parser.add_argument('picture')
    parser.add_argument('time', type=float, help='s')
    parser.add_argument('--panels', action='store_true', help='the 3D view and the image alone')
    arguments = parser.parse_args()
    with sync_playwright() as playwright:
        program = shutil.which('chromium') or shutil.which('google-chrome')
        browser = playwright.chromium.launch(executable_path=program, args=OPTIONS)
        page = browser.new_page(viewport=WINDOW)
        page.goto(arguments.page.resolve().as_uri())
        page.wait_for_selector('body[data-ready]')
        page.evaluate(f'mocapPage.showTime({arguments.time})')
        place = page.locator('main') if arguments.panels else page
        place.screenshot(path=FOLDER / arguments.picture)
        browser.close()


if __name__ == '__main__':
    main()
