"""The node: color images in, detections out; the newest image wins."""

from __future__ import annotations

import os
from typing import NamedTuple

from hoid_msgs.msg import DetectionArray
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import Header
from std_srvs.srv import SetBool
from vision_msgs.msg import Detection2DArray

from hoid_common import topics
from hoid_common.errors import ConfigError, HoidError
from hoid_common.ros import conversions, qos
from hoid_common.ros.debug_image import DebugImages
from hoid_common.ros.inputs import Inputs
from hoid_common.ros.lifecycle import ManagedNode
from hoid_common.ros.parameters import Parameters
from hoid_common.ros.run import run_node
from hoid_common.values import ByteArray, Detections
from hoid_detector.config import DetectorNodeConfig
from hoid_detector.drawing import draw_detections
from hoid_detector.model.model_path import find_model
from hoid_detector.newest_wins import NewestWins
from hoid_detector.onnx_detector import OnnxDetector


class _Seen(NamedTuple):
    header: Header
    image_bgr: ByteArray  # (H, W, 3)
    detections: Detections
    detect_ms: float
    is_watched: bool  # somebody listened to the debug image


class DetectorNode(ManagedNode):
    """Detects in a thread of its own; all that is ROS happens in the executor's."""

    def __init__(self) -> None:
        super().__init__('hoid_detector')
        self._detector: OnnxDetector | None = None
        self._enabled = True
        self._settings = Parameters(self, DetectorNodeConfig(), self._reconfigure, self._approve)
        os.nice(self._settings.config.niceness)
        self._done = self.create_guard_condition(self._finish)
        self._worker = NewestWins(self._detect, self._done.trigger)
        self._detections = self.create_publisher(DetectionArray, topics.DETECTIONS, qos.OUTPUT)
        self._detections_2d = self.create_publisher(
            Detection2DArray, topics.OWN_DETECTIONS_2D, qos.OUTPUT
        )
        self._debug_images = DebugImages(self)
        self.create_service(SetBool, topics.ENABLE, self._enable)
        Inputs(self, self._settings.config.input, self.diagnostics).color(self._take)
        self.begin(autostart=self._settings.config.autostart)

    def destroy_node(self) -> None:
        """End the worker first: it must not wake a node that is gone."""
        self._worker.close()
        super().destroy_node()

    def configure(self) -> None:
        """Load the model."""
        config = self._settings.config
        self._detector = OnnxDetector(find_model(config.model), config)
        self.diagnostics.set_value('model', self._detector.description)
        if warning := self._detector.network.provider_warning:
            self.diagnostics.set_problem('provider', warning)

    def pause(self) -> None:
        """Leave the image that waits."""
        self._worker.clear()

    def _take(self, msg: conversions.ReceivedImage | CompressedImage) -> None:
        if self._enabled:
            self._worker.offer(msg)

    def _detect(self, msg: conversions.ReceivedImage | CompressedImage) -> _Seen:
        assert self._detector is not None
        image_bgr = conversions.color_from_msg(msg)
        detections = self._detector.detect(image_bgr, conversions.stamp_from_msg(msg.header.stamp))
        size_px, names = image_bgr.shape[1::-1], self._detector.class_names
        detect_ms, is_watched = self._detector.detect_ms, self._debug_images.is_watched
        # From this thread, as somebody waits for it.
        self._detections.publish(
            conversions.detections_to_msg(detections, msg.header, size_px, names, detect_ms)
        )
        if self._detections_2d.get_subscription_count():
            self._detections_2d.publish(conversions.detections_2d_to_msg(detections, msg.header))
        return _Seen(msg.header, image_bgr, detections, detect_ms, is_watched)

    def _finish(self) -> None:
        try:
            seen = self._worker.finish()
        except HoidError as error:
            self.diagnostics.report(error, 'images refused')
            return
        if seen is None:
            return
        if seen.is_watched:
            picture = draw_detections(seen.image_bgr, seen.detections)
            self._debug_images.publish(picture, seen.header)
        self.diagnostics.count('images processed')
        self._say_numbers()
        self.diagnostics.set_count('images dropped for newer ones', self._worker.num_dropped)
        self.diagnostics.set_value('time per image', f'{seen.detect_ms:.1f} ms')

    def _say_numbers(self) -> None:
        """Say it while the network gives nothing to detect anything by."""
        assert self._detector is not None
        number = self._detector.num_without_numbers
        self.diagnostics.set_count('images without a number from the network', number)
        if self._detector.gives_numbers:
            self.diagnostics.clear_problem('numbers')
        else:
            self.diagnostics.set_problem('numbers', self._detector.nonsense, severe=True)

    def _enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._enabled = request.data
        response.success, response.message = True, 'detecting' if request.data else 'stopped'
        self.diagnostics.set_value(f'asked for by {topics.ENABLE}', response.message)
        return response

    def _approve(self, config: DetectorNodeConfig) -> None:
        objection = self._detector.objection(config.classes) if self._detector else ''
        if objection:
            raise ConfigError(objection)

    def _reconfigure(self, config: DetectorNodeConfig) -> None:
        if self._detector is not None:
            self._detector.reconfigure(config)


def main() -> int:
    """Run the node."""
    return run_node(DetectorNode)
