"""Damaged, hostile and irregular files as inputs of the commands that read them."""

from __future__ import annotations

import hashlib
import os
import resource
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from hoid_bags.bag.bag_reader import BagReader
from hoid_bags.bag.bag_writer import BagWriter
from hoid_bags.sequence import open_sequence
from hoid_benchmarks.faults import recordings
from hoid_benchmarks.faults.cases import Outcome
from hoid_benchmarks.faults.damage import Rng, damaged
from hoid_benchmarks.faults.guarded import Ended, run_guarded
from hoid_benchmarks.faults.models import damaged_model, finished_boxes, hostile_model, no_people
from hoid_benchmarks.faults.recordings import SILENT
from hoid_benchmarks.faults.samples import CAMERA, Samples
from hoid_bringup import cli
from hoid_common.errors import HoidError
from hoid_common.io.files import abandoned_scratch_folders

LIMIT_S = 10.0
_MEMORY_FACTOR, _MEMORY_MB = 1.3, 50.0  # chosen: limit relative to the command on good files
_HEAD_BYTES = 100  # of a message: its header, and size and encoding of an image
_STAMPS = ('nan', 'sNaN', '-inf', '1e999999', '9e999980', '9' * 5000, '1_0', '-1', '\u0661', '1:2')
_PATHS = (
    'x' * 300,
    'a/' * 3000,
    'a\0b',
    '\x1b[2J',
    '\u202e',
    '/dev/zero',
    '..',
    '/etc/passwd',
    '',
)
_REFUSED = 1

Work = Callable[[], int]


def file_cases(samples: Samples, folder: Path, seeds: range) -> Iterator[Outcome]:
    """Yield one outcome for each kind of file and each seed.

    Raises:
        HoidError: A command refuses good files, so that damaged ones would prove nothing.
    """
    clean_mb = {}
    for i, (kind, make) in enumerate(KINDS.items()):
        ended = run_guarded(make(samples, _new_folder(folder / f'clean {i}'), None), LIMIT_S)
        if ended.status:
            raise HoidError(f'{kind}: good files are refused: {ended.stderr}')
        clean_mb[kind] = ended.peak_mb
    for seed in seeds:
        for kind, make in KINDS.items():
            place = _new_folder(folder / f'{seed}')
            ended = run_guarded(make(samples, place, np.random.default_rng(seed)), LIMIT_S)
            complaint = _complaint(ended, clean_mb[kind]) or _leftovers(place, ended)
            shutil.rmtree(place)
            yield Outcome(
                kind, seed, complaint, ended.status == _REFUSED, ended.wall_s, ended.peak_mb
            )


def _complaint(ended: Ended, clean_mb: float) -> str:
    lines = [line for line in ended.stderr.splitlines() if line.startswith('hoid ')]
    if ended.was_killed:
        return f'it hung for {LIMIT_S:g} s'
    if ended.status == SILENT:
        return 'wrong data were read without an error'
    if 'Traceback' in ended.stderr or ended.status not in (0, 1, 2):
        return f'status {ended.status}: {" ".join(ended.stderr.split())[-300:]}'
    if ended.status == _REFUSED and (len(lines) != 1 or not lines[0].isprintable()):
        return f'{len(lines)} error lines: {ended.stderr[:300]!a}'
    if ended.peak_mb > _MEMORY_FACTOR * clean_mb + _MEMORY_MB:
        return f'{ended.peak_mb:.0f} MB where good files take {clean_mb:.0f}'
    return ''


def _leftovers(place: Path, ended: Ended) -> str:
    if left := abandoned_scratch_folders(place):
        return f'{left[0].name} was left behind'
    if ended.status == _REFUSED and (place / 'out').exists():
        return 'refused, but a bag was written'
    return ''


def _bag_bytes(samples: Samples, place: Path, rng: Rng | None) -> Work:
    """Read a damaged .mcap file: messages must be unchanged, or the damage must be reported."""
    bag = shutil.copytree(samples.bag, place / 'bag')
    _damage(bag / 'bag.mcap', rng)
    return lambda: _read_bag(bag, _digests(samples.bag))


