"""The package's exceptions. Libraries raise them, entry points print them as one line."""


class MocapError(Exception):
    """Anything this package refuses to do; the message says what and where."""


class ConfigError(MocapError):
    """A parameter that does not exist, or a value outside its range."""


class SkeletonError(MocapError):
    """An unknown keypoint layout, or joints that do not fit it."""


class ModelError(MocapError):
    """A base-pose model that cannot be trained, found or read."""


class InputError(MocapError):
    """A message, file or array that is not what it should be; names the place."""


class FrameDropped(MocapError):
    """A well-formed frame the tracker does not accept (repeated or older stamp)."""


class RecordingError(MocapError):
    """A recording that cannot be opened, written or finished."""


def reader_reason(error: Exception) -> str:
    """Why an .npz could not be read, in one line and without numpy's advice to trust it."""
    said = ' '.join(str(error).split())
    if 'pickle' in said:
        return 'holds Python objects' if 'Object arrays' in said else 'no .npz file'
    return said or type(error).__name__
