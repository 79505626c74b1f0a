"""Run jobs on all local cores or on a Dask cluster; what has run is not run again."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from distributed import Client, LocalCluster, as_completed
from tqdm import tqdm

from hoid_benchmarks.plan import Job
from hoid_benchmarks.results import Result, read_result, result_path, write_result
from hoid_benchmarks.sequences import Store
from hoid_benchmarks.worker import Outcome, run_job
from hoid_common.errors import InputError


@dataclass(frozen=True)
class Engine:
    """Where jobs run and where their results go."""

    folder: Path
    store: Store
    cluster: str = ''  # address of a Dask scheduler; empty = all cores of this machine

    def run(self, jobs: Sequence[Job]) -> dict[Job, Result]:
        """Run what has not run yet, and return every result; a failed run is a result too."""
        done = {job: r for job in jobs if (r := read_result(self.folder, job)) and r.ok}
        waiting = [job for job in jobs if job not in done]
        paths, missing = self._sequences(waiting)
        for result in missing:
            write_result(self.folder, result)
            done[result.job] = result
        ready = [job for job in waiting if job.sequence in paths]
        if ready:
            with self._client() as client, tqdm(total=len(ready), unit='run') as bar:
                for batch in _batches(ready):
                    for job, outcome in self._outcomes(client, batch, paths):
                        done[job] = self._keep(job, outcome)
                        bar.set_postfix_str(job.label)
                        bar.update()
        return done

    def _sequences(self, jobs: Iterable[Job]) -> tuple[dict[str, Path], list[Result]]:
        """Find or make each sequence once; jobs on missing ones end here, with the reason."""
        paths: dict[str, Path] = {}
        reasons: dict[str, str] = {}
        for name in tqdm(list(dict.fromkeys(job.sequence for job in jobs)), unit='sequence'):
            try:
                paths[name] = self.store.find(name)
            except InputError as error:
                reasons[name] = str(error)
        missing = [
            Result(job, {}, reasons[job.sequence]) for job in jobs if job.sequence in reasons
        ]
        return paths, missing

    @contextmanager
    def _client(self) -> Iterator[Client]:
        if self.cluster:
            with Client(self.cluster) as client:
                yield client
            return
        with (
            LocalCluster(
                n_workers=os.cpu_count(),
                threads_per_worker=1,
                dashboard_address=None,
                silence_logs=50,
            ) as cluster,
            Client(cluster) as client,
        ):
            yield client

    def _outcomes(
        self, client: Client, jobs: Sequence[Job], paths: dict[str, Path]
    ) -> Iterator[tuple[Job, Outcome]]:
        futures = {
            client.submit(run_job, job, paths[job.sequence], pure=False): job for job in jobs
        }
        for future in as_completed(futures):
            yield futures[future], future.result()

    def _keep(self, job: Job, outcome: Outcome) -> Result:
        folder = result_path(self.folder, job).parent
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in outcome.files.items():
            (folder / name).write_text(text)
        result = Result(job, outcome.summary, outcome.error)
        write_result(self.folder, result)
        return result


def _batches(jobs: Sequence[Job]) -> Iterator[list[Job]]:
    """Yield the offline jobs together, then each live job alone: it needs the whole machine."""
    offline = [job for job in jobs if not job.live]
    if offline:
        yield offline
    yield from ([job] for job in jobs if job.live)
