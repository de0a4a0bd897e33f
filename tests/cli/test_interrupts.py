# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Ctrl-C while commands run."""

from __future__ import annotations

import argparse
import signal
from collections.abc import Iterator
from contextlib import suppress

import pytest

from mocap_ros.cli import main as command_line
from mocap_ros.cli.terminal import interrupt_between_items


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

    monkeypatch.setattr('mocap_ros.cli.config.add_options', lambda parser: parser.set_defaults(run=run))
    if is_interrupted:
        assert command_line.main(['config']) == 130
        assert capsys.readouterr().err == 'mocap-ros: interrupted\n'
    else:
        with pytest.raises(SystemError):
            command_line.main(['config'])
