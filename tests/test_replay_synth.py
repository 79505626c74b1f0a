"""A rendered scene replayed through the real processes: accuracy, and effect of the filter."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hoid_bags.bag import bag_messages
from hoid_bags.bag.bag_sequence import BagSequence
from hoid_bags.bag.bag_writer import BagWriter
from hoid_bags.storage.bag_types import CAMERA_INFO, COMPRESSED_IMAGE, IMAGE, POSE_STAMPED
from hoid_bringup import cli
from hoid_common import topics
from hoid_common.io import images
from hoid_common.io.tum_text import read_tum
from hoid_synth.bag import write_bag
from hoid_synth.config import SceneConfig

pytestmark = [pytest.mark.thorough, pytest.mark.alone]

FRAMES = 75  # two people walk past, close to the camera
LATE_NS = 25_000_000


@pytest.fixture(scope='module')
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp('a scene') / 'scene.bag'
    write_bag(SceneConfig(num_frames=FRAMES), path, workers=2)
    return path


def replay(scene: Path, out: Path, *options: str) -> dict[str, Any]:
    argv = ['replay', str(scene), '--out', str(out), '--lockstep', '--detector', 'truth']
    assert cli.main([*argv, *options]) == 0
    summary: dict[str, Any] = json.loads((out / 'summary.json').read_text())
    return summary


@pytest.mark.usefixtures('domain_id')
def test_the_filter_reduces_the_error_and_no_image_is_lost(scene: Path, tmp_path: Path) -> None:
    filtered = replay(scene, tmp_path / 'with', '--filter', 'hoid2d')
    # The consensus would protect the pose as well.
    no_consensus = '--set', 'slam.tracking.consensus.enabled=false'
    plain = replay(scene, tmp_path / 'without', '--filter', 'none', *no_consensus)
    for summary in (filtered, plain):
        assert summary['frames_total'] == FRAMES
        assert summary['frames_processed'] == FRAMES
    assert filtered['coverage'] >= 0.98
    assert filtered['ate_rmse_m'] < 0.015
    assert filtered['ate_online_rmse_m'] < 0.03
    assert plain['ate_rmse_m'] > 2 * filtered['ate_rmse_m']
    assert filtered['filter']['features_removed'] > 0
    assert filtered['filter']['objects_dynamic'] > 0
    assert plain['filter']['features_removed'] == 0


@pytest.mark.usefixtures('domain_id')
def test_a_replay_agrees_with_the_offline_run(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    live = replay(scene, tmp_path / 'live', '--filter', 'hoid2d')
    assert 'ground-truth boxes' in capsys.readouterr().out
    argv = ['run', str(scene), '--out', str(tmp_path / 'offline'), '--detector', 'truth']
    assert cli.main([*argv, '--filter', 'hoid2d']) == 0
    offline = json.loads((tmp_path / 'offline' / 'summary.json').read_text())
    assert live['ate_rmse_m'] <= max(1.5 * offline['ate_rmse_m'], 0.01)
    for name in ('trajectory.txt', 'trajectory_online.txt'):
        trajectory = read_tum(tmp_path / 'live' / name)
        assert set(trajectory.stamps_ns) <= set(BagSequence(scene).depth_of_color)
        assert len(trajectory) == live['frames_tracked']
    assert len(read_tum(tmp_path / 'live' / 'keyframes.txt')) == live['keyframes'] > 2
    assert live['map_points'] > 300
    ply = (tmp_path / 'live' / 'map.ply').read_bytes()
    assert f'element vertex {live["map_points"]}\n'.encode() in ply
    assert set(live['stage_ms']) >= {'extract', 'filter', 'track', 'frame'}
    assert 0 < live['latency_ms']['median'] < 2000
    assert (tmp_path / 'live' / 'logs' / 'rgbd_slam.log').exists()
    assert not list((tmp_path / 'live').glob('.*'))


@pytest.mark.usefixtures('domain_id')
def test_a_node_that_cannot_start_ends_the_replay_with_its_message(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    argv = ['replay', str(scene), '--out', str(tmp_path / 'out'), '--detector', 'nowhere.onnx']
    assert cli.main(argv) == 1
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith('hoid replay: hoid_detector refused to start: ')
    assert 'nowhere.onnx' in error
    assert not (tmp_path / 'out' / 'summary.json').exists()


def as_of_a_driver(scene: Path, bag: Path, *, is_color_packed: bool) -> Path:
    """Write a scene with one packed image topic and a raw one; depth is late, in 0.1 mm."""
    sequence = BagSequence(scene)
    color, depth = '/cam/color/image_raw', '/cam/aligned_depth_to_color/image_raw'
    packed_or_raw = (IMAGE, COMPRESSED_IMAGE)
    color += '/compressed' * is_color_packed
    depth += '/compressedDepth' * (not is_color_packed)
    with BagWriter(bag) as writer:
        writer.add_topic('/cam/color/camera_info', CAMERA_INFO)
        writer.add_topic(topics.GROUND_TRUTH, POSE_STAMPED)
        writer.add_topic(color, packed_or_raw[is_color_packed])
        writer.add_topic(depth, packed_or_raw[not is_color_packed])
        truth = sequence.ground_truth
        assert truth is not None
        poses = dict(zip(truth.stamps_ns.tolist(), truth.T_world_camera, strict=True))
        for frame in sequence:
            ns, units = frame.stamp_ns, np.rint(frame.depth_m * 10_000).astype(np.uint16)
            info = bag_messages.camera_info(ns, sequence.camera)
            writer.write('/cam/color/camera_info', ns, info)
            pose = bag_messages.pose_stamped(ns, poses[ns])
            writer.write(topics.GROUND_TRUTH, ns, pose)
            jpeg = images.encode_jpeg(frame.image_bgr, 95)
            writer.write(
                color, ns,
                bag_messages.compressed_image(ns, jpeg, images.JPEG_FORMAT) if is_color_packed
                else bag_messages.image(ns, frame.image_bgr, 'bgr8'),
            )  # fmt: skip
            late_ns, png = ns + LATE_NS, images.encode_compressed_depth(units)
            writer.write(
                depth, ns,
                bag_messages.image(late_ns, units, '16UC1') if is_color_packed
                else bag_messages.compressed_image(late_ns, png, images.COMPRESSED_DEPTH_FORMAT),
            )  # fmt: skip
    return bag


@pytest.mark.usefixtures('domain_id')
@pytest.mark.parametrize('is_color_packed', [True, False])
def test_one_packed_topic_late_depth_and_other_units_are_replayed(
    scene: Path, tmp_path: Path, is_color_packed: bool
) -> None:
    bag = as_of_a_driver(scene, tmp_path / 'bag', is_color_packed=is_color_packed)
    argv = ['replay', str(bag), '--out', str(tmp_path / 'out'), '--lockstep', '--filter', 'none']
    assert cli.main([*argv, '--depth-offset', '0.025', '--depth-factor', '10000']) == 0
    summary = json.loads((tmp_path / 'out' / 'summary.json').read_text())
    assert summary['frames_processed'] == summary['frames_total'] == FRAMES
    assert summary['coverage'] >= 0.98
    assert summary['ate_rmse_m'] < 0.06  # people walk past, and nothing is filtered
