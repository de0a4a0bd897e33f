# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Failures of the commands: one line on stderr, and no file is lost."""

import os
import re
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap_ros.cli.main import main
from mocap_ros.cli.options import derive_output_stem
from mocap_ros.skeleton import CMU15
from tests.support.keypoint_files import QUICK_OPTIONS

MAX_WRITTEN_BYTES = 100  # bytes of a file on the disk that is full; fewer than any result has

LIVE_REFUSES = (
    *(['x.npz'], ['--output', 'x.html'], ['--video', 'x.mp4'], ['--person', '1'], ['--topic', '/x']),
    *(['--config', 'x.yaml'], ['--set', 'node.hfov=60'], ['--model', 'walk'], ['--strict']),
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
        (['replay', 'RECORDING', '-o', 'x'], 'demo.npz: is a sequence file; expected a bag'),
        (['evaluate', 'bag'], 'bag: the bag cannot be read'),
        (['evaluate', 'garbage.npz'], 'garbage.npz'),
        (['evaluate', 'RECORDING', '--person', '1'], 'demo.npz: --person does not apply'),
        (['evaluate', 'RECORDING', '--json', 'folder'], 'folder: cannot be written: is a folder'),
        (['config', '--config', 'nowhere.yaml'], 'nowhere.yaml'),
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
        *((['view', *given, '--live'], f'publishes; {given[0]} does not apply') for given in LIVE_REFUSES),
        (['detect', 'RECORDING'], 'demo.npz: is a sequence file'),
        (['keyframes', 'RECORDING', '-o', 'k.txt'], 'k.txt: unknown file type; expected .yaml'),
        (['reconstruct', 'RECORDING', '--choices', 'zero.json'], '--choices needs --method keyframes'),
        (['detect', '99'], '/dev/video99: no camera ('),
    ],
)
def test_a_failure_is_one_line_on_stderr(
    recording: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    place: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'link.npz').symlink_to(tmp_path / 'x.npz')
    (tmp_path / 'garbage.npz').write_bytes(b'PK\x03\x04 and then nothing of use')
    (tmp_path / 'bag').mkdir()
    (tmp_path / 'bag' / 'metadata.yaml').touch()
    (tmp_path / 'folder').mkdir()
    os.mkfifo(tmp_path / 'pipe.npz')
    (tmp_path / 'bomb.yaml').write_text('a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]')
    (tmp_path / 'zero.json').symlink_to('/dev/zero')
    (tmp_path / 'empty.npz').touch()
    for name in ('walk.jpg', 'walk.bvh', 'walk.mp4'):
        (tmp_path / name).write_bytes(b'content')
    trials: dict[str, Any] = {'_joints': np.array(CMU15.joints), '1_1': np.zeros((9, 15, 3))}
    np.savez(tmp_path / 'trials.npz', **trials)
    assert main([str(recording) if a == 'RECORDING' else a for a in arguments]) == 1
    error = capsys.readouterr().err
    assert error.count('\n') == 1
    assert place in error
    assert 'pickle' not in error
    assert not list(tmp_path.glob('x.*'))


@pytest.mark.parametrize(
    ('arguments', 'out'),
    [
        (['reconstruct', 'RECORDING', '--model', 'read.npz', '-o', 'read.npz'], 'read.npz'),
        (['reconstruct', 'RECORDING', '--config', 'read.csv', '-o', 'a.npz', '-o', 'read.csv'], 'read.csv'),
        (['reconstruct', 'RECORDING', '--config', 'parameters.yaml', '-o', 'read.npz'], 'read.npz'),
        (
            ['reconstruct', 'RECORDING', '--method', 'keyframes', '--choices', 'read.csv', '-o', 'read.csv'],
            'read.csv',
        ),
        (['reconstruct', 'walk/link.npz', '-o', 'walk/demo.npz'], 'walk/demo.npz'),
        (['reconstruct', 'bag', '-o', 'bag/bag_0.mcap'], 'bag/bag_0.mcap'),
        (['evaluate', 'read.npz', '--truth', 'RECORDING', '--json', 'walk/demo.npz'], 'walk/demo.npz'),
        (['keyframes', 'RECORDING', '--config', 'read_distances.png', '-o', 'read.yaml'], 'read_distances.png'),
        (['detect', 'walk.mp4', '--model', 'read.npz', '-o', 'read.npz'], 'read.npz'),
        (['train', 'walk', '--manifest', 'read.csv', '-o', 'read.csv'], 'read.csv'),
        (['train', 'walk', '-o', 'walk/manifest.csv'], 'walk/manifest.csv'),
        (
            ['train', '--lifter', 'walk', '--start-from', 'read.npz', '-o', 'a', '--checkpoint', 'read.npz'],
            'read.npz',
        ),
    ],
)
def test_no_file_that_a_command_reads_is_overwritten(
    recording: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    out: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    for folder in ('bag', 'walk'):
        Path(folder).mkdir()
    for name in (
        *('read.npz', 'read.csv', 'read.png', 'read.html', 'read.yaml', 'read_distances.png'),
        *('bag/bag_0.mcap', 'bag/metadata.yaml', 'walk/manifest.csv', 'walk/anna.ASF', 'walk/anna_1.amc'),
    ):
        Path(name).write_text('{}')
    Path('walk/demo.npz').symlink_to(recording)
    Path('walk/link.npz').symlink_to('demo.npz')
    Path('parameters.yaml').write_text('/**: {ros__parameters: {solver: {prior: read.npz}}}')
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
