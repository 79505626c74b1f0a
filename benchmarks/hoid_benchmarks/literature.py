"""The comparison with the literature: published values, marked as such."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from hoid_benchmarks.tables import Cell, Table

_FILE = Path(__file__).parent / 'literature.yaml'


def published() -> tuple[Table, ...]:
    """Return the tables of published values; none of them was rerun here."""
    return tuple(_table(entry) for entry in yaml.safe_load(_FILE.read_text())['tables'])


def _table(entry: dict[str, Any]) -> Table:
    rows = tuple(tuple(_cell(value) for value in row) for row in entry['rows'])
    return Table(entry['id'], entry['title'], tuple(entry['columns']), rows)


def _cell(value: float | str) -> Cell:
    return Cell(f'{value:g}', value) if isinstance(value, float) else Cell(str(value))
