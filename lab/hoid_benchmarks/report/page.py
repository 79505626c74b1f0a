"""One self-contained HTML page with all tables and figures, which needs no network."""

from __future__ import annotations

import html
import json
import math
from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import plotly.offline

from hoid_benchmarks.plan.kinds import kinds_text
from hoid_benchmarks.plan.plan import Experiment, Job
from hoid_benchmarks.report.tables import Cell, Table

_HERE = Path(__file__).parent


class Picture(NamedTuple):
    """An image on the page."""

    caption: str
    data_url: str


class Section(NamedTuple):
    """One experiment on the page."""

    experiment: Experiment
    table: Table
    plots: tuple[dict[str, Any], ...]  # plotly figures: data, layout
    pictures: tuple[Picture, ...] = ()
    note: str = ''  # conclusion from the numbers
    missing: tuple[str, ...] = ()  # missing sequences


class Headline(NamedTuple):
    """A main result at the top of the page."""

    value: Cell
    what: str


class RunGroup(NamedTuple):
    """Runs that differ only in their seed, as one entry of the page."""

    label: str
    commands: tuple[str, ...]
    results: tuple[str, ...]  # one line for each run


class Head(NamedTuple):
    """Title, facts and main results at the top of the page."""

    title: str
    facts: Mapping[str, str]  # machine, versions, command, ...
    headlines: tuple[Headline, ...] = ()


class Page(NamedTuple):
    """The content of the page."""

    head: Head
    sections: Sequence[Section]
    extra: Sequence[Table]
    runs: Sequence[RunGroup]
    run_of: Mapping[Job, int]  # index of a job's group


def render_page(page: Page) -> str:
    """Return the page's HTML."""
    style, script = ((_HERE / name).read_text() for name in ('page.css', 'page.js'))
    extra = [t for t in page.extra if t.rows]
    parts = [(part, list(group)) for part, group in groupby(page.sections, _part)]
    body = [
        _intro(page),
        _contents(parts, extra),
        *(_part_html(part, sections, page.run_of) for part, sections in parts),
        *(
            f'<section id="{_e(t.id)}"><h2>{_e(t.title)}</h2>{_table(t, page.run_of)}</section>'
            for t in extra
        ),
        _runs(page.runs),
    ]
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<link rel="icon" href="data:,"><title>{_e(page.head.title)}</title>'
        f'<style>{style}</style><script>{plotly.offline.get_plotlyjs()}</script>'
        f'<script>{script}</script></head><body>{"".join(body)}</body></html>\n'
    )


def _part(section: Section) -> str:
    return section.experiment.part


def _intro(page: Page) -> str:
    head = page.head
    facts = ''.join(f'<dt>{_e(k)}</dt><dd>{_e(v)}</dd>' for k, v in head.facts.items())
    tiles = ''.join(
        f'<li><strong>{_linked(h.value, page.run_of)}</strong> {_e(h.what)}</li>'
        for h in head.headlines
    )
    return (
        f'<header><h1>{_e(head.title)}</h1>'
        + (f'<ul class="headlines">{tiles}</ul>' if tiles else '')
        + '<p>Medians over runs, with the range in brackets. Offline runs repeat bit for bit, so '
        'a seed other than 0 also changes the number of features by 1 or 2 %. ATE and RPE '
        '(over 1 s) are RMSE after SE(3) alignment without scale, poses associated within 0.02 s, '
        'of the final trajectory unless a column says online. Coverage is the share of the '
        'frames with a pose. Every number links to its runs and to the commands that repeat '
        'them. A difference is called equal if the ranges of the runs overlap; a click on a '
        f'column sorts.</p><dl class="facts">{facts}</dl></header>'
    )


