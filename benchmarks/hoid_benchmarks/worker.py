"""One job, in a process of its own so that its memory and time are its own."""

from __future__ import annotations

import json
import pickle
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hoid_bags.sequence import open_sequence
from hoid_bags.trajectory_io import read_tum, write_tum
from hoid_benchmarks.perturb import PerturbedSequence, perturb_detections
from hoid_benchmarks.plan import Job, Perturbation
from hoid_bringup.detection_source import detection_source
from hoid_bringup.evaluation import evaluate
from hoid_bringup.offline import run_offline
from hoid_bringup.run_config import RunConfig
from hoid_common.errors import HoidError, InputError

_FILES = ('trajectory.txt', 'trajectory_online.txt', 'ground_truth.txt')


@dataclass(frozen=True)
class Outcome:
    """What a job leaves behind: its summary and its trajectories, or an error."""

    summary: dict[str, Any] = field(default_factory=dict)
    files: dict[str, str] = field(default_factory=dict)
    error: str = ''


def command_of(job: Job, path: str) -> list[str]:
    """Return the `hoid` arguments that repeat a job; perturbed ones go through this module."""
    command = ['replay' if job.live else 'run', path, '--out', 'OUT', '--filter', job.filter]
    if job.detector:
        command += ['--detector', job.detector]
    command += ['--seed', str(job.seed)]
    for name, value in job.parameters:
        command += ['--set', f'{name}={value}']
    return command


def run_job(job: Job, path: Path) -> Outcome:
    """Run a job in a child process; never raises, so that one failure does not end the rest."""
    with tempfile.TemporaryDirectory(prefix='hoid-bench-') as folder:
        out = Path(folder) / 'run'
        if job.perturbation == Perturbation():
            words = [w if w != 'OUT' else str(out) for w in command_of(job, str(path))]
            child = [sys.executable, '-m', 'hoid_bringup', *words]
        else:
            order = Path(folder) / 'job.pickle'
            order.write_bytes(pickle.dumps((job, path, out)))
            child = [sys.executable, '-m', 'hoid_benchmarks.worker', str(order)]
        done = subprocess.run(child, capture_output=True, text=True, check=False)
        if done.returncode:
            lines = done.stderr.strip().splitlines()
            return Outcome(error=lines[-1] if lines else f'exit status {done.returncode}')
        return _collect(out, path)


def _collect(out: Path, path: Path) -> Outcome:
    summary = json.loads((out / 'summary.json').read_text())
    truth = open_sequence(path).ground_truth
    if truth is not None:
        write_tum(out / 'ground_truth.txt', truth)
        summary |= _more_errors(out)
    return Outcome(summary, {n: (out / n).read_text() for n in _FILES if (out / n).is_file()})


def _more_errors(out: Path) -> dict[str, float | None]:
    """Return what the paper's tables need beside the summary."""
    try:
        found = evaluate(read_tum(out / 'trajectory.txt'), read_tum(out / 'ground_truth.txt'))
    except InputError:  # too short to align: the summary says null as well
        return {'ate_mean_m': None, 'ate_median_m': None}
    return {'ate_mean_m': found.ate_mean_m, 'ate_median_m': found.ate_median_m}


def _run_perturbed(job: Job, path: Path, out: Path) -> None:
    config = RunConfig().updated(
        {
            'model': job.detector,
            'filter.strategy': job.filter,
            'slam.seed': job.seed,
            **dict(job.parameters),
        }
    )
    base = open_sequence(path)
    detect = perturb_detections(detection_source(base, config), job.perturbation, job.seed)
    sequence = PerturbedSequence(base, job.perturbation, job.seed)
    run_offline(sequence, config, out, detect=detect, show_progress=False)


def main() -> int:
    """Run one perturbed job, pickled in the file that the argument names."""
    order = Path(sys.argv[1]).read_bytes()
    job, path, out = pickle.loads(order)  # noqa: S301  written by the parent process
    try:
        _run_perturbed(job, path, out)
    except HoidError as error:
        sys.stderr.write(f'{error}\n')
        return 1
    return 0


if __name__ == '__main__':
    sys.exit(main())
