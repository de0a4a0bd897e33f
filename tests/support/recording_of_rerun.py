# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What Rerun's own program says of a recording."""

from __future__ import annotations

import os
import re
import subprocess
from collections import Counter
from pathlib import Path

from mocap_ros.viewing.rerun_viewer import disable_telemetry, viewer_command


def run_rerun(folder: Path, *arguments: str) -> str:
    """Run a command of Rerun without telemetry; return what it prints."""
    environment = {**os.environ, **disable_telemetry(folder / 'settings')}
    done = subprocess.run(
        [*viewer_command(), *arguments], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def count_rows(folder: Path, recording: Path) -> Counter[str]:
    """Return the number of rows of each entity of a recording, without those of the layout."""
    printed = run_rerun(folder, 'rrd', 'print', str(recording))
    rows: Counter[str] = Counter()
    for count, entity in re.findall(r'with (\d+) rows .*? - /(\S+) - data', printed):
        rows[entity] += int(count)
    return rows
