"""Peer of hoid_filter: publishes images and boxes, and collects the outputs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from hoid_msgs.msg import Detection, DetectionArray, DynamicObjectArray, FeatureVerdicts
from hoid_msgs.msg import Features as FeaturesMsg
from sensor_msgs.msg import CameraInfo, Image

from hoid_common.ros import conversions
from hoid_common.values import CameraModel
from hoid_system_tests.probe import TIMEOUT_S, Probe

HEIGHT, WIDTH = 480, 640
CAMERA = CameraModel(WIDTH, HEIGHT, 500.0, 500.0, 320.0, 240.0)
FRAME = 'camera_color_optical_frame'
START_NS = 1_305_031_102_175_304_123
PERIOD_NS = 33_333_333
PERSON = ('person', (100.0, 50.0, 300.0, 450.0))
CUP = ('cup', (280.0, 200.0, 320.0, 240.0))  # half of it is in the person's box
TV = ('tv', (400.0, 40.0, 600.0, 200.0))
Row = tuple[str, tuple[float, float, float, float]]


def _textured() -> Any:
    rng = np.random.default_rng(3)
    coarse = rng.integers(0, 256, (HEIGHT // 8, WIDTH // 8, 3), dtype=np.uint8)
    return cv2.resize(coarse, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)


IMAGE = _textured()
DEPTH_M = np.full((HEIGHT, WIDTH), 2.0, np.float32)


class Peer:
    """Publishes the inputs of the filter node and collects its outputs.

    Make it before the node starts and `connect` afterwards. The node then knows the subscriptions
    before it can receive an image; a subscription that it discovers later, on a busy machine,
    misses the first results.
    """

    def __init__(self, probe: Probe) -> None:
        self.probe = probe
        self.features = probe.collect(FeaturesMsg, 'features', wait=False)
        self.objects = probe.collect(DynamicObjectArray, 'dynamic_objects', wait=False)
        self.verdicts = probe.collect(FeatureVerdicts, 'feature_verdicts', wait=False)
        self.diagnostics = probe.collect(DiagnosticArray, '/diagnostics', wait=False)

    def connect(self, *, waits_for_boxes: bool = True) -> None:
        """Wait until the node subscribes to the inputs, and send it the camera."""
        self.color = self.probe.publisher(Image, 'rgb/image')
        self.depth = self.probe.publisher(Image, 'depth/image')
        self.boxes = self.probe.publisher(DetectionArray, 'detections', wait=waits_for_boxes)
        self.camera = self.probe.publisher(CameraInfo, 'rgb/camera_info')
        self.camera.publish(conversions.camera_to_msg(CAMERA, self.header(0)))
        self.wait_for_count('camera infos received', 1)

    def header(self, i: int) -> Any:
        """Return the header of frame i."""
        return conversions.header_to_msg(START_NS + i * PERIOD_NS, FRAME)

    def send_images(self, i: int, depth_m: Any = DEPTH_M, image_bgr: Any = IMAGE) -> None:
        """Publish the images of frame i."""
        self.color.publish(conversions.color_to_msg(image_bgr, self.header(i)))
        self.depth.publish(conversions.depth_to_msg(depth_m, self.header(i)))

    def send_boxes(self, i: int, *rows: Row, **fields: Any) -> None:
        """Publish the detections of frame i; `fields` replace those of the message."""
        found = [
            Detection(
                class_name=name, score=0.9, x_min=box[0], y_min=box[1], x_max=box[2], y_max=box[3]
            )
            for name, box in rows
        ]
        values = {'image_width': WIDTH, 'image_height': HEIGHT, 'detections': found, **fields}
        self.boxes.publish(DetectionArray(header=self.header(i), **values))

    def answer(
        self, number: int = 1, num_features: int | None = None
    ) -> tuple[FeaturesMsg, DynamicObjectArray]:
        """Return the last of `number` messages on objects, and of as many features by default."""
        num_features = number if num_features is None else num_features
        self.probe.spin_until_count(self.features, num_features, f'not {num_features} features')
        self.probe.spin_until_count(self.objects, number, f'not {number} verdicts on objects')
        return self.features[num_features - 1], self.objects[number - 1]

    def show(self, i: int, *rows: Row, depth_m: Any = DEPTH_M) -> None:
        """Publish the detections of frame i, then its images."""
        self.send_boxes(i, *rows)
        self.probe.spin_for(0.2)
        self.send_images(i, depth_m)

    def newest_diagnosis(self) -> tuple[str, dict[str, str]]:
        """Return the message and the values of the node's newest diagnostics."""
        mine = [s for d in self.diagnostics for s in d.status if s.name == '/hoid_filter']
        if not mine:
            return '', {}
        return mine[-1].message, {v.key: v.value for v in mine[-1].values}

    def wait_for_count(self, name: str, number: int, timeout_s: float = TIMEOUT_S) -> None:
        """Wait until a counter of the diagnostics has reached a number."""
        self.probe.spin_until(
            lambda: int(self.newest_diagnosis()[1].get(name, 0)) >= number,
            f'"{name}" stays below {number}',
            timeout_s,
        )


FilterRunner = Callable[..., Peer]
"""Starts the node with parameters by name."""


def num_inside(msg: FeaturesMsg, row: Row) -> int:
    """Return how many features lie in a box."""
    uv, box = np.rint(np.array(msg.uv_px).reshape(-1, 2)), row[1]
    inside = (uv >= np.array(box[:2])) & (uv < np.array(box[2:]))
    return int(inside.all(axis=1).sum())
