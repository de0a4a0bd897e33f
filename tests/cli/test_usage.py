# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The help and the usage errors of the command line."""

from __future__ import annotations

import argparse
import subprocess
import sys

import pytest

from mocap_ros.cli.main import COMMANDS, build_parser, main

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


def test_the_help_lists_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(['--help'])
    assert stopped.value.code == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines if line.startswith(' ' * 4) and line[4] != ' '] == list(COMMANDS)


@pytest.mark.parametrize(
    ('arguments', 'reason'),
    [
        ([], ''),
        (['evaluate'], ''),
        (['recontruct', 'x.npz'], "no command 'recontruct'; did you mean 'reconstruct'?"),
        (['--fps', '30', 'reconstruct', 'x.json'], "'--fps' comes before the command"),
        (['x.npz', 'view'], "'x.npz' comes before the command; write: mocap-ros view"),
        (['x.npz'], "no command 'x.npz'; there are demo, reconstruct"),
        (['config', '\x1b[31m\r\n\u202e'], r'unrecognized arguments: \x1b[31m \u202e'),
        (['reconstruct', 'x.json', '--fps', 'fast'], "argument --fps: 'fast' "),
        (['reconstruct', 'x.json', '--fps', '-5'], 'argument --fps: '),
        (['reconstruct', 'a.json', '--image-size', '640'], "argument --image-size: '640': "),
        (['reconstruct', 'a.json', '--image-size', '0x480'], "argument --image-size: '0x480': "),
        (['reconstruct', 'a.json', '--hfov', '0.5'], 'argument --hfov: '),
        (['reconstruct', 'a.json', '--hfov', '56', '--focal', '600'], '--focal'),
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
def test_wrong_usage_exits_with_2_and_names_the_argument(
    capsys: pytest.CaptureFixture[str], arguments: list[str], reason: str
) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    assert stopped.value.code == 2
    assert reason in capsys.readouterr().err.splitlines()[-1]
