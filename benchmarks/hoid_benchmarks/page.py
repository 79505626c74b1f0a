"""One self-contained HTML page of all tables and figures; opens with no network."""

from __future__ import annotations

import html
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import plotly.offline

from hoid_benchmarks.plan import Experiment, Job
from hoid_benchmarks.tables import Cell, Table

_HERE = Path(__file__).parent


class Section(NamedTuple):
    """One experiment on the page."""

    experiment: Experiment
    table: Table
    plots: tuple[dict[str, Any], ...]  # plotly figures: data, layout


class Head(NamedTuple):
    """What stands at the top of the page."""

    title: str
    machine: str
    versions: str
    command: str


def render_page(
    head: Head, sections: Sequence[Section], extra: Sequence[Table], commands: dict[Job, str]
) -> str:
    """Return the page; `commands` repeats each job."""
    style, script = ((_HERE / name).read_text() for name in ('page.css', 'page.js'))
    jobs = list(dict.fromkeys(job for s in sections for job in s.experiment.jobs))
    number = {job: i for i, job in enumerate(jobs)}
    body = [
        _intro(head),
        _contents(sections),
        *(_section(s, number) for s in sections),
        *(
            f'<section><h2>{_e(t.title)}</h2>{_table(t, number)}</section>'
            for t in extra
            if t.rows
        ),
        _runs(jobs, number, commands),
    ]
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<link rel="icon" href="data:,"><title>{_e(head.title)}</title><style>{style}</style>'
        f'<script>{plotly.offline.get_plotlyjs()}</script><script>{script}</script></head>'
        f'<body>{"".join(body)}</body></html>\n'
    )


def _intro(head: Head) -> str:
    return (
        f'<h1>{_e(head.title)}</h1><p>Machine: {_e(head.machine)}<br>Versions: {_e(head.versions)}'
        f'<br>Command: <code>{_e(head.command)}</code></p>'
        '<p>Medians over seeds, with the range in brackets; SE(3) alignment without scale, '
        'association within 0.02 s, RPE over 1 s. Coverage is frames tracked over frames in the '
        'recording. Every number links to its runs and the commands that repeat them.</p>'
    )


def _contents(sections: Sequence[Section]) -> str:
    items = ''.join(
        f'<li><a href="#{_e(s.experiment.id)}">{_e(s.experiment.title)}</a></li>' for s in sections
    )
    return f'<nav aria-label="Contents"><ul>{items}</ul></nav>'


def _section(section: Section, number: dict[Job, int]) -> str:
    e = section.experiment
    differs = (
        f'<p class="differs">Differs from the paper: {_e(e.differs)}</p>' if e.differs else ''
    )
    plots = ''.join(
        f'<div class="plot"></div><script type="application/json">{_json(p)}</script>'
        for p in section.plots
    )
    return (
        f'<section id="{_e(e.id)}"><h2>{_e(e.title)}</h2><p>{_e(e.about)}</p>{differs}'
        f'{_table(section.table, number)}{plots}</section>'
    )


def _extra(table: Table, number: dict[Job, int]) -> str:
    return f'<section><h2>{_e(table.title)}</h2>{_table(table, number)}</section>'


def _table(table: Table, number: dict[Job, int]) -> str:
    head = ''.join(
        f'<th scope="col"><button type="button">{_e(c)}</button></th>' for c in table.columns
    )
    rows = ''.join(
        '<tr>' + ''.join(_cell(cell, number) for cell in row) + '</tr>' for row in table.rows
    )
    return (
        f'<div class="scroll"><table id="table-{_e(table.id)}">'
        f'<caption>{_e(table.title)}</caption>'
        f'<thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>'
    )


def _cell(cell: Cell, number: dict[Job, int]) -> str:
    text = _e(cell.text)
    if cell.jobs:
        text = f'<a href="#run-{number[cell.jobs[0]]}">{text}</a>'
    finite = cell.value == cell.value
    value = f' data-value="{cell.value}"' if finite else ''
    return f'<td{value}>{text}</td>'


def _runs(jobs: Sequence[Job], number: dict[Job, int], commands: dict[Job, str]) -> str:
    items = ''.join(
        f'<details id="run-{number[job]}"><summary>{_e(job.label)}</summary>'
        f'<pre>{_e(commands[job])}</pre></details>'
        for job in jobs
    )
    return f'<section id="runs"><h2>Runs and their commands</h2>{items}</section>'


def _json(value: Any) -> str:
    return json.dumps(value).replace('</', '<\\/')


def _e(text: str) -> str:
    return html.escape(text)
