"""The suite's errors: one line each, naming what is at fault and what to do about it."""

_HEAD, _TAIL = 600, 300  # characters of a longer one


class HoidError(Exception):
    """Base of all errors that a user can cause and mend.

    Whatever files or messages it repeats, it is a line that a terminal can show.
    """

    def __str__(self) -> str:
        text = super().__str__()
        if len(text) <= _HEAD + _TAIL:
            return _printable(text)
        return f'{_printable(text[:_HEAD])[:_HEAD]} ... {_printable(text[-_TAIL:])[-_TAIL:]}'


def _printable(text: str) -> str:
    return ''.join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


class InputError(HoidError):
    """A file, recording or bag cannot be used."""


class ConfigError(HoidError):
    """A parameter or option has an unusable value."""


class MessageError(HoidError):
    """A message contradicts itself or the camera (array lengths, encodings, sizes)."""


class ModelError(HoidError):
    """A detector model cannot be found, read or understood."""


class NoModelError(ModelError):
    """No detector model is here, and none was asked for; motion tells what moves without one."""


class MapFileError(HoidError):
    """A map file is truncated, foreign, hostile or of another version."""
