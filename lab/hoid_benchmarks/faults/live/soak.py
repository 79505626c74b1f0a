"""Hours of the same: whether memory, descriptors or delays of any process grow."""

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

import cv2
import numpy as np
import psutil

from hoid_benchmarks.faults.cases import Outcome
from hoid_benchmarks.faults.live.sender import CAMERA, RATE_HZ, Scene, Sender
from hoid_benchmarks.faults.live.stage import Setup, Stage, member_pids, staged
from hoid_benchmarks.faults.samples import camera_yaml
from hoid_common.values import FloatArray

_STEP_PX, _PERIOD_S, _S_PER_H = 4, 2.0, 3600.0
_WARM_UP = 1 / 3  # of the time
_MAX_MB_PER_H, _MAX_DESCRIPTORS, _MAX_DRIFT_MS = 2.0, 2, 10.0
_PAUSE_S, _LATE_S = 2.0, 5.0  # longer than any image is kept for its pose
_NUM_BURSTS, _BURST = 5, 8  # images at once, more than a queue holds
_NUM_OFFLINE = 150  # images of the recording that is run again and again
_OFFLINE = (  # what a collection frees does not stay
    'import gc, sys\n'
    'from hoid_bringup.cli import main\n'
    'while main(["run", *sys.argv[1:]]) == 0: gc.collect()\n'
    'sys.exit(1)\n'
)


class _Sample(NamedTuple):
    when_s: float
    memory_mb: float
    descriptors: int


def soak_cases(folder: Path, minutes: int) -> Iterator[Outcome]:
    """Yield an outcome for each process of a live run, and of offline runs in one process."""
    scene = Scene(step_px=_STEP_PX)
    with staged(folder / 'live', Setup(scene=scene)) as stage:
        _fill_queues(stage)
        series = _live(stage, minutes)
        yield _delays(stage.sender, minutes)
    yield from _judged('soak, live', series, minutes)
    yield from _judged('soak, offline', {'run': _offline(scene, folder, minutes)}, minutes)


def _fill_queues(stage: Stage) -> None:
    """Send more than the nodes' queues hold: what is kept for late messages then is all.

    Much comes at once, and then one process after the other answers late. Without, one delay after
    the other lets the queues fill in the course of an hour.
    """
    sender, period_s = stage.sender, stage.sender.period_s
    for _ in range(_NUM_BURSTS):
        sender.period_s = 0.0
        for _ in range(_BURST):
            sender.send()
        sender.period_s = period_s
        sender.send_for(_PAUSE_S)
    for pid in member_pids(stage.nodes.pids).values():
        os.kill(pid, signal.SIGSTOP)
        sender.send_for(_LATE_S)
        os.kill(pid, signal.SIGCONT)
        sender.send_for(_PAUSE_S)


def _live(stage: Stage, minutes: int) -> Mapping[str, list[_Sample]]:
    series: dict[str, list[_Sample]] = defaultdict(list)
    end_s = time.monotonic() + 60 * minutes
    next_s = 0.0
    while time.monotonic() < end_s:
        stage.sender.send()
        if time.monotonic() > next_s:
            next_s = time.monotonic() + _PERIOD_S
            for name, pid in member_pids(stage.nodes.pids).items():
                series[name].append(_sample(pid))
    return series


def _offline(scene: Scene, folder: Path, minutes: int) -> list[_Sample]:
    """Run a recording again and again in one process."""
    recording = _recorded(scene, folder / 'recording')
    command = (sys.executable, '-c', _OFFLINE, str(recording), '--out', str(folder / 'out'))
    options = ('--camera', str(recording / 'camera.yaml'), '--filter', 'none')
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
    """Write what a camera sees of a scene as a TUM folder."""
    for kind in ('rgb', 'depth'):
        (folder / kind).mkdir(parents=True)
    lists: dict[str, list[str]] = {'rgb': [], 'depth': []}
    for i in range(_NUM_OFFLINE):
        image_bgr, depth_m, _ = scene.view(i)
        stamp = f'{1000 + i / RATE_HZ:.6f}'
        pixels = {'rgb': image_bgr, 'depth': np.round(5000 * depth_m).astype(np.uint16)}
        for kind, image in pixels.items():
            cv2.imwrite(str(folder / kind / f'{stamp}.png'), image)
            lists[kind].append(f'{stamp} {kind}/{stamp}.png')
    for kind, rows in lists.items():
        (folder / f'{kind}.txt').write_text('\n'.join(rows) + '\n')
    (folder / 'camera.yaml').write_text(camera_yaml(CAMERA))
    return folder


def _judged(what: str, series: Mapping[str, list[_Sample]], minutes: int) -> Iterator[Outcome]:
    """Yield whether processes grow."""
    for name, samples in series.items():
        when_s, memory_mb, descriptors = np.array(samples).T
        is_warm = when_s > when_s[0] + 60 * minutes * _WARM_UP
        slope, error = _slope(when_s[is_warm], memory_mb[is_warm])
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


def _delays(sender: Sender, minutes: int) -> Outcome:
    """Judge how the time from an image to its odometry has changed."""
    heard = [h for h in sender.heard if h.stamp_ns in sender.sent_s]
    delays_ms = np.array([1e3 * (h.when_s - sender.sent_s[h.stamp_ns]) for h in heard])
    third = len(delays_ms) // 3
    first_ms, last_ms = np.median(delays_ms[third : 2 * third]), np.median(delays_ms[2 * third :])
    drift_ms = float(last_ms - first_ms)
    complaint = f'{drift_ms:.1f} ms later' if drift_ms > _MAX_DRIFT_MS else ''
    note = f'median {first_ms:.1f} ms, then {last_ms:.1f} ms'
    return Outcome('soak, live: delay of odometry', 0, complaint, wall_s=60.0 * minutes, note=note)


def _slope(when_s: FloatArray, values: FloatArray) -> tuple[float, float]:
    """Return by how much values grow in an hour, and the standard error of that."""
    coefficients, covariance = np.polyfit(when_s, values, 1, cov=True)
    return _S_PER_H * float(coefficients[0]), _S_PER_H * float(np.sqrt(covariance[0, 0]))


def _sample(pid: int) -> _Sample:
    process = psutil.Process(pid)
    memory = process.memory_info()
    own_mb = (memory.rss - memory.shared) / 2**20  # images are received in what is shared
    return _Sample(time.monotonic(), own_mb, process.num_fds())
