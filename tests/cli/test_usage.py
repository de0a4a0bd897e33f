# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Help, usage errors, failures and interrupts of the commands; on a terminal, their bar and Ctrl-C."""

import argparse
import fcntl
import os
import pty
import re
import resource
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap_ros.cli import main as command_line
from mocap_ros.cli.main import build_parser, main
from mocap_ros.cli.options import derive_output_stem
from mocap_ros.cli.terminal import interrupt_between_items
from mocap_ros.formats.sequence_file import load_sequence, save_sequence
from mocap_ros.skeleton import CMU15
from tests.support.input_files import QUICK_OPTIONS

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
        *(
            (['reconstruct', 'x.json', '--fps', f], f"argument --fps: '{f}' ")
            for f in ('fast', '30/', '30/0', '1/x')
        ),
        (['reconstruct', 'a.json', '--image-size', '640'], "argument --image-size: '640': "),
        (['reconstruct', 'a.json', '--image-size', '0x480'], "argument --image-size: '0x480': "),
        (['reconstruct', 'a.json', '--hfov', '0.5'], 'argument --hfov: '),
        (['reconstruct', 'a.json', '--hfov', '56', '--focal', '600'], '--focal'),
        *(
            (['reconstruct', 'x', f'--floor-height={h}'], f'--floor-height: {h}')
            for h in ('-1', '0', 'nan', '101')
        ),
        (['batch', 'x', '-o', 'y', '--workers', 'two'], "argument --workers: 'two' "),
        (['play', 'bag', '--rate', '0'], 'argument --rate: 0 '),
        (['play', 'bag', '--rate', 'fast'], "argument --rate: 'fast' "),
        (['detect', 'a.mp4', '--max-people', '0'], "argument --max-people: '0' "),
        (['train', 'a', '-o', 'b', '--every', '0'], "argument --every: '0' "),
        (['train', 'a', '-o', 'b', '--seed', str(2**63)], 'argument --seed: '),
    ],
)
def test_wrong_usage_exits_with_2(capsys: pytest.CaptureFixture[str], arguments: list[str], reason: str) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    assert stopped.value.code == 2
    assert reason in capsys.readouterr().err.splitlines()[-1]


def test_a_rate_may_be_a_fraction() -> None:
    args = build_parser().parse_args(['reconstruct', 'x.json', '-o', 'y', '--fps', '30000/1001'])
    assert args.fps == 30000 / 1001


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
def test_a_terminal_shows_one_bar(long_recording: Path, tmp_path: Path, size: tuple[int, int]) -> None:
    command = ['reconstruct', str(long_recording), '-o', str(tmp_path / 'r.npz')]
    code, shown = run_on_terminal(command, size=size)
    assert code == 0
    assert 'mocap-ros reconstruct: loading ...' in shown
    assert re.search(r'\rreconstruct: +\d+%.*\d\d:\d\d, \d\d:\d\d left', shown)
    first, second = keep_what_stays(shown)
    assert first == str(tmp_path / 'r.npz')
    assert second.startswith(f'{long_recording}: good; ')


def test_a_pipe_shows_no_bar(short_recording: Path, tmp_path: Path) -> None:
    command = ['reconstruct', str(short_recording), '-o', str(tmp_path / 'r.npz')]
    script = [sys.executable, '-m', 'mocap_ros.cli.main', *command]
    piped = subprocess.run(script, capture_output=True, text=True, check=True)
    assert (piped.stderr, piped.stdout.splitlines()[0]) == ('', command[-1])


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
    if arguments[0] == 'batch':
        pytest.importorskip('distributed')
    monkeypatch.chdir(tmp_path)
    path_of = {'LONG': str(long_recording), 'FOLDER': str(long_recording.parent)}
    code, shown = run_on_terminal([path_of.get(argument, argument) for argument in arguments], at)
    assert code == 130
    assert keep_what_stays(shown) == ['mocap-ros: interrupted']
    assert not list(tmp_path.glob('x.*'))


MAX_WRITTEN_BYTES = 100  # bytes of a file on the disk that is full; fewer than any result has


@pytest.fixture
def in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder, in which the test runs."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


LIVE_REFUSES = (
    *(['x.npz'], ['--output', 'x.html'], ['--video', 'x.mp4'], ['--person', '1'], ['--topic', '/x']),
    *(['--config', 'x.yaml'], ['--set', 'node.hfov=60'], ['--pitch', '0'], ['--model', 'walk'], ['--strict']),
)


