"""Soak test: memory, file descriptors and latency of long runs must not grow."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import psutil

from hoid_benchmarks.faults.cases import Outcome
from hoid_benchmarks.faults.live.node_harness import NodeHarness, Setup, member_pids, running_nodes
from hoid_benchmarks.faults.live.sender import CAMERA, RATE_HZ, Scene, Sender
from hoid_benchmarks.faults.samples import camera_yaml, write_tum_folder
from hoid_common.values import NS_PER_S, FloatArray

_STEP_PX, _PERIOD_S, _S_PER_H = 4, 2.0, 3600.0
_WARM_UP = 1 / 3  # share of the samples that is not evaluated
_MAX_MB_PER_H, _MAX_DESCRIPTORS, _MAX_DRIFT_MS = 2.0, 2, 10.0
_PAUSE_S, _LATE_S = 2.0, 5.0  # longer than any image waits for its pose
_NUM_BURSTS, _BURST = 5, 8  # images in a burst; more than a queue holds
_NUM_OFFLINE = 150  # images of the recording that is run repeatedly
_OFFLINE = (  # collects garbage between runs, which would otherwise count as growth
    'import gc, sys\n'
    'from hoid_bringup.cli import main\n'
    'while main(["run", *sys.argv[1:]]) == 0: gc.collect()\n'
    'sys.exit(1)\n'
)


class _Sample(NamedTuple):
    time_s: float
    memory_mb: float
    descriptors: int


def soak_cases(folder: Path, minutes: int) -> Iterator[Outcome]:
    """Yield an outcome for each process of a live run, and one for repeated offline runs."""
    scene = Scene(step_px=_STEP_PX)
    with running_nodes(folder / 'live', Setup(scene=scene)) as harness:
        _fill_queues(harness)
        series = _live(harness, minutes)
        yield _delay_outcome(harness.sender, minutes)
    yield from _growth_outcomes('soak, live', series, minutes)
    yield from _growth_outcomes(
        'soak, offline', {'run': _offline(scene, folder, minutes)}, minutes
    )


def _fill_queues(harness: NodeHarness) -> None:
    """Fill the queues of the nodes, so that their memory cannot grow by filling later.

    Bursts of images are followed by a pause of each process. Without this, occasional delays fill
    the queues in the course of an hour.
    """
    sender, period_s = harness.sender, harness.sender.period_s
    for _ in range(_NUM_BURSTS):
        sender.period_s = 0.0
        for _ in range(_BURST):
            sender.send()
        sender.period_s = period_s
        sender.send_for(_PAUSE_S)
    for pid in member_pids(harness.nodes.pids).values():
        os.kill(pid, signal.SIGSTOP)
        sender.send_for(_LATE_S)
        os.kill(pid, signal.SIGCONT)
        sender.send_for(_PAUSE_S)


def _live(harness: NodeHarness, minutes: int) -> Mapping[str, list[_Sample]]:
    series: dict[str, list[_Sample]] = defaultdict(list)
    end_s = time.monotonic() + 60 * minutes
    next_s = 0.0
    while time.monotonic() < end_s:
        harness.sender.send()
        if time.monotonic() > next_s:
            next_s = time.monotonic() + _PERIOD_S
            for name, pid in member_pids(harness.nodes.pids).items():
                series[name].append(_sample(pid))
    return series


def _offline(scene: Scene, folder: Path, minutes: int) -> list[_Sample]:
    """Return samples of a process that runs one recording repeatedly."""
    recording = _recorded(scene, folder / 'recording')
    command = (sys.executable, '-c', _OFFLINE, str(recording), '--out', str(folder / 'out'))
    options = ('--calibration', str(recording / 'camera.yaml'), '--filter', 'none')
    samples = []
    with subprocess.Popen(
        (*command, *options), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as child:
        end_s = time.monotonic() + 60 * minutes
        while time.monotonic() < end_s and child.poll() is None:
            samples.append(_sample(child.pid))
            time.sleep(_PERIOD_S)
        child.kill()
    return samples


def _recorded(scene: Scene, folder: Path) -> Path:
    """Write the images of a scene as a TUM folder, and return its path."""
    views = (scene.view(i) for i in range(_NUM_OFFLINE))
    images = ((color, np.round(5000 * depth_m).astype(np.uint16)) for color, depth_m, _ in views)
    write_tum_folder(folder, images, round(NS_PER_S / RATE_HZ))
    (folder / 'camera.yaml').write_text(camera_yaml(CAMERA))
    return folder


def _growth_outcomes(
    what: str, series: Mapping[str, list[_Sample]], minutes: int
) -> Iterator[Outcome]:
    """Yield an outcome for each process; it fails if memory or descriptors grow."""
    for name, samples in series.items():
        time_s, memory_mb, descriptors = np.array(samples).T
        is_warm = time_s > time_s[0] + 60 * minutes * _WARM_UP
        slope, error = _slope(time_s[is_warm], memory_mb[is_warm])
        more = int(descriptors[is_warm][-1] - descriptors[is_warm][0])
        complaint = ''
        if slope - 2 * error > _MAX_MB_PER_H:
            complaint = f'{slope:.1f} MB more an hour'
        elif more > _MAX_DESCRIPTORS:
            complaint = f'{more} more descriptors'
        note = f'{slope:+.1f} ± {error:.1f} MB/h, {more:+d} descriptors'
        peak_mb = float(memory_mb.max())
        yield Outcome(
            f'{what}: {name}', 0, complaint, wall_s=60.0 * minutes, peak_mb=peak_mb, note=note
        )


def _delay_outcome(sender: Sender, minutes: int) -> Outcome:
    """Return the outcome for the latency from image to odometry; it fails if it grows."""
    heard = [h for h in sender.heard if h.stamp_ns in sender.sent_s]
    delays_ms = np.array([1e3 * (h.received_s - sender.sent_s[h.stamp_ns]) for h in heard])
    third = len(delays_ms) // 3
    first_ms, last_ms = np.median(delays_ms[third : 2 * third]), np.median(delays_ms[2 * third :])
    drift_ms = float(last_ms - first_ms)
    complaint = f'{drift_ms:.1f} ms later' if drift_ms > _MAX_DRIFT_MS else ''
    note = f'median {first_ms:.1f} ms, then {last_ms:.1f} ms'
    return Outcome('soak, live: delay of odometry', 0, complaint, wall_s=60.0 * minutes, note=note)


def _slope(time_s: FloatArray, values: FloatArray) -> tuple[float, float]:
    """Return the growth of values per hour by linear regression, and its standard error."""
    coefficients, covariance = np.polyfit(time_s, values, 1, cov=True)
    return _S_PER_H * float(coefficients[0]), _S_PER_H * float(np.sqrt(covariance[0, 0]))


def _sample(pid: int) -> _Sample:
    process = psutil.Process(pid)
    memory = process.memory_info()
    # Images arrive in shared memory, which is not the process's own.
    own_mb = (memory.rss - memory.shared) / 2**20
    return _Sample(time.monotonic(), own_mb, process.num_fds())
