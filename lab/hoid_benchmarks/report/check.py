"""Bounds on the results of the quick plan: a loss of accuracy or speed fails the check.

Times are relative to a fixed computation in the same process (`reference.py`), because wall times
depend on the machine and its load.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from hoid_benchmarks.jobs.results import Result, key_value, spread
from hoid_common.io.yaml_file import read_yaml

_FILE = Path(__file__).parent / 'bounds.yaml'


def check(results: Iterable[Result], bounds: Path = _FILE) -> list[str]:
    """Return one line for each broken bound and each failed run.

    A rule selects runs (`of`: sequence, filter, and optionally mode and variant) and a value of
    their summaries, whose median must lie between `min` and `max`. With `over`, the value is
    divided by another value, of the runs selected by `of` with the changes in `against`.
    """
    rules: list[dict[str, Any]] = read_yaml(bounds)['bounds']
    found = list(results)
    failed = [f'run failed: {r.job.label}: {r.error}' for r in found if not r.ok]
    return failed + [line for rule in rules if (line := _broken(rule, found))]


def _broken(rule: Mapping[str, Any], results: list[Result]) -> str:
    value = _median(rule['of'], rule['value'], results)
    if 'over' in rule:
        value /= _median({**rule['of'], **rule.get('against', {})}, rule['over'], results)
    low, high = rule.get('min', -math.inf), rule.get('max', math.inf)
    if low <= value <= high:  # False for NaN: a bound without runs is broken
        return ''
    return f'{rule["name"]}: {value:.4g} is not in [{low}, {high}]'


def _median(of: Mapping[str, str], name: str, results: list[Result]) -> float:
    wanted = {'mode': 'offline', 'variant': '', **of}
    chosen = [r for r in results if all(getattr(r.job, k) == v for k, v in wanted.items())]
    return spread(chosen, key_value(name)).median
