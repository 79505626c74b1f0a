"""Entry point: `python -m hoid_bringup` runs `hoid`."""

from __future__ import annotations

import signal

if __name__ == '__main__':
    handler = signal.getsignal(signal.SIGINT)
    if handler is not signal.SIG_IGN:
        # Ctrl-C while modules are imported ends the process without a traceback. The script `hoid`
        # blocks SIGINT, so that it cannot interrupt the start of the interpreter.
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    from hoid_bringup.cli import main

    signal.signal(signal.SIGINT, handler)
    raise SystemExit(main())
