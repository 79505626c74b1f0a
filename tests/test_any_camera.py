"""Cameras as people have them, on real topics: frames, stamps, units, transports, encodings."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import cv2
import numpy as np
import pytest
from hoid_msgs.msg import DetectionArray
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import Header

from hoid_common.io.depth import MAX_DEPTH_M, MIN_DEPTH_M
from hoid_common.ros import conversions
from hoid_common.values import Features
from hoid_system_tests.filter_peer import DEPTH_M, IMAGE, PERSON, FilterRunner, Peer
from hoid_system_tests.frame_tree import OPTICAL
from hoid_system_tests.point_world import CAMERA, PointWorld, pose_after
from hoid_system_tests.probe import Probe
from hoid_system_tests.processes import Start
from hoid_system_tests.sample_bench import SampleBench
from hoid_system_tests.slam_peer import PERIOD_NS, START_NS, SlamPeer, features_msg
from rgbd_slam.store import map_file

pytestmark = pytest.mark.thorough

MS = 1_000_000
SMALL = np.full((16, 24, 3), (200, 120, 40), np.uint8)
DISTORTION = [0.26, -0.95, -0.005, 0.003, 1.16]
# A rectified camera, beside K and D of the raw image, as drivers publish it.
RECTIFIED = {'k': [580.0, 0, 310.0, 0, 580.0, 250.0, 0, 0, 1], 'd': DISTORTION}
STRAY_M = (1e5, 1e-4, 1e30, MAX_DEPTH_M * 1.01, MIN_DEPTH_M * 0.99)


def header(stamp_ms: int, frame: str = 'camera') -> Header:
    return conversions.header_to_msg(stamp_ms * MS, frame)


def image(pixels: NDArray[Any], encoding: str, stamp_ms: int, rows: int = 0) -> Image:
    """Return an image message; `rows` is the height if it is not that of the pixels."""
    pixels = np.ascontiguousarray(pixels)
    return Image(
        header=header(stamp_ms), height=rows or pixels.shape[0], width=pixels.shape[1],
        encoding=encoding, step=pixels.strides[0], data=pixels.tobytes(),
    )  # fmt: skip


def rectified_info() -> CameraInfo:
    msg = conversions.camera_to_msg(CAMERA, conversions.header_to_msg(START_NS, OPTICAL))
    for name, value in RECTIFIED.items():
        setattr(msg, name, value)
    return msg  # its P is that of CAMERA


def with_frame(msg: Any, frame: str) -> Any:
    msg.header.frame_id = frame
    return msg


@pytest.mark.parametrize('name', ['rgb/image', 'rgb/image/compressed'])
def test_rectified_images_have_the_scale_of_p(start: Start, probe: Probe, name: str) -> None:
    remap = f'{name}:=/camera/color/image_rect_color'
    compressed = {'input.compressed': True} if name.endswith('compressed') else {}
    start('rgbd_slam', 'rgbd_slam_node', compressed, ros_args=('-r', remap))
    peer, world, last = SlamPeer(probe), PointWorld(), 20
    peer.begin(rectified_info())
    for i in range(last + 1):
        pose = pose_after(i, turn_rad=0.004)
        peer.answer_to(features_msg(world.features(pose, START_NS + i * PERIOD_NS)))
    T_first, T_last = peer.pose(START_NS), peer.pose(START_NS + last * PERIOD_NS)
    moved_m = np.linalg.norm((np.linalg.inv(T_first) @ T_last)[:3, 3])
    assert moved_m == pytest.approx(np.linalg.norm(pose_after(last, 0.004)[:3, 3]), abs=0.004)
    assert 'rectified' not in peer.diagnosis()[0]


def test_images_that_may_be_rectified_are_doubted_once(start: Start, probe: Probe) -> None:
    start('rgbd_slam', 'rgbd_slam_node')
    peer = SlamPeer(probe)
    peer.begin(rectified_info())
    assert '/rgb/image is taken as not rectified' in peer.diagnosis()[0]


def test_the_filter_measures_rectified_images_by_p(start: Start, probe: Probe) -> None:
    peer = Peer(probe)
    remap = 'rgb/image:=/camera/color/image_rect_color'
    start('hoid_filter', 'hoid_filter_node', {'strategy': 'hoid2d'}, ros_args=('-r', remap))
    peer.color = probe.publisher(Image, '/camera/color/image_rect_color')
    peer.depth = probe.publisher(Image, 'depth/image')
    peer.boxes = probe.publisher(DetectionArray, 'detections')
    peer.camera = probe.publisher(CameraInfo, 'rgb/camera_info')
    info = conversions.camera_to_msg(CAMERA, peer.header(0))
    info.k, info.d = RECTIFIED['k'], DISTORTION
    peer.camera.publish(info)
    peer.wait_for_count('camera infos received', 1)
    peer.show(0, PERSON)
    _, objects = peer.answer()
    u, v = (PERSON[1][0] + PERSON[1][2]) / 2, (PERSON[1][1] + PERSON[1][3]) / 2
    expected = [(u - 319.5) / 525 * 2, (v - 239.5) / 525 * 2, 2.0]
    assert list(objects.objects[0].center_camera_m) == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize(
    ('frame', 'parameters', 'expected'),
    [('/camera_optical', {}, 'camera_optical'), ('', {'input.camera_frame': 'named'}, 'named')],
)
def test_the_filter_publishes_frames_that_are_valid_in_tf(
    run_filter: FilterRunner, frame: str, parameters: dict[str, Any], expected: str
) -> None:
    peer = run_filter(**parameters)
    peer.send_boxes(0, PERSON)
    peer.color.publish(with_frame(conversions.color_to_msg(IMAGE, peer.header(0)), frame))
    peer.depth.publish(with_frame(conversions.depth_to_msg(DEPTH_M, peer.header(0)), ''))
    features, objects = peer.answer()
    assert features.header.frame_id == objects.header.frame_id == expected


def test_the_filter_refuses_an_empty_frame_and_names_the_parameter(
    run_filter: FilterRunner,
) -> None:
    peer = run_filter()
    peer.color.publish(with_frame(conversions.color_to_msg(IMAGE, peer.header(0)), ''))
    peer.wait_for_count('color images refused', 1)
    message = peer.newest_diagnosis()[0]
    assert message.startswith('color images: frame_id is empty')
    assert 'input.camera_frame' in message
    assert peer.features == []


def test_one_compressed_topic_beside_a_raw_one(domain_id: int) -> None:
    sample = SampleBench(domain_id, '-r', 'rgb/image:=cam/color/compressed')
    colors = sample.probe.publisher(CompressedImage, 'cam/color/compressed')
    depths = sample.probe.publisher(Image, 'depth/image')
    colors.publish(conversions.compressed_color_to_msg(SMALL, header(1000), quality=95))
    depths.publish(image(np.full((16, 24), 1500, np.uint16), '16UC1', 1000))
    sample.probe.spin_until(lambda: len(sample.node.matches) == 1, 'no match')
    color, depth = (stamped.value for stamped in sample.node.matches[0].values)
    np.testing.assert_allclose(color, SMALL, atol=3)
    assert (depth == 1.5).all()
    sample.close()


GRAY = cv2.cvtColor(SMALL, cv2.COLOR_BGR2GRAY)


def bayer(order: str) -> NDArray[np.uint8]:
    """Return the pixels of SMALL behind a Bayer pattern, named as in ROS."""
    out = np.empty(SMALL.shape[:2], np.uint8)
    for k, letter in enumerate(order):
        channel = 'bgr'.index(letter)
        out[k // 2 :: 2, k % 2 :: 2] = SMALL[k // 2 :: 2, k % 2 :: 2, channel]
    return out


def nv12() -> NDArray[np.uint8]:
    planes = cv2.cvtColor(SMALL, cv2.COLOR_BGR2YUV_I420)
    height = SMALL.shape[0]
    u, v = planes[height:].reshape(2, -1)
    chroma = np.stack([u, v], axis=1).reshape(-1, SMALL.shape[1])
    return np.concatenate([planes[:height], chroma]).astype(np.uint8)


def uyvy() -> NDArray[np.uint8]:
    planes = cv2.cvtColor(SMALL, cv2.COLOR_BGR2YUV_I420)
    y, (u, v) = planes[0, 0], planes[SMALL.shape[0] :].reshape(2, -1)[:, 0]
    return np.tile(np.array([u, y, v, y], np.uint8), (16, 12))


def color_images() -> list[Image]:
    found = [image((GRAY.astype(np.uint16) << 8), 'mono16', 0)]
    found += [image(bayer(o), f'bayer_{o}8', 0) for o in ('rggb', 'bggr', 'gbrg', 'grbg')]
    yuv = image(uyvy(), 'yuv422', 0)
    yuv.width = SMALL.shape[1]
    return [*found, yuv, image(nv12(), 'nv12', 0, rows=SMALL.shape[0])]


def depth_images() -> list[Image]:
    signed = np.full((16, 24), 1500, np.int16)
    signed[0] = -7
    return [image(np.full((16, 24), 1.5), '64FC1', 0), image(signed, '16SC1', 0)]


def test_every_encoding_of_color_and_depth_is_received(sample: SampleBench) -> None:
    colors = sample.probe.publisher(Image, 'rgb/image')
    depths = sample.probe.publisher(Image, 'depth/image')
    sent = [
        *((c, depth_images()[0]) for c in color_images()),
        (color_images()[0], depth_images()[1]),
    ]
    for i, pair in enumerate(sent):
        for message, publisher in zip(pair, (colors, depths), strict=True):
            message.header = header(1000 + 33 * i)
            publisher.publish(message)
        sample.probe.spin_until_count(sample.node.matches, i + 1, f'{pair[0].encoding} is refused')
    for (color, depth), match in zip(sent, sample.node.matches, strict=True):
        bgr, depth_m = (stamped.value for stamped in match.values)
        is_gray = color.encoding == 'mono16'
        expected = np.repeat(GRAY[..., None], 3, axis=2) if is_gray else SMALL
        inner = np.abs(bgr.astype(int) - expected)[2:-2, 2:-2]
        assert inner.max() <= 4, color.encoding
        assert (depth_m[1:] == 1.5).all()
        assert (depth_m[0] == (0 if depth.encoding == '16SC1' else 1.5)).all()


def wait_for_more(sample: SampleBench, count: Callable[[], int], before: int) -> None:
    sample.probe.spin_until(lambda: count() > before, 'no depth image')


def feed(sample: SampleBench, offset_ms: float, count: int = 120) -> None:
    """Send color and depth images; depth is stamped later by an offset."""
    take_color = sample.node.sync.input('color', conversions.color_from_msg)
    depths = sample.probe.publisher(Image, 'depth/image')
    before = len(sample.node.matches)
    for i in range(count):
        color = image(SMALL, 'bgr8', 0)
        depth = image(np.full((16, 24), 1000 + i, np.uint16), '16UC1', 0)
        color_ns = 10**9 + i * 33 * MS + (i % 3) * MS // 2  # as real periods, not quite constant
        color.header.stamp = conversions.stamp_to_msg(color_ns)
        depth.header.stamp = conversions.stamp_to_msg(round(color_ns + offset_ms * MS))
        take_color(color)
        depths.publish(depth)
        received = partial(sample.count, 'depth images received')
        wait_for_more(sample, received, received())
    assert len(sample.node.matches) > before


def test_a_constant_offset_is_estimated_and_offered(sample: SampleBench) -> None:
    feed(sample, 25.0)
    assert '+25.0 ms' in sample.status().message
    assert '--depth-offset 0.0250' in sample.status().message


def test_a_known_offset_pairs_the_right_images(domain_id: int) -> None:
    sample = SampleBench(domain_id, '-p', 'input.depth_offset_s:=0.025')
    feed(sample, 25.0)
    assert 'ms' not in sample.status().message
    depths = [match.values[1].value[0, 0] for match in sample.node.matches]
    np.testing.assert_allclose(depths, 1 + np.arange(len(depths)) / 1000, atol=1e-6)
    sample.close()


def tenths(peer: Peer, i: int) -> None:
    """Send images whose depth is in units of 0.1 mm."""
    depth = np.round(DEPTH_M * 10_000).astype(np.uint16)
    depth_m = (depth / np.float32(1000)).astype(np.float32)
    message = conversions.depth_to_msg(depth_m, peer.header(i))
    assert message.encoding == '16UC1'
    peer.send_boxes(i)
    peer.color.publish(conversions.color_to_msg(IMAGE, peer.header(i)))
    peer.depth.publish(message)


def test_depth_in_other_units_is_read_when_the_parameter_names_them(
    run_filter: FilterRunner,
) -> None:
    peer = run_filter(**{'input.depth_units_per_m': 10_000.0})
    tenths(peer, 0)
    features, _ = peer.answer()
    assert set(features.depth_m) == {2.0}


def test_depth_in_other_units_is_doubted_and_the_parameter_named(
    run_filter: FilterRunner,
) -> None:
    peer = run_filter()
    for i in range(10):
        tenths(peer, i)
        peer.probe.spin_until_count(peer.features, i + 1, 'no features')
    peer.probe.spin_until(
        lambda: 'median of 20.00 m' in peer.newest_diagnosis()[0], 'the unit is not doubted'
    )
    assert 'input.depth_units_per_m' in peer.newest_diagnosis()[0]


def with_stray_depth(features: Features) -> Features:
    """Return features of which every twentieth has a depth that is no reading."""
    depth_m = features.depth_m.copy()
    depth_m[::20] = np.resize(np.array(STRAY_M, np.float32), len(depth_m[::20]))
    return Features(**(vars(features) | {'depth_m': depth_m}))


def test_a_map_with_stray_depth_is_saved(start: Start, probe: Probe, tmp_path: Any) -> None:
    parameters = {'map_directory': str(tmp_path)}
    start('rgbd_slam', 'rgbd_slam_node', parameters)
    peer, world = SlamPeer(probe), PointWorld()
    peer.begin()
    for i in range(40):
        pose = pose_after(i, turn_rad=0.004)
        seen = with_stray_depth(world.features(pose, START_NS + i * PERIOD_NS))
        peer.answer_to(features_msg(seen))
    moved_m = np.linalg.norm(
        (np.linalg.inv(peer.pose(START_NS)) @ peer.pose(START_NS + 39 * PERIOD_NS))[:3, 3]
    )
    assert moved_m == pytest.approx(np.linalg.norm(pose_after(39, 0.004)[:3, 3]), abs=0.006)
    saved = peer.save('stray')
    assert saved.success, saved.message
    assert len(map_file.load(tmp_path / 'stray.hoidmap').map) > 0


def test_stray_depth_in_an_image_is_no_reading(run_filter: FilterRunner) -> None:
    peer = run_filter()
    depth_m = DEPTH_M.copy()
    is_stray = np.random.default_rng(0).random(depth_m.shape) < 0.05
    depth_m[is_stray] = np.resize(np.array(STRAY_M, np.float32), is_stray.sum())
    message = Image(
        header=peer.header(0), height=480, width=640, encoding='32FC1', step=4 * 640,
        data=depth_m.tobytes(),
    )  # fmt: skip
    peer.send_boxes(0)
    peer.color.publish(conversions.color_to_msg(IMAGE, peer.header(0)))
    peer.depth.publish(message)
    features, _ = peer.answer()
    assert set(features.depth_m) == {0.0, 2.0}
