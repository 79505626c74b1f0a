"""Entry point of a node's executable, and its exit statuses.

This module imports only small modules, so that its SIGINT handler is installed before the imports
of the node, which take a second. Ctrl-C then ends the process without a traceback.
"""

from __future__ import annotations

import os
import signal
import sys
from importlib import import_module
from typing import NoReturn

from hoid_common.process.child_process import preload

EXIT_INTERRUPTED = 128 + signal.SIGINT
"""Exit status after Ctrl-C during start-up: a shell's convention for death by a signal."""
EXIT_CONFIG = os.EX_CONFIG
"""Exit status after an invalid parameter or argument, with which a restart would fail again."""


def start(module: str) -> NoReturn:
    """Import a node's module, run its `main`, and exit with the status that `main` returns.

    Until `main` installs its own handlers, SIGINT ends the process with status 130. SIGINT is also
    unblocked, because a parent may block it while the interpreter starts.

    If the node's package defines `CHILD_MODULES`, a fork server with these modules is started for
    the child processes of the node (see `preload`).

    Args:
        module: Dotted name of the module.
    """
    signal.signal(signal.SIGINT, lambda *_: os._exit(EXIT_INTERRUPTED))
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    node = import_module(module)
    if children := getattr(import_module(module.partition('.')[0]), 'CHILD_MODULES', ()):
        preload(*children)
    sys.exit(node.main())
