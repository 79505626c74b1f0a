"""Writes the tables of README and of the result pages from the files of results.

A table is written between `<!-- bench PLAN EXPERIMENT ... -->` and `<!-- /bench -->`; the names of
columns after a bar, `EXPERIMENT | RMSE [m], coverage`, select these, and the names of filters in
`EXPERIMENT | filter: none, hoid+` select their rows. The word `summary` instead of
experiments means the table of README. The output of `hoid bench faults`, `live` and `rooms` is
written into a file of text beside their pages, which quote it.
`make reference` writes all tables, the figures, the list of decisions and the page of published
values.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from hoid_benchmarks.faults.cases import merged
from hoid_benchmarks.markdown import markdown_table
from hoid_benchmarks.plan.kinds import kinds_text
from hoid_benchmarks.publish.error_table import error_table
from hoid_benchmarks.publish.figures import Mark, figures, save_figures
from hoid_benchmarks.publish.layouts import LAYOUTS, layouts_svg
from hoid_benchmarks.publish.literature_page import literature_page
from hoid_benchmarks.publish.results_file import Kept, Row, read_kept, select_columns, select_rows
from hoid_common.errors import InputError
from hoid_common.io.yaml_file import read_yaml

ROOT = Path(__file__).parents[3]
RESULTS = Path('docs/results')  # the result pages, and a file of results for each plan
DECISIONS = Path('docs/decisions')  # one page each, `NNN-the-choice-in-words.md`
_DECISIONS_HEAD = """# Decisions

Context, measurements, the choice, and what would reopen it. Numbers are those of the date; current
ones are in [results](../results/index.md). `make reference` writes this list.

