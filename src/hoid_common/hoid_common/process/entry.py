"""How the executable of a node begins and which statuses it ends with.

Nothing large is imported here, so that Ctrl-C is heard in silence while the node's module loads.
"""

from __future__ import annotations

import os
import signal
import sys
from importlib import import_module
from typing import NoReturn

from hoid_common.process.child_process import preload

INTERRUPTED = 128 + signal.SIGINT  # by Ctrl-C before the node was up
REFUSED = os.EX_CONFIG  # what it was given; a restart would end the same way


def start(module: str) -> NoReturn:
    """Import a node's module, run its `main` and exit with the status that it returns.

    Until `main` takes over, SIGINT ends the process with status 130. It may come here blocked, as
    only so it cannot hit an interpreter that is starting.

    The node's processes are forks of this one where the package names their modules, as
    `CHILD_MODULES`.
    """
    signal.signal(signal.SIGINT, lambda *_: os._exit(INTERRUPTED))
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    node = import_module(module)
    if children := getattr(import_module(module.partition('.')[0]), 'CHILD_MODULES', ()):
        preload(*children)
    sys.exit(node.main())
