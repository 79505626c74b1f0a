"""The commands `run`, `replay` and `evaluate`."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from hoid_bags.imu_recording import joined_imu
from hoid_bags.options import add_recording_arguments
from hoid_bringup.evaluate.evaluation import Evaluation, evaluate
from hoid_bringup.live.replay_plan import ReplayConfig
from hoid_bringup.run import options
from hoid_bringup.run.no_detector import MOTION, NO_DETECTOR, STRATEGY, lacks_model
from hoid_bringup.run.offline import MapFiles, run_offline
from hoid_bringup.run.outputs import num_frames_of_run
from hoid_bringup.run.run_config import TRUTH, RunConfig
from hoid_bringup.run.summary import Summary
from hoid_common.errors import ConfigError, InputError
from hoid_common.io.files import write_file
from hoid_common.io.tum_text import read_tum
from rgbd_slam.robot_frames import camera_mount

_CAMERA_ROLL = 'detector.camera_roll_deg'


def _add_shared_arguments(parser: argparse.ArgumentParser) -> None:
    add_recording_arguments(parser)
    parser.add_argument(
        '--out', type=Path, required=True, metavar='DIR', help='folder for the results'
    )
    options.add_method_arguments(parser)


def add_run_arguments(parser: argparse.ArgumentParser) -> None:
    _add_shared_arguments(parser)
    parser.add_argument(
        '--dense',
        action='store_true',
        help='also write the dense map (cloud.ply) and the grid (grid.pgm, grid.yaml)',
    )
    parser.add_argument(
        '--mount',
        type=float,
        nargs=3,
        metavar=('ROLL', 'PITCH', 'YAW'),
        help='how the camera is mounted, in degrees: rolled clockwise, pitched down, yawed to the '
        'left (default: level)',
    )
    parser.add_argument(
        '--imu',
        action='append',
        default=[],
        metavar='FILE|TOPIC',
        help='samples of an IMU: a text file of stamp, wx wy wz (rad/s) or ax ay az (m/s^2) or '
        'both, or a topic; may be repeated (default: no IMU)',
    )
    parser.add_argument('--map', type=Path, metavar='FILE', help='saved map to start with')
    parser.add_argument(
        '--localize',
        action='store_true',
        help='only localize in the map of --map',
    )
    parser.add_argument(
        '--save-map', type=Path, metavar='FILE', help='file in which to save the map at the end'
    )


def run_command(args: argparse.Namespace) -> None:
    """Run SLAM on every frame of a recording, write the results and print a report.

    HoidError if an argument is invalid or the run fails; for a damaged recording, only after the
    readable part was processed.
    """
    config = with_mount(_config(args), args.mount)
    if config.live_only:
        names = ', '.join(config.live_only)
        raise ConfigError(f'{names}: for live nodes only; use "hoid replay", or leave it out')
    sequence = options.recording(args)
    maps = MapFiles(args.map, args.localize, args.save_map)
    summary = run_offline(
        sequence, config, args.out, dense=args.dense, recording=args.input, maps=maps,
        T_base_camera=None if args.mount is None else camera_mount(*args.mount),
        imu=joined_imu(args.imu, args.input) if args.imu else None,
    )  # fmt: skip
    print(run_report(summary, args.out))
    if sequence.fault:
        raise InputError(sequence.fault)


def with_mount(config: RunConfig, mount_deg: Sequence[float] | None) -> RunConfig:
    """Return the configuration with the roll in `mount_deg` as `detector.camera_roll_deg`.

    The detector then turns images upright, to the nearest quarter turn. `mount_deg` has roll
    (clockwise as seen from behind), pitch (down) and yaw (to the left) of the camera in degrees. A
    roll that is configured already is kept.
    """
    if mount_deg is None or _CAMERA_ROLL in config.changed():
        return config
    return config.updated({_CAMERA_ROLL: mount_deg[0]})


def add_replay_arguments(parser: argparse.ArgumentParser) -> None:
    _add_shared_arguments(parser)
    parser.add_argument(
        '--rate',
        type=float,
        default=ReplayConfig().rate,
        metavar='R',
        help='speed; 1 is real time (default: %(default)g)',
    )
    parser.add_argument(
        '--lockstep',
        action='store_true',
        help='publish each image after the odometry of the one before',
    )
    parser.add_argument(
        '--imu',
        action='append',
        default=[],
        metavar='TOPIC',
        help='topic of an IMU in the bag; may be repeated (default: no IMU)',
    )


def replay_command(args: argparse.Namespace) -> None:
    """Play a recording in real time to the nodes, write the results and print a report.

    HoidError if an argument is invalid or the replay fails; for a damaged bag, only after the
    readable part was played.
    """
    # It imports ROS, which the other commands do not need.
    from hoid_bringup.live.replay import replay

    config = ReplayConfig(
        rate=args.rate, lockstep=args.lockstep, run=_config(args), imu=tuple(args.imu)
    )
    with options.playable_bag(args) as bag:
        summary = replay(bag, config, args.out, recording=args.input)
    print(run_report(summary, args.out))
    if bag.fault:
        raise InputError(bag.fault)


def add_evaluate_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        'estimate', type=Path, metavar='ESTIMATE', help='estimated trajectory in TUM format'
    )
    parser.add_argument(
        'groundtruth', type=Path, metavar='GROUNDTRUTH', help='true trajectory in TUM format'
    )
    parser.add_argument(
        '--frames',
        type=int,
        metavar='N',
        help='number of frames of the recording, for the coverage '
        '(default: from the summary of the run beside ESTIMATE)',
    )
    parser.add_argument('--json', type=Path, metavar='FILE', help='write the errors as JSON')


def evaluate_command(args: argparse.Namespace) -> None:
    """Print the errors of a trajectory; write them to a JSON file if one is named."""
    num_frames = args.frames or num_frames_of_run(args.estimate)
    result = evaluate(read_tum(args.estimate), read_tum(args.groundtruth), num_frames)
    print(evaluation_report(result))
    if args.json is not None:
        text = json.dumps(asdict(result), indent=2) + '\n'
        write_file(args.json, text.encode())


def _config(args: argparse.Namespace) -> RunConfig:
    """Return the configuration; its strategy is `motion` if no detector model is found."""
    config = options.run_config(args)
    if lacks_model(config, options.given_parameters(args)):
        print(NO_DETECTOR)
        return config.updated({STRATEGY: MOTION})
    print_detection_note(config)
    return config


def print_detection_note(config: RunConfig) -> None:
    if config.needs_detections and config.detector.model == TRUTH:
        print('detections: ground-truth boxes of the rendered scene; no detector runs')


def run_report(summary: Summary, out_dir: Path) -> str:
    s = summary
    lines = [
        f'tracked    {s.frames_tracked} of {s.frames_total} frames ({100 * s.coverage:.1f} %)',
        f'processed  {s.frames_processed} frames',
        *([f'dropped    {dropped}'] if (dropped := dropped_frames(summary)) else []),
        f'map        {s.keyframes} keyframes, {s.map_points} points, {s.loops} loops',
    ]
    if s.frames_in_other_maps:
        lines.append(
            f'not merged {s.frames_in_other_maps} more frames, tracked in maps that were begun '
            'after a loss of tracking'
        )
    if s.ate_rmse_m is not None:
        online = s.ate_online_rmse_m
        lines.append(
            f'ATE RMSE   {s.ate_rmse_m:.4f} m'
            + (f' (online {online:.4f} m)' if online is not None else '')
        )
    if s.rpe_trans_1s_rmse_m is not None:
        lines.append(f'RPE 1 s    {s.rpe_trans_1s_rmse_m:.4f} m, {s.rpe_rot_1s_rmse_deg:.3f} deg')
    times = (('frame', s.stage_ms.get('frame')), ('latency', s.latency_ms))
    lines += [
        f'{name:10s} {spread.median:.1f} ms median, {spread.p95:.1f} ms p95'
        for name, spread in times
        if spread is not None
    ]
    lines.append(f'results    {out_dir}')
    return '\n'.join(lines)


def dropped_frames(summary: Summary) -> str:
    """Return a text about dropped frames of a replay and the reason, or '' if there are none."""
    num_dropped = summary.frames_total - summary.frames_processed
    if num_dropped <= 0 or not summary.cpu_share_by_node:
        return ''
    used = sum(summary.cpu_share_by_node.values())
    return (
        f'{num_dropped} frames, which arrived while earlier ones were processed: the nodes got '
        f'{used:.1f} of {os.cpu_count()} cores; stop other programs, or replay with --lockstep '
        'or a lower --rate'
    )


def evaluation_report(result: Evaluation) -> str:
    r = result
    spread = f'mean {r.ate_mean_m:.4f}, median {r.ate_median_m:.4f}, max {r.ate_max_m:.4f}'
    coverage = '' if r.coverage is None else f', coverage {100 * r.coverage:.1f} %'
    lines = [
        f'poses      {r.num_pairs} matched{coverage}',
        f'ATE        RMSE {r.ate_rmse_m:.4f} m, {spread}',
    ]
    if r.rpe_trans_1s_rmse_m is not None:
        lines.append(
            f'RPE 1 s    RMSE {r.rpe_trans_1s_rmse_m:.4f} m, {r.rpe_rot_1s_rmse_deg:.3f} deg'
        )
    return '\n'.join(lines)
