"""Reading of untrusted files and checks of untrusted names, within size limits."""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import BinaryIO

from hoid_common.errors import ConfigError, InputError, replaced_by

MAX_TEXT_BYTES = 64_000_000
"""Largest text file. Chosen: a list of half a million images (five hours) is a quarter as long."""
MAX_NAME_BYTES, MAX_PATH_BYTES = 255, 4095
"""Longest name of a file, and longest path: Linux' NAME_MAX, and PATH_MAX without the NUL."""

_SHOWN_CHARS = 40  # number of characters that an error quotes of a name that is too long


def read_bytes(path: Path, limit_bytes: int) -> bytes:
    with open_regular(path) as file:
        try:
            data = file.read(limit_bytes + 1)
        except OSError as error:
            raise read_error(path, error) from error
    if len(data) > limit_bytes:
        raise InputError(f'{path}: larger than {limit_bytes / 1e6:g} MB; is it the right file?')
    return data


def read_text(path: Path, limit_bytes: int = MAX_TEXT_BYTES) -> str:
    """Return the content of a UTF-8 text file of at most `limit_bytes`; else InputError."""
    with replaced_by(InputError(f'{path}: not a text file'), UnicodeDecodeError):
        return read_bytes(path, limit_bytes).decode('utf-8-sig')


def open_regular(path: Path) -> BinaryIO:
    """Return a regular file opened for reading. InputError for any other: a pipe may never end."""
    try:
        # Without O_NONBLOCK, opening a pipe that nobody writes to would block forever.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except (OSError, ValueError) as error:  # ValueError: the name contains a NUL
        raise read_error(path, error) from error
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise InputError(f'{path}: not a regular file')
    return os.fdopen(descriptor, 'rb')


def read_error(path: Path, error: Exception) -> InputError:
    if isinstance(error, FileNotFoundError):
        return InputError(f'{path}: no such file')
    return InputError(f'{path}: cannot be read: {getattr(error, "strerror", None) or error}')


def expand_home(text: str, what: str) -> Path:
    """Return the path with `~` or `~user` expanded; ConfigError if the home folder is unknown."""
    try:
        return Path(text).expanduser()
    except RuntimeError as error:
        user = text.partition('/')[0]
        raise ConfigError(
            f'{what}: {text}: no home folder is known for {user}; give the path without {user}'
        ) from error


def check_path_name(text: str, what: str) -> None:
    """Raise ConfigError for a path that is empty, too long or not UTF-8, or contains a NUL."""
    if not text:
        raise ConfigError(f'{what}: must not be empty')
    try:
        parts = [len(part.encode()) for part in text.split('/')]
    except UnicodeEncodeError as error:  # surrogates stand for bytes that are not UTF-8
        raise ConfigError(f'{what} {text!a}: not a UTF-8 name; rename it') from error
    total = sum(parts) + len(parts) - 1
    if max(parts) > MAX_NAME_BYTES or total > MAX_PATH_BYTES or '\0' in text:
        raise ConfigError(f'{what} {text[:_SHOWN_CHARS]!r}...: no file can have this name')
