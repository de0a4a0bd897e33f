# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The command line of `mocap_node`: help, wrong arguments, a missing ROS, an early interrupt."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from mocap_ros.messages.keypoints import KEYPOINTS
from mocap_ros.ros.help import INPUT_TYPES, SERVICES
from mocap_ros.ros.main import main
from mocap_ros.ros.message_types import load_interface_class
from mocap_ros.runtime.outputs import OUTPUTS

pytest.importorskip('rclpy')
pytest.importorskip('mocap_ros_msgs')

pytestmark = pytest.mark.ros


def test_help_lists_arguments_topics_and_installed_services(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(['--help'])
    assert stopped.value.code == 0
    text = capsys.readouterr().out
    for word in ('-p tracker.window:=', '--params-file FILE', *OUTPUTS.values(), KEYPOINTS, *SERVICES.values()):
        assert word in text
    for interface in (*INPUT_TYPES.values(), *SERVICES.values()):
        assert load_interface_class(interface)


@pytest.mark.parametrize(
    ('arguments', 'code', 'reason'),
    [
        (['--ros-args', '--params-file', 'none.yaml'], 1, 'none.yaml'),
        (['--ros-args', '--params-file', 'bad.yaml'], 1, 'bad.yaml'),
        (['--ros-args', '--frobnicate'], 1, '--frobnicate'),
        (['tracker.window:=2.0'], 2, 'unrecognized arguments: tracker.window:=2.0'),
    ],
)
def test_wrong_arguments_are_reported_without_a_traceback(
    env: dict[str, str], tmp_path: Path, arguments: list[str], code: int, reason: str
) -> None:
    (tmp_path / 'bad.yaml').write_text('{')
    command = [sys.executable, '-m', 'mocap_ros.ros.main', *arguments]
    done = subprocess.run(command, env=env, cwd=tmp_path, capture_output=True, text=True, check=False)
    *usage, line = done.stderr.splitlines()
    assert (done.returncode, len(usage)) == (code, code - 1)
    assert line.startswith('mocap_node: ')
    assert reason in line


def test_a_missing_ros_is_reported_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delitem(sys.modules, 'mocap_ros.ros.node', raising=False)
    monkeypatch.setitem(sys.modules, 'rclpy', None)
    assert main([]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith('mocap_node: needs ROS 2')


@pytest.mark.parametrize(
    ('program', 'end'),
    [('mocap_ros.ros.main', (0, '')), ('mocap_ros.cli.main', (130, 'mocap-ros: interrupted\n'))],
)
def test_an_interrupt_during_the_start_gives_no_traceback(
    env: dict[str, str], program: str, end: tuple[int, str]
) -> None:
    code = (
        'import _thread, builtins, sys; real = builtins.__import__\n'
        'def slow(name, *rest):\n'
        "    if name.startswith('mocap_ros.messages'): _thread.interrupt_main()\n"
        '    return real(name, *rest)\n'
        f'from {program} import main\n'
        "builtins.__import__ = slow; sys.exit(main(['replay', 'x', '-o', 'y']))"
    )
    done = subprocess.run([sys.executable, '-c', code], env=env, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == end
