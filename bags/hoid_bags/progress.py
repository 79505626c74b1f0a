"""Progress on stderr: a bar on a terminal, an occasional line in a log."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import Any

from tqdm import tqdm

_TERMINAL_S, _LOG_S = 0.1, 10.0  # chosen: periods of updates


def progress(items: Iterable[Any] | None, total: int, unit: str, *, show: bool = True) -> Any:
    """Return a tqdm bar over items, or without items one that the caller updates."""
    interval_s = _TERMINAL_S if sys.stderr.isatty() else _LOG_S
    return tqdm(
        items, total=total, unit=f' {unit}', mininterval=interval_s, disable=not show, ncols=88
    )
