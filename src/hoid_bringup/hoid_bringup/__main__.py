"""Entry point: `python -m hoid_bringup` runs `hoid`."""

from __future__ import annotations

import signal

if __name__ == '__main__':
    handler = signal.getsignal(signal.SIGINT)
    if handler is not signal.SIG_IGN:
        # While modules are imported, Ctrl-C ends the process without a traceback. The script
        # `hoid` blocks SIGINT, so that it cannot interrupt the interpreter's own start.
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    from hoid_bringup.cli import main

    signal.signal(signal.SIGINT, handler)
    raise SystemExit(main())