def _metadata(samples: Samples, place: Path, rng: Rng | None) -> Work:
    bag = shutil.copytree(samples.bag, place / 'bag')
    _damage(bag / 'metadata.yaml', rng)
    return lambda: _read_bag(bag, _digests(samples.bag))


def _bag_message(samples: Samples, place: Path, rng: Rng | None) -> Work:
    """Read an intact bag of which one serialized message is damaged."""
    bag = place / 'bag'
    with BagReader(samples.bag) as reader, BagWriter(bag) as writer:
        for topic in reader.topics:
            writer.add_topic(topic.name, topic.type_name)
        messages = list(reader.messages())
        if rng is not None:
            i = int(rng.integers(len(messages)))
            data = messages[i].data  # most other bytes are pixels, of which every value is valid
            data = damaged(data[:_HEAD_BYTES], rng) + data[_HEAD_BYTES:]
            messages[i] = messages[i]._replace(data=data)
        for topic_name, log_ns, data in messages:
            writer.write_serialized(topic_name, log_ns, data)
    return lambda: _read_bag(bag, _digests(bag))


def _read_bag(bag: Path, good: list[str]) -> int:
    status = cli.main(['info', '--bandwidth', str(bag)])
    try:
        if status == 0 and _digests(bag) != good:
            return SILENT
        for _ in open_sequence(bag, CAMERA):
            pass
    except HoidError:
        status = status or _report_refusal()
    return status


def _report_refusal() -> int:
    """Return the status of a fault that only reading the images finds; write its error line."""
    sys.stderr.write('hoid run: refused\n')
    return _REFUSED


def _digests(bag: Path) -> list[str]:
    with BagReader(bag) as reader:
        return sorted(
            hashlib.sha256(f'{m.topic} {m.log_ns}'.encode() + m.data).hexdigest()
            for m in reader.messages()
        )


def _tum_file(samples: Samples, place: Path, rng: Rng | None) -> Work:
    tum = shutil.copytree(samples.tum, place / 'tum')
    if rng is not None:
        _damage(_one_of(sorted(p for p in tum.rglob('*') if p.is_file()), rng), rng)
    return _converted(tum, samples.camera, place)


def _tum_list(samples: Samples, place: Path, rng: Rng | None) -> Work:
    tum = shutil.copytree(samples.tum, place / 'tum')
    _damage(tum / 'rgb.txt', rng)
    return _converted(tum, samples.camera, place)


def _tum_row(samples: Samples, place: Path, rng: Rng | None) -> Work:
    """Convert a TUM folder whose image list has one row with an abnormal stamp or path."""
    tum = shutil.copytree(samples.tum, place / 'tum')
    if rng is not None:
        rows = (tum / 'rgb.txt').read_text().splitlines()
        i = int(rng.integers(len(rows)))
        stamp, name = rows[i].split()
        strange = [f'{other} {name}' for other in _STAMPS] + [f'{stamp} {o}' for o in _PATHS]
        rows[i] = strange[int(rng.integers(len(strange)))]
        (tum / 'rgb.txt').write_text('\n'.join(rows), encoding='utf-8')
    return _converted(tum, samples.camera, place)


def _camera(samples: Samples, place: Path, rng: Rng | None) -> Work:
    camera = Path(shutil.copy(samples.camera, place / 'camera.yaml'))
    _damage(camera, rng)
    return _converted(samples.tum, camera, place)


def _converted(tum: Path, camera: Path, place: Path) -> Work:
    argv = ['convert', str(tum), str(place / 'out'), '--calibration', str(camera)]
    return lambda: cli.main(argv)


def _trajectory(samples: Samples, place: Path, rng: Rng | None) -> Work:
    path = Path(shutil.copy(samples.trajectory, place / 'path.txt'))
    _damage(path, rng)
    return lambda: cli.main(['evaluate', str(path), str(samples.trajectory)])


