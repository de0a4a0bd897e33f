# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""An X server without a screen, for programs that open windows."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def open_display() -> Iterator[str]:
    """Start Xvfb on a free display; yield its name.

    The screen is larger than any window, so that the pointer in its middle hovers over none.
    """
    reader, writer = os.pipe()
    command = ['Xvfb', '-displayfd', str(writer), '-screen', '0', '5000x4000x24']
    process = subprocess.Popen(command, pass_fds=[writer], stderr=subprocess.DEVNULL)
    os.close(writer)
    try:
        with os.fdopen(reader, encoding='ascii') as stream:
            number = stream.readline().strip()
        assert number, 'Xvfb did not start'
        yield f':{number}'
    finally:
        process.terminate()
        process.wait()
