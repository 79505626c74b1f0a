"""The main results at the top of the page."""

from __future__ import annotations

from collections.abc import Mapping

from hoid_benchmarks.jobs.results import Result, key_value, spread
from hoid_benchmarks.plan.kinds import kind_of
from hoid_benchmarks.plan.plan import Job, Plan
from hoid_benchmarks.report.page import Headline
from hoid_benchmarks.report.tables import EQUAL, Cell, reduction
from hoid_benchmarks.report.views import by_method, grouped

_MOST = 6
_ATE, _COVERAGE = key_value('ate_rmse_m'), key_value('coverage')


def headlines(plan: Plan, results: Mapping[Job, Result]) -> tuple[Headline, ...]:
    """Return the reduction of ATE from the first to the last filter, for each sequence."""
    jobs = [job for e in plan.experiments if e.view == 'comparison' for job in e.jobs]
    ended_well = [r for job in jobs if (r := results.get(job)) and r.ok]
    groups = grouped(ended_well, lambda job: (job.sequence,)).values()
    return tuple(filter(None, map(_headline, groups)))[:_MOST]


def _headline(results: list[Result]) -> Headline | None:
    methods = list(grouped(results, by_method).values())
    before, after = (spread(group, _ATE) for group in (methods[0], methods[-1]))
    job = methods[-1][0].job
    if len(methods) < 2 or not before.median > 0 or not after.median > 0:
        return None
    better = reduction(before, after, methods[-1])
    words = (
        'equal within the range of the runs'
        if better.text == EQUAL
        else f'{abs(better.value):.1f} % {"better" if better.value >= 0 else "worse"}'
    )
    coverage = spread(methods[-1], _COVERAGE).median
    return Headline(
        Cell(words, better.value, (job,)),
        f'ATE on {job.sequence} ({kind_of(job.sequence)}): {before.median:.4f} m without a '
        f'filter, {after.median:.4f} m with {job.filter} ({job.detector}), coverage '
        f'{coverage:.2f}',
    )
