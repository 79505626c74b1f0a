"""Joins the messages of an image for the scene: pose, depth, color and objects."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

from hoid_msgs.msg import DynamicObjectArray, TrackedImage
from rclpy.node import Node
from std_msgs.msg import Header

from hoid_common import topics
from hoid_common.errors import HoidError, MessageError
from hoid_common.inputs.input_config import RELIABLE
from hoid_common.poses.keyframe_poses import KeyframePoses
from hoid_common.ros import conversions
from hoid_common.ros.conversions.slam import tracked_image_from_msg
from hoid_common.ros.diagnostics import Diagnostics
from hoid_common.ros.frame_tree import LiveAlignment
from hoid_common.ros.inputs import Inputs
from hoid_common.sync import Match, StampMatcher
from hoid_common.values import ByteArray, CameraModel, DynamicObject, Float32Array
from hoid_scene.config.scene_config import SceneNodeConfig
from hoid_scene.scene_scheduler import SceneRequest, SceneScheduler

# Largest difference of the stamps of messages that belong to one image. Chosen: those of depth and
# color of one image differ less, and those of two images at 30 Hz more.
_SLOP_NS = 20_000_000
_PATIENCE_NS = 1_000_000_000  # chosen: how long an image waits for the final states of its objects
_CAPACITY = 60  # chosen: messages of a kind that wait for the others of an image; 2 s at 30 Hz
# A pose has the stamp of its color image. With `sync_slop_s` of the filter up to 20 ms, the stamps
# of depth and color always fit if an image has a pose, so that missing images mean late poses.
# With a larger value, these stamps may differ too much.
_LATE_POSES = (
    'the dense map and the tracks get no images: poses arrive too long after their depth images. '
    'Reduce the load of the computer. If it is low, the stamps of depth and color differ by more '
    'than 20 ms: set input.depth_offset_s'
)


class SceneImage(NamedTuple):
    """A color image with its depth, its objects and the request to the scene mapper to use it."""

    request: SceneRequest
    depth_m: Float32Array  # (H, W)
    color: Any  # the message of the color image
    objects: tuple[DynamicObject, ...]

    @property
    def header(self) -> Header:
        header: Header = self.color.header
        return header


class _Picked(NamedTuple):
    """A tracked image that was selected for a map."""

    msg: TrackedImage
    request: SceneRequest


class SceneImages:
    """Selects tracked images for the maps, and joins each with its depth, color and objects."""

    def __init__(
        self,
        node: Node,
        inputs: Inputs,
        config: SceneNodeConfig,
        keyframes: Callable[[], tuple[str, KeyframePoses] | None],
        on_image: Callable[[SceneImage], None],
        diagnostics: Diagnostics,
    ) -> None:
        self._units_per_m = config.input.depth_units_per_m
        self._keyframes, self._on_image, self._diagnostics = keyframes, on_image, diagnostics
        self._camera: CameraModel | None = None  # camera of the tracked images; None: unknown
        self.reconfigure(config)
        self._early: deque[TrackedImage] = deque(maxlen=_CAPACITY)  # images with unknown keyframes
        self._matcher = StampMatcher(
            ('pose', 'depth', 'color', 'objects'), _SLOP_NS, _CAPACITY, ('objects',), _PATIENCE_NS
        )
        inputs.depth(self._matched('depth'))
        inputs.color(self._matched('color'))
        self._alignment = LiveAlignment(node, inputs, diagnostics)
        inputs.messages(
            DynamicObjectArray, topics.DYNAMIC_OBJECTS, self._on_objects, 'dynamic objects'
        )
        inputs.messages(
            TrackedImage,
            topics.TRACKED_IMAGES,
            self._on_pose,
            'tracked images',
            reliability=RELIABLE,
            is_occasional=True,
            queue_length=_CAPACITY,
        )

    def reconfigure(self, config: SceneNodeConfig) -> None:
        sections = (config.dense, config.objects, config.object_map)
        rates_hz = (part.rate_hz if part.enabled else None for part in sections)
        self._scheduler = SceneScheduler(*rates_hz)

    def begin(self, camera: CameraModel | None) -> None:
        self._camera = self._alignment.aligner.color = camera
        self._matcher.reset()
        self._early.clear()

    def note_keyframes(self) -> None:
        for _ in range(len(self._early)):
            self._on_pose(self._early.popleft())

    def _on_pose(self, msg: TrackedImage) -> None:
        known = self._keyframes()
        if known is None or msg.session != known[0]:
            return
        row = known[1].row_of(msg.keyframe)
        if row is None:
            self._early.append(msg)
            return
        image = tracked_image_from_msg(msg, known[1].T_map_camera[row])
        request = self._scheduler.pick(image, lambda: known[1])
        if request is not None:
            self._add('pose', image.stamp_ns, _Picked(msg, request))

    def _on_objects(self, msg: DynamicObjectArray) -> None:
        """Add the objects of an image, unless their states are provisional."""
        if not msg.provisional:
            self._add('objects', conversions.stamp_from_msg(msg.header.stamp), msg)

    def _matched(self, name: str) -> Callable[[Any], None]:
        def on_message(msg: Any) -> None:
            self._add(name, conversions.stamp_from_msg(msg.header.stamp), msg)

        return on_message

    def _add(self, name: str, stamp_ns: int, value: Any) -> None:
        for match in self._matcher.add(name, stamp_ns, value):
            try:
                self._use(match)
            except HoidError as error:
                self._diagnostics.report(error, 'images refused')
        self._diagnostics.set_count('images missing', self._matcher.counts['pose'].unmatched)
        self._diagnostics.report_problem('stamps', _LATE_POSES if self._matcher.gap else '')

    def _use(self, match: Match) -> None:
        picked, depth, color, objects_msg = match.values
        objects = () if objects_msg is None else conversions.dynamic_objects_from_msg(objects_msg)
        request = self._scheduler.narrow(picked.request, objects)
        if self._camera is None or request is None:
            return
        depth_m = self._alignment.align(
            conversions.depth_from_msg(depth, self._units_per_m),
            depth.header,
            color.header,
            self._camera.size_px,
        )
        current = self._at_present(picked._replace(request=request))
        self._on_image(SceneImage(current, depth_m, color, objects))

    def color_of(self, image: SceneImage) -> ByteArray:
        """Return the (H, W, 3) color of an image; raise MessageError if it cannot be used."""
        image_bgr = conversions.color_from_msg(image.color)
        height, width = image_bgr.shape[:2]
        if self._camera is not None and (width, height) != self._camera.size_px:
            raise MessageError(
                f'color image is {width}x{height}, but the images that are tracked are '
                f'{self._camera.width_px}x{self._camera.height_px}'
            )
        return image_bgr

    def _at_present(self, picked: _Picked) -> SceneRequest:
        """Return the request, with its pose by present keyframes if its keyframe still exists."""
        known, request = self._keyframes(), picked.request
        row = None if known is None else known[1].row_of(request.reference_uid)
        if known is None or row is None:
            return request
        image = tracked_image_from_msg(picked.msg, known[1].T_map_camera[row])
        keyframes = None if request.keyframes is None else known[1]
        return request._replace(T_map_camera=image.T_map_camera, keyframes=keyframes)
