# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The memory that a process of many days keeps."""

from __future__ import annotations

import platform
import re
import subprocess
import sys

import pytest

# Blocks of 2 kB, of which every hundredth stays in use, so that nothing at the end of the heap can be returned.
PROGRAM = """
import re
from mocap_ros.runtime.cpu_setup import configure_process, release_free_memory
configure_process()

def read_memory():
    return int(re.search(r'VmRSS:\\s+(\\d+)', open('/proc/self/status').read())[1]) / 1e3

blocks = [bytes([n % 255 + 1]) * 2000 for n in range(50_000)]
blocks = blocks[::100]
before = read_memory()
release_free_memory()
print(before, read_memory())
"""


@pytest.mark.skipif(platform.libc_ver()[0] != 'glibc', reason='only the GNU C library keeps what is freed')
def test_free_memory_between_blocks_in_use_is_returned() -> None:
    output = subprocess.run([sys.executable, '-c', PROGRAM], capture_output=True, text=True, check=True).stdout
    before, after = (float(number) for number in re.findall(r'[\d.]+', output))
    assert before - after > 60, 'MB of 100 that were freed'
