"""The engine, with a stub instead of the run of a job."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from distributed import LocalCluster

from hoid_benchmarks.jobs import engine as engine_module
from hoid_benchmarks.jobs.code import Code
from hoid_benchmarks.jobs.engine import Engine
from hoid_benchmarks.jobs.worker import Outcome
from hoid_benchmarks.plan.plan import Job
from hoid_benchmarks.plan.sequences import Store
from hoid_bringup.run.provenance import machine

JOBS = (
    Job('here', 'none', '', 0, mode='timed'),
    Job('here', 'none', '', 1),
    Job('here', 'none', '', 2),
    Job('fr3_walking_xyz', 'none', '', 0),
)


@dataclass(frozen=True)
class Log:
    """File of the executed jobs in order, shared by threads and processes."""

    path: Path

    def add(self, job: Job) -> None:
        with self.path.open('a') as file:
            file.write(f'{JOBS.index(job)}\n')

    @property
    def jobs(self) -> list[Job]:
        return [JOBS[int(line)] for line in self.path.read_text().splitlines()]


@pytest.fixture
def ran(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Log:
    """Replace the run of a job by a stub in which seed 2 fails."""
    log = Log(tmp_path / 'ran')

    def run_job(job: Job, path: Path, store: Store) -> Outcome:
        assert path.name == 'here'
        assert store.made.name == 'made'
        log.add(job)
        if job.seed == 2:
            return Outcome(error='lost')
        return Outcome({'ate_rmse_m': 0.1}, {'trajectory.txt': b'# none\n'})

    monkeypatch.setattr(engine_module, 'run_job', run_job)
    return log


@pytest.fixture
def engine(tmp_path: Path) -> Engine:
    (tmp_path / 'shared' / 'data' / 'here').mkdir(parents=True)
    store = Store(tmp_path / 'shared', tmp_path / 'made')
    return Engine(tmp_path / 'out', store, Code('digest', 'commit'), workers=2)


def test_each_job_runs_once_and_what_is_timed_runs_alone_at_the_end(
    engine: Engine, ran: Log
) -> None:
    results = engine.run(JOBS)
    assert tuple(results) == JOBS  # in the order of the plan, including missing and late ones
    assert set(ran.jobs) == set(JOBS[:3])
    assert ran.jobs[-1] == JOBS[0]
    assert results[JOBS[1]].summary == {'ate_rmse_m': 0.1}
    assert results[JOBS[2]].error == 'lost'
    assert [r.machine for r in results.values()] == [machine()] * 3 + ['']
    assert results[JOBS[3]].missing
    assert engine.stored(JOBS).keys() == {JOBS[0], JOBS[1]}
    engine.run(JOBS)
    assert ran.jobs[3:] == [JOBS[2]]  # only the failed job runs again
    assert engine.repeat(JOBS[1]).ok
    assert ran.jobs[4:] == [JOBS[1]]


def test_a_check_takes_results_of_this_code_only(engine: Engine, ran: Log) -> None:
    engine.run(JOBS[:2])
    other = replace(engine, code=Code('another', 'commit'))
    other.run(JOBS[:2])
    assert len(ran.jobs) == 2
    replace(other, only_this_code=True).run(JOBS[:2])
    assert len(ran.jobs) == 4


def test_a_cluster_gives_the_same(engine: Engine, ran: Log) -> None:
    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address='localhost:0'
    ) as cluster:
        results = replace(engine, cluster=cluster.scheduler_address).run(JOBS)
    assert len(ran.jobs) == 3
    assert [results[job].ok for job in JOBS] == [True, True, False, False]
