"""Start of a node: SIGINT is handled while the imports take a second."""

from __future__ import annotations

import os
import signal
import sys
import time
from importlib import import_module
from typing import NoReturn

from hoid_common.errors import ConfigError
from hoid_common.process.child_process import preload
from hoid_common.process.limits import require_node_limits
from hoid_common.process.output import relay_output
from hoid_common.process.shared_memory import reduce_own_segment
from hoid_common.process.signals import NODE_END_SIGNALS

EXIT_INTERRUPTED = 128 + signal.SIGINT
"""Exit status after Ctrl-C during start-up: a shell's convention for death by a signal."""
EXIT_CONFIG = os.EX_CONFIG
"""Exit status of a node that cannot start with its parameters, arguments and files."""
EXIT_FAILED = 1
"""Exit status of a node that ran, and ended because of an error."""
REFUSAL_PAUSE = 'HOID_REFUSAL_PAUSE_S'
"""Environment variable: time (s) that a node waits before it ends with EXIT_CONFIG.

`ros2 launch` restarts a node after a fixed delay. Without the pause, a node that cannot start
would keep a whole processor core busy by its attempts. If the variable is not set, there is no
pause.
"""


def start(module: str) -> NoReturn:
    """Import a node's module, run its `main`, and exit with the status that `main` returns.

    Until `main` installs its own handlers, SIGINT ends the process with status 130; a parent may
    have blocked it while the interpreter starts. `relay_output` keeps output that nobody reads
    from blocking the process. If the node's package defines `CHILD_MODULES`, a fork server with
    these modules is started (`preload`).
    """
    signal.signal(signal.SIGINT, lambda *_: os._exit(EXIT_INTERRUPTED))
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    try:
        require_node_limits()
    except ConfigError as error:
        sys.stderr.write(f'error: {error}\n')
        sys.exit(EXIT_CONFIG)
    relay_output()
    reduce_own_segment()
    node = import_module(module)
    if children := getattr(import_module(module.partition('.')[0]), 'CHILD_MODULES', ()):
        preload(*children)
    status = node.main()
    if status == EXIT_CONFIG:
        _pause_before_exit()
    sys.exit(status)


def _pause_before_exit() -> None:
    for sign in NODE_END_SIGNALS:
        signal.signal(sign, lambda *_: os._exit(EXIT_CONFIG))
    time.sleep(float(os.environ.get(REFUSAL_PAUSE, '0')))
