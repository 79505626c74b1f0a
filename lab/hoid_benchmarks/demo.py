"""`hoid demo`: a scene with people, rendered or recorded, run in three configurations."""

from __future__ import annotations

import argparse
import itertools
import os
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from hoid_bags.bag.bag_sequence import BagSequence
from hoid_benchmarks.animation import write_animation
from hoid_benchmarks.demo_picture import DemoRun, Snapshot, draw_demo
from hoid_benchmarks.map_animation import points_camera_m
from hoid_benchmarks.plan.plan import load_profile
from hoid_bringup.commands import dropped_frames, print_detection_note
from hoid_bringup.evaluate.evaluation import align
from hoid_bringup.live.replay_plan import ReplayConfig
from hoid_bringup.live.ros_domain import VARIABLE
from hoid_bringup.run import outputs
from hoid_bringup.run.detection_source import detection_source
from hoid_bringup.run.no_detector import MOTION, NO_DETECTOR, STRATEGY, lacks_model
from hoid_bringup.run.offline import run_offline
from hoid_bringup.run.run_config import RunConfig
from hoid_bringup.run.summary import Spread, Summary
from hoid_common import se3
from hoid_common.camera_topics import CAMERA_TOPICS
from hoid_common.errors import HoidError
from hoid_common.io.tum_text import read_tum
from hoid_common.values import (
    ByteArray,
    FilterResult,
    FloatArray,
    ObjectState,
    RgbdFrame,
    Trajectory,
)
from hoid_detector.model.model_path import SYNTHETIC
from hoid_filter.drawing import KEPT_BGR, REASON_BGR, REMOVED_BGR, draw_points
from hoid_filter.feature_filter import FeatureFilter
from hoid_synth.bag import write_bag
from hoid_synth.config import SceneConfig

_WORKERS = 2
_FRAMES, _SECONDS = 150, 20.0
_SNAPSHOTS = (0.35, 0.6, 0.85)  # as shares of the recording
_ANIMATED_EVERY = 8
_MAPPED_EVERY = 5  # chosen: images whose features the floor plans show
_ANIMATED_PX = 320  # width
# Predicted and remembered objects would clutter the picture.
_DRAWN = (ObjectState.PERSON, ObjectState.HANDLED)
# The baseline of the paper, this tracker without a filter, and the default configuration.
_RULES, _WITHOUT, _WITH = "ORB-SLAM3's rules", 'ours, no filter', 'ours, HOID'
_FOLDERS = {_RULES: 'orb_slam3_rules', _WITHOUT: 'without', _WITH: 'with_filter'}
_LIVE, _LIVE_FOLDER = 'HOID live here', 'live'
_NOTE = f"{_RULES}: this tracker with ORB-SLAM3's thresholds; only the last column varies"
_NO_FILTER = 'none'


