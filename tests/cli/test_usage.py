"""The help and the usage errors of the command line."""

from __future__ import annotations

import argparse

import pytest

from mocap_ros.cli.main import build_parser, main


def test_every_option_is_described_with_its_default() -> None:
    (commands,) = [a for a in build_parser()._actions if isinstance(a, argparse._SubParsersAction)]
    for name, command in commands.choices.items():
        assert command.description, name
        for action in command._actions:
            text = f'{action.help} {command.formatter_class("")._get_help_string(action)}'
            assert action.help, (name, action.dest)
            assert action.required or action.dest == 'help' or 'default' in text, (name, action.dest)


def test_wrong_usage_exits_with_2() -> None:
    for arguments in ([], ['evaluate'], ['dance']):
        with pytest.raises(SystemExit) as stopped:
            main(arguments)
        assert stopped.value.code == 2
