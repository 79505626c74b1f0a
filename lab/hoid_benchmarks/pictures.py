"""The command `pictures`: draws features and verdicts of the filter as in the paper's figures.

It writes three sheets for some frames of a recording: the verdict on each object (Figure 4), all
features with the detections (Figure 6), and the features kept by the 2-D rule beside those kept by
the 3-D rule (Figure 7). With `--objects`, it draws the object map instead.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from string import ascii_uppercase

import cv2
import numpy as np

from hoid_bags.options import add_recording_arguments, open_recording
from hoid_bags.sequence import Sequence
from hoid_benchmarks.animation import write_animation
from hoid_benchmarks.captions import draw_legend, draw_title
from hoid_benchmarks.map_animation import draw_growing_maps
from hoid_benchmarks.object_picture import draw_objects, object_rows, object_table
from hoid_benchmarks.plan.detections import every_image
from hoid_benchmarks.rooms.room_run import map_room
from hoid_bringup.run.detection_source import DetectionSource, detection_source
from hoid_bringup.run.options import DETECTOR_HELP
from hoid_bringup.run.run_config import RunConfig
from hoid_common.errors import ConfigError, InputError
from hoid_common.io.files import write_file, written
from hoid_common.values import ByteArray, Detections, RgbdFrame
from hoid_filter.config import FilterConfig
from hoid_filter.drawing import draw_result
from hoid_filter.feature_filter import FeatureFilter
from hoid_filter.strategy_registry import STRATEGIES

_NUM_SCENES = 3
_ANIMATED_PX, _ANIMATED_MS = 720, 400  # slowed down, so that verdicts can be read
_STATELESS = ('none', 'hoid2d', 'hoid3d')  # strategies that classify each image by itself


@dataclass(frozen=True, eq=False)
class Scene:
    """Results of the strategies for one frame, as (H, W, 3) BGR images."""

    verdict: ByteArray
    everything: ByteArray  # all features with the detections
    kept_2d: ByteArray
    kept_3d: ByteArray


def add_pictures_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `hoid pictures`."""
    add_recording_arguments(parser)
    parser.add_argument(
        '--out', type=Path, required=True, metavar='DIR', help='folder for the pictures'
    )
    parser.add_argument(
        '--frames',
        type=int,
        nargs='+',
        metavar='N',
        help='numbers of the frames, from 0 (default: three frames)',
    )
    parser.add_argument(
        '--filter',
        default=FilterConfig().strategy,
        choices=STRATEGIES,
        help='strategy whose verdicts are drawn',
    )
    parser.add_argument('--detector', metavar='MODEL', default='', help=DETECTOR_HELP)
    parser.add_argument(
        '--animation',
        action='store_true',
        help='also write animation.webp of the images from the first to the last of --frames',
    )
    parser.add_argument(
        '--objects',
        action='store_true',
        help='write objects.jpg, the object map, instead',
    )


def pictures_command(args: argparse.Namespace) -> None:
    """Write images with the filter's boxes and features, or, with `--objects`, the object map.

    Raises:
        HoidError: The recording, the detector, a frame number or the folder is invalid.
    """
    sequence = open_recording(args, args.input)
    wanted = frame_numbers(args.frames, len(sequence))
    run = RunConfig().updated({'detector.model': args.detector})
    if args.objects:
        _draw_object_map(
            sequence, wanted[0], run.updated({'filter.strategy': args.filter}), args.out
        )
        return
    detect = detection_source(sequence, every_image(run))  # needed even if the strategy is "none"
    config = FilterConfig(strategy=args.filter)
    scenes = dict(draw_scenes(sequence, wanted, detect, config))
    paths = write_sheets([scenes[n] for n in wanted], wanted, args.filter, args.out)
    if args.animation:
        paths += (args.out / 'animation.webp',)
        drawn = draw_growing_maps(sequence, detect, run.updated({'filter.strategy': args.filter}))
        shown = list(islice(drawn, max(wanted) + 1))[min(wanted) :]
        write_animation(paths[-1], shown, _ANIMATED_PX, _ANIMATED_MS)
    sys.stdout.writelines(f'{path}\n' for path in paths)


