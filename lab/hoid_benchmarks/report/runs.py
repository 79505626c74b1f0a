"""The list of runs on the page: main results, and the commands that repeat each run."""

from __future__ import annotations

import os
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from hoid_benchmarks.jobs.results import Result, key_value
from hoid_benchmarks.jobs.worker import command_of
from hoid_benchmarks.plan.plan import EXACT, Job, Perturbation, Plan
from hoid_benchmarks.plan.sequences import Store
from hoid_benchmarks.report.page import RunGroup

_SHOWN = (  # name in the summary, format of the text
    ('ate_rmse_m', 'ATE {:.4f} m'),
    ('ate_online_rmse_m', 'online {:.4f} m'),
    ('coverage', 'coverage {:.3f}'),
    ('frames_processed', '{} frames'),
    ('keyframes', '{} keyframes'),
    ('map_points', '{} points'),
    ('stage_ms.frame.median', '{:.1f} ms a frame'),
    ('peak_rss_mb', '{:.0f} MB'),
)


@dataclass(frozen=True)
class RunList:
    """Describes runs; their commands must be run in the root of the project."""

    plan: Plan
    store: Store
    root: Path

    def group(self, results: Sequence[Result]) -> RunGroup:
        """Return the entry of runs that differ only in their seed."""
        first = results[0].job
        label = replace(first, seed=0).label.removesuffix(' seed 0')
        return RunGroup(
            label,
            tuple(self.command(r.job) for r in results),
            tuple(_run_line(r) for r in results),
        )

    def command(self, job: Job) -> str:
        """Return the shell command that repeats a job."""
        recipe = self.store.recipe(job.sequence)
        path = self.store.locate(job.sequence)
        lines = [self._hoid(recipe)] if recipe else []
        if (
            job.perturbation != Perturbation()
            or job.filter == EXACT
            or job.mode in ('detect', 'verdicts', 'masks')
            or path is None
        ):
            return f'{self.plan.command} --job {job.key}'
        return '\n'.join([*lines, self._hoid(command_of(job, str(path), f'out/{job.key}'))])

    def _hoid(self, words: Sequence[str]) -> str:
        return shlex.join(['./hoid', *(self._relative(w) for w in words)])

    def _relative(self, word: str) -> str:
        return os.path.relpath(word, self.root) if Path(word).is_absolute() else word


def key_without_seed(job: Job) -> tuple[str, ...]:
    """Return a key that is equal for runs which differ only in their seed."""
    return (replace(job, seed=0).key,)


def _run_line(result: Result) -> str:
    if not result.ok:
        return f'Failed: {result.error}'
    words = [
        form.format(value)
        for name, form in _SHOWN
        if (value := key_value(name)(result.summary)) is not None
    ]
    commit = [f'commit {result.commit}'] if result.commit else []
    return ', '.join([f'Seed {result.job.seed}', *words, *commit])
