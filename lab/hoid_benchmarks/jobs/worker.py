"""Runs one job in a separate process, so that its memory and time can be measured."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from hoid_bags.imu_recording import read_own_imu
from hoid_bags.sequence import open_sequence
from hoid_benchmarks.jobs.exact import ExactFilter
from hoid_benchmarks.jobs.inertial import InertialErrors
from hoid_benchmarks.jobs.masks import mask_rows
from hoid_benchmarks.jobs.verdicts import Verdicts
from hoid_benchmarks.plan.detections import cached_detections, every_image
from hoid_benchmarks.plan.detectors import evaluate_detector
from hoid_benchmarks.plan.imu_changes import changed_imu
from hoid_benchmarks.plan.perturb import PerturbedSequence, perturb_detections
from hoid_benchmarks.plan.plan import EXACT, Job
from hoid_benchmarks.plan.reference import reference_ms
from hoid_benchmarks.plan.sequences import IMU_SUFFIX, Store
from hoid_bringup.evaluate.evaluation import evaluate
from hoid_bringup.run.detection_source import detection_source
from hoid_bringup.run.offline import OfflinePipeline
from hoid_bringup.run.outputs import write_outputs
from hoid_bringup.run.provenance import machine as this_machine
from hoid_bringup.run.run_config import RunConfig
from hoid_common.errors import HoidError, InputError
from hoid_common.io.tum_text import read_tum, write_tum
from hoid_common.values import S_PER_NS

_TRUTH = 'ground_truth.txt'
_KEPT = ('trajectory.txt', 'trajectory_online.txt', _TRUTH, 'features.csv')
_PICTURES = ('verdicts.png', 'features.png', 'rules.png')
_TIMEOUT_S = 4 * 3600


@dataclass(frozen=True)
class Outcome:
    """Summary and files of a job, or its error."""

    summary: dict[str, Any] = field(default_factory=dict)
    files: dict[str, bytes] = field(default_factory=dict)
    error: str = ''
    machine: str = field(default_factory=this_machine)  # machine that ran the job


def command_of(job: Job, path: str, out: str = 'OUT') -> list[str]:
    """Return the `hoid` arguments that repeat a job without a perturbation."""
    method = ['--filter', job.filter]
    if job.detector:
        method += ['--detector', job.detector]
    if job.mode == 'pictures':
        return ['pictures', path, '--out', out, *method]
    method += ['--seed', str(job.seed)]
    for name, value in job.settings().items():
        method += ['--set', f'{name}={value}']
    return ['replay' if job.mode == 'live' else 'run', path, '--out', out, *method]


def run_job(job: Job, path: Path, store: Store) -> Outcome:
    """Run a job in a child process. Errors are part of the outcome, so that other jobs continue.

    Args:
        job: The run to perform.
        path: Path of the job's sequence.
        store: Folders of other sequences and of cached detections.
    """
    with tempfile.TemporaryDirectory(prefix='hoid-bench-') as folder:
        out = Path(folder) / 'run'
        try:
            done = subprocess.run(
                _child(job, path, out, store), capture_output=True, text=True, check=False,
                timeout=_TIMEOUT_S, env={**os.environ, 'OMP_NUM_THREADS': '1'},
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return Outcome(error=f'not finished after {_TIMEOUT_S // 3600} hours')
        if done.returncode:
            lines = done.stderr.strip().splitlines()
            return Outcome(error=lines[-1] if lines else f'exit status {done.returncode}')
        return _collect(job, out, path)


def _child(job: Job, path: Path, out: Path, store: Store) -> list[str]:
    if job.mode in ('live', 'pictures'):
        return [sys.executable, '-m', 'hoid_bringup', *command_of(job, str(path), str(out))]
    order = out.with_name('job.pickle')
    order.write_bytes(pickle.dumps((job, path, out, store)))
    return [sys.executable, '-m', 'hoid_benchmarks.jobs.worker', str(order)]


def _collect(job: Job, out: Path, path: Path) -> Outcome:
    summary = {}
    if (out / 'summary.json').is_file():
        summary = json.loads((out / 'summary.json').read_text())
    if job.mode == 'live' and (truth := open_sequence(path).ground_truth) is not None:
        write_tum(out / _TRUTH, truth)
    if (out / _TRUTH).is_file():
        summary |= _more_errors(out)
    files = {n: (out / n).read_bytes() for n in (*_KEPT, *_PICTURES) if (out / n).is_file()}
    return Outcome(summary, files)


def _more_errors(out: Path) -> dict[str, float | None]:
    """Return the mean and median ATE, which only the paper's tables need."""
    try:
        found = evaluate(read_tum(out / 'trajectory.txt'), read_tum(out / _TRUTH))
    except InputError:  # too short to align; the RMSE in the summary is null as well
        return {'ate_mean_m': None, 'ate_median_m': None}
    return {'ate_mean_m': found.ate_mean_m, 'ate_median_m': found.ate_median_m}


