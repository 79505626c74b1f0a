"""The node: images and detections in, features of the static world and verdicts out."""

from __future__ import annotations

from hoid_msgs.msg import DetectionArray
from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import CameraInfo
from vision_msgs.msg import Detection2DArray

from hoid_common import topics
from hoid_common.errors import MessageError
from hoid_common.ros import conversions
from hoid_common.ros.inputs import Inputs
from hoid_common.ros.lifecycle import ManagedNode
from hoid_common.ros.parameters import Parameters
from hoid_common.ros.run import run_node
from hoid_common.ros.sync import Synchronizer
from hoid_common.sync import Match, StampMatcher
from hoid_common.values import RgbdFrame
from hoid_filter.detections.detection_gate import Known
from hoid_filter.feature_filter import FeatureFilter, check_sizes
from hoid_filter.node_config import FilterNodeConfig
from hoid_filter.ros.looks import Looks
from hoid_filter.ros.outputs import FilterOutputs
from hoid_filter.ros.second_looks import FirstLook, SecondLooks

_SILENCE_S = 0.05  # after which images are looked at again that wait for detections


class FilterNode(ManagedNode):
    """Brings images, depth and detections together and publishes what the filter makes of them.

    An image is published at once, judged by what moved before and by boxes predicted to it. It is
    judged again when motion has been looked for in it and its own detections are there. Motion is
    looked for when no message waits; an image that the next one overtakes goes without. Only
    before the detector's first answer does an image wait.
    """

    def __init__(self) -> None:
        super().__init__('hoid_filter')
        self._settings = Parameters(self, FilterNodeConfig(), self._reconfigure)
        config = self._settings.config
        self._filter = FeatureFilter(config)
        self._size_px: tuple[int, int] | None = None  # of the newest image
        self._outputs = FilterOutputs(self)
        self._second_looks = SecondLooks(
            config.detections, self._filter, self._outputs, self.diagnostics
        )
        self._looks = Looks(self._filter, self._outputs, self._second_looks, self.diagnostics)
        self._has_published = False  # since the last turn in which nothing else was to be done
        self._idle = self.create_guard_condition(self._go_on)
        self._subscribe(config)
        self.begin(autostart=config.autostart)

    def clean_up(self) -> None:
        """Forget objects, and images that are to be judged again."""
        self._filter.reset()
        self._second_looks.forget()
        self._looks.forget()

    def _subscribe(self, config: FilterNodeConfig) -> None:
        inputs = Inputs(self, config.input, self.diagnostics)
        matcher = StampMatcher(('colour', 'depth'), int(config.sync_slop_s * 1e9))
        images = Synchronizer(matcher, self._take_images, self.diagnostics)
        inputs.color(images.input('colour', conversions.color_from_msg))
        inputs.depth(images.input('depth', conversions.depth_from_msg))
        inputs.messages(CameraInfo, topics.CAMERA_INFO, self._take_camera, 'camera infos')
        if config.needs_detections:
            type_, topic = DetectionArray, topics.DETECTIONS
            if config.detections.as_vision_msgs:
                type_, topic = Detection2DArray, topics.DETECTIONS_2D
            inputs.messages(type_, topic, self._take_detections, 'detections')
            steady = Clock(clock_type=ClockType.STEADY_TIME)
            self.create_timer(_SILENCE_S, self._poll, clock=steady)

    def _take_images(self, match: Match) -> None:
        (header, image_bgr), (_, depth_m) = match.values
        frame = RgbdFrame(match.stamp_ns, image_bgr, depth_m)
        check_sizes(frame)  # now, as it may be worked on much later
        if frame.size_px != self._size_px:
            self._size_px = frame.size_px
            self._check_camera()
        if self._settings.config.needs_detections:
            self._publish(self._second_looks.add_image(header, frame))
        else:
            self._publish(FirstLook(header, frame, Known(None, is_final=True)))

    def _publish(self, look: FirstLook | None) -> None:
        if look is not None:
            self._has_published = True
            self._idle.trigger()
            self._looks.take(look)

    def _go_on(self) -> None:
        """Look for motion when all messages that had come have been served."""
        if self._has_published:  # in this turn: the next images may be there by now
            self._has_published = False
            self._idle.trigger()
        else:
            self._looks.look_for_motion()

    def _take_detections(self, msg: DetectionArray | Detection2DArray) -> None:
        self._looks.look_for_motion()  # first: they may have the final word
        if isinstance(msg, Detection2DArray):
            detections = conversions.detections_2d_from_msg(msg)
        else:
            said = (msg.image_width, msg.image_height)
            if self._size_px not in (None, said):
                raise MessageError(f'detections are of {said} px, colour is {self._size_px}')
            detections = conversions.detections_from_msg(msg)
        self._publish(self._second_looks.add_detections(detections))

    def _take_camera(self, msg: CameraInfo) -> None:
        self._filter.camera = conversions.camera_from_msg(msg)
        self._check_camera()

    def _check_camera(self) -> None:
        """Say when the camera is not that of the images; places of objects are then unknown."""
        camera, size_px = self._filter.camera, self._size_px
        if camera is not None and size_px not in (None, camera.size_px):
            error = MessageError(f'camera_info is of a {camera.size_px} px image, not {size_px}')
            self.diagnostics.report(error, 'camera infos refused')

    def _poll(self) -> None:
        self._publish(self._second_looks.poll())

    def _reconfigure(self, config: FilterNodeConfig) -> None:
        self._second_looks.reconfigure(config.detections)
        self._filter.reconfigure(config)


def main() -> int:
    """Run the node."""
    return run_node(FilterNode)