"""
_MARKED = re.compile(
    r'(<!-- bench (\w+) ([\w ]+?)(?: \| ([^\n]+?))? -->\n).*?(<!-- /bench -->)', re.DOTALL
)
_SUMMARY = 'summary'
_SUMMARY_ROWS = Path(__file__).with_name('summary.yaml')
_NAMES = ('sequence', 'filter', 'detector')
_ATE = 'RMSE [m]'
_DETECTORS = {
    'yolox_nano': 'YOLOX-nano',
    'yolov8n_int8': 'YOLOv8n',
    'synthetic': 'synthetic',
    'truth': 'ground-truth boxes',
}
_IN_TICKS = ('sequence', 'filter', 'variant')


def results_path(root: Path, plan: str) -> Path:
    """Return the path of the file with the results of a plan."""
    return root / RESULTS / f'{plan}.json'


def rewritten(text: str, root: Path) -> str:
    """Return the text of a page with every marked table updated from the files of results.

    Raises:
        InputError: A file of results is damaged.
    """
    return _MARKED.sub(lambda found: _filled(found, root), text)


def marked_pages(root: Path) -> list[Path]:
    """Return those of README.md and the pages under docs/ that contain a marked table.

    That is a table between `<!-- bench ... -->` and `<!-- /bench -->`.
    """
    pages = [root / 'README.md', *sorted((root / 'docs').rglob('*.md'))]
    return [page for page in pages if _MARKED.search(page.read_text(encoding='utf-8'))]


def written_pages(root: Path) -> dict[Path, str]:
    """Return the texts of generated files by path: decisions, published values, layouts."""
    kept = read_kept(results_path(root, 'readme'))
    return {
        root / DECISIONS / 'index.md': _decisions(root),
        root / RESULTS / 'literature.md': literature_page(kept),
        root / LAYOUTS: layouts_svg(root),
    }


def write_pages(root: Path) -> None:
    """Write the marked tables of all pages, and the figures."""
    for page in marked_pages(root):
        page.write_text(rewritten(page.read_text(encoding='utf-8'), root), encoding='utf-8')
    save_figures(root / RESULTS, drawn_figures(root))


def drawn_figures(root: Path) -> dict[str, list[Mark]]:
    """Return the marks of the figures by file name."""
    return figures(*(read_kept(results_path(root, plan)) for plan in ('readme', 'ablation')))


def publish_faults(root: Path, table: str) -> None:
    """Replace the rows of a fault campaign; rows of other kinds are kept."""
    path = _report_path(root, 'faults')
    before = path.read_text(encoding='utf-8') if path.is_file() else ''
    path.write_text(merged(before, table), encoding='utf-8')


def publish_report(root: Path, name: str, report: str) -> None:
    """Write the printed report of a benchmark into docs/results."""
    _report_path(root, name).write_text(report, encoding='utf-8')


def _report_path(root: Path, name: str) -> Path:
    return root / RESULTS / f'{name}.txt'


def _decisions(root: Path) -> str:
    """Return the numbered list of decisions with the title of each page."""
    rows = []
    for page in sorted((root / DECISIONS).glob('0*.md')):
        title = page.read_text(encoding='utf-8').splitlines()[0]
        number, words = title.removeprefix('# ').split('. ', 1)
        rows.append(f'{number}. [{words}]({page.name})\n')
    return _DECISIONS_HEAD + ''.join(rows)


def _filled(found: re.Match[str], root: Path) -> str:
    begin, plan, names, selected, end = found.groups()
    kept = read_kept(results_path(root, plan))
    if names == _SUMMARY:
        return f'{begin}\n{_summary(kept)}\n{end}'
    here = [kept[name] for name in names.split() if name in kept]
    if selected:
        here = [_selected(one, selected) for one in here]
    left = [name for name in names.split() if name not in kept]
    parts = [_table(here)] if here else []
    if left:
        only = ' '.join(f'--only {name}' for name in left)
        parts.append(f'Not run yet: `./hoid bench {plan} {only} --publish`.')
    return f'{begin}\n' + '\n\n'.join(parts) + f'\n\n{end}'


def _selected(kept: Kept, selected: str) -> Kept:
    column, is_rows, names = selected.partition(': ')
    if is_rows:
        return select_rows(kept, column, names.split(', '))
    return select_columns(kept, selected.split(', '))


def _table(kept: Sequence[Kept]) -> str:
    """Return the rows of experiments with equal columns as a table, with commits and machines."""
    columns = kept[0].columns
    if any(one.columns != columns for one in kept):
        raise InputError(f'experiments in one table have different columns: {columns}')
    rows = [row for one in kept for row in one.rows]
    written = [replace(row, cells=tuple(map(_written, columns, row.cells))) for row in rows]
    if 'sequence' not in columns:
        return f'{_table_without_constants(columns, written)}\n{_made(rows)}'
    at = columns.index('sequence')
    table = error_table(columns, written)
    kinds = kinds_text((row.cells[at] for row in rows), '`')
    return f'{kinds} {table.caption}\n\n{markdown_table(table.heads, table.rows)}\n{_made(rows)}'


def _table_without_constants(columns: Sequence[str], rows: Sequence[Row]) -> str:
    """Return a table without columns that are equal in all rows, which are said before it.

    Rows that differ in their first cell only are one row, with all first cells.
    """
    cells = [row.cells for row in rows]
    same = [len(rows) > 1 and len(set(column)) == 1 for column in zip(*cells, strict=True)]
    said = [
        f'{c} {cell}' for c, cell, is_same in zip(columns, cells[0], same, strict=True) if is_same
    ]
    kept = [k for k, is_same in enumerate(same) if not is_same]
    heads = [columns[k] for k in kept]
    names: dict[tuple[str, ...], list[str]] = {}
    for name, *others in ([row[k] for k in kept] for row in cells):
        names.setdefault(tuple(others), []).append(name)
    merged = [('; '.join(same), *others) for others, same in names.items()]
    table = markdown_table(heads, merged)
    return (f'In all rows: {", ".join(said)}.\n\n' if said else '') + table


def _written(column: str, cell: str) -> str:
    if column in _IN_TICKS and cell not in ('', '-'):
        return f'`{cell}`'
    return _DETECTORS.get(cell, cell) if column == 'detector' else cell


def _made(rows: Sequence[Row], verb: str = 'Made') -> str:
    commits = sorted({commit for row in rows for commit in row.commit.split(', ')})
    machines = '; '.join(sorted({row.machine for row in rows} - {''}))
    of = f'at commit {commits[0]}' if len(commits) == 1 else f'at commits {", ".join(commits)}'
    return f'{verb} {of}, on {machines}.' if machines else f'{verb} {of}.'


def _summary(kept: dict[str, Kept]) -> str:
    """Return the table of README without the rows that have no results."""
    table = read_yaml(_SUMMARY_ROWS)
    rows, shown = [], list[Row]()
    for wanted in table['rows']:
        ours = [_found(kept, wanted, name) for name in table['filters']]
        if None in ours:
            continue
        shown += ours
        errors = [_median(kept[wanted['experiment']], row) for row in ours]
        rows.append(
            (wanted['words'], wanted['orb_slam3'], *errors, _DETECTORS[wanted['detector']])
        )
    heads = ('sequence', 'ORB-SLAM3', *table['filters'].values(), 'detector')
    return f'{markdown_table(heads, rows)}\n{_made(shown, "Ours made")}\n'


def _found(kept: dict[str, Kept], wanted: dict[str, Any], name: str) -> Any:
    """Return the row of a filter and its detector, or None."""
    experiment = kept.get(wanted['experiment'])
    detector = '-' if name == 'none' else wanted['detector']
    names = (wanted['sequence'], name, detector)
    for row in experiment.rows if experiment else ():
        if row.cells[: len(_NAMES)] == names:
            return row
    return None


def _median(kept: Kept, row: Row) -> str:
    return row.cells[kept.columns.index(_ATE)].split()[0]


if __name__ == '__main__':
    write_pages(ROOT)
    for path, text in written_pages(ROOT).items():
        path.write_text(text, encoding='utf-8')
