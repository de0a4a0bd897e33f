# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Exceptions of the package, and texts for them. Libraries raise them; programs print them as one line."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager

# What Python raises where content that it reads is not of the expected form
MALFORMED = (LookupError, TypeError, ValueError, OverflowError, AttributeError)
MAX_MESSAGE_CHARACTERS = 2000  # of a line; longer ones, which quote what a stranger wrote, lose their middle


class MocapError(Exception):
    """Base of all exceptions that this package raises on purpose; the message says what is wrong and where.

    Messages quote names from files and messages of strangers, so `make_printable_line` is applied to them.
    """

    def __init__(self, message: str) -> None:
        super().__init__(make_printable_line(message))


class ConfigError(MocapError):
    """A parameter that does not exist, or a value outside its range."""


class SkeletonError(MocapError):
    """An unknown keypoint layout, or joint names that a keypoint layout does not have."""


class ModelError(MocapError):
    """A base-pose model, a lifter or a detector's model that cannot be trained, found, read or run."""


class InputError(MocapError):
    """A message, file or array with invalid content; the message names the place."""


class FrameDropped(MocapError):
    """A well-formed frame or message that is too late: a repeated or old stamp, or an image already complete."""


class RecordingError(MocapError):
    """A recording that cannot be opened, written or finished."""


class FolderTaken(RecordingError):
    """A folder for a new recording that is there already."""


class DiskFull(RecordingError):
    """A disk without space, or with less than `recorder.min_free_mb`."""


@contextmanager
def name_errors(place: object, kind: type[MocapError] = MocapError) -> Iterator[None]:
    """Put a place, such as a path or an argument, in front of the errors of a kind, which keep their types."""
    try:
        yield
    except kind as error:
        raise type(error)(f'{place}: {error}') from None


@contextmanager
def naming(place: object, expected: str = '') -> Iterator[None]:
    """Put a place in the content of a file in front of the errors of a block, which become an `InputError`.

    These are `InputError`, `SkeletonError` and, if it says what was expected there, those of `MALFORMED`.
    """
    try:
        yield
    except (InputError, SkeletonError) as error:
        raise InputError(f'{place}: {error}') from None
    except MALFORMED:
        if not expected:
            raise
        raise InputError(f'{place}: {expected}') from None


def make_printable_line(message: str, length: int = MAX_MESSAGE_CHARACTERS) -> str:
    """Return a message as one line for a terminal, of so many characters at most.

    All that a program prints with names from files and messages of strangers goes through here: characters that a
    terminal would obey are written as Python escapes them.
    """
    if len(message) > length:
        half = length // 2 - 3
        message = f'{message[:half]} ... {message[-half:]}'
    if message.isprintable():
        return message
    line = ' '.join(message.split())
    return ''.join(c if c.isprintable() else repr(c)[1:-1] for c in line)[:length]


def describe_read_error(error: Exception) -> str:
    """Return in one line why an .npz file could not be read.

    NumPy's advice to load the file with pickle is left out, because files may come from untrusted sources.
    """
    message = ' '.join(str(error).split())
    if 'pickle' in message:
        return 'holds Python objects' if 'Object arrays' in message else 'no .npz file'
    return message or type(error).__name__


def describe_parse_error(error: Exception) -> str:
    """Return in one line why a text could not be parsed.

    Python's advice to allow longer numbers is left out, because it is for programmers.
    """
    if isinstance(error, RecursionError):
        return 'nested too deep'
    return ' '.join(str(error).split()).partition('; use sys.')[0]


def suggest(word: object, known: Mapping[str, str] | Iterable[str], otherwise: str = '') -> str:
    """Return a clause about the known name that an unknown word is probably meant for.

    Of a mapping, the keys are compared and the value is named. Where the word is the beginning of several near
    names, all of these are named. Where none is near, the clause is `otherwise`, or the list of the known names.
    """
    import difflib

    names = known if isinstance(known, Mapping) else {name: name for name in known}
    close = difflib.get_close_matches(str(word), names, n=3)
    meant = [name for name in names if name in close and name.startswith(str(word))] or close[:1]
    likely = ' or '.join(repr(names[name]) for name in meant)
    return f'did you mean {likely}?' if meant else otherwise or f'known: {", ".join(names.values())}'


def tell_installation(extra: str) -> str:
    """Return the command that installs an optional part of this package, such as `video`."""
    return f"pip install -e '.[{extra}]' in the source folder of mocap_ros"
