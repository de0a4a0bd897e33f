"""Exceptions of the package. Libraries raise them; programs print them as one line."""


class MocapError(Exception):
    """Base of all exceptions that this package raises on purpose; the message says what is wrong and where."""


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


class DiskFull(RecordingError):
    """A disk without space, or with less than `recorder.min_free_mb`."""


def describe_read_error(error: Exception) -> str:
    """Return in one line why an .npz file could not be read.

    NumPy's advice to load the file with pickle is left out, because files may come from untrusted sources.
    """
    message = ' '.join(str(error).split())
    if 'pickle' in message:
        return 'holds Python objects' if 'Object arrays' in message else 'no .npz file'
    return message or type(error).__name__
