"""The comparison with the literature: published values, marked as such."""

from __future__ import annotations

from pathlib import Path

import yaml

from hoid_benchmarks.tables import Cell, Table

_FILE = Path(__file__).parent / 'literature.yaml'


def published() -> Table:
    """Return the published values; none of them was rerun here."""
    document = yaml.safe_load(_FILE.read_text())
    rows = tuple(tuple(_cell(value) for value in row) for row in document['rows'])
    return Table('literature', document['title'], tuple(document['columns']), rows)


def _cell(value: float | str) -> Cell:
    return Cell(f'{value:g}', value) if isinstance(value, float) else Cell(str(value))