def add_demo_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `hoid demo`."""
    parser.add_argument(
        '--out',
        type=Path,
        default=Path('out/demo'),
        metavar='DIR',
        help='folder for the results (default: %(default)s)',
    )
    parser.add_argument(
        '--seed', type=int, default=1, metavar='N', help='seed of the rendered scene'
    )
    parser.add_argument(
        '--frames',
        type=int,
        default=_FRAMES,
        metavar='N',
        help='number of rendered frames at 30 Hz (default: %(default)s)',
    )
    parser.add_argument(
        '--detector',
        metavar='MODEL',
        help=f'ONNX model of the detector, a file or a known name (default: {SYNTHETIC}; with a '
        'camera, search for a model)',
    )
    parser.add_argument(
        '--camera',
        choices=tuple(CAMERA_TOPICS),
        help='running camera driver to use instead of a rendered scene',
    )
    parser.add_argument(
        '--camera-namespace',
        default='',
        metavar='NS',
        help='namespace of the camera driver (default: its own default)',
    )
    parser.add_argument(
        '--seconds',
        type=float,
        default=_SECONDS,
        metavar='S',
        help='time to record in s (default: %(default)g)',
    )


def demo_command(args: argparse.Namespace) -> None:
    """Render or record a scene, run it in three configurations, and draw the comparison.

    They run offline, on every image, so that the load of the computer changes nothing. A run in
    real time follows, which says what this computer can do.
    """
    bag_path = args.out / 'scene.bag'
    shutil.rmtree(bag_path, ignore_errors=True)
    if args.camera:
        _record(args, bag_path)
    else:
        print(f'1/5  rendering {args.frames} images: two people carry a screen past the camera')
        write_bag(_scene(args), bag_path, _WORKERS, show_progress=True)
    bag = BagSequence(bag_path)
    configs = _configs(args)
    print_detection_note(configs[_WITH])
    summaries: dict[str, Summary] = {}
    for step, (label, config) in enumerate(configs.items(), 2):
        print(f'{step}/5  processing every image offline, without a time limit: {label}')
        summaries[label] = run_offline(bag, config, args.out / _FOLDERS[label])
    print('5/5  replaying it in real time through the live nodes')
    picture, animation = _draw(bag, configs, args.out)
    live, in_time = _live(bag, configs[_WITH], args.out / _LIVE_FOLDER)
    print(_table(summaries if live is None else {**summaries, _LIVE: live}))
    print(f'\n{_NOTE}')
    print(f'\nlive here    {in_time}')
    print(f'picture      {picture}\nanimation    {animation}\nall results  {args.out}')


def _live(bag: BagSequence, config: RunConfig, out: Path) -> tuple[Summary | None, str]:
    """Run the live nodes; return their summary, and how many images were processed in time.

    If this computer cannot run them, the summary is None, and the text says why.
    """
    from hoid_bringup.live.replay import replay  # needs ROS

    try:
        live = replay(bag, ReplayConfig(run=config), out)
    except HoidError as error:
        return None, f'not measured: {error}'
    if dropped := dropped_frames(live):
        print(f'     dropped {dropped}')
    return live, f'{live.frames_processed} of {live.frames_total} images in time'


def _draw(bag: BagSequence, configs: Mapping[str, RunConfig], out: Path) -> tuple[Path, Path]:
    """Draw the picture and the animation of finished runs, and return their paths."""
    picture, animation = out / 'demo.png', out / 'demo.webp'
    frames = _filtered(bag, configs[_WITH])
    everything = _filtered(bag, configs[_WITHOUT], _MAPPED_EVERY)
    seen = {_RULES: everything, _WITHOUT: everything, _WITH: frames[::_MAPPED_EVERY]}
    runs = {label: _run(bag, out / _FOLDERS[label], seen[label]) for label in configs}
    draw_demo(picture, runs, [frames[int(share * len(frames))] for share in _SNAPSHOTS])
    write_animation(animation, [f.image_bgr for f in frames[::_ANIMATED_EVERY]], _ANIMATED_PX)
    return picture, animation


def _record(args: argparse.Namespace, bag_path: Path) -> None:
    """Record the topics of a camera, after waiting for them to appear."""
    from hoid_bags.live.record import record  # needs ROS

    names = CAMERA_TOPICS[args.camera].topics(args.camera_namespace)
    print(f'1/5  recording {args.seconds:g} s of {", ".join(names)}: look around')
    bag_path.parent.mkdir(parents=True, exist_ok=True)
    record(bag_path, names, duration_s=args.seconds, show_progress=True)
    # The camera keeps publishing, so the replay needs its own domain.
    os.environ.pop(VARIABLE, None)


def _scene(args: argparse.Namespace) -> SceneConfig:
    return SceneConfig(
        seed=args.seed, num_frames=args.frames, path='xyz', near_m=1.5, event='carry_screen'
    )


def _configs(args: argparse.Namespace) -> dict[str, RunConfig]:
    """Return the compared configurations by label."""
    rules = {**load_profile('orb_slam3'), STRATEGY: _NO_FILTER}
    model = args.detector or ('' if args.camera else SYNTHETIC)
    ours = RunConfig().updated({'detector.model': model})
    if lacks_model(ours, ()):
        print(NO_DETECTOR)
        ours = ours.updated({STRATEGY: MOTION})
    return {
        _RULES: RunConfig().updated(rules),
        _WITHOUT: RunConfig().updated({STRATEGY: _NO_FILTER}),
        _WITH: ours,
    }


def _filtered(bag: BagSequence, config: RunConfig, every: int = 1) -> list[Snapshot]:
    """Return every n-th image with the decisions of the filter drawn into it."""
    detect = detection_source(bag, config)
    feature_filter = FeatureFilter(config.filter, bag.camera)
    found = []
    for frame in itertools.islice(bag, 0, None, every):
        result = feature_filter.process(frame, detect(frame), for_picture=True)
        points_m = points_camera_m(bag.camera, result.features)
        found.append(Snapshot(frame.stamp_ns, _drawn(frame, result), points_m))
    return found


def _drawn(frame: RgbdFrame, result: FilterResult) -> ByteArray:
    picture = frame.image_bgr.copy()
    draw_points(picture, result.removed_uv_px, REMOVED_BGR)
    draw_points(picture, result.features.uv_px, KEPT_BGR)
    for item in result.objects:
        if item.state in _DRAWN:
            x1, y1, x2, y2 = np.rint(item.box_xyxy_px).astype(int).tolist()
            cv2.rectangle(picture, (x1, y1), (x2 - 1, y2 - 1), REASON_BGR[item.state], 2)
    return picture


def _run(bag: BagSequence, folder: Path, seen: Sequence[Snapshot]) -> DemoRun:
    """Return the trajectory of a run and the features of images where its poses place them.

    Both are aligned to the ground truth if it is known.
    """
    found = read_tum(folder / outputs.FINAL)
    points_m = _placed_m(found, seen)
    if bag.ground_truth is None:
        return DemoRun(found.stamps_ns, found.T_world_camera, points_m)
    path = align(found, bag.ground_truth)
    return DemoRun(
        path.stamps_ns,
        path.T_world_camera,
        se3.transform(path.T_world_map, points_m),
        path.T_world_camera_true,
        path.error_m,
    )


def _placed_m(found: Trajectory, seen: Sequence[Snapshot]) -> FloatArray:
    """Return the features (N, 3) of images in the map frame of a trajectory, in m."""
    poses = dict(zip(found.stamps_ns.tolist(), found.T_world_camera, strict=True))
    placed = [
        se3.transform(poses[image.stamp_ns], image.points_camera_m)
        for image in seen
        if image.stamp_ns in poses
    ]
    return np.concatenate([np.empty((0, 3)), *placed])


def _table(summaries: dict[str, Summary]) -> str:
    """Return a table with the numbers of all runs side by side."""
    rows = [('', *summaries)]
    every = list(summaries.values())
    rows.append(('frames tracked', *(f'{s.frames_tracked} of {s.frames_total}' for s in every)))
    rows.append(('ATE RMSE', *(_meters(s.ate_rmse_m) for s in every)))
    rows.append(('time per frame', *(_median_ms(s.stage_ms.get('frame')) for s in every)))
    rows.append(('image to odometry', *(_median_ms(s.latency_ms) for s in every)))
    return '\n' + '\n'.join(
        ''.join([f'{name:17s}', *(f'{text:>18s}' for text in texts)]) for name, *texts in rows
    )


def _meters(value_m: float | None) -> str:
    return '-' if value_m is None else f'{value_m:.4f} m'


def _median_ms(spread: Spread | None) -> str:
    return '-' if spread is None else f'{spread.median:.1f} ms'
