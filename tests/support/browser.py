# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Pages that tests look at with Playwright."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image


def count_colours(png: bytes) -> int:
    """Return the number of different colours in a picture, which is 1 where nothing was drawn."""
    return len(np.unique(np.asarray(Image.open(BytesIO(png)).convert('RGB')).reshape(-1, 3), axis=0))


def write_and_open(page: Any, path: Path, text: str) -> None:
    """Write a page to a file and open it as a user would, without a server."""
    path.write_text(text, encoding='utf-8')
    page.goto(path.as_uri())
