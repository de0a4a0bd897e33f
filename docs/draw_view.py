# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Make the pictures of docs/img/view from pages that `mocap-ros view` and `make demo` wrote.

.venv/bin/pip install playwright          # and Chromium, e.g. `apt install chromium`
.venv/bin/python docs/draw_view.py demo_output/demo.html page.png 3.1
.venv/bin/python docs/draw_view.py balance_openpose_cam2.html real.webp 0 --until 1.65
"""

from __future__ import annotations

import argparse
import io
import shutil
from pathlib import Path

from PIL import Image
from playwright.sync_api import ViewportSize, sync_playwright

FOLDER = Path(__file__).resolve().parent / 'img' / 'view'
WINDOW: ViewportSize = {'width': 1280, 'height': 700}  # px
SMALL_WINDOW: ViewportSize = {'width': 960, 'height': 400}  # px
FRAMES_HZ, SLOWNESS = 30, 2  # of a moving picture, which is shown at half speed
OPTIONS = ['--no-sandbox', '--disable-gpu', '--use-angle=swiftshader', '--enable-unsafe-swiftshader']


def shrink(png: bytes) -> Image.Image:
    """Return a picture at half its size, which smooths its edges."""
    picture = Image.open(io.BytesIO(png)).convert('RGB')
    return picture.resize((picture.width // 2, picture.height // 2), Image.Resampling.LANCZOS)


def main() -> None:
    """Open the page, show the time, and photograph the page, or its two panels until another time."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('page', type=Path)
    parser.add_argument('picture')
    parser.add_argument('time', type=float, help='s')
    parser.add_argument('--until', type=float, help='s; the 3D view and the image alone as a moving picture')
    arguments = parser.parse_args()
    with sync_playwright() as playwright:
        program = shutil.which('chromium') or shutil.which('google-chrome')
        browser = playwright.chromium.launch(executable_path=program, args=OPTIONS)
        window = WINDOW if arguments.until is None else SMALL_WINDOW
        page = browser.new_page(viewport=window, device_scale_factor=2)
        page.goto(arguments.page.resolve().as_uri())
        page.wait_for_selector('body[data-ready]')
        page.evaluate(f'mocapPage.showTime({arguments.time})')
        if arguments.until is None:
            shrink(page.screenshot()).save(FOLDER / arguments.picture)
        else:
            page.add_style_tag(content='header, #curves, footer, .tools { display: none !important }')
            page.evaluate('dispatchEvent(new Event("resize"))')
            frames = []
            for step in range(round((arguments.until - arguments.time) * FRAMES_HZ) + 1):
                page.evaluate(f'mocapPage.showTime({arguments.time + step / FRAMES_HZ})')
                frames.append(shrink(page.locator('main').screenshot()))
            duration = round(1000 * SLOWNESS / FRAMES_HZ)
            frames[0].save(
                *(FOLDER / arguments.picture, 'WEBP'),
                save_all=True,
                append_images=frames[1:],
                duration=duration,
                loop=0,
                quality=60,
            )
        browser.close()


if __name__ == '__main__':
    main()
