"""The command `pictures`: what the filter sees and decides, in the manner of the paper's figures.

For chosen frames of a recording (scenarios A, B, C ...) three sheets are written: the verdict on
each object (Figure 4), all features with the detections (Figure 6), and the features that the 2-D
rule and the 3-D rule keep, side by side (Figure 7).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from string import ascii_uppercase

import cv2
import numpy as np

from hoid_bags.options import add_folder_arguments, chosen_camera
from hoid_bags.sequence import Sequence, open_sequence
from hoid_bringup.run.detection_source import DetectionSource, detection_source
from hoid_bringup.run.run_config import TRUTH, RunConfig
from hoid_common.errors import ConfigError, InputError
from hoid_common.io.files import write_error
from hoid_common.values import ByteArray, Detections, RgbdFrame
from hoid_filter.config import FilterConfig
from hoid_filter.drawing import draw_result, draw_title
from hoid_filter.feature_filter import FeatureFilter
from hoid_filter.strategy_registry import STRATEGIES

_NUM_SCENES = 3
_ALONE = ('none', 'hoid2d', 'hoid3d')  # strategies that judge each image for itself


@dataclass(frozen=True, eq=False)
class Scene:
    """One frame as the strategies see it: (H, W, 3) BGR pictures."""

    verdict: ByteArray
    everything: ByteArray  # all features, with the detections
    kept_2d: ByteArray
    kept_3d: ByteArray


def add_pictures_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `hoid pictures`."""
    parser.add_argument('input', metavar='INPUT', type=Path, help='TUM folder or bag')
    parser.add_argument('--out', type=Path, required=True, metavar='DIR', help='pictures go here')
    parser.add_argument(
        '--frames', type=int, nargs='+', metavar='N', help='which, from 0 (default: three)'
    )
    parser.add_argument(
        '--filter', default=FilterConfig().strategy, choices=STRATEGIES, help='whose verdicts'
    )
    parser.add_argument(
        '--detector',
        metavar='MODEL',
        default='',
        help=f'ONNX file; "{TRUTH}": the exact boxes of a rendered bag (default: usual places)',
    )
    add_folder_arguments(parser)


def pictures_command(args: argparse.Namespace) -> None:
    """Write the sheets.

    Raises:
        HoidError: the recording, the detector, a frame's number or the folder cannot be used.
    """
    sequence = open_sequence(args.input, chosen_camera(args), args.depth_factor)
    wanted = frame_numbers(args.frames, len(sequence))
    run = RunConfig().updated({'detector.model': args.detector})
    detect = detection_source(sequence, run)  # also for "none"
    config = FilterConfig(strategy=args.filter)
    scenes = dict(draw_scenes(sequence, wanted, detect, config))
    for path in write_sheets([scenes[n] for n in wanted], wanted, args.filter, args.out):
        sys.stdout.write(f'{path}\n')


def frame_numbers(requested: list[int] | None, num_frames: int) -> list[int]:
    """Return the frames to draw: those asked for, or three spread over the recording.

    Raises:
        ConfigError: there is no such frame.
        InputError: there are no frames at all.
    """
    if num_frames == 0:
        raise InputError('the recording holds no frames to draw')
    if requested is None:
        spread = np.linspace(0, num_frames - 1, _NUM_SCENES + 2)[1:-1]
        return list(dict.fromkeys(np.rint(spread).astype(int).tolist()))
    for number in requested:
        if not 0 <= number < num_frames:
            raise ConfigError(f'--frames {number}: the recording has 0 to {num_frames - 1}')
    return list(dict.fromkeys(requested))


def draw_scenes(
    sequence: Sequence, wanted: Iterable[int], detect: DetectionSource, config: FilterConfig
) -> Iterator[tuple[int, Scene]]:
    """Yield the wanted frames' numbers and pictures, in order of time.

    The strategy of `config` gets every frame up to the last one, as it may remember what it saw.
    """
    chosen = frozenset(wanted)
    last = max(chosen)
    judge = FeatureFilter(config, sequence.camera)
    for number, frame in enumerate(sequence):
        detections = detect(frame)
        result = judge.process(frame, detections, for_picture=number in chosen)
        if number in chosen:
            verdict = draw_result(frame.image_bgr, result)
            alone = _drawn_alone(frame, detections, config)
            yield number, Scene(verdict, alone['none'], alone['hoid2d'], alone['hoid3d'])
        if number == last:
            return


def write_sheets(
    scenes: list[Scene], numbers: list[int], strategy: str, out: Path
) -> tuple[Path, ...]:
    """Write the three sheets of some scenes and return where they are.

    Raises:
        InputError: the folder cannot be written.
    """
    names = [f'{_letter(k)} (frame {n})' for k, n in enumerate(numbers)]
    titled = list(zip(names, scenes, strict=True))
    sheets: dict[str, ByteArray] = {
        'verdicts': np.hstack([draw_title(s.verdict, f'{n}: {strategy}') for n, s in titled]),
        'features': np.hstack([draw_title(s.everything, f'{n}: all') for n, s in titled]),
        'rules': np.vstack(
            [
                np.hstack(
                    [
                        draw_title(s.kept_2d, f'{n}: kept by the 2-D rule'),
                        draw_title(s.kept_3d, f'{n}: kept by the 3-D rule'),
                    ]
                )
                for n, s in titled
            ]
        ),
    }
    return tuple(_write(out / f'{name}.png', sheet) for name, sheet in sheets.items())


def _drawn_alone(
    frame: RgbdFrame, detections: Detections | None, config: FilterConfig
) -> Mapping[str, ByteArray]:
    return {
        strategy: draw_result(
            frame.image_bgr,
            FeatureFilter(replace(config, strategy=strategy)).process(frame, detections),
        )
        for strategy in _ALONE
    }


def _letter(k: int) -> str:
    return ascii_uppercase[k] if k < len(ascii_uppercase) else f'{k + 1}'


def _write(path: Path, picture: ByteArray) -> Path:
    _, data = cv2.imencode('.png', picture)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data.tobytes())
    except OSError as error:
        raise write_error(path, error) from error
    return path
