# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Help, usage errors and interrupts of the commands; as processes on a terminal, their bar and Ctrl-C."""

import argparse
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
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mocap_ros.cli import main as command_line
from mocap_ros.cli.main import build_parser, main
from mocap_ros.cli.terminal import interrupt_between_items
from mocap_ros.formats.sequence_file import load_sequence, save_sequence

SLOW_PACKAGES = {'numpy', 'scipy', 'matplotlib', 'rosbags', 'rclpy', 'mcap'}


def test_every_option_is_described_with_its_default() -> None:
    (commands,) = [a for a in build_parser()._actions if isinstance(a, argparse._SubParsersAction)]
    for name, command in commands.choices.items():
        assert command.description, name
        for action in command._actions:
            text = f'{action.help} {command.formatter_class("")._get_help_string(action)}'
            assert action.help, (name, action.dest)
            assert action.required or action.dest == 'help' or 'default' in text, (name, action.dest)


@pytest.mark.parametrize('arguments', [['config', '--help'], []])
def test_help_waits_for_no_slow_package(arguments: list[str]) -> None:
    code = (
        'import sys\n'
        'from mocap_ros.cli.main import main\n'
        'try:\n'
        f'    main({arguments})\n'
        'finally:\n'
        "    print('imported:', *{name.partition('.')[0] for name in sys.modules})"
    )
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=False)
    (line,) = [line for line in done.stdout.splitlines() if line.startswith('imported:')]
    imported = set(line.split())
    assert 'mocap_ros' in imported
    assert not imported & SLOW_PACKAGES


@pytest.mark.parametrize(
    ('arguments', 'reason'),
    [
        ([], ''),
        (['evaluate'], ''),
        (['recontruct', 'x.npz'], "no command 'recontruct'; did you mean 'reconstruct'?"),
        (['reconstruct', 'a.json', '--layout', 'coc17'], "argument --layout: no 'coc17'; did you mean 'coco17'?"),
        (['config', '--confg', 'x'], "unrecognized arguments: --confg x; did you mean '--config'?"),
        (['--fps', '30', 'reconstruct', 'x.json'], "'--fps' comes before the command"),
        (['x.npz', 'view'], "'x.npz' comes before the command; write: mocap-ros view"),
        (['x.npz'], "no command 'x.npz'; known: demo, reconstruct"),
        (['config', '\x1b[31m\r\n\u202e'], r'unrecognized arguments: \x1b[31m \u202e'),
        (['reconstruct', 'x.json', '--fps', 'fast'], "argument --fps: 'fast' "),
        (['reconstruct', 'x.json', '--fps', '-5'], 'argument --fps: '),
        (['reconstruct', 'a.json', '--image-size', '640'], "argument --image-size: '640': "),
        (['reconstruct', 'a.json', '--image-size', '0x480'], "argument --image-size: '0x480': "),
        (['reconstruct', 'a.json', '--hfov', '0.5'], 'argument --hfov: '),
        (['reconstruct', 'a.json', '--hfov', '56', '--focal', '600'], '--focal'),
        *(
            (['reconstruct', 'a.json', f'--floor-height={h}'], f'argument --floor-height: {h} ')
            for h in ('-1', '0', 'nan', '101')
        ),
        (['batch', 'x', '-o', 'y', '--workers', 'two'], "argument --workers: 'two' "),
        (['play', 'bag', '--rate', '0'], 'argument --rate: 0 '),
        (['play', 'bag', '--rate', 'nan'], 'argument --rate: nan '),
        (['play', 'bag', '--rate', 'fast'], "argument --rate: 'fast' "),
        (['detect', 'a.mp4', '--max-people', '0'], "argument --max-people: '0' "),
        (['detect', 'a.mp4', '--max-people', '1.5'], "argument --max-people: '1.5' "),
        (['train', 'a', '-o', 'b', '--every', '0'], "argument --every: '0' "),
        (['train', 'a', '-o', 'b', '--seed', str(2**63)], 'argument --seed: '),
    ],
)
def test_wrong_usage_exits_with_2(capsys: pytest.CaptureFixture[str], arguments: list[str], reason: str) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    assert stopped.value.code == 2
    assert reason in capsys.readouterr().err.splitlines()[-1]


@pytest.fixture(autouse=True)
def _python_handler() -> Iterator[None]:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize('last', [2, 4])
def test_an_interrupt_waits_for_the_item_in_hand(last: int) -> None:
    finished: list[int] = []

    def work() -> None:
        with interrupt_between_items() as stop_at_interrupt:
            for item in stop_at_interrupt(range(5)):
                if item == last:
                    signal.raise_signal(signal.SIGINT)
                finished.append(item)

    with pytest.raises(KeyboardInterrupt):
        work()
    assert finished == list(range(last + 1))
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_second_interrupt_does_not_wait() -> None:
    with suppress(KeyboardInterrupt), interrupt_between_items():
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


def test_an_ignored_interrupt_stays_ignored() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with interrupt_between_items() as stop_at_interrupt:
        signal.raise_signal(signal.SIGINT)
        assert list(stop_at_interrupt(range(3))) == [0, 1, 2]


@pytest.mark.parametrize('is_interrupted', [True, False])
@pytest.mark.parametrize('link', ['__cause__', '__context__'])
def test_an_interrupt_of_compiled_code_ends_a_command(
    is_interrupted: bool, link: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    inner, outer = ValueError(), SystemError('returned a result with an exception set')
    setattr(outer, link, inner)
    setattr(inner, link, KeyboardInterrupt() if is_interrupted else None)

    def run(_: argparse.Namespace) -> int:
        raise outer

    monkeypatch.setattr('mocap_ros.cli.config.run', run)
    if is_interrupted:
        assert command_line.main(['config']) == 130
        assert capsys.readouterr().err == 'mocap-ros: interrupted\n'
    else:
        with pytest.raises(SystemError):
            command_line.main(['config'])


COLUMNS = 200
TIMEOUT_S = 300.0  # s; far above what a command takes on a busy machine


@pytest.fixture(scope='module')
def long_recording(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording that takes some seconds to reconstruct."""
    whole = load_sequence(recording)
    keypoints = np.concatenate([whole.keypoints] * 3)
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
def test_only_a_terminal_shows_a_bar(long_recording: Path, tmp_path: Path, size: tuple[int, int]) -> None:
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
