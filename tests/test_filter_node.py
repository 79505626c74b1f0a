"""hoid_filter on real topics: one image's features and verdicts, lateness, loss, wrong input."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from hoid_msgs.msg import Detection, DetectionArray, DynamicObjectArray
from hoid_msgs.msg import DynamicObject as ObjectMsg
from hoid_msgs.msg import Features as FeaturesMsg
from sensor_msgs.msg import CameraInfo, Image

from hoid_bringup.supervisor import Supervisor
from hoid_common.ros import conversions
from hoid_common.values import CameraModel
from hoid_system_tests.probe import Probe

HEIGHT, WIDTH = 480, 640
CAMERA = CameraModel(WIDTH, HEIGHT, 500.0, 500.0, 320.0, 240.0)
FRAME = 'camera_color_optical_frame'
START_NS = 1_305_031_102_175_304_123
PERIOD_NS = 33_333_333
PERSON = ('person', (100.0, 50.0, 300.0, 450.0))
CUP = ('cup', (280.0, 200.0, 320.0, 240.0))  # half of it in the person's box
TV = ('tv', (400.0, 40.0, 600.0, 200.0))
Row = tuple[str, tuple[float, float, float, float]]


def textured() -> Any:
    rng = np.random.default_rng(3)
    coarse = rng.integers(0, 256, (HEIGHT // 8, WIDTH // 8, 3), dtype=np.uint8)
    return cv2.resize(coarse, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)


IMAGE = textured()
DEPTH_M = np.full((HEIGHT, WIDTH), 2.0, np.float32)


class Peer:
    """Sends what the node needs and keeps what it says."""

    def __init__(self, probe: Probe) -> None:
        self.probe = probe
        self.features = probe.collect(FeaturesMsg, 'features', wait=False)
        self.objects = probe.collect(DynamicObjectArray, 'dynamic_objects', wait=False)
        self.diagnostics = probe.collect(DiagnosticArray, '/diagnostics', wait=False)
        self.color = probe.publisher(Image, 'rgb/image')
        self.depth = probe.publisher(Image, 'depth/image')
        self.boxes = probe.publisher(DetectionArray, 'detections')
        self.camera = probe.publisher(CameraInfo, 'rgb/camera_info')
        self.camera.publish(conversions.camera_to_msg(CAMERA, self.header(0)))
        probe.spin_for(0.2)

    def header(self, i: int) -> Any:
        return conversions.header_to_msg(START_NS + i * PERIOD_NS, FRAME)

    def send_images(self, i: int, depth_m: Any = DEPTH_M) -> None:
        self.color.publish(conversions.color_to_msg(IMAGE, self.header(i)))
        self.depth.publish(conversions.depth_to_msg(depth_m, self.header(i)))

    def send_boxes(self, i: int, *rows: Row, **fields: Any) -> None:
        found = [
            Detection(
                class_name=name, score=0.9, x_min=box[0], y_min=box[1], x_max=box[2], y_max=box[3]
            )
            for name, box in rows
        ]
        values = {'image_width': WIDTH, 'image_height': HEIGHT, 'detections': found, **fields}
        self.boxes.publish(DetectionArray(header=self.header(i), **values))

    def answer(self, number: int = 1) -> tuple[FeaturesMsg, DynamicObjectArray]:
        """Return the features and verdicts on the image, once `number` images were filtered."""
        self.probe.spin_until(
            lambda: len(self.features) >= number and len(self.objects) >= number, 'no features'
        )
        return self.features[number - 1], self.objects[number - 1]

    def said(self) -> tuple[str, dict[str, str]]:
        """Return the message and values of the node's newest diagnostics."""
        mine = [s for d in self.diagnostics for s in d.status if s.name == '/hoid_filter']
        if not mine:
            return '', {}
        return mine[-1].message, {v.key: v.value for v in mine[-1].values}

    def wait_for_count(self, name: str, number: int) -> None:
        self.probe.spin_until(
            lambda: int(self.said()[1].get(name, 0)) >= number, f'"{name}" stays below {number}'
        )


