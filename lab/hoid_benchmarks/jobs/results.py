"""Results of jobs: one JSON file per run, and medians over runs."""

from __future__ import annotations

import json
import math
import statistics
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

from hoid_benchmarks.plan.plan import Job


@dataclass(frozen=True)
class Result:
    """Result of one job: the summary of the run, or the error."""

    job: Job
    summary: Mapping[str, Any]  # summary.json of the run; empty when it failed
    error: str = ''
    missing: bool = False  # its sequence is missing; such results are not stored
    code: str = ''  # digest of the code that ran
    commit: str = ''
    machine: str = ''  # machine that ran it; empty in results of earlier versions

    @property
    def ok(self) -> bool:
        """Return whether the run succeeded."""
        return not self.error


class Spread(NamedTuple):
    """Median and range over runs; NaN if no run has the value."""

    median: float
    low: float
    high: float
    runs: int

    def overlaps(self, other: Spread) -> bool:
        """Return whether the ranges overlap; false if a single run leaves a range unknown."""
        is_known = min(self.runs, other.runs) > 1
        return is_known and self.low <= other.high and other.low <= self.high


def result_path(folder: Path, job: Job) -> Path:
    """Return the path of a job's result."""
    return folder / 'runs' / job.key / 'result.json'


def write_result(folder: Path, result: Result) -> None:
    """Write a result under a temporary name and rename it, so that no partial result is stored."""
    path = result_path(folder, result.job)
    path.parent.mkdir(parents=True, exist_ok=True)
    document = {
        'job': asdict(result.job),
        'summary': dict(result.summary),
        'error': result.error,
        'code': result.code,
        'commit': result.commit,
        'machine': result.machine,
    }
    unfinished = path.with_suffix('.tmp')
    unfinished.write_text(json.dumps(document, indent=1, sort_keys=True) + '\n')
    unfinished.rename(path)


def read_result(folder: Path, job: Job) -> Result | None:
    """Return the stored result of a job, or None."""
    path = result_path(folder, job)
    if not path.is_file():
        return None
    document = json.loads(path.read_text())
    return Result(
        job,
        document['summary'],
        document['error'],
        code=document.get('code', ''),
        commit=document.get('commit', ''),
        machine=document.get('machine', ''),
    )


def spread(results: Iterable[Result], value: Callable[[Mapping[str, Any]], Any]) -> Spread:
    """Return the median and range of a value over the successful runs that state the value."""
    values = [value(r.summary) for r in results if r.ok]
    numbers = [float(v) for v in values if v is not None and math.isfinite(v)]
    if not numbers:
        return Spread(math.nan, math.nan, math.nan, 0)
    return Spread(statistics.median(numbers), min(numbers), max(numbers), len(numbers))


def key_value(name: str) -> Callable[[Mapping[str, Any]], Any]:
    """Return a function that reads a dotted name in a summary, such as `stage_ms.track.median`."""

    def get(summary: Mapping[str, Any]) -> Any:
        value: Any = summary
        for part in name.split('.'):
            value = value.get(part) if isinstance(value, Mapping) else None
        return value

    return get


def removed_share(summary: Mapping[str, Any]) -> float | None:
    """Return the share of the features that the filter removed."""
    counts = summary.get('filter', {})
    found = counts.get('features_in')
    return counts['features_removed'] / found if found else None
