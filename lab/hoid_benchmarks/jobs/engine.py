"""Runs jobs on all local cores or on a Dask cluster; stored results are reused."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import psutil
from distributed import Client, Future, LocalCluster, as_completed

from hoid_bags.progress import progress
from hoid_benchmarks.jobs.code import Code
from hoid_benchmarks.jobs.results import Result, read_result, result_path, write_result
from hoid_benchmarks.jobs.worker import Outcome, run_job
from hoid_benchmarks.plan.plan import Job
from hoid_benchmarks.plan.sequences import Store
from hoid_common.errors import InputError

_QUIET = 50  # Dask's log level (critical only): errors are stored in the results
_MODES_ALONE = ('live', 'timed', 'detect')  # wall-clock times need the whole machine


@dataclass(frozen=True)
class Engine:
    """Runs jobs and stores their results.

    Args:
        folder: Folder of the results.
        store: Folders of the sequences, at the same paths on all machines of a cluster.
        code: Version of the code, stored with each result.
        cluster: Address of a Dask scheduler; empty means all cores of this machine.
        only_this_code: Whether to repeat runs whose result is of another version of the code.
        workers: Number of parallel jobs on this machine; 0 means one per core.
    """

    folder: Path
    store: Store
    code: Code
    cluster: str = ''
    only_this_code: bool = False
    workers: int = 0

    def run(self, jobs: Sequence[Job]) -> dict[Job, Result]:
        """Run the jobs without a stored result, and return all results, also of failed runs."""
        done = self.stored(jobs)
        waiting = [job for job in jobs if job not in done]
        paths, reasons = self._sequences(waiting)
        done |= {
            job: Result(job, {}, reasons[job.sequence], missing=True)
            for job in waiting
            if job.sequence in reasons
        }
        ready = [job for job in waiting if job.sequence in paths]
        if ready:
            done |= self._run_all(ready, paths)
        return {job: done[job] for job in jobs}  # in the order of the plan

    def repeat(self, job: Job) -> Result:
        """Run a job even if its result is stored."""
        paths, reasons = self._sequences([job])
        if job.sequence in reasons:
            return Result(job, {}, reasons[job.sequence], missing=True)
        return self._keep(job, run_job(job, paths[job.sequence], self.store))

    def stored(self, jobs: Iterable[Job]) -> dict[Job, Result]:
        """Return the stored results that can be reused."""
        found = {job: r for job in jobs if (r := read_result(self.folder, job)) and r.ok}
        if not self.only_this_code:
            return found
        return {job: r for job, r in found.items() if r.code == self.code.digest}

    def _sequences(self, jobs: Iterable[Job]) -> tuple[dict[str, Path], dict[str, str]]:
        """Find or make each sequence once; return the paths, and errors of missing sequences."""
        paths: dict[str, Path] = {}
        reasons: dict[str, str] = {}
        names = list(dict.fromkeys(job.sequence for job in jobs))
        bar = progress(names, len(names), 'sequences')
        for name in bar:
            bar.set_postfix_str(name)
            try:
                paths[name] = self.store.find(name)
            except InputError as error:
                reasons[name] = str(error)
        return paths, reasons

    def _run_all(self, jobs: Sequence[Job], paths: Mapping[str, Path]) -> dict[Job, Result]:
        done = {}
        with self._client() as client, progress(None, len(jobs), 'runs') as bar:
            for batch in _batches(jobs):
                for job, outcome in self._outcomes(client, batch, paths):
                    done[job] = self._keep(job, outcome)
                    bar.set_postfix_str(job.label[:40])
                    bar.update()
        return done

    @contextmanager
    def _client(self) -> Iterator[Client]:
        if self.cluster:
            with Client(self.cluster) as client:
                yield client
            return
        with (
            # Threads suffice: each of them only waits for the process of its job.
            LocalCluster(
                n_workers=1,
                threads_per_worker=self.workers or os.cpu_count(),
                processes=False,
                dashboard_address='localhost:0',
                silence_logs=_QUIET,
            ) as cluster,
            Client(cluster) as client,
        ):
            yield client

    def _outcomes(
        self, client: Client, jobs: Sequence[Job], paths: Mapping[str, Path]
    ) -> Iterator[tuple[Job, Outcome]]:
        futures = {
            client.submit(run_job, job, paths[job.sequence], self.store, pure=False): job
            for job in jobs
        }
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        finally:
            self._stop(client, [future for future in futures if not future.done()])

    def _stop(self, client: Client, left: Sequence[Future[Outcome]]) -> None:
        """Cancel the remaining jobs after an interrupt; closing the client would wait for them."""
        if not left:
            return
        client.cancel(left)
        if not self.cluster:
            for child in psutil.Process().children():
                child.kill()

    def _keep(self, job: Job, outcome: Outcome) -> Result:
        folder = result_path(self.folder, job).parent
        folder.mkdir(parents=True, exist_ok=True)
        for name, data in outcome.files.items():
            (folder / name).write_bytes(data)
        result = Result(
            job,
            outcome.summary,
            outcome.error,
            code=self.code.digest,
            commit=self.code.commit,
            machine=outcome.machine,
        )
        write_result(self.folder, result)
        return result


def _batches(jobs: Sequence[Job]) -> Iterator[list[Job]]:
    """Yield the jobs that may run in parallel, then each of the others alone.

    Jobs are ordered by seed, so that an interrupted campaign has results for every experiment.
    """
    jobs = sorted(jobs, key=lambda job: job.seed)
    together = [job for job in jobs if job.mode not in _MODES_ALONE]
    if together:
        yield together
    yield from ([job] for job in jobs if job.mode in _MODES_ALONE)
