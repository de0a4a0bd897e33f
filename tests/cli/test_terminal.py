# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Commands as processes on a terminal: the bar, its absence in a pipe, and Ctrl-C."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mocap_ros.formats.sequence_file import load_sequence, save_sequence

COLUMNS = 200
TIMEOUT_S = 120.0  # s; far above what a command takes on a busy machine


@pytest.fixture(scope='module')
def long_recording(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording that takes some seconds to reconstruct."""
    whole = load_sequence(recording)
    keypoints = np.concatenate([whole.keypoints] * 5)
    path = tmp_path_factory.mktemp('long') / 'long.npz'
    save_sequence(path, replace(whole, keypoints=keypoints, timestamps=np.arange(len(keypoints)) / 30, truth=None))
    return path


def run_on_terminal(
    arguments: Sequence[str], interrupt_at: str = '', size: tuple[int, int] = (24, COLUMNS)
) -> tuple[int, str]:
    """Run a command on a terminal, and interrupt it when it shows something.

    Returns the exit code and what the command shows, of an interrupted one since the interrupt.
    """
    terminal, end = pty.openpty()
    fcntl.ioctl(end, termios.TIOCSWINSZ, struct.pack('HHHH', *size, 0, 0))
    command = [sys.executable, '-m', 'mocap_ros.cli.main', *arguments]
    process = subprocess.Popen(command, stdin=end, stdout=end, stderr=end, start_new_session=True)
    os.close(end)
    shown, deadline = '', time.monotonic() + TIMEOUT_S
    while time.monotonic() < deadline:
        if not select.select([terminal], [], [], 0.1)[0]:
            continue
        try:
            shown += os.read(terminal, 65536).decode(errors='replace')
        except OSError:  # the process has ended
            break
        if interrupt_at and interrupt_at in shown:
            shown, interrupt_at = '', ''
            os.killpg(process.pid, signal.SIGINT)  # as Ctrl-C does, to all processes of the command
    os.close(terminal)
    return process.wait(TIMEOUT_S), shown


def keep_what_stays(shown: str) -> list[str]:
    """Return the lines that stay on a terminal: what follows the last return to their beginning."""
    lines = [re.split(r'\r(?:\x1b\[K)?', line)[-1] for line in shown.replace('\r\n', '\n').split('\n')]
    return [line for line in lines if line]


@pytest.mark.parametrize('size', [(24, COLUMNS), (0, 0)])
def test_a_terminal_shows_one_bar_with_the_time_left_and_a_pipe_none(
    long_recording: Path, tmp_path: Path, size: tuple[int, int]
) -> None:
    command = ['reconstruct', str(long_recording), '-o', str(tmp_path / 'r.npz')]
    code, shown = run_on_terminal(command, size=size)
    assert code == 0
    assert 'mocap-ros reconstruct: loading ...' in shown
    assert re.search(r'\rreconstruct: +\d+%.*\d\d:\d\d, \d\d:\d\d left', shown)
    first, second = keep_what_stays(shown)
    assert first == str(tmp_path / 'r.npz')
    assert second.startswith(f'{long_recording}: good; ')
    script = [sys.executable, '-m', 'mocap_ros.cli.main']
    piped = subprocess.run([*script, *command], capture_output=True, text=True, check=True)
    assert piped.stderr == ''
    assert piped.stdout.splitlines()[0] == first


@pytest.mark.parametrize(
    ('arguments', 'at'),
    [
        (['reconstruct', 'LONG', '-o', 'x.npz'], 'loading'),
        (['reconstruct', 'LONG', '-o', 'x.npz'], 'left'),
        (['view', 'LONG', '-o', 'x.html'], 'left'),
        (['batch', 'FOLDER', '-o', 'x', '--work', 'reconstruct', '--workers', '1'], 'dashboard'),
        pytest.param(['play', 'LONG'], 'waiting for a subscriber', marks=pytest.mark.ros),
        pytest.param(['demo', '-o', 'x'], 'play: ', marks=[pytest.mark.ros, pytest.mark.slow]),
    ],
)
def test_ctrl_c_ends_a_command_with_130_and_one_line(
    long_recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], at: str
) -> None:
    for package in {'batch': ['distributed'], 'play': ['rclpy'], 'demo': ['rclpy']}.get(arguments[0], []):
        pytest.importorskip(package)
    monkeypatch.chdir(tmp_path)
    path_of = {'LONG': str(long_recording), 'FOLDER': str(long_recording.parent)}
    code, shown = run_on_terminal([path_of.get(argument, argument) for argument in arguments], at)
    assert code == 130
    assert keep_what_stays(shown) == ['mocap-ros: interrupted']
    assert not list(tmp_path.glob('x.*'))