@pytest.mark.parametrize(
    ('arguments', 'place'),
    [
        (['reconstruct', 'nowhere.npz'], 'nowhere.npz'),
        (['reconstruct', 'RECORDING', '-o', 'x.docx'], 'x.docx: unknown file type'),
        (['reconstruct', 'RECORDING', '--model', 'moonwalk'], "'moonwalk'"),
        (['config', '--set', 'tracker.iteration=1'], "did you mean 'tracker.iterations'?"),
        (['reconstruct', 'RECORDING', '--all-people'], '--all-people does not apply'),
        (['reconstruct', 'x', '--all-people', '--person', 'x'], '--person and --all-people'),
        (['reconstruct', 'RECORDING', '--set', 'solver.prior=nofile'], 'solver.prior: nofile: '),
        (['reconstruct', 'RECORDING', '--fps', '30'], 'demo.npz: is a sequence file, to which --fps'),
        (['reconstruct', 'RECORDING', '-o', 'pipe.npz'], 'pipe.npz: cannot be written: '),
        (['reconstruct', r'C:\walk.npz'], 'folders are separated by /'),
        (['replay', 'bag', '-o', 'bag'], 'bag: exists already'),
        (['play', 'RECORDING', '--vmc', '127.0.0.1:9'], 'demo.npz: is a sequence file; expected a result'),
        (['replay', 'RECORDING', '-o', 'x'], 'demo.npz: is a sequence file; expected a bag'),
        (['evaluate', 'bag'], 'bag: the bag cannot be read'),
        (['evaluate', 'garbage.npz'], 'garbage.npz'),
        (['evaluate', 'RECORDING', '--person', '1'], 'demo.npz: is a sequence file, to which --person'),
        (['evaluate', 'RECORDING', '--json', 'folder'], 'folder: cannot be written: is a folder'),
        (['config', '--config', 'nowhere.yaml'], 'nowhere.yaml'),
        (['reconstruct', 'RECORDING', '--pitch', '100'], "tracker.vertical = '100'"),
        (['config', '--config', 'bomb.yaml'], 'bomb.yaml: not YAML: line 2: '),
        (['config', '--set', f'solver.max_iterations=1{"0" * 400}'], 'expected 1 to 10000'),
        (['train', 'RECORDING', '-o', 'x.npz'], '_joints'),
        (['train', 'folder', '-o', 'x.npz'], 'folder: no .amc, .bvh, .c3d in it'),
        (['train', 'trials.npz', '-o', 'x.npz'], '1_1: a body 0 m tall'),
        (['train', 'trials.npz', '-o', 'x.npz', '--seed', '1'], '--seed: applies only to --lifter'),
        (['train', '--lifter', 'a.bvh', '-o', 'x.npz', '--checkpoint', 'link.npz'], 'x.npz: not written'),
        (['view', 'RECORDING', '-o', 'x.pgf'], 'x.pgf: unknown file type'),
        (['view', 'RECORDING', '-o', 'x.html', '--person', '7'], 'to which --person does not apply'),
        (['view', 'walk.jpg', '-o', 'x.html'], 'walk.jpg: is an image; run a 2D keypoint detector on it'),
        (['reconstruct', 'empty.npz'], 'empty.npz: is an empty file'),
        (['view', 'walk.bvh'], 'is of a format that mocap-ros writes but does not read'),
        (['recover', 'walk.mp4'], '`mocap-ros detect`'),
        (['reconstruct', 'pipe.npz'], 'pipe.npz: neither a file'),
        (['evaluate', 'zero.json'], 'zero.json: neither a file'),
        (['reconstruct', 'RECORDING', '--model', 'pipe.npz'], 'neither a file'),
        (['reconstruct', 'RECORDING', '--method', 'keyframes', '--choices', 'zero.json'], 'neither a file'),
        (['train', 'trials.npz', '--manifest', 'zero.json', '-o', 'x.npz'], 'neither a file'),
        (['view', 'RECORDING', '-o', 'x.html', '--port', '1'], '--port applies only to --live'),
        *((['view', *given, '--live'], f'publishes, to which {given[0]} does') for given in LIVE_REFUSES),
        (['view', '--live', 'walk.npz'], 'walk.npz: no such file'),
        (['detect', 'RECORDING'], 'demo.npz: is a sequence file'),
        (['detect', 'walk.mp4', '-o', 'x.bvh'], 'x.bvh: unknown file type'),
        (['detect', 'walk.mp4', '-o', 'x.mcap', '--person', 'x'], 'x.mcap: holds all people'),
        (['keyframes', 'RECORDING', '-o', 'k.txt'], 'k.txt: unknown file type; expected .yaml'),
        (['reconstruct', 'RECORDING', '--choices', 'zero.json'], '--choices needs --method keyframes'),
        (['detect', '99'], '/dev/video99: no camera ('),
    ],
)
def test_a_failure_is_one_line_on_stderr(
    recording: Path, in_folder: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], place: str
) -> None:
    (in_folder / 'link.npz').symlink_to(in_folder / 'x.npz')
    (in_folder / 'garbage.npz').write_bytes(b'PK\x03\x04 and then nothing of use')
    (in_folder / 'bag').mkdir()
    (in_folder / 'bag' / 'metadata.yaml').touch()
    (in_folder / 'folder').mkdir()
    os.mkfifo(in_folder / 'pipe.npz')
    (in_folder / 'bomb.yaml').write_text('a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]')
    (in_folder / 'zero.json').symlink_to('/dev/zero')
    (in_folder / 'empty.npz').touch()
    for name in ('walk.jpg', 'walk.bvh', 'walk.mp4'):
        (in_folder / name).write_bytes(b'content')
    trials: dict[str, Any] = {'_joints': np.array(CMU15.joints), '1_1': np.zeros((9, 15, 3))}
    np.savez(in_folder / 'trials.npz', **trials)
    assert main([str(recording) if a == 'RECORDING' else a for a in arguments]) == 1
    error = capsys.readouterr().err
    assert error.count('\n') == 1
    assert place in error
    assert 'pickle' not in error
    assert not list(in_folder.glob('x.*'))


