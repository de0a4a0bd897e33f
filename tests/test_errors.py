# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Errors are one printable line, whatever the texts of strangers that they quote."""

from __future__ import annotations

import pickle

import pytest

from mocap_ros.errors import MAX_MESSAGE_CHARACTERS, InputError


@pytest.mark.parametrize(
    ('message', 'shown'),
    [
        ('a.npz: Zoë: 5 px', 'a.npz: Zoë: 5 px'),
        ('a\n  b\tc', 'a b c'),
        ('\x1b[2Ja\x07\u202eb\ud800', r'\x1b[2Ja\x07\u202eb\ud800'),
    ],
)
def test_a_message_is_one_printable_line(message: str, shown: str) -> None:
    error = InputError(message)
    assert str(error) == shown
    assert str(pickle.loads(pickle.dumps(error))) == shown


def test_a_long_message_keeps_its_beginning_and_its_end() -> None:
    for fill in ('x', '\x00'):
        text = str(InputError(f'a.json: {fill * 10**6} is no name'))
        assert len(text) <= MAX_MESSAGE_CHARACTERS
        assert text.startswith('a.json: ')
    assert str(InputError(f'a.json: {"x" * 10**6} is no name')).endswith('x is no name')
