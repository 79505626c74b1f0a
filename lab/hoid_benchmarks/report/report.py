"""The report of a plan: files of tables and figures, and the page."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import cv2

from hoid_benchmarks.jobs.results import Result, result_path
from hoid_benchmarks.plan.plan import Experiment, Job, Plan
from hoid_benchmarks.report.figure_files import save_figures
from hoid_benchmarks.report.figures import make_plots
from hoid_benchmarks.report.headlines import headlines
from hoid_benchmarks.report.literature import published
from hoid_benchmarks.report.notes import curve_note
from hoid_benchmarks.report.page import Head, Page, Picture, Section, render_page
from hoid_benchmarks.report.runs import RunList, key_without_seed
from hoid_benchmarks.report.tables import Table, text
from hoid_benchmarks.report.views import failures, grouped, make_table, missing, with_commits

_CAPTIONS = {
    'verdicts.png': 'verdict on each object (paper, Figure 4)',
    'features.png': 'all features, with the detections (paper, Figure 6)',
    'rules.png': 'features kept by the 2-D and by the 3-D rule (paper, Figure 7)',
}
_PICTURE_WIDTH_PX = 1400
_JPEG = (cv2.IMWRITE_JPEG_QUALITY, 80)


@dataclass(frozen=True)
class Report:
    """Writes the available results, and lists the experiments that are not complete."""

    plan: Plan
    results: Mapping[Job, Result]
    folder: Path
    runs: RunList

    def write(self) -> Path:
        """Write every table and figure and return the page's path."""
        for name in ('tables', 'figures'):
            (self.folder / name).mkdir(parents=True, exist_ok=True)
        begun = [e for e in self.plan.experiments if any(j in self.results for j in e.jobs)]
        parts = list(dict.fromkeys(e.part for e in begun))
        sections = [self._section(e) for e in sorted(begun, key=lambda e: parts.index(e.part))]
        every = list(self.results.values())
        extra = (*published(every), missing(every), self._not_run(), failures(every))
        for table in (*(s.table for s in sections), *extra):
            if table.rows:
                (self.folder / 'tables' / f'{table.id}.csv').write_text(table.csv())
                (self.folder / 'tables' / f'{table.id}.md').write_text(table.markdown())
        groups = grouped([r for r in every if not r.missing], key_without_seed)
        run_of = {r.job: i for i, group in enumerate(groups.values()) for r in group}
        runs = [self.runs.group(group) for group in groups.values()]
        page = self.folder / 'index.html'
        page.write_text(render_page(Page(self._head(), sections, extra, runs, run_of)))
        return page

    def _section(self, experiment: Experiment) -> Section:
        every = [self.results[job] for job in experiment.jobs if job in self.results]
        here = [r for r in every if not r.missing]
        plots = make_plots(experiment, here, self.folder)
        save_figures(experiment, plots, self.folder / 'figures')
        return Section(
            experiment,
            with_commits(make_table(experiment, here), here),
            plots,
            tuple(p for r in here for p in _pictures(r, self.folder)),
            curve_note(experiment, here),
            tuple(dict.fromkeys(r.job.sequence for r in every if r.missing)),
        )

    def _head(self) -> Head:
        every = self.results.values()
        facts = {
            'Command': self.plan.command,
            'Commit': _distinct(r.commit for r in every) or 'not from a clone',
            'Machine': _distinct(r.machine for r in every),
            'Versions': _distinct(_versions(r.summary) for r in every),
            'Written': datetime.now(UTC).strftime('%Y-%m-%d %H:%M UTC'),
        }
        facts = {name: fact for name, fact in facts.items() if fact}
        top = headlines(self.plan, self.results)
        return Head(f'HOID RGB-D SLAM: {self.plan.name} experiments', facts, top)

    def _not_run(self) -> Table:
        """Return the incomplete experiments with the command that completes each of them."""
        rows = []
        for e in self.plan.experiments:
            left = sum(job not in self.results for job in e.jobs)
            if left:
                rows.append(
                    (
                        text(e.title),
                        text(f'{left} of {len(e.jobs)} runs'),
                        text(f'{self.plan.command} --only {e.id}'),
                    )
                )
        columns = ('experiment', 'not run', 'command')
        return Table('not_run', 'Experiments that have not run yet', columns, tuple(rows))


def _distinct(values: Iterable[str]) -> str:
    return '; '.join(sorted(set(values) - {''}))


def _versions(summary: Mapping[str, Any]) -> str:
    versions = sorted(summary.get('versions', {}).items())  # stored results are sorted by key
    return ', '.join(f'{name} {version}' for name, version in versions)


def _pictures(result: Result, folder: Path) -> list[Picture]:
    """Return the pictures of a run, reduced in size for the page."""
    run = result_path(folder, result.job).parent
    found = []
    for name, caption in _CAPTIONS.items():
        picture = cv2.imread(str(run / name)) if (run / name).is_file() else None
        if picture is None:
            continue
        scale = min(1.0, _PICTURE_WIDTH_PX / picture.shape[1])
        small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        _, data = cv2.imencode('.jpg', small, _JPEG)
        url = f'data:image/jpeg;base64,{base64.b64encode(data.tobytes()).decode()}'
        found.append(Picture(f'{result.job.sequence}: {caption}', url))
    return found
