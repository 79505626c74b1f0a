"""`hoid demo`: a rendered scene, replayed live with the filter and without."""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

from hoid_bags.bag.bag_sequence import BagSequence
from hoid_bringup.commands import say_detections
from hoid_bringup.evaluate.evaluation import align
from hoid_bringup.evaluate.plots import plot_comparison
from hoid_bringup.live.replay_plan import ReplayConfig
from hoid_bringup.run import outputs
from hoid_bringup.run.detection_source import detection_source
from hoid_bringup.run.run_config import RunConfig
from hoid_bringup.run.summary import Spread, Summary
from hoid_common.errors import InputError
from hoid_common.io.trajectory_io import read_tum
from hoid_common.values import ByteArray
from hoid_detector.model.model_path import SYNTHETIC
from hoid_filter.drawing import draw_result
from hoid_filter.feature_filter import FeatureFilter
from hoid_synth.bag import write_bag
from hoid_synth.config import SceneConfig

_WORKERS = 2
_RUNS = {'with the filter': RunConfig().filter.strategy, 'without': 'none'}
_NUM_SCENES = 4


def add_demo_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `hoid demo`."""
    scene = SceneConfig()
    parser.add_argument(
        '--out', type=Path, default=Path('out/demo'), metavar='DIR', help='default: %(default)s'
    )
    parser.add_argument('--seed', type=int, default=scene.seed, metavar='N', help='of the scene')
    parser.add_argument('--frames', type=int, default=300, metavar='N', help='at 30 Hz')
    parser.add_argument(
        '--detector', default=SYNTHETIC, metavar='MODEL', help='default: %(default)s'
    )


def demo_command(args: argparse.Namespace) -> None:
    """Show what the suite does, in a few minutes."""
    from hoid_bringup.live.replay import replay  # needs ROS

    bag_path = args.out / 'scene.bag'
    scene = SceneConfig(seed=args.seed, num_frames=args.frames)
    print(f'1/3  rendering {scene.frames} frames of a furnished home with two people')
    shutil.rmtree(bag_path, ignore_errors=True)
    write_bag(scene, bag_path, _WORKERS, show_progress=True)
    bag = BagSequence(bag_path)
    say_detections(RunConfig().updated({'detector.model': args.detector}))
    if args.detector == SYNTHETIC:
        print("detections: the project's own detector, trained on rendered homes of other seeds")
    summaries = {}
    for number, (label, strategy) in enumerate(_RUNS.items(), start=2):
        config = RunConfig().updated(
            {'filter.strategy': strategy, 'detector.model': args.detector}
        )
        print(f'{number}/3  replaying it in real time through the live nodes, {label}')
        summaries[label] = replay(bag, ReplayConfig(run=config), args.out / _folder(label))
    picture = args.out / 'demo.png'
    config = RunConfig().updated({'detector.model': args.detector})
    _draw(picture, bag, args.out, config)
    print(_table(summaries))
    print(f'\npicture      {picture}')
    print(f'all results  {args.out}')


def _folder(label: str) -> str:
    return label.replace(' the ', '_')


def _scenes(bag: BagSequence, config: RunConfig) -> list[ByteArray]:
    """Return pictures of what the filter decides, the busiest of each part of the bag."""
    detect = detection_source(bag, config)
    feature_filter = FeatureFilter(config.filter, bag.camera)
    best: dict[int, tuple[int, ByteArray]] = {}
    for i, frame in enumerate(bag):
        result = feature_filter.process(frame, detect(frame), for_picture=True)
        part, score = i * _NUM_SCENES // len(bag), sum(o.is_dynamic for o in result.objects)
        if score > best.get(part, (-1,))[0]:
            best[part] = score, draw_result(frame.image_bgr, result)
    return [picture for _, (_, picture) in sorted(best.items())]


def _draw(path: Path, bag: BagSequence, out: Path, config: RunConfig) -> None:
    truth = bag.ground_truth
    if truth is None:
        raise InputError(f'{bag.path}: has no ground truth')
    runs = {
        f'{label} ({strategy})': align(read_tum(out / _folder(label) / outputs.FINAL), truth)
        for label, strategy in _RUNS.items()
    }
    plot_comparison(path, runs, 'Rendered home with two people, live', _scenes(bag, config))


def _table(summaries: dict[str, Summary]) -> str:
    """Return the numbers of both runs side by side."""
    rows = [('', *summaries)]
    every = list(summaries.values())
    rows.append(('frames tracked', *(f'{s.frames_tracked} of {s.frames_total}' for s in every)))
    rows.append(('coverage', *(f'{100 * s.coverage:.1f} %' for s in every)))
    rows.append(('ATE RMSE', *(_metres(s.ate_rmse_m) for s in every)))
    rows.append(('time per frame', *(_median_ms(s.stage_ms.get('frame')) for s in every)))
    rows.append(('image to odometry', *(_median_ms(s.latency_ms) for s in every)))
    return '\n' + '\n'.join(f'{a:20s}{b:>18s}{c:>18s}' for a, b, c in rows)


def _metres(value_m: float | None) -> str:
    return '-' if value_m is None else f'{value_m:.4f} m'


def _median_ms(spread: Spread | None) -> str:
    return '-' if spread is None else f'{spread.median:.1f} ms'