def _no_file(samples: Samples, place: Path, rng: Rng | None) -> Work:
    """Run a command with a pipe, a device, a folder, a link or nothing instead of a file."""
    tum, bag = (shutil.copytree(p, place / p.name) for p in (samples.tum, samples.bag))
    works = [
        (tum / 'rgb.txt', _converted(tum, samples.camera, place)),
        (bag / 'bag.mcap', lambda: cli.main(['info', str(bag)])),
        (bag / 'metadata.yaml', lambda: cli.main(['info', str(bag)])),
        (place / 'path', lambda: cli.main(['evaluate', str(place / 'path'), str(place / 'path')])),
    ]
    if rng is None:  # the memory limit is that of the most demanding command
        good = str(samples.trajectory)
        return lambda: (
            works[0][1]() or cli.main(['info', str(bag)]) or cli.main(['evaluate', good, good])
        )
    path, work = works[int(rng.integers(len(works)))]
    path.unlink(missing_ok=True)
    replacements: list[Callable[[], object]] = [
        lambda: os.mkfifo(path),
        lambda: path.symlink_to('/dev/zero'),
        path.mkdir,
        lambda: path.symlink_to(path.name),  # a link to itself
        lambda: None,
    ]
    replacements[int(rng.integers(len(replacements)))]()
    return work


def _name(samples: Samples, place: Path, rng: Rng | None) -> Work:
    """Convert with an abnormal file name in one argument."""
    argv = ['convert', str(samples.tum), str(place / 'out'), '--calibration', str(samples.camera)]
    if rng is not None:
        strange = ('x' * 5000, 'é' * 200, os.fsdecode(b'caf\xe9'), '', 'a\nb' * 100, '\x1b[2J')
        argv[int(rng.choice([1, 4]))] = strange[int(rng.integers(len(strange)))]
    return lambda: cli.main(argv)


def _damaged_model(_samples: Samples, place: Path, rng: Rng | None) -> Work:
    """Run the damaged model of the synthetic detector: any boxes that it returns must be valid."""
    return damaged_model(place, rng)


def _hostile_model(_samples: Samples, place: Path, rng: Rng | None) -> Work:
    return hostile_model(place, rng)


def _finished_boxes(_samples: Samples, place: Path, rng: Rng | None) -> Work:
    return finished_boxes(place, rng)


def _no_people(_samples: Samples, place: Path, rng: Rng | None) -> Work:
    return no_people(place, rng)


def _few_descriptors(samples: Samples, place: Path, rng: Rng | None) -> Work:
    """Run a command that may open a few files only; the nodes need many more."""
    works = (
        _converted(samples.tum, samples.camera, place),
        lambda: cli.main(['info', str(samples.bag)]),
        lambda: cli.main(['evaluate', str(samples.trajectory), str(samples.trajectory)]),
        lambda: cli.main(['nodes', '--restart']),
    )
    if rng is None:
        return works[0]
    work = works[int(rng.integers(len(works)))]
    limit = int(rng.integers(8, 41))

    def limited() -> int:
        resource.setrlimit(resource.RLIMIT_NOFILE, (limit, limit))
        return work()

    return limited


def _new_folder(folder: Path) -> Path:
    folder.mkdir(parents=True)
    return folder


def _damage(path: Path, rng: Rng | None) -> None:
    if rng is not None:
        path.write_bytes(damaged(path.read_bytes(), rng))


def _one_of(paths: list[Path], rng: Rng) -> Path:
    return paths[int(rng.integers(len(paths)))]


KINDS: dict[str, Callable[[Samples, Path, Rng | None], Work]] = {
    'bag: bytes': _bag_bytes,
    'bag: metadata.yaml': _metadata,
    'bag: a message': _bag_message,
    'TUM folder: a file': _tum_file,
    'TUM folder: a list': _tum_list,
    'TUM folder: a row': _tum_row,
    'camera YAML': _camera,
    'trajectory': _trajectory,
    'pipes, devices, loops': _no_file,
    'names': _name,
    'ONNX model: bytes': _damaged_model,
    'ONNX model: hostile': _hostile_model,
    'ONNX model: tables of boxes': _finished_boxes,
    'ONNX model: no people': _no_people,
    'bag: repeated stamps': recordings.repeated_stamps,
    'bag: offset stamps': recordings.offset_stamps,
    'bag: empty frame_id': recordings.empty_frame_id,
    'bag: units of depth': recordings.depth_units,
    'bag: extreme depths': recordings.extreme_depths,
    'bag: rectified images': recordings.rectified_images,
    'bag: changed camera_info': recordings.changed_camera,
    'ground truth: no poses': recordings.bad_truth,
    'few descriptors': _few_descriptors,
}
