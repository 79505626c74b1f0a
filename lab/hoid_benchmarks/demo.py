"""`hoid demo`: a scene with people, rendered or recorded, run with and without the filter."""

from __future__ import annotations

import argparse
import os
import shutil
from pathlib import Path

import cv2
import numpy as np

from hoid_bags.bag.bag_sequence import BagSequence
from hoid_benchmarks.demo_picture import DemoRun, Snapshot, draw_demo, write_animation
from hoid_benchmarks.plan.plan import load_profile
from hoid_bringup.commands import print_detection_note
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
from hoid_common.io.trajectory_io import read_tum
from hoid_common.values import ByteArray, FilterResult, Reason, RgbdFrame
from hoid_detector.model.model_path import SYNTHETIC
from hoid_filter.drawing import KEPT_BGR, REASON_BGR, REMOVED_BGR, draw_points
from hoid_filter.feature_filter import FeatureFilter
from hoid_synth.bag import write_bag
from hoid_synth.config import SceneConfig
from rgbd_slam.scene.export import read_ply

_WORKERS = 2
_FRAMES, _SECONDS = 210, 20.0
_SNAPSHOTS = (0.35, 0.6, 0.85)  # as shares of the recording
_ANIMATED_EVERY = 10
_ANIMATED_PX = (240, 180)
# Predicted and remembered objects would clutter the picture.
_DRAWN = (Reason.PERSON, Reason.HANDLED)
# The baseline of the paper, and the default configuration.
_WITHOUT, _WITH = "ORB-SLAM3's rules, no filter", 'HOID'


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
        help='time to record from the camera in s (default: %(default)g)',
    )


def demo_command(args: argparse.Namespace) -> None:
    """Render or record a scene, run it with and without the filter, and draw the comparison."""
    from hoid_bringup.live.replay import replay  # needs ROS

    bag_path = args.out / 'scene.bag'
    shutil.rmtree(bag_path, ignore_errors=True)
    if args.camera:
        _record(args, bag_path)
    else:
        print(f'1/3  rendering {args.frames} frames of three people who walk past the camera')
        write_bag(_scene(args), bag_path, _WORKERS, show_progress=True)
    bag = BagSequence(bag_path)
    configs = _configs(args)
    print_detection_note(configs[_WITH])
    print(f'2/3  processing every image offline, without a time limit: {_WITHOUT}')
    summaries = {_WITHOUT: run_offline(bag, configs[_WITHOUT], args.out / _folder(_WITHOUT))}
    print(f'3/3  replaying it in real time through the live nodes: {_WITH}')
    summaries[_WITH] = replay(bag, ReplayConfig(run=configs[_WITH]), args.out / _folder(_WITH))
    picture, animation = args.out / 'demo.png', args.out / 'demo.gif'
    frames = _pictures(bag, configs[_WITH])
    shown = [frames[int(share * len(frames))] for share in _SNAPSHOTS]
    draw_demo(picture, {label: _run(bag, args.out, label) for label in configs}, shown)
    write_animation(
        animation,
        [cv2.resize(f.image_bgr, _ANIMATED_PX) for f in frames[::_ANIMATED_EVERY]],  # type: ignore[misc]
    )
    print(_table(summaries))
    print(f'\npicture      {picture}\nanimation    {animation}\nall results  {args.out}')


def _record(args: argparse.Namespace, bag_path: Path) -> None:
    """Record the topics of a camera, after waiting for them to appear."""
    from hoid_bags.live.record import record  # needs ROS

    names = CAMERA_TOPICS[args.camera].topics(args.camera_namespace)
    print(f'1/3  recording {args.seconds:g} s of {", ".join(names)}: look around')
    bag_path.parent.mkdir(parents=True, exist_ok=True)
    record(bag_path, names, duration_s=args.seconds, show_progress=True)
    # The camera keeps publishing, so the replay needs its own domain.
    os.environ.pop(VARIABLE, None)


def _scene(args: argparse.Namespace) -> SceneConfig:
    return SceneConfig(
        seed=args.seed, num_frames=args.frames, path='xyz', num_people=3, near_m=1.5, together=True
    )


def _configs(args: argparse.Namespace) -> dict[str, RunConfig]:
    """Return the compared configurations by label."""
    seed_method = {**load_profile('orb_slam3'), STRATEGY: 'none'}
    model = args.detector or ('' if args.camera else SYNTHETIC)
    ours = RunConfig().updated({'detector.model': model})
    if lacks_model(ours, ()):
        print(NO_DETECTOR)
        ours = ours.updated({STRATEGY: MOTION})
    return {_WITHOUT: RunConfig().updated(seed_method), _WITH: ours}


def _folder(label: str) -> str:
    return 'with_filter' if label == _WITH else 'without'


def _pictures(bag: BagSequence, config: RunConfig) -> list[Snapshot]:
    """Return the images with the decisions of the filter drawn into them."""
    detect = detection_source(bag, config)
    feature_filter = FeatureFilter(config.filter, bag.camera)
    found = []
    for frame in bag:
        result = feature_filter.process(frame, detect(frame), for_picture=True)
        found.append(Snapshot(frame.stamp_ns, _drawn(frame, result)))
    return found


def _drawn(frame: RgbdFrame, result: FilterResult) -> ByteArray:
    picture = frame.image_bgr.copy()
    draw_points(picture, result.removed_uv_px, REMOVED_BGR)
    draw_points(picture, result.features.uv_px, KEPT_BGR)
    for item in result.objects:
        if item.reason in _DRAWN:
            x1, y1, x2, y2 = np.rint(item.box_xyxy_px).astype(int).tolist()
            cv2.rectangle(picture, (x1, y1), (x2 - 1, y2 - 1), REASON_BGR[item.reason], 2)
    return picture


def _run(bag: BagSequence, out: Path, label: str) -> DemoRun:
    """Return trajectory and map of a run, aligned to the ground truth if it is known."""
    folder = out / _folder(label)
    found = read_tum(folder / outputs.FINAL)
    points_m = read_ply(folder / outputs.MAP).points_m.astype(np.float64)
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


def _table(summaries: dict[str, Summary]) -> str:
    """Return a table with the numbers of both runs side by side."""
    rows = [('', *summaries)]
    every = list(summaries.values())
    rows.append(('frames tracked', *(f'{s.frames_tracked} of {s.frames_total}' for s in every)))
    rows.append(('coverage', *(f'{100 * s.coverage:.1f} %' for s in every)))
    rows.append(('ATE RMSE', *(_meters(s.ate_rmse_m) for s in every)))
    rows.append(('time per frame', *(_median_ms(s.stage_ms.get('frame')) for s in every)))
    rows.append(('image to odometry', *(_median_ms(s.latency_ms) for s in every)))
    return '\n' + '\n'.join(f'{a:20s}{b:>30s}{c:>12s}' for a, b, c in rows)


def _meters(value_m: float | None) -> str:
    return '-' if value_m is None else f'{value_m:.4f} m'


def _median_ms(spread: Spread | None) -> str:
    return '-' if spread is None else f'{spread.median:.1f} ms'