@pytest.fixture
def run(probe: Probe, start: Callable[..., Supervisor]) -> Callable[..., Peer]:
    def run_node(**params: Any) -> Peer:
        start('hoid_filter', 'hoid_filter_node', {'strategy': 'hoid2d', **params})
        return Peer(probe)

    return run_node


def positions(msg: FeaturesMsg) -> Any:
    return np.rint(np.array(msg.uv_px).reshape(-1, 2))


def num_inside(msg: FeaturesMsg, row: Row) -> int:
    uv, box = positions(msg), row[1]
    inside = (uv >= np.array(box[:2])) & (uv < np.array(box[2:]))
    return int(inside.all(axis=1).sum())


def test_values_of_one_image(run: Callable[..., Peer]) -> None:
    peer = run()
    peer.send_images(0)
    peer.send_boxes(0, PERSON, CUP, TV)
    features, objects = peer.answer()
    header = peer.header(0)
    assert features.header == header
    assert objects.header == header
    assert (features.image_width, features.image_height) == (WIDTH, HEIGHT)
    assert len(features.octave) == 1000
    assert set(features.depth_m) == {2.0}
    assert num_inside(features, PERSON) == num_inside(features, CUP) == 0
    assert num_inside(features, TV) > 50
    assert 0 < features.num_removed < features.num_detected
    assert [(o.class_name, o.dynamic, o.reason) for o in objects.objects] == [
        ('person', True, ObjectMsg.PERSON),
        ('cup', True, ObjectMsg.HANDLED),
        ('tv', False, ObjectMsg.STATIC),
    ]
    person, cup, _ = objects.objects
    assert cup.overlap_ratio == pytest.approx(0.5)
    assert cup.depth_gap_m == 0.0
    assert list(person.center_camera_m) == pytest.approx([-0.48, 0.04, 2.0])
    assert list(person.size_m) == pytest.approx([0.8, 1.6])


def test_skipped_image_goes_through_with_predicted_boxes(run: Callable[..., Peer]) -> None:
    peer = run()
    peer.send_images(0)
    peer.send_boxes(0, PERSON)
    peer.answer(1)
    peer.send_images(1)
    peer.send_images(2)
    peer.probe.spin_for(0.05)
    peer.send_boxes(2, PERSON)
    assert peer.answer(2)[1].objects[0].reason == ObjectMsg.PREDICTED
    features, objects = peer.answer(3)
    assert objects.objects[0].reason == ObjectMsg.PERSON
    assert features.header == peer.header(2)


def test_latest_mode_never_waits(run: Callable[..., Peer]) -> None:
    peer = run(**{'detections.mode': 'latest', 'detections.wait_s': 10.0})
    peer.send_boxes(0, PERSON)
    peer.probe.spin_for(0.2)
    peer.send_images(1)
    features, objects = peer.answer()
    assert objects.objects[0].reason == ObjectMsg.PREDICTED
    assert num_inside(features, PERSON) == 0


@pytest.mark.parametrize('on_loss', ['unfiltered', 'stop'])
def test_loss_of_the_detector_is_said_and_lived_with(
    run: Callable[..., Peer], on_loss: str
) -> None:
    peer = run(**{'detections.timeout_s': 0.5, 'detections.on_loss': on_loss})
    peer.send_images(0)
    peer.send_boxes(0, PERSON)
    peer.answer(1)
    for i in range(1, 31):
        peer.send_images(i)
        peer.probe.spin_for(0.033)
    peer.probe.spin_until(
        lambda: 'is the detector alive?' in peer.said()[0], 'the loss is not said'
    )
    if on_loss == 'stop':
        assert peer.features[-1].header.stamp != peer.header(30).stamp
    else:
        peer.probe.spin_until(
            lambda: peer.features[-1].header.stamp == peer.header(30).stamp, 'it stopped'
        )
        assert num_inside(peer.features[-1], PERSON) > 50
    peer.send_boxes(30, PERSON)
    peer.probe.spin_until(
        lambda: 'is the detector alive?' not in peer.said()[0], 'the detector stays lost'
    )
    peer.send_images(31)
    peer.send_boxes(31, PERSON)
    peer.probe.spin_until(
        lambda: peer.features[-1].header.stamp == peer.header(31).stamp, 'it does not come back'
    )
    assert num_inside(peer.features[-1], PERSON) == 0


