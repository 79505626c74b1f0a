"""From results to files: tables, figures and the page."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from hoid_benchmarks.figures import make_plots, save_figures
from hoid_benchmarks.machine import machine, versions
from hoid_benchmarks.page import Head, Section, render_page
from hoid_benchmarks.plan import Job, Plan
from hoid_benchmarks.results import Result
from hoid_benchmarks.tables import Table, failures, make_table
from hoid_benchmarks.worker import command_of


def write_report(
    plan: Plan, results: Mapping[Job, Result], folder: Path, literature: tuple[Table, ...]
) -> Path:
    """Write every table and figure and return the page's path."""
    tables, figures = folder / 'tables', folder / 'figures'
    for place in (tables, figures):
        place.mkdir(parents=True, exist_ok=True)
    sections = []
    for experiment in plan.experiments:
        mine = [results[job] for job in experiment.jobs]
        table = make_table(experiment, mine)
        plots = make_plots(experiment, mine, folder)
        save_figures(experiment, plots, figures)
        sections.append(Section(experiment, table, plots))
    extra = (*literature, failures(list(results.values())))
    for table in (*(s.table for s in sections), *extra):
        (tables / f'{table.id}.csv').write_text(table.csv())
        (tables / f'{table.id}.md').write_text(table.markdown())
    commands = {job: ' '.join(['./hoid', *command_of(job, job.sequence)]) for job in plan.jobs()}
    head = Head(f'HOID SLAM: {plan.name}', machine(), versions(), f'./hoid bench {plan.name}')
    page = folder / 'index.html'
    page.write_text(render_page(head, sections, extra, commands))
    return page
