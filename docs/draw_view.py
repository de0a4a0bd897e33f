# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Make the pictures of the page of `mocap-ros view`, page.png and the animation demo.gif in docs/img/view.

    make demo
    .venv/bin/pip install playwright          # and Chromium, e.g. `apt install chromium`
    .venv/bin/python docs/draw_view.py [PAGE]

PAGE is a page that `mocap-ros view` wrote; by default demo_output/demo.html.
"""

from __future__ import annotations

import io
import shutil
import sys
from pathlib import Path

import numpy as np
from PIL import Image
from playwright.sync_api import ViewportSize, sync_playwright
from tqdm import tqdm

ROOT = Path(__file__).resolve().parents[1]
OUT = ROOT / 'docs' / 'img' / 'view'
WINDOW: ViewportSize = {'width': 1280, 'height': 800}  # px; of the still picture
SMALL_WINDOW: ViewportSize = {
    'width': 1000,
    'height': 640,
}  # px; of the animation, whose text stays readable at WIDTH
WIDTH = 680  # px; of the animation, about that of a column of text
STEP_S = 0.1  # s; between two pictures of the animation
END_S = 9.0  # s; the part of the demo in which the person walks, runs and jumps
STILL_S = 3.1  # s; one arm is hidden then, and the cadence is known
COLOURS = 48  # of the animation; more make the file larger, not better
# Colours of the skeleton and of the kinds of motion, of which a picture has too few pixels to keep them.
IMPORTANT_COLOURS = (
    '#1f77b4',
    '#165686',
    '#d62728',
    '#961b1c',
    '#ff9f1c',
    '#ffe0b0',
    '#8fbf8f',
    '#b9a3d0',
    '#f6d4d4',
)
OPTIONS = ['--no-sandbox', '--disable-gpu', '--use-angle=swiftshader', '--enable-unsafe-swiftshader']


def main(path: Path) -> None:
    """Open the page and photograph it."""
    OUT.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        program = shutil.which('chromium') or shutil.which('google-chrome')
        browser = playwright.chromium.launch(executable_path=program, args=OPTIONS)
        page = browser.new_page(viewport=WINDOW)
        page.goto(path.resolve().as_uri())
        page.wait_for_selector('body[data-ready]')
        page.evaluate(f'mocapPage.showTime({STILL_S})')
        page.screenshot(path=OUT / 'page.png')
        page.set_viewport_size(SMALL_WINDOW)
        pictures = []
        for time in tqdm(np.arange(0, END_S, STEP_S)):
            page.evaluate(f'mocapPage.showTime({time})')
            picture = Image.open(io.BytesIO(page.screenshot())).convert('RGB')
            height = round(picture.height * WIDTH / picture.width)
            pictures.append(picture.resize((WIDTH, height), Image.Resampling.LANCZOS))
        browser.close()
    palette = _choose_palette(pictures[len(pictures) // 2])
    frames = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    frames[0].save(
        OUT / 'demo.gif',
        save_all=True,
        append_images=frames[1:],
        duration=round(1000 * STEP_S),
        loop=0,
        optimize=True,
    )
    print(
        *(f'{file}: {file.stat().st_size / 1e6:.2f} MB' for file in (OUT / 'page.png', OUT / 'demo.gif')), sep='\n'
    )


def _choose_palette(picture: Image.Image) -> Image.Image:
    """Return a picture with the palette of the animation, which holds the important colours too."""
    weighted = picture.copy()
    for row, colour in enumerate(IMPORTANT_COLOURS):
        weighted.paste(colour, (0, 20 * row, picture.width, 20 * (row + 1)))
    return weighted.quantize(COLOURS, dither=Image.Dither.NONE)


if __name__ == '__main__':
    main(Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / 'demo_output' / 'demo.html'))
