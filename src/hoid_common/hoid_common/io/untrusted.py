"""What users and other programs hand over: names and files, taken within bounds or refused.

Every refusal is one line that names the file or option.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import BinaryIO

from hoid_common.errors import ConfigError, InputError

MAX_TEXT_BYTES = 64_000_000
"""Of a text file: a list of half a million images is a quarter of it."""
MAX_NAME_BYTES, MAX_PATH_BYTES = 255, 4095
"""Of one name in a path, and of the whole, as Linux has them."""

_SHOWN = 40  # characters of a name that is too long to be said


def read_bytes(path: Path, limit_bytes: int) -> bytes:
    """Return the content of a regular file, never reading more than so many bytes.

    Raises:
        InputError: It is missing, no regular file, larger, or cannot be read.
    """
    with open_regular(path) as file:
        try:
            data = file.read(limit_bytes + 1)
        except OSError as error:
            raise unreadable(path, error) from error
    if len(data) > limit_bytes:
        raise InputError(f'{path}: larger than {limit_bytes / 1e6:g} MB; is it the right file?')
    return data


def read_text(path: Path, limit_bytes: int = MAX_TEXT_BYTES) -> str:
    """Return the content of a text file; raises as `read_bytes`, and where it is not UTF-8."""
    try:
        return read_bytes(path, limit_bytes).decode('utf-8-sig')
    except UnicodeDecodeError as error:
        raise InputError(f'{path}: not a text file') from error


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file; a pipe or a device, which may never end, raises InputError."""
    try:
        # Without O_NONBLOCK, opening a pipe that nobody writes to would wait for ever.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise unreadable(path, error) from error
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise InputError(f'{path}: not a regular file')
    return os.fdopen(descriptor, 'rb')


def unreadable(path: Path, error: Exception) -> InputError:
    """Return the error to raise for a file that the system refuses to read."""
    if isinstance(error, FileNotFoundError):
        return InputError(f'{path}: no such file')
    return InputError(f'{path}: cannot be read: {getattr(error, "strerror", None) or error}')


def check_name(text: str, what: str) -> None:
    """Raise ConfigError for a path that no file can have, or that no result could repeat.

    Args:
        text: The path as given; a word that is no path passes when it is one that a file can have.
        what: What it was given for, such as "--out".
    """
    if not text:
        raise ConfigError(f'{what}: must not be empty')
    try:
        parts = [len(part.encode()) for part in text.split('/')]
    except UnicodeEncodeError as error:  # bytes from the system that are no UTF-8
        raise ConfigError(f'{what} {text!a}: not a UTF-8 name; rename it') from error
    total = sum(parts) + len(parts) - 1
    if max(parts) > MAX_NAME_BYTES or total > MAX_PATH_BYTES or '\0' in text:
        raise ConfigError(f'{what} {text[:_SHOWN]!r}...: no file can be called that')