def _contents(parts: Sequence[tuple[str, list[Section]]], extra: Sequence[Table]) -> str:
    groups = [(part, [(s.experiment.id, s.experiment.title) for s in ss]) for part, ss in parts]
    groups.append(('Other', [*((t.id, t.title) for t in extra), ('runs', 'Runs and commands')]))
    lists = ''.join(
        f'<div><h2>{_e(part)}</h2><ul>'
        + ''.join(f'<li><a href="#{_e(i)}">{_e(title)}</a></li>' for i, title in items)
        + '</ul></div>'
        for part, items in groups
    )
    return f'<nav aria-label="Contents">{lists}</nav>'


def _part_html(part: str, sections: Sequence[Section], run_of: Mapping[Job, int]) -> str:
    inner = ''.join(_section(s, run_of) for s in sections)
    return f'<h2 class="part">{_e(part)}</h2>{inner}'


def _section(section: Section, run_of: Mapping[Job, int]) -> str:
    e = section.experiment
    lines = [
        f'<p>{_e(e.about)}</p>' if e.about else '',
        f'<p>{_e(kinds_text(job.sequence for job in e.jobs))}</p>',
        f'<p class="differs"><b>Differs from the paper:</b> {_e(e.differs)}</p>'
        if e.differs
        else '',
        f'<p class="note">{_e(section.note)}</p>' if section.note else '',
        _table(section.table, run_of) if section.table.rows else '',
        f'<p class="missing">Missing: {_e(", ".join(section.missing))} '
        '(<a href="#missing">how to add them</a>).</p>'
        if section.missing
        else '',
    ]
    plots = ''.join(
        f'<figure><figcaption>{_e(p["layout"]["title"]["text"])}</figcaption>'
        '<div class="legend"></div><div class="plot"></div>'
        f'<script type="application/json">{_json(p)}</script></figure>'
        for p in section.plots
    )
    pictures = ''.join(
        f'<figure><figcaption>{_e(p.caption)}</figcaption>'
        f'<img alt="{_e(p.caption)}" src="{p.data_url}"></figure>'
        for p in section.pictures
    )
    return (
        f'<section id="{_e(e.id)}"><h3>{_e(e.title)}</h3>{"".join(lines)}'
        f'<div class="plots">{plots}</div>{pictures}</section>'
    )


def _table(table: Table, run_of: Mapping[Job, int]) -> str:
    kinds = [_column_class(table, k) for k in range(len(table.columns))]
    head = ''.join(
        f'<th scope="col"{kind}><button type="button">{_e(c)}</button></th>'
        for c, kind in zip(table.columns, kinds, strict=True)
    )
    rows = ''.join(
        '<tr>'
        + ''.join(_cell(c, kind, run_of) for c, kind in zip(row, kinds, strict=True))
        + '</tr>'
        for row in table.rows
    )
    return (
        f'<div class="scroll" tabindex="0"><table id="table-{_e(table.id)}">'
        f'<thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>'
    )


def _column_class(table: Table, k: int) -> str:
    return ' class="text"' if all(math.isnan(row[k].value) for row in table.rows) else ''


def _cell(cell: Cell, kind: str, run_of: Mapping[Job, int]) -> str:
    value = '' if math.isnan(cell.value) else f' data-value="{cell.value}"'
    return f'<td{kind}{value}>{_linked(cell, run_of)}</td>'


def _linked(cell: Cell, run_of: Mapping[Job, int]) -> str:
    return (
        f'<a href="#run-{run_of[cell.jobs[0]]}">{_e(cell.text)}</a>'
        if cell.jobs
        else _e(cell.text)
    )


def _runs(runs: Sequence[RunGroup]) -> str:
    items = ''.join(
        f'<details id="run-{i}"><summary>{_e(run.label)}</summary>'
        + ''.join(
            f'<pre>{_e(command)}</pre><p>{_e(result)}</p>'
            for command, result in zip(run.commands, run.results, strict=True)
        )
        + '</details>'
        for i, run in enumerate(runs)
    )
    return f'<section id="runs"><h2>Runs and the commands that repeat them</h2>{items}</section>'


def _json(value: Any) -> str:
    return json.dumps(value).replace('</', '<\\/')


def _e(text: str) -> str:
    return html.escape(text)
