"""Figures of the result pages, drawn from the rows of their tables."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from hashlib import sha256
from itertools import cycle
from pathlib import Path
from statistics import median
from typing import NamedTuple

import matplotlib as mpl

mpl.use('Agg')
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullFormatter

from hoid_benchmarks.publish.results_file import Kept
from hoid_common.io.yaml_file import read_yaml

ATE, TIME, WORTH = 'ate.svg', 'time.svg', 'worth.svg'
_EXACT = 'exact'  # the oracle filter, whose masks are precomputed: its time means nothing
_STYLES = {
    'none': ('#7f7f7f', 'o'), 'person': ('#e69f00', 'v'), 'hoid2d': ('#56b4e9', 's'),
    'hoid3d': ('#0072b2', 'D'), 'descriptor': ('#cc79a7', '^'), 'motion': ('#009e73', 'P'),
    'hoid+': ('#d55e00', '*'), _EXACT: ('#000000', 'x'),
}  # fmt: skip
_SPARE_STYLES = (('#8c564b', 'p'), ('#bcbd22', 'h'), ('#17becf', '<'), ('#9467bd', '>'))
_NOT_DRAWN = 'truth'  # ground-truth boxes are not available to a user
_OTHER_RULES = 'seed_method'  # runs with the rules of ORB-SLAM3
_NUMBER = re.compile(r'\d+(?:\.\d+)?')
_DEFAULT = 'default'
_MM = 1e3
_WORDS = Path(__file__).with_name('scene_words.yaml')
_LEGEND_LETTERS = 70  # total length of names in one row of a legend
_WIDTH_INCH, _ROW_INCH, _REST_INCH = 7.2, 0.24, 1.1


class Mark(NamedTuple):
    """One median with its range, on the line `row`, with the color and marker of `group`."""

    row: str
    group: str
    low: float
    middle: float
    high: float


def figures(readme: Mapping[str, Kept], ablation: Mapping[str, Kept]) -> dict[str, list[Mark]]:
    """Return the marks of each figure by file name; a figure without rows is left out.

    Args:
        readme: The experiments of the README's plan, by name.
        ablation: The experiments of the ablation plan, by name.
    """
    compared = [
        one
        for name, one in readme.items()
        if 'RMSE [m]' in one.columns and not name.startswith(_OTHER_RULES)
    ]
    drawn = {
        ATE: _errors(compared),
        TIME: _times(compared),
        WORTH: _ablation_ratios(ablation.values()),
    }
    return {name: marks for name, marks in drawn.items() if marks}


def save_figures(folder: Path, drawn: Mapping[str, Sequence[Mark]]) -> None:
    """Write the figures as SVG."""
    labels = {
        ATE: 'ATE RMSE [mm], median and range of five runs',
        TIME: 'time of extraction, filter and tracking per frame [ms], median to largest p95',
        WORTH: 'ATE without the part / ATE with all parts',
    }
    for name, marks in drawn.items():
        _save(folder / name, marks, labels[name], logarithmic=name != TIME)


def digest(marks: Sequence[Mark]) -> str:
    """Return a digest of the marks, by which a page can be compared with the file of results."""
    return sha256(repr([*map(tuple, marks)]).encode()).hexdigest()


def _errors(compared: Sequence[Kept]) -> list[Mark]:
    """Return the ATE by sequence and filter, with the first of several detectors."""
    words = read_yaml(_WORDS)
    found: dict[tuple[str, str], Mark] = {}
    for sequence, strategy, detector, cell in _cells(compared, 'RMSE [m]'):
        if detector != _NOT_DRAWN:
            middle, *ends = (_MM * value for value in _numbers(cell))
            low, high = ends or (middle, middle)
            mark = Mark(words.get(sequence, sequence), strategy, low, middle, high)
            found.setdefault((sequence, strategy), mark)
    return list(found.values())


def _times(compared: Sequence[Kept]) -> list[Mark]:
    """Return the time per frame by filter: median over sequences, and the largest p95.

    Times of different machines are not comparable; only the machine with the most rows is used.
    """
    machines = Counter(row.machine for one in compared for row in one.rows)
    usual = max(machines, key=machines.__getitem__, default='')
    of_one = [replace(k, rows=tuple(r for r in k.rows if r.machine == usual)) for k in compared]
    times: dict[str, list[list[float]]] = {}
    for _, strategy, _, cell in _cells(of_one, 'frame [ms]: median / p95'):
        if strategy != _EXACT and (numbers := _numbers(cell)):
            times.setdefault(strategy, []).append(numbers)
    marks = []
    for strategy in sorted(times, key=list(_STYLES).index):
        medians, p95s = zip(*times[strategy], strict=True)
        middle = median(medians)
        marks.append(Mark(strategy, strategy, middle, middle, max(p95s)))
    return marks


def _ablation_ratios(experiments: Iterable[Kept]) -> list[Mark]:
    """Return the ratio of the ATE without a part to the ATE with it, by part and sequence."""
    marks, words = [], read_yaml(_WORDS)
    for one in experiments:
        if 'ATE RMSE [m]' not in one.columns:
            continue
        rows = [dict(zip(one.columns, row.cells, strict=True)) for row in one.rows]
        whole = {
            (r['sequence'], r['filter']): _numbers(r['ATE RMSE [m]'])[0]
            for r in rows
            if r['variant'] == _DEFAULT
        }
        for r in rows:
            before = whole.get((r['sequence'], r['filter']))
            if before and r['variant'] != _DEFAULT:
                middle, low, high = (v / before for v in _numbers(r['ATE RMSE [m]']))
                part = r['variant'].removesuffix('=False')
                where = words.get(r['sequence'], r['sequence'])
                marks.append(Mark(part, f'{r["filter"]}, {where}', low, middle, high))
    return marks


def _cells(compared: Sequence[Kept], column: str) -> Iterator[tuple[str, str, str, str]]:
    """Yield sequence, filter, detector and the cell of a column for each row."""
    for one in compared:
        at = one.columns.index(column)
        for row in one.rows:
            sequence, strategy, detector = row.cells[:3]
            yield sequence, strategy, detector, row.cells[at]


def _numbers(cell: str) -> list[float]:
    return [float(number) for number in _NUMBER.findall(cell)]


def _save(path: Path, marks: Sequence[Mark], label: str, *, logarithmic: bool) -> None:
    rows = list(dict.fromkeys(mark.row for mark in marks))
    size = _WIDTH_INCH, _REST_INCH + _ROW_INCH * len(rows)
    # Text is stored as text, and equal marks give equal files.
    with plt.rc_context({'svg.fonttype': 'none', 'svg.hashsalt': 'hoid', 'font.size': 9}):
        figure, axes = plt.subplots(figsize=size, layout='constrained')
        if logarithmic:
            axes.set_xscale('log')
            axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axes.xaxis.set_minor_formatter(NullFormatter())
        _draw(axes, marks, rows)
        if not logarithmic:
            axes.set_xlim(left=0)
        axes.set_xlabel(label)
        columns = _LEGEND_LETTERS // max(len(mark.group) for mark in marks)
        figure.legend(frameon=False, ncols=min(columns, 4), loc='outside upper center')
        figure.savefig(path, metadata={'Date': None, 'Description': digest(marks)})
        plt.close(figure)


def _draw(axes: Axes, marks: Sequence[Mark], rows: Sequence[str]) -> None:
    named = dict.fromkeys(mark.group for mark in marks)
    groups = [n for n in _STYLES if n in named] + [n for n in named if n not in _STYLES]
    free = [style for name, style in _STYLES.items() if name not in groups]
    spare = cycle((*free, *_SPARE_STYLES))
    styles = {name: _STYLES.get(name) or next(spare) for name in groups}
    for k, name in enumerate(groups):
        mine = [mark for mark in marks if mark.group == name]
        color, marker = styles[name]
        aside = 0.6 * ((k + 0.5) / len(groups) - 0.5) if groups != list(rows) else 0
        axes.errorbar(
            [mark.middle for mark in mine],
            [rows.index(mark.row) + aside for mark in mine],
            xerr=[[m.middle - m.low for m in mine], [m.high - m.middle for m in mine]],
            fmt=marker, color=color, markersize=5, lw=1, label=name,
        )  # fmt: skip
    axes.set_yticks(range(len(rows)), rows)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.xaxis.set_major_formatter('{x:g}')
    axes.grid(alpha=0.3)
    axes.spines[['top', 'right']].set_visible(False)
