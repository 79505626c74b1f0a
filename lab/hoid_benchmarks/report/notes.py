"""Notes on curves as text: the best value, and the loss at the ends of the range."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence

from hoid_benchmarks.jobs.results import Result, key_value, spread
from hoid_benchmarks.plan.plan import Experiment
from hoid_benchmarks.report.views import grouped, setting_of

_ATE = key_value('ate_rmse_m')
_MIN_VALUES = 3  # fewer make no curve


def curve_note(experiment: Experiment, results: Sequence[Result]) -> str:
    """Return a note on the minimum of a parameter's curve; empty if no parameter is varied.

    For several sequences, the note uses the geometric mean of the ratio of ATE to the lowest ATE
    of the sequence, because an average in meters would depend on the hardest sequence only.
    """
    if experiment.view == 'verdicts':
        return f'{_verdict_note(experiment, results)} {_ate_note(experiment, results)}'.strip()
    if experiment.view != 'curve' or '.' not in experiment.varied:
        return ''
    return _ate_note(experiment, results)


def _ate_note(experiment: Experiment, results: Sequence[Result]) -> str:
    curves = _curves(experiment, [r for r in results if r.ok])
    values = sorted({x for curve in curves.values() for x in curve})
    if len(values) < _MIN_VALUES:
        return ''
    factor = {x: _factor(curves, x) for x in values}
    best = min(values, key=lambda x: factor[x])
    each = ', '.join(f'{name}: {min(c, key=lambda x: c[x]):g}' for name, c in curves.items())
    ends = ' and '.join(f'{100 * (factor[x] - 1):.0f} % at {x:g}' for x in (values[0], values[-1]))
    noise = 100 * _seed_noise(experiment, results)
    return (
        f'Lowest ATE over all sequences at {best:g} ({100 * (factor[best] - 1):.0f} % above each '
        f"sequence's own best value, on average); the ends of the range cost {ends}. "
        f'Runs with equal parameters vary by {noise:.0f} %. Lowest by sequence: {each}.'
    )


def _verdict_note(experiment: Experiment, results: Sequence[Result]) -> str:
    """Return, for each filter, the value that best separates handled from passed objects."""
    notes = []
    for (method,), group in grouped([r for r in results if r.ok], lambda j: (j.filter,)).items():
        by_value = grouped(group, lambda j: (str(setting_of(j, experiment.varied)),))
        shares = {float(value): _correct_shares(mine) for (value,), mine in by_value.items()}
        best = max(shares, key=lambda x: sum(shares[x]))
        shares_text = '; '.join(
            f'at {x:g} {100 * found:.0f} % of the handled objects are removed and '
            f'{100 * spared:.0f} % of the others are kept'
            for x in dict.fromkeys((min(shares), best, max(shares)))
            for found, spared in [shares[x]]
        )
        notes.append(f'{method}: best separation at {best:g}; {shares_text}.')
    return ' '.join(notes)


def _correct_shares(results: Sequence[Result]) -> tuple[float, float]:
    """Return the shares of handled objects removed and other objects kept, over all recordings."""

    def right(wrong: str, of: str) -> float:
        wrong_sum, total = (
            sum(key_value(f'verdicts.{name}')(r.summary) for r in results) for name in (wrong, of)
        )
        return 1 - wrong_sum / total if total else math.nan

    return right('wrongly_static', 'handled'), right('wrongly_dynamic', 'passed')


def _curves(experiment: Experiment, results: Sequence[Result]) -> dict[str, dict[float, float]]:
    """Return the median ATE by value, by sequence and filter."""
    curves: dict[str, dict[float, float]] = {}
    for key, group in grouped(
        results, lambda j: (j.sequence, j.filter, str(setting_of(j, experiment.varied)))
    ).items():
        median_m = spread(group, _ATE).median
        if math.isfinite(median_m):
            curves.setdefault(f'{key[0]} {key[1]}', {})[float(key[2])] = median_m
    return curves


def _factor(curves: dict[str, dict[float, float]], value: float) -> float:
    ratios = [curve[value] / min(curve.values()) for curve in curves.values() if value in curve]
    return statistics.geometric_mean(ratios)


def _seed_noise(experiment: Experiment, results: Sequence[Result]) -> float:
    """Return half the relative range of ATE over seeds, as the median over all groups."""
    groups = grouped(
        results, lambda j: (j.sequence, j.filter, str(setting_of(j, experiment.varied)))
    )
    spreads = [spread(group, _ATE) for group in groups.values()]
    shares = [(s.high - s.low) / 2 / s.median for s in spreads if s.runs > 1]
    return statistics.median(shares) if shares else 0.0
