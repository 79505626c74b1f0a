"""Detector node: publishes detections in color images; under load, it skips to the newest one."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import NamedTuple

from hoid_msgs.msg import DetectionArray
from rclpy.clock import Clock, ClockType
from rclpy.timer import Timer
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import Header
from std_srvs.srv import SetBool
from vision_msgs.msg import Detection2DArray

from hoid_common import topics
from hoid_common.errors import HoidError
from hoid_common.ros import conversions, qos
from hoid_common.ros.debug_image import DebugImages
from hoid_common.ros.frame_tree import StaticFrameListener
from hoid_common.ros.inputs import Inputs
from hoid_common.ros.lifecycle import ManagedNode
from hoid_common.ros.parameters import Parameters
from hoid_common.ros.run import run_node
from hoid_common.sync import Rate
from hoid_common.values import ByteArray, Detections
from hoid_detector.config import DetectorNodeConfig
from hoid_detector.drawing import draw_detections
from hoid_detector.model.model_path import find_model
from hoid_detector.newest_wins import NewestWins
from hoid_detector.onnx_detector import OnnxDetector
from hoid_detector.quarter_turn import mounted_roll_deg

# Niceness of the worker thread: tracking has priority on a busy computer (decision 016).
_NICENESS = 10


class _Result(NamedTuple):
    header: Header
    image_bgr: ByteArray  # (H, W, 3)
    detections: Detections
    detect_ms: float
    is_watched: bool  # whether the debug image had a subscriber


class DetectorNode(ManagedNode):
    """The detector node, which detects objects and publishes them in a worker thread."""

    def __init__(self) -> None:
        super().__init__('hoid_detector')
        self._detector: OnnxDetector | None = None
        self._enabled = True
        self._settings = Parameters(self, DetectorNodeConfig(), self._reconfigure, self._approve)
        os.nice(_NICENESS)
        self._done = self.create_guard_condition(self._finish)
        self._worker = NewestWins(self._detect, self._done.trigger)
        self._pace(self._settings.config.rate_hz)
        self._detections = self.create_publisher(DetectionArray, topics.DETECTIONS, qos.OUTPUT)
        self._detections_2d = self.create_publisher(
            Detection2DArray, topics.OWN_DETECTIONS_2D, qos.OUTPUT
        )
        self._debug_images = DebugImages(self)
        has_base = bool(self._settings.config.base_frame)
        self._static = StaticFrameListener(self, self.diagnostics) if has_base else None
        # Roll of the camera relative to the base frame, from /tf_static; 0 if it is unknown or not
        # used.
        self._mounted_roll_deg = 0.0
        self.create_service(SetBool, topics.ENABLE, self._enable)
        inputs = Inputs(self, self._settings.config.input, self.diagnostics)
        inputs.color(self._take)
        if self._settings.config.expected_score_threshold > 0:
            inputs.messages(
                DetectionArray,
                topics.EXPECTED_OBJECTS,
                self._expect,
                'expected objects',
                is_occasional=True,
            )
        self.begin(autostart=self._settings.config.autostart)

    def _pace(self, rate_hz: float) -> None:
        """Set the detection rate (Hz), by the stamps of images; 0 = every image.

        If no image comes for a period, the newest image is processed even if it was not due, so
        that the last image of a stream or of a triggered camera gets detections.
        """
        self._rate = Rate(rate_hz)
        self._pause: Timer | None = None
        if rate_hz:
            steady = Clock(clock_type=ClockType.STEADY_TIME)
            self._pause = self.create_timer(1 / rate_hz, self._end_pause, clock=steady)

    def _end_pause(self) -> None:
        assert self._pause is not None
        self._pause.cancel()
        self._worker.start_waiting()

    def destroy_node(self) -> None:
        self._worker.close()
        super().destroy_node()

    def configure(self) -> None:
        config = self._settings.config
        self._detector = OnnxDetector(find_model(config.model), config)
        self.diagnostics.set_value('model', self._detector.description)
        if warning := self._detector.network.provider_warning:
            self.diagnostics.set_problem('provider', warning)

    def pause(self) -> None:
        self._worker.clear()

    def _take(self, msg: conversions.ReceivedImage | CompressedImage) -> None:
        if self._enabled:
            self._find_roll(msg.header.frame_id)
            is_due = self._rate.take_due(conversions.stamp_from_msg(msg.header.stamp))
            if self._pause is not None:
                self._pause.reset()
            self._worker.offer(msg, is_due=is_due)

    def _expect(self, msg: DetectionArray) -> None:
        if self._detector is not None:
            self._detector.expected = conversions.detections_from_msg(msg)

    def _find_roll(self, camera_frame: str) -> None:
        """Set the roll of the camera from /tf_static, unless `camera_roll_deg` is given."""
        config = self._settings.config
        if self._static is None or self._detector is None:
            return
        if config.camera_roll_deg:
            self.diagnostics.clear_problem('base')
            return
        T_base_camera = self._static.frames.find(config.base_frame, camera_frame)
        if T_base_camera is None:
            self.diagnostics.set_problem(
                'base',
                f'{self.resolve_topic_name(topics.TF_STATIC)} does not join frames '
                f'"{config.base_frame}" and "{camera_frame}", so images are not turned upright: '
                'publish where the camera is mounted',
            )
            return
        self.diagnostics.clear_problem('base')
        roll_deg = mounted_roll_deg(T_base_camera)
        if roll_deg != self._mounted_roll_deg:
            self._mounted_roll_deg = roll_deg
            self.diagnostics.set_value('camera roll', f'{roll_deg:.0f} degrees')
            self._reconfigure(config)

    def _detect(self, msg: conversions.ReceivedImage | CompressedImage) -> _Result:
        assert self._detector is not None
        image_bgr = conversions.color_from_msg(msg)
        detections = self._detector.detect(image_bgr, conversions.stamp_from_msg(msg.header.stamp))
        size_px, names = image_bgr.shape[1::-1], self._detector.class_names
        detect_ms, is_watched = self._detector.detect_ms, self._debug_images.is_watched
        # This thread publishes, because the filter waits for the detections of its image.
        self._detections.publish(
            conversions.detections_to_msg(detections, msg.header, size_px, names, detect_ms)
        )
        if self._detections_2d.get_subscription_count():
            self._detections_2d.publish(conversions.detections_2d_to_msg(detections, msg.header))
        return _Result(msg.header, image_bgr, detections, detect_ms, is_watched)

    def _finish(self) -> None:
        try:
            result = self._worker.finish()
        except HoidError as error:
            self.diagnostics.report(error, 'images refused')
            return
        if result is None:
            return
        if result.is_watched:
            picture = draw_detections(result.image_bgr, result.detections)
            self._debug_images.publish(picture, result.header)
        self.diagnostics.count('images processed')
        self._report_non_finite_outputs()
        self.diagnostics.set_count('images dropped for newer ones', self._worker.num_dropped)
        self.diagnostics.set_value('time per image', f'{result.detect_ms:.1f} ms')

    def _report_non_finite_outputs(self) -> None:
        assert self._detector is not None
        number = self._detector.num_non_finite
        self.diagnostics.set_count('images with non-finite network outputs', number)
        self.diagnostics.report_problem('outputs', self._detector.warning, severe=True)

    def _enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._enabled = request.data
        response.success, response.message = True, 'detecting' if request.data else 'stopped'
        self.diagnostics.set_value(f'requested by {topics.ENABLE}', response.message)
        return response

    def _approve(self, config: DetectorNodeConfig) -> None:
        if self._detector is not None:
            self._detector.check_classes(config.classes)

    def _reconfigure(self, config: DetectorNodeConfig) -> None:
        if self._detector is not None:
            roll_deg = config.camera_roll_deg or self._mounted_roll_deg
            self._detector.reconfigure(replace(config, camera_roll_deg=roll_deg))


def main() -> int:
    return run_node(DetectorNode)