def test_debug_image_is_drawn_for_a_listener(run: Callable[..., Peer]) -> None:
    peer = run()
    pictures = peer.probe.collect(Image, 'hoid_filter/debug_image')
    peer.probe.spin_for(0.3)
    peer.send_images(0)
    peer.send_boxes(0, PERSON)
    peer.probe.spin_until(lambda: bool(pictures), 'no picture')
    picture = conversions.color_from_msg(pictures[0])
    assert pictures[0].header == peer.header(0)
    assert picture.shape == IMAGE.shape
    assert picture[300, 100].tolist() == [60, 60, 230]  # the left edge of the person's box


NAN, INF = float('nan'), float('inf')


def test_wrong_boxes_are_refused_or_clipped_one_by_one(run: Callable[..., Peer]) -> None:
    peer = run()
    refused = [
        (NAN, 10.0, 50.0, 60.0),
        (0.0, 0.0, INF, 60.0),
        (90.0, 10.0, 50.0, 60.0),  # inverted
        (700.0, 10.0, 800.0, 60.0),  # outside
    ]
    for i, box in enumerate(refused):
        peer.send_images(i)
        peer.send_boxes(i, PERSON, ('cup', box))
        features, objects = peer.answer(i + 1)
        assert [o.class_name for o in objects.objects] == ['person']
        assert num_inside(features, PERSON) == 0
    peer.send_images(9)
    peer.send_boxes(9, ('cup', (600.0, 10.0, 800.0, 60.0)))
    assert peer.answer(5)[1].objects[0].x_max == WIDTH
    peer.wait_for_count('detections clipped', 1)
    peer.wait_for_count('detections refused', len(refused))


def test_whole_messages_that_are_wrong_are_refused(run: Callable[..., Peer]) -> None:
    peer = run(**{'detections.wait_s': 0.1})
    peer.send_images(0)
    peer.answer(1)
    peer.send_boxes(1, PERSON, image_width=1920, image_height=1080)
    peer.wait_for_count('detections refused', 1)
    peer.send_boxes(1, detections=[Detection() for _ in range(20_000)])
    peer.wait_for_count('detections refused', 2)
    peer.send_images(2)
    peer.send_boxes(2, PERSON)
    features, _ = peer.answer(2)
    assert num_inside(features, PERSON) == 0


def test_wrong_images_are_refused(run: Callable[..., Peer]) -> None:
    peer = run(**{'detections.wait_s': 0.1})
    peer.send_images(0, DEPTH_M[::2, ::2])
    peer.wait_for_count('depth images refused', 1)
    strange = conversions.color_to_msg(IMAGE, peer.header(1))
    strange.encoding = 'yuv422'
    peer.color.publish(strange)
    peer.depth.publish(conversions.depth_to_msg(DEPTH_M, peer.header(1)))
    peer.wait_for_count('depth images refused', 2)
    depth_m = np.tile(np.where(np.arange(WIDTH) % 2, np.float32('nan'), 2.5001), (HEIGHT, 1))
    holed = conversions.depth_to_msg(np.full((HEIGHT, WIDTH), np.float32(2.5001)), peer.header(2))
    holed.data = depth_m.astype(np.float32).tobytes()
    peer.color.publish(conversions.color_to_msg(IMAGE, peer.header(2)))
    peer.depth.publish(holed)
    peer.send_boxes(2, PERSON)
    features, _ = peer.answer()
    assert features.header == peer.header(2)
    assert set(features.depth_m) == {0.0, float(np.float32(2.5001))}


def test_scores_beyond_one_are_clipped(run: Callable[..., Peer]) -> None:
    peer = run()
    peer.send_images(0)
    name, box = PERSON
    sure = Detection(
        class_name=name, score=7.5, x_min=box[0], y_min=box[1], x_max=box[2], y_max=box[3]
    )
    peer.send_boxes(0, detections=[sure])
    _, objects = peer.answer()
    assert objects.objects[0].score == 1.0
    peer.wait_for_count('detections clipped', 1)
