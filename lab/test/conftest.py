"""A plan of two experiments, which share jobs."""

from __future__ import annotations

from pathlib import Path

import pytest

from hoid_benchmarks.plan.plan import Plan, load_plan

_PLAN = """
experiments:
  - id: compare
    title: None against HOID
    view: comparison
    sequences: [a]
    filters: [none, hoid2d]
    detectors: [x, y]
    seeds: [0, 1]
  - id: curve
    title: Missed
    view: curve
    vary: {missed_share: [0.0, 0.5]}
    sequences: [a]
    filters: [hoid2d]
    detectors: [x]
    seeds: [0, 1]
"""


@pytest.fixture
def plan_file(tmp_path: Path) -> Path:
    """Return the file of a plan."""
    path = tmp_path / 'plan.yaml'
    path.write_text(_PLAN)
    return path


@pytest.fixture
def plan(plan_file: Path) -> Plan:
    """Return the plan."""
    return load_plan(str(plan_file))
