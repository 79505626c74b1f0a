"""`python -m hoid_bringup` is `hoid`."""

from __future__ import annotations

from hoid_bringup.cli import main

if __name__ == '__main__':
    raise SystemExit(main())
