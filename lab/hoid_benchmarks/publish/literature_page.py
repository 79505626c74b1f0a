"""The page that compares published values with this project, for available sequences."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from hoid_benchmarks.publish.results_file import Kept
from hoid_benchmarks.report.literature import own_names, published
from hoid_benchmarks.report.tables import text

_ATE, _SEQUENCE, _FILTER = 'RMSE [m]', 'sequence', 'filter'
_SOURCE = 'run here, median (JPEG color images, see [results](index.md))'
_HEAD = """# Published values

ATE RMSE in meters as stated in the papers, which was not reproduced here. `./hoid bench official
DATA` prints them beside the values of this project for the recordings in the folder `DATA`
([how](../howto/official_sequences.md)). `make reference` writes this page.
"""


def literature_page(kept: Mapping[str, Kept]) -> str:
    """Return the page as Markdown, with a section for each table."""
    parts = [_HEAD]
    for table in published():
        names = own_names(table.id)
        ours = [_without_filter(kept, names.get(column)) for column in table.columns[1:]]
        row = tuple(map(text, ('this project, no filter', *ours[:-1], _SOURCE)))
        rows = (*table.rows, row) if any(cell != '-' for cell in ours) else table.rows
        title, *_ = table.title.removeprefix('Literature, ').partition(' (')
        parts.append(f'## {title}\n\n{replace(table, rows=rows).markdown()}')
    return '\n'.join(parts)


def _without_filter(kept: Mapping[str, Kept], sequence: str | None) -> str:
    """Return the median of the unfiltered runs of a sequence, or a dash."""
    for one in kept.values():
        if {_ATE, _SEQUENCE, _FILTER} <= {*one.columns}:
            at = one.columns.index
            for row in one.rows:
                if (row.cells[at(_SEQUENCE)], row.cells[at(_FILTER)]) == (sequence, 'none'):
                    return row.cells[at(_ATE)].split()[0]
    return '-'
