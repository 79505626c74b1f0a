"""Stored bounds on the quick set, so that a loss of accuracy or speed fails the build.

Times are ratios within one run, never wall times: another machine or a busy one must not matter.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import yaml

from hoid_benchmarks.results import Result, key_value, spread

_FILE = Path(__file__).parent / 'bounds.yaml'


def check(results: Iterable[Result], bounds: Path = _FILE) -> list[str]:
    """Return a line for each broken bound; no line means that all hold."""
    rules: list[dict[str, Any]] = yaml.safe_load(bounds.read_text())['bounds']
    found = list(results)
    failed = [f'run failed: {r.job.label}: {r.error}' for r in found if not r.ok]
    return failed + [line for rule in rules if (line := _broken(rule, found))]


def _broken(rule: dict[str, Any], results: list[Result]) -> str:
    value = _median(rule, rule['value'], results)
    if 'over' in rule:
        value /= _median({**rule, **rule.get('against', {})}, rule['over'], results)
    low, high = rule.get('min', -math.inf), rule.get('max', math.inf)
    if low <= value <= high:  # False for NaN: a bound on nothing is broken
        return ''
    return f'{rule["name"]}: {value:.4g} is not in [{low}, {high}]'


def _median(rule: dict[str, Any], name: str, results: list[Result]) -> float:
    chosen = [
        r
        for r in results
        if r.job.sequence == rule['sequence']
        and r.job.filter == rule['filter']
        and not r.job.parameters
    ]
    return spread(chosen, key_value(name)).median
