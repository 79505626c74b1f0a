"""A detector node with a network of known output, and a peer node."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from hoid_msgs.msg import DetectionArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import Image

from hoid_common.ros import conversions, qos
from hoid_common.values import ByteArray
from hoid_detector.node import DetectorNode
from hoid_system_tests.probe import SETTLE_S

ROWS = ((10.0, 20.0, 30.0, 60.0, 0.9, 0.0), (50.0, 8.0, 90.0, 24.0, 0.6, 41.0))
IMAGE = np.full((128, 192, 3), 60, np.uint8)  # twice the network's size
FRAME = 'camera_color_optical_frame'
STAMP_NS = 1_305_031_102_175_304_123


def write_model(path: Path, *, work: int = 0) -> Path:
    """Write a 96 x 64 network that outputs ROWS for every image, after `work` multiplications."""
    onnx = pytest.importorskip('onnx', reason='builds its models with the onnx package')
    h, f32 = onnx.helper, onnx.TensorProto.FLOAT
    array = onnx.numpy_helper.from_array
    side = 1000
    constants = [
        array(np.array(ROWS, np.float32)[None], 'rows'),
        array(np.full((side, side), 1e-6, np.float32), 'square'),
        array(np.array(0, np.float32), 'zero'),
    ]
    nodes = [h.make_node('ReduceMean', ['images'], ['mean'], keepdims=0)]
    nodes.append(h.make_node('Mul', ['square', 'mean'], ['product0']))
    nodes += [
        h.make_node('MatMul', [f'product{i}', 'square'], [f'product{i + 1}']) for i in range(work)
    ]
    nodes.append(h.make_node('ReduceMean', [f'product{work}'], ['worked'], keepdims=0))
    nodes.append(h.make_node('Mul', ['worked', 'zero'], ['nothing']))
    nodes.append(h.make_node('Add', ['rows', 'nothing'], ['output0']))
    image = h.make_tensor_value_info('images', f32, [1, 3, 64, 96])
    result = h.make_tensor_value_info('output0', f32, [1, len(ROWS), 6])
    graph = h.make_graph(nodes, 'known', [image], [result], constants)
    model = h.make_model(graph, opset_imports=[h.make_opsetid('', 17)], ir_version=8)
    onnx.save(model, path)
    return path


class Bench:
    """A detector node and a peer node, spun by one executor in this thread."""

    def __init__(self) -> None:
        self.executor = SingleThreadedExecutor()
        self.peer = Node('peer')
        self._clients: dict[str, Any] = {}
        self.executor.add_node(self.peer)
        self.detections: list[DetectionArray] = []
        self.diagnostics: list[DiagnosticStatus] = []
        keep = self.detections.append
        self.peer.create_subscription(DetectionArray, 'detections', keep, qos.OUTPUT)
        self.peer.create_subscription(
            DiagnosticArray, '/diagnostics', lambda m: self.diagnostics.extend(m.status), 10
        )
        self.images = self.peer.create_publisher(Image, 'rgb/image', qos.OUTPUT)
        self.node: DetectorNode | None = None

    def start(self) -> DetectorNode:
        self.node = DetectorNode()
        self.executor.add_node(self.node)
        self.until(lambda: self.images.get_subscription_count() or None)
        self.until(lambda: self.peer.count_publishers('detections') or None)
        return self.node

    def until(self, condition: Callable[[], Any], limit_s: float = 15.0) -> Any:
        """Spin until the condition returns a value, and return that value."""
        end_s = time.monotonic() + limit_s
        while time.monotonic() < end_s:
            if (value := condition()) not in (None, False):
                return value
            self.executor.spin_once(timeout_sec=0.02)
        raise AssertionError('no value within the limit')

    def spin(self, duration_s: float) -> None:
        end_s = time.monotonic() + duration_s
        while time.monotonic() < end_s:
            self.executor.spin_once(timeout_sec=0.02)

    def send(self, image: ByteArray, stamp_ns: int = STAMP_NS, **changes: Any) -> None:
        msg = conversions.color_to_msg(image, conversions.header_to_msg(stamp_ns, FRAME))
        for name, value in changes.items():
            setattr(msg, name, value)
        self.images.publish(msg)

    def answer(self) -> DetectionArray:
        """Return the next detections."""
        return self.until(lambda: self.detections.pop(0) if self.detections else None)

    def call(self, type_: Any, name: str, request: Any) -> Any:
        if name not in self._clients:
            self._clients[name] = self.peer.create_client(type_, name)
            self.until(self._clients[name].service_is_ready)
            self.spin(SETTLE_S)
        client = self._clients[name]
        future = client.call_async(request)
        self.until(future.done)
        return future.result()

    def values(self) -> dict[str, str]:
        """Return level, message and values of the node's next diagnostics."""
        self.diagnostics.clear()
        status = self.until(lambda: self.diagnostics[-1] if self.diagnostics else None)
        return {'level': status.level, 'message': status.message} | {
            v.key: v.value for v in status.values
        }

    def close(self) -> None:
        for node in (self.node, self.peer):
            if node is not None:
                self.executor.remove_node(node)
                node.destroy_node()
        self.executor.shutdown()
