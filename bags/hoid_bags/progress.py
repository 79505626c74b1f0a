"""Progress on stderr: a bar on a terminal, an occasional line in a log."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterable
from typing import Any

from tqdm import tqdm

from hoid_common.process.signals import signal_handlers_deferred

_TERMINAL_S, _LOG_S = 0.1, 10.0  # chosen: periods of updates on a terminal and in a log


def progress(items: Iterable[Any] | None, total: int, unit: str, *, show: bool = True) -> Any:
    """Return tqdm's bar over the items. If `items` is None, the caller calls `update`."""
    interval_s = _TERMINAL_S if sys.stderr.isatty() else _LOG_S
    return tqdm(
        items,
        total=total,
        unit=f' {unit}',
        mininterval=interval_s,
        disable=not show or not logging.getLogger().isEnabledFor(logging.WARNING),
        ncols=88,
    )


class AboveProgress(logging.Handler):
    """Writes log lines to stderr, above a progress bar that is being drawn."""

    def emit(self, record: logging.LogRecord) -> None:
        write_above(self.format(record))


def write_above(line: str) -> None:
    """Write a line to stderr, above a progress bar that is being drawn."""
    # If an interrupt comes before tqdm takes its lock, tqdm still releases it, which fails.
    with signal_handlers_deferred(), tqdm.external_write_mode(sys.stderr):
        sys.stderr.write(f'{line}\n')
