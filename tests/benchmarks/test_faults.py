# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The campaign of faults in short: recorders that are killed, and disks that fail, leave bags that can be read."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from tests.support.paths import ROOT

# Kills one recorder of each kind, and lets some steps of a recording fail in each way.
CAMPAIGN = """
import json, sys
from pathlib import Path
import faults
from report import Report
root = Path(sys.argv[1])
kills = faults.do_all(faults.kill_once, [(kind, 0, root) for kind in faults.KILLS], root, 'kills')
found = faults.measure_steps(root, Report(None, {}), every=9)
Path(sys.argv[2]).write_text(json.dumps({'kills': [k.fault for k in kills], **found}))
"""


def test_bags_survive_kills_and_failing_disks(tmp_path: Path) -> None:
    """In a process of its own, because it forks."""
    found, bags = tmp_path / 'found.json', tmp_path / 'bags'
    bags.mkdir()
    command = [sys.executable, '-c', CAMPAIGN, str(bags), str(found)]
    completed = subprocess.run(
        command, cwd=ROOT / 'benchmarks', capture_output=True, text=True, check=False, timeout=300
    )
    assert completed.returncode == 0, completed.stderr
    results = json.loads(found.read_text())
    assert results['kills'] == [''] * 4, completed.stdout
    assert results['steps'] > 30
    assert results['wrong'] == 0, completed.stdout
