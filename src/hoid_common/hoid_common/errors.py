"""Exceptions and texts. The text of an error is one line: what is wrong, where, what to do."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

# A text longer than both numbers of characters together is cut to its beginning and its end.
# Chosen: 11 to 12 lines of a terminal with 80 columns.
_HEAD_CHARS, _TAIL_CHARS = 600, 300


class HoidError(Exception):
    """Base class of the suite's exceptions, most of which a user can cause and correct.

    str() is printable and of limited length, even if the text quotes a hostile file or message.
    """

    def __str__(self) -> str:
        text = super().__str__()
        if len(text) <= _HEAD_CHARS + _TAIL_CHARS:
            return _printable(text)
        head = _printable(text[:_HEAD_CHARS])[:_HEAD_CHARS]
        tail = _printable(text[-_TAIL_CHARS:])[-_TAIL_CHARS:]
        return f'{head} ... {tail}'


def counted(number: int, noun: str) -> str:
    """Return a number with its noun, such as "1 keyframe" and "2 keyframes"."""
    return f'{number} {noun}' if number == 1 else f'{number} {noun}s'


def _printable(text: str) -> str:
    return ''.join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


class InputError(HoidError):
    """A file, recording or bag cannot be used."""


class ConfigError(HoidError):
    """A parameter or command-line option has a value that cannot be used."""


class MessageError(HoidError):
    """A message or its content, such as an image, cannot be used."""


class ModelError(HoidError):
    """A detector model cannot be found, read or understood."""


class NoModelError(ModelError):
    """The detector model is not installed and cannot be downloaded."""


class MapFileError(HoidError):
    """A map file cannot be read, written or used."""


@contextmanager
def replaced_by(error: HoidError, *causes: type[Exception]) -> Iterator[None]:
    """Raise `error` in place of an exception of one of the types `causes`."""
    try:
        yield
    except causes as cause:
        raise error from cause


@contextmanager
def prefixed(prefix: str, kind: type[HoidError], *causes: type[Exception]) -> Iterator[None]:
    """Raise `kind` in place of an exception of the types `causes`; its text follows `prefix`."""
    try:
        yield
    except causes as cause:
        raise kind(f'{prefix}{getattr(cause, "strerror", None) or cause}') from cause