@pytest.mark.parametrize(
    ('arguments', 'out'),
    [
        (['reconstruct', 'RECORDING', '--model', 'read.npz', '-o', 'read.npz'], 'read.npz'),
        (['reconstruct', 'RECORDING', '--config', 'read.csv', '-o', 'a.npz', '-o', 'read.csv'], 'read.csv'),
        (['reconstruct', 'RECORDING', '--config', 'parameters.yaml', '-o', 'read.npz'], 'read.npz'),
        (['reconstruct', 'RECORDING', '--method=keyframes', '--choices=read.csv', '-o', 'read.csv'], 'read.csv'),
        (['reconstruct', 'walk/link.npz', '-o', 'walk/demo.npz'], 'walk/demo.npz'),
        (['reconstruct', 'bag', '-o', 'bag/bag_0.mcap'], 'bag/bag_0.mcap'),
        (['evaluate', 'read.npz', '--truth', 'RECORDING', '--json', 'walk/demo.npz'], 'walk/demo.npz'),
        (['keyframes', 'RECORDING', '--config', 'read_distances.png', '-o', 'read.yaml'], 'read_distances.png'),
        (['detect', 'walk.mp4', '--model', 'read.npz', '-o', 'read.npz'], 'read.npz'),
        (['train', 'walk', '--manifest', 'read.csv', '-o', 'read.csv'], 'read.csv'),
        (['train', 'walk', '-o', 'walk/manifest.csv'], 'walk/manifest.csv'),
        (['train', '--lifter', 'walk', '--start-from=read.npz', '-o', 'a', '--checkpoint=read.npz'], 'read.npz'),
    ],
)
def test_no_file_that_a_command_reads_is_overwritten(
    recording: Path, in_folder: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], out: str
) -> None:
    for folder in ('bag', 'walk'):
        (in_folder / folder).mkdir()
    for name in (
        *('read.npz', 'read.csv', 'read.png', 'read.html', 'read.yaml', 'read_distances.png'),
        *('bag/bag_0.mcap', 'bag/metadata.yaml', 'walk/manifest.csv', 'walk/anna.ASF', 'walk/anna_1.amc'),
    ):
        (in_folder / name).write_text('{}')
    (in_folder / 'walk/demo.npz').symlink_to(recording)
    (in_folder / 'walk/link.npz').symlink_to('demo.npz')
    (in_folder / 'parameters.yaml').write_text('/**: {ros__parameters: {solver: {prior: read.npz}}}')
    assert main([str(recording) if a == 'RECORDING' else a for a in arguments]) == 1
    assert capsys.readouterr().err.startswith(f'mocap-ros: {out}: not written, ')
    assert Path(out).is_symlink() or Path(out).read_text() == '{}'


@contextmanager
def limit_file_size(size: int) -> Iterator[None]:
    """Let the system refuse files of more than some bytes, as a full disk does; Python ignores the signal."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize(
    ('command', 'ending'),
    [
        *(('reconstruct', '.npz'), ('reconstruct', '.mcap'), ('reconstruct', '.bvh')),
        *(('view', '.png'), ('view', '.html'), ('evaluate', '.json'), ('keyframes', '.yaml')),
    ],
)
def test_a_disk_that_is_full_half_way_leaves_the_old_files(
    short_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str, ending: str
) -> None:
    out = tmp_path / 'out' / f'old{ending}'
    out.parent.mkdir()
    option = '--json' if command == 'evaluate' else '-o'
    quick = [] if command == 'keyframes' else QUICK_OPTIONS
    arguments = [command, str(short_recording), option, str(out), *quick]
    assert main(arguments) == 0
    capsys.readouterr()
    before = {path: (path.read_bytes(), path.stat().st_ino) for path in out.parent.iterdir()}
    assert out in before
    with limit_file_size(MAX_WRITTEN_BYTES):
        assert main(arguments) == 1
    message = rf'^mocap-ros: {re.escape(str(out))}: (cannot be written: )?File too large$'
    assert re.search(message, capsys.readouterr().err, re.MULTILINE)
    assert {path: (path.read_bytes(), path.stat().st_ino) for path in out.parent.iterdir()} == before


def test_results_of_folders_are_called_as_the_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for day in ('2026.11.21', '2026.11.22'):
        (tmp_path / day).mkdir()
        assert derive_output_stem(tmp_path / day) == day
    monkeypatch.chdir(tmp_path / '2026.11.21')
    assert derive_output_stem(Path()) == derive_output_stem(Path('../2026.11.21')) == '2026.11.21'
    assert derive_output_stem(Path('..')) == tmp_path.name
    assert derive_output_stem(Path('walk.1.npz')) == 'walk.1'
