"""Bounds on results, as `hoid bench --check` applies them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import yaml

import hoid_benchmarks
from hoid_benchmarks.jobs.results import Result
from hoid_benchmarks.plan.plan import Job, Perturbation, load_plan
from hoid_benchmarks.report.check import check

BOUNDS = """
bounds:
  - {name: ate, of: {sequence: a, filter: hoid+}, value: ate_rmse_m, max: 0.015}
  - {name: gain, of: {sequence: a, filter: hoid+}, value: ate_rmse_m, over: ate_rmse_m,
     against: {filter: none}, max: 0.1}
  - {name: cost, of: {sequence: a, filter: hoid+}, value: stage_ms.frame.median,
     over: reference_ms, max: 2.5}
"""


def broken(path: Path, ate_m: float = 0.01, frame_ms: float = 14.0, without_m: float = 0.2) -> str:
    (path / 'bounds.yaml').write_text(BOUNDS)
    cost = {'stage_ms': {'frame': {'median': frame_ms}}, 'reference_ms': 7.0}
    job = Job('a', 'hoid+', 'x', 0)
    results = [
        Result(job, {'ate_rmse_m': ate_m, **cost}),
        Result(replace(job, filter='none'), {'ate_rmse_m': without_m}),
        # Bounds do not apply to other variants:
        Result(replace(job, parameters=(('p', 1),)), {'ate_rmse_m': 9.0}),
        Result(replace(job, perturbation=Perturbation(missed_share=0.5)), {'ate_rmse_m': 9.0}),
    ]
    return '; '.join(check(results, path / 'bounds.yaml'))


def test_a_loss_of_accuracy_or_speed_breaks_a_bound(tmp_path: Path) -> None:
    assert broken(tmp_path) == ''
    assert broken(tmp_path, ate_m=0.02) == 'ate: 0.02 is not in [-inf, 0.015]'
    assert broken(tmp_path, without_m=0.05) == 'gain: 0.2 is not in [-inf, 0.1]'
    assert broken(tmp_path, frame_ms=21.0) == 'cost: 3 is not in [-inf, 2.5]'


def test_a_bound_on_nothing_and_a_failed_run_are_broken(tmp_path: Path) -> None:
    (tmp_path / 'bounds.yaml').write_text(BOUNDS)
    assert len(check([], tmp_path / 'bounds.yaml')) == 3
    died = Result(Job('b', 'none', '', 0), {}, 'died')
    assert 'run failed: b none seed 0: died' in check([died], tmp_path / 'bounds.yaml')


def test_shipped_bounds_are_on_runs_of_the_quick_set() -> None:
    jobs = load_plan('quick').jobs()
    rules = yaml.safe_load(
        (Path(hoid_benchmarks.__file__).parent / 'report' / 'bounds.yaml').read_text()
    )
    assert rules['bounds']
    for rule in rules['bounds']:
        for of in (rule['of'], {**rule['of'], **rule.get('against', {})}):
            wanted = {'mode': 'offline', 'variant': '', **of}
            assert any(all(getattr(j, k) == v for k, v in wanted.items()) for j in jobs), rule
