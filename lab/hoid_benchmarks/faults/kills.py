"""Writers of bags killed at random times: bags are never wrong, flushed messages remain."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from hoid_bags.bag import bag_messages
from hoid_bags.bag.bag_reader import BagReader
from hoid_bags.bag.bag_writer import BagWriter
from hoid_bags.bag.info import summarize
from hoid_bags.bag.repair import repair
from hoid_bags.storage.bag_types import IMU
from hoid_benchmarks.faults.cases import Outcome
from hoid_benchmarks.faults.guarded import run_guarded
from hoid_benchmarks.faults.samples import NUM_FRAMES, Samples
from hoid_bringup import cli
from hoid_common.errors import InputError
from hoid_common.io.files import abandoned_scratch_folders
from hoid_common.values import NS_PER_S

CONVERT, RECORD = 'convert, killed', 'recording, killed'
_LIMIT_S = 20.0
# Errors of a repair if the writer was killed before it had written a message.
_NOTHING_YET = ('no message can be read', 'not a bag', 'no such bag')
_MESSAGES_PER_FRAME = 3  # two images and a camera
_FLUSH_S = 0.5
_PERIOD_S = 0.005


def kill_cases(samples: Samples, folder: Path, seeds: range) -> Iterator[Outcome]:
    """Yield the outcomes of a killed conversion and a killed recording for each seed."""
    whole = run_guarded(_convert(samples, folder / 'whole'), _LIMIT_S)
    for seed in seeds:
        rng = np.random.default_rng(seed)
        place = folder / f'{seed}'
        after_s = rng.random() * whole.wall_s
        yield Outcome(CONVERT, seed, _killed_conversion(samples, place / 'convert', after_s))
        after_s = 0.2 + 2.5 * rng.random()
        yield Outcome(RECORD, seed, _killed_recording(place / 'record', after_s))
        shutil.rmtree(place)


def _convert(samples: Samples, place: Path) -> Callable[[], int]:
    place.mkdir(parents=True)
    argv = ['convert', str(samples.tum), str(place / 'bag'), '--calibration', str(samples.camera)]
    return lambda: cli.main(argv)


def _killed_conversion(samples: Samples, place: Path, after_s: float) -> str:
    ended = run_guarded(_convert(samples, place), after_s)
    bag = place / 'bag'
    if bag.exists():
        summary = summarize(bag)
        whole = summary.fault is None
        if not whole or summary.num_messages != _MESSAGES_PER_FRAME * NUM_FRAMES:
            return f'a bag of {summary.num_messages} messages: {summary.fault}'
    elif not ended.was_killed:
        return f'no bag without a kill: {ended.stderr}'
    return _unrepaired(place)


def _unrepaired(place: Path) -> str:
    """Return what is wrong with the repaired remains of a killed writer; '' if nothing is."""
    for left in abandoned_scratch_folders(place):
        try:
            bag = repair(left)
        except InputError as error:
            if not any(text in str(error) for text in _NOTHING_YET):
                return f'no repair: {error}'
        else:
            if fault := summarize(bag).fault:
                return f'after its repair: {fault}'
    return ''


def _killed_recording(place: Path, after_s: float) -> str:
    place.mkdir(parents=True)
    run_guarded(lambda: _record(place / 'bag'), after_s)
    killed_ns = time.time_ns()
    left = abandoned_scratch_folders(place)
    if not left:
        return 'nothing was left'
    if wrong := _unrepaired(place):
        return wrong
    if not (place / 'bag').exists():
        return '' if after_s < 1.0 else f'nothing was kept of {after_s:.1f} s'
    with BagReader(place / 'bag') as reader:
        _, last_ns = reader.span_ns
    lost_s = (killed_ns - last_ns) / NS_PER_S
    return '' if lost_s <= 1.0 else f'the last {lost_s:.1f} s are lost'


def _record(bag: Path) -> int:
    """Write a message every 5 ms until killed, with the flush period of the recorder."""
    with BagWriter(bag) as writer:
        writer.add_topic('imu', IMU)
        flush_s = 0.0
        while True:
            now_ns = time.time_ns()
            writer.write('imu', now_ns, bag_messages.imu(now_ns, np.zeros(3)))
            if time.monotonic() >= flush_s:
                writer.flush()
                flush_s = time.monotonic() + _FLUSH_S
            time.sleep(_PERIOD_S)