def _draw_object_map(sequence: Sequence, number: int, config: RunConfig, out: Path) -> None:
    """Map a recording, draw its object map, and print a table of the objects."""
    path = out / 'objects.jpg'
    room = map_room(sequence, config.updated({'object_map.enabled': True}))
    frame = next(frame for k, frame in enumerate(sequence) if k == number)
    with written(path):
        out.mkdir(parents=True, exist_ok=True)
        draw_objects(path, room, frame, sequence.camera)
    sys.stdout.write(f'{object_table(object_rows(room.objects, room.history))}{path}\n')


def frame_numbers(requested: list[int] | None, num_frames: int) -> list[int]:
    """Return the frames to draw: the requested ones, or three spread over the recording.

    Raises:
        ConfigError: A requested frame does not exist.
        InputError: The recording has no frames.
    """
    if num_frames == 0:
        raise InputError('the recording has no frames to draw')
    if requested is None:
        spread = np.linspace(0, num_frames - 1, _NUM_SCENES + 2)[1:-1]
        return list(dict.fromkeys(np.rint(spread).astype(int).tolist()))
    for number in requested:
        if not 0 <= number < num_frames:
            raise ConfigError(f'--frames {number}: the recording has frames 0 to {num_frames - 1}')
    return list(dict.fromkeys(requested))


def draw_scenes(
    sequence: Sequence, wanted: Iterable[int], detect: DetectionSource, config: FilterConfig
) -> Iterator[tuple[int, Scene]]:
    """Yield the number and pictures of each wanted frame, in order of time.

    The strategy of `config` may be stateful: it processes every frame up to the last wanted one.
    """
    chosen = frozenset(wanted)
    last = max(chosen)
    feature_filter = FeatureFilter(config, sequence.camera)
    for number, frame in enumerate(sequence):
        detections = detect(frame)
        result = feature_filter.process(frame, detections, for_picture=number in chosen)
        if number in chosen:
            verdict = draw_result(frame.image_bgr, result)
            stateless = _draw_stateless(frame, detections, config)
            yield (
                number,
                Scene(verdict, stateless['none'], stateless['hoid2d'], stateless['hoid3d']),
            )
        if number == last:
            return


def write_sheets(
    scenes: list[Scene], numbers: list[int], strategy: str, out: Path
) -> tuple[Path, ...]:
    """Write the three sheets of some scenes and return their paths.

    Raises:
        InputError: The folder cannot be written.
    """
    names = [f'{_letter(k)} (frame {n})' for k, n in enumerate(numbers)]
    titled = list(zip(names, scenes, strict=True))
    sheets: dict[str, ByteArray] = {
        'verdicts': np.hstack([draw_title(s.verdict, f'{n}: {strategy}') for n, s in titled]),
        'features': np.hstack([draw_title(s.everything, f'{n}: none') for n, s in titled]),
        'rules': np.vstack(
            [
                np.hstack(
                    [
                        draw_title(s.kept_2d, f'{n}: hoid2d'),
                        draw_title(s.kept_3d, f'{n}: hoid3d'),
                    ]
                )
                for n, s in titled
            ]
        ),
    }
    return tuple(_write(out / f'{name}.png', draw_legend(sheet)) for name, sheet in sheets.items())


def _draw_stateless(
    frame: RgbdFrame, detections: Detections | None, config: FilterConfig
) -> Mapping[str, ByteArray]:
    return {
        strategy: draw_result(
            frame.image_bgr,
            FeatureFilter(replace(config, strategy=strategy)).process(frame, detections),
        )
        for strategy in _STATELESS
    }


def _letter(k: int) -> str:
    return ascii_uppercase[k] if k < len(ascii_uppercase) else f'{k + 1}'


def _write(path: Path, picture: ByteArray) -> Path:
    _, data = cv2.imencode('.png', picture)
    write_file(path, data.tobytes())
    return path