def _config(job: Job) -> RunConfig:
    named = {'detector.model': job.detector, 'filter.strategy': job.strategy}
    return RunConfig().updated({**named, 'slam.seed': job.seed, **job.settings()})


def _run_offline(job: Job, path: Path, out: Path, store: Store) -> None:
    """Run every frame, and write the outputs of a run and the values that the experiments need."""
    config = _config(job)
    base = open_sequence(path)
    cache_folder = store.made / 'detections_of_images'
    cached = cached_detections(base, config, cache_folder) if job.mode != 'timed' else None
    rate_hz = job.perturbation.detector_hz or config.detector.rate_hz
    detect = perturb_detections(
        cached or detection_source(base, every_image(config)),
        replace(job.perturbation, detector_hz=rate_hz),
        job.seed,
    )
    sequence = PerturbedSequence(base, job.perturbation, job.seed)
    find_features = None
    if job.filter == EXACT:
        masks = store.made / 'masks' / f'{path.name}.npy'
        find_features = ExactFilter(job.sequence, masks, config.filter.extraction).process
    imu = errors = None
    if job.sequence.endswith(IMU_SUFFIX):
        imu = changed_imu(read_own_imu(path), job.perturbation.imu, job.seed)
        errors = InertialErrors(job, sequence, len(base))
    pipeline = OfflinePipeline(sequence, config, detect, find_features=find_features, imu=imu)
    verdicts = Verdicts(job.sequence, base.camera) if job.mode == 'verdicts' else None
    lines = ['stamp_ns,features kept']
    start_s, stamps_ns = time.process_time(), []
    for i, frame in enumerate(sequence):
        done = pipeline.process(frame)
        lines.append(f'{frame.stamp_ns},{pipeline.num_kept[-1]}')
        stamps_ns.append(frame.stamp_ns)
        if verdicts is not None:
            verdicts.add(i, pipeline.objects)
        if errors is not None:
            errors.add(frame.stamp_ns, done.pose, pipeline.imu_report())
    spent_s = time.process_time() - start_s
    if cached is not None:
        cached.save()
        pipeline.stage_ms.pop('detect', None)  # mostly the time of reading the cache
    summary = write_outputs(out, pipeline.finish(sequence, config.summary_options()))
    (out / 'features.csv').write_text('\n'.join(lines) + '\n')
    if sequence.ground_truth is not None:
        write_tum(out / _TRUTH, sequence.ground_truth)
    document = (
        json.loads(summary.to_json())
        | {'reference_ms': reference_ms()}
        | _cost(job, spent_s, stamps_ns)
    )
    if verdicts is not None:
        document['verdicts'] = verdicts.summary()
    if errors is not None:
        document['imu_errors'] = errors.summary(read_tum(out / 'trajectory.txt'))
    (out / 'summary.json').write_text(json.dumps(document))


def _cost(job: Job, spent_s: float, stamps_ns: Sequence[int]) -> dict[str, float]:
    """Return the processor time of a timed run per second of the recording."""
    if job.mode != 'timed':  # detections are read from a cache
        return {}
    return {'cpu_s_per_s': spent_s / (S_PER_NS * (stamps_ns[-1] - stamps_ns[0]))}


def _run_detector(job: Job, path: Path, out: Path, _store: Store) -> None:
    out.mkdir()
    summary = {'detector': evaluate_detector(open_sequence(path), path, job.detector)}
    (out / 'summary.json').write_text(json.dumps(summary))


def _run_masks(job: Job, _path: Path, out: Path, store: Store) -> None:
    out.mkdir()
    (out / 'summary.json').write_text(json.dumps({'masks': mask_rows(job, store)}))


_RUNNERS = {
    'offline': _run_offline,
    'timed': _run_offline,
    'detect': _run_detector,
    'verdicts': _run_offline,
    'masks': _run_masks,
}


def main() -> int:
    """Run the job that is pickled in the file named by the first argument."""
    order = Path(sys.argv[1]).read_bytes()
    job, path, out, store = pickle.loads(order)  # noqa: S301  written by the parent process
    try:
        _RUNNERS[job.mode](job, path, out, store)
    except HoidError as error:
        sys.stderr.write(f'{error}\n')
        return 1
    return 0


if __name__ == '__main__':
    sys.exit(main())
