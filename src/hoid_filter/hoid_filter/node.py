"""The filter node: receives images and detections, publishes static features and verdicts."""

from __future__ import annotations

from functools import partial

from hoid_msgs.msg import DetectionArray
from rclpy.clock import Clock, ClockType
from std_msgs.msg import Header
from vision_msgs.msg import Detection2DArray

from hoid_common import topics
from hoid_common.coco import COCO
from hoid_common.config import did_you_mean
from hoid_common.errors import MessageError
from hoid_common.io.depth import DepthUnitWarning
from hoid_common.ros import conversions
from hoid_common.ros.frame_tree import LiveAlignment
from hoid_common.ros.inputs import Inputs, Synchronizer
from hoid_common.ros.lifecycle import ManagedNode
from hoid_common.ros.parameters import Parameters
from hoid_common.ros.run import run_node
from hoid_common.sync import Match, StampMatcher
from hoid_common.values import CameraModel, RgbdFrame
from hoid_filter.config import HANDLED_CLASSES, FilterNodeConfig
from hoid_filter.feature_filter import FeatureFilter
from hoid_filter.live_filter import LiveFilter
from hoid_filter.ros.outputs import FilterOutputs

_POLL_S = 0.05  # chosen: a tenth of the default of `detections.wait_s`
_UNIT_REMEDY = 'set input.depth_units_per_m of hoid_filter and hoid_scene'


class FilterNode(ManagedNode):
    """Passes images and detections to a `LiveFilter`, and camera_info to its `FeatureFilter`."""

    def __init__(self) -> None:
        super().__init__('hoid_filter')
        self._settings = Parameters(self, FilterNodeConfig(), self._reconfigure)
        config = self._settings.config
        self._filter = FeatureFilter(config)
        self._camera: CameraModel | None = None  # camera of the newest camera_info
        self._size_px: tuple[int, int] | None = None  # size of the newest image
        self._unit = DepthUnitWarning(_UNIT_REMEDY)
        # A guard condition runs after the messages that were ready in the same turn.
        idle = self.create_guard_condition(self._on_idle)
        self._live = LiveFilter(
            config.detections, self._filter, FilterOutputs(self), self.diagnostics, idle.trigger
        )
        self._warn_of_unknown_classes(config.dynamic_classes)
        self._subscribe(config)
        self.begin(autostart=config.autostart)

    def clean_up(self) -> None:
        self._live.forget()

    def _subscribe(self, config: FilterNodeConfig) -> None:
        inputs = Inputs(self, config.input, self.diagnostics)
        matcher = StampMatcher(('color', 'depth'), int(config.sync_slop_s * 1e9))
        images = Synchronizer(matcher, self._on_images, self.diagnostics)
        inputs.color(images.input('color', conversions.color_from_msg))
        to_m = partial(conversions.depth_from_msg, units_per_m=config.input.depth_units_per_m)
        inputs.depth(images.input('depth', to_m))
        inputs.camera(self._on_camera)
        self._alignment = LiveAlignment(self, inputs, self.diagnostics)
        if self._filter.needs_detections:
            type_, topic = DetectionArray, topics.DETECTIONS
            if config.detections.as_vision_msgs:
                type_, topic = Detection2DArray, topics.DETECTIONS_2D
            inputs.messages(type_, topic, self._on_detections, 'detections')
            steady = Clock(clock_type=ClockType.STEADY_TIME)
            self.create_timer(_POLL_S, self._live.poll, clock=steady)

    def _warn_of_unknown_classes(self, names: tuple[str, ...]) -> None:
        known = {*COCO, *HANDLED_CLASSES}
        for name in names:
            if name not in known:
                self.get_logger().warning(
                    f'dynamic_classes: COCO has no class "{name}"{did_you_mean(name, known)}; '
                    'it has an effect only if the detector reports this name'
                )

    def _on_images(self, match: Match) -> None:
        (header, image_bgr), (depth_header, depth_m) = match.values
        size_px = image_bgr.shape[1], image_bgr.shape[0]
        if size_px != self._size_px:
            if self._size_px is not None:  # the objects' boxes are in pixels of the old resolution
                self._live.forget()
            self._size_px = size_px
            self._use_camera()
        depth_m = self._alignment.align(depth_m, depth_header, header, size_px)
        frame = RgbdFrame(match.stamp_ns, image_bgr, depth_m)
        if warning := self._unit.warning_for(depth_m):
            self.diagnostics.set_problem('depth unit', warning)
        self._live.add_image(header, frame)

    def _on_detections(self, msg: DetectionArray | Detection2DArray) -> None:
        if isinstance(msg, Detection2DArray):
            detections = conversions.detections_2d_from_msg(msg)
        else:
            size_px = (msg.image_width, msg.image_height)
            if self._size_px not in (None, size_px):
                raise MessageError(
                    f'detections are of a {size_px} px image, color images have {self._size_px} '
                    'px: let the detector subscribe to these images'
                )
            detections = conversions.detections_from_msg(msg)
        self._live.add_detections(detections)

    def _on_idle(self) -> None:
        self._live.on_idle()

    def _on_camera(self, camera: CameraModel, _header: Header) -> None:
        self._camera = camera
        self._use_camera()

    def _use_camera(self) -> None:
        """Use the camera_info, scaled to the color images if the ratio of sizes is whole."""
        camera, size_px = self._camera, self._size_px
        if camera is None or size_px is None:
            return
        self._filter.camera = self._alignment.aligner.color = camera.scaled_to(size_px)
        if self._filter.camera is None:
            error = MessageError(
                f'camera_info is of a {camera.size_px} px image, color images have {size_px} px: '
                'publish the camera_info of the color images'
            )
            self.diagnostics.report(error, 'camera infos refused')

    def _reconfigure(self, config: FilterNodeConfig) -> None:
        self._live.config = config.detections
        self._filter.reconfigure(config)


def main() -> int:
    return run_node(FilterNode)
