"""Key presses on a terminal, without waiting for Enter."""

from __future__ import annotations

import os
import select
import sys
import termios
import tty
from typing import Self

PAUSE_KEY = ' '

_MAX_BYTES = 64  # chosen: largest number of bytes read at once


class KeyPresses:
    """Reader of the keys pressed on the terminal; a context manager.

    If the standard input is no terminal, no key is ever pressed.
    """

    def __enter__(self) -> Self:
        self._saved = None
        if sys.stdin is not None and sys.stdin.isatty():
            self._saved = termios.tcgetattr(sys.stdin)
            tty.setcbreak(sys.stdin)
        return self

    def __exit__(self, *_: object) -> None:
        if self._saved is not None:
            termios.tcsetattr(sys.stdin, termios.TCSADRAIN, self._saved)

    def read(self) -> str:
        """Return the keys pressed since the last call, without waiting."""
        keys = ''
        while self._saved is not None and select.select([sys.stdin], [], [], 0)[0]:
            # The keys are read from the descriptor, because select does not see characters that
            # sys.stdin has read into its buffer.
            pressed = os.read(sys.stdin.fileno(), _MAX_BYTES)
            if not pressed:  # end of file
                break
            keys += pressed.decode(errors='replace')
        return keys
