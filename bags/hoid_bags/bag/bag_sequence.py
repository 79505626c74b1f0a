"""Bags as sequences of RGB-D frames."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path

import numpy as np

from hoid_bags.bag import bag_messages
from hoid_bags.bag.bag_reader import BagReader
from hoid_bags.bag.bag_topics import RecordedTopics, TopicChoice, find_topics
from hoid_bags.bag.contents import BagTopic
from hoid_bags.bag.image_messages import decode_color, decode_depth, image_head
from hoid_bags.bag.stamps import header_stamp_ns
from hoid_bags.images import check_size
from hoid_bags.storage import bag_types
from hoid_bags.storage.bag_types import Message
from hoid_bags.tum.association import MAX_PAIR_GAP_NS, pair_images
from hoid_common.errors import InputError, MessageError
from hoid_common.inputs.camera_info_check import CameraInfoCheck
from hoid_common.inputs.registration import DepthAligner
from hoid_common.io.camera_info import camera_from_info, rectification_doubt
from hoid_common.io.depth import DepthUnitWarning
from hoid_common.io.images import UNIT_REMEDY
from hoid_common.io.stamps import OrderedStamps, in_order, longest_pass
from hoid_common.messages import detections_from_msg, pose_from_msg, stamp_from_msg
from hoid_common.values import (
    CameraModel,
    Detections,
    FloatArray,
    IntArray,
    RgbdFrame,
    Trajectory,
)

_LOG = logging.getLogger(__name__)
_REGISTER = (
    'register it in the driver, record the camera_info of depth and /tf_static, or name other '
    'topics with --depth and --rgb'
)
_MAX_BAD_AT_START = 30  # chosen: reading ends if the first 30 images are all unusable


class BagSequence:
    """The paired color and depth images of a bag, a `hoid_bags.sequence.Sequence`.

    Topics, stamps, camera and ground truth are read when the bag is opened; images during
    iteration. A pair is left out if one of its images cannot be decoded or has another size than
    the camera; `fault` then states the number of these pairs, unless it describes other damage.
    """

    def __init__(
        self,
        path: Path,
        camera: CameraModel | None = None,
        choice: TopicChoice = TopicChoice(),  # noqa: B008 - immutable
        max_gap_ns: int = MAX_PAIR_GAP_NS,
        depth_offset_ns: int = 0,
        depth_units_per_m: float = 0.0,
    ) -> None:
        """Open a bag; for all arguments see `open_sequence`.

        InputError if the path is no bag, its topics cannot be chosen (see `find_topics`), no
        camera is given or usable, no message of an image topic is usable, no color and depth image
        make a pair, or stamps are too close to each other for any camera.

        Args:
            depth_units_per_m: Depth units per meter; 0: 1000 for whole numbers, 1 for floats.
        """
        self.path = path
        self.depth_offset_ns, self.depth_units_per_m = depth_offset_ns, depth_units_per_m
        self.name = path.resolve().name
        with BagReader(path) as reader:
            self.topics = find_topics(reader, choice)
            index = _Index(reader, self.topics, camera)
            self.fault = reader.fault
        found = camera or index.cameras.camera
        if found is None:
            problem = index.cameras.problem or 'has no camera_info of the color images'
            raise InputError(f'{path}: {problem}; give --calibration')
        self.camera = found
        self._aligner, self._frames = index.aligner, index.frames
        self._aligner.color = self.camera
        self.ground_truth = index.ground_truth
        self.true_detections: Mapping[int, Detections] | None = index.true_detections
        self._first_log_ns, self._last_log_ns = index.first_log_ns, index.last_log_ns
        color_ns, depth_ns = index.stamps_ns
        pairs = pair_images(color_ns, depth_ns, max_gap_ns, depth_offset_ns, path)
        self.depth_of_color = {int(color_ns[i]): int(depth_ns[j]) for i, j in pairs.tolist()}
        """Stamp of the depth image (ns) by the stamp of the color image, in order of time."""

    def __len__(self) -> int:
        return len(self.depth_of_color)

    def __iter__(self) -> Iterator[RgbdFrame]:
        unit, told, num_frames = DepthUnitWarning(UNIT_REMEDY), '', 0
        errors: list[InputError] = []
        for color_ns, color, depth in self._paired_messages():
            try:
                frame = self._frame(color_ns, color, depth)
            except InputError as error:
                errors.append(error)
                if not num_frames and len(errors) >= _MAX_BAD_AT_START:
                    raise
                continue
            num_frames += 1
            if warning := unit.warning_for(frame.depth_m):
                _LOG.warning('%s: %s', self.path, warning)
            if (text := self._aligner.doubt or self._aligner.note) not in ('', told):
                _LOG.warning('%s: %s', self.path, told := text)
            yield frame
        if errors and not num_frames:
            raise errors[0]
        if errors and self.fault is None:
            self.fault = f'{len(errors)} images left out; {errors[0]}'

    def _paired_messages(self) -> Iterator[tuple[int, bytes, bytes]]:
        """Yield (color stamp in ns, color message, depth message) of each pair, serialized."""
        names = [self.topics.color.name, self.topics.depth.name]
        waiting = iter(self.depth_of_color.items())
        color_ns, depth_ns = next(waiting)
        missing = set(self.depth_of_color), set(self.depth_of_color.values())
        color: dict[int, bytes] = {}
        depth: dict[int, bytes] = {}
        with BagReader(self.path) as reader:
            for topic, log_ns, data in reader.messages(names, self._first_log_ns):
                if log_ns > self._last_log_ns:
                    break
                is_depth = topic == self.topics.depth.name
                try:
                    stamp_ns = header_stamp_ns(data)
                except MessageError:  # the warning at the opening of the bag counts it
                    continue
                if stamp_ns not in missing[is_depth]:  # without partner, or repeated
                    continue
                missing[is_depth].remove(stamp_ns)
                (depth if is_depth else color)[stamp_ns] = data
                while color_ns in color and depth_ns in depth:
                    yield color_ns, color.pop(color_ns), depth.pop(depth_ns)
                    color_ns, depth_ns = next(waiting, (-1, -1))

    def _frame(self, color_ns: int, color: bytes, depth: bytes) -> RgbdFrame:
        """Return the frame of two serialized messages; InputError if it cannot be used."""
        topic = self.topics.color
        try:
            image_bgr = decode_color(color, topic)
            topic = self.topics.depth
            depth_m = decode_depth(depth, topic, self.depth_units_per_m)
            size_px = image_bgr.shape[1], image_bgr.shape[0]
            depth_m = self._aligner.align(depth_m, *self._frames, size_px)
            topic = self.topics.color
            check_size(image_bgr, self.camera, topic.name)
        except (MessageError, InputError) as error:
            raise InputError(f'{self.path}: {topic.name} at {color_ns} ns: {error}') from error
        return RgbdFrame(color_ns, image_bgr, depth_m)


class _Index:
    """Stamps of the images, camera and ground truth, collected in one pass over a bag."""

    def __init__(
        self, reader: BagReader, found: RecordedTopics, given_camera: CameraModel | None
    ) -> None:
        self.cameras = CameraInfoCheck(
            'give the camera with --calibration, or split the recording'
        )
        self._reported: set[str] = set()  # kinds of camera problems that were already logged
        self._found = found
        self.aligner = DepthAligner(_REGISTER)
        self._frame_of: dict[str, str] = {}  # name of the frame by image topic
        self._T_color_depth: FloatArray | None = None
        self._images: dict[str, list[tuple[int, int]]] = {  # log times and stamps
            found.color.name: [],
            found.depth.name: [],
        }
        self._poses: dict[int, FloatArray] = {}
        self._detections: dict[int, Detections] = {}
        self._problems: dict[str, list[str]] = {}
        by_name = {topic.name: topic for topic in found if topic is not None}
        for topic, log_ns, data in reader.messages(list(by_name)):
            try:
                self._add(by_name[topic], log_ns, data)
            except MessageError as error:
                self._problems.setdefault(topic, []).append(f'{reader.path}: {topic}: {error}')
        self._report_problems(given_camera)
        used = [_longest(reader.path, *topic) for topic in self._images.items()]
        self.stamps_ns = [order.stamps_ns for order, _ in used]  # stamps of color and depth images
        self.first_log_ns = min(int(log_ns[0]) for _, log_ns in used)
        self.last_log_ns = max(int(log_ns.max()) for _, log_ns in used)
        depth, color = (self._frame_of.get(t.name, '') for t in (found.depth, found.color))
        self.frames = depth, color
        if self._T_color_depth is not None and all(self.frames):
            self.aligner.frames.add(self.frames[1], self.frames[0], self._T_color_depth)
        self.true_detections = self._detections if found.true_detections else None
        self.ground_truth = _trajectory(self._poses) if found.ground_truth else None

    def _add(self, topic: BagTopic, log_ns: int, data: bytes) -> None:
        if topic.name in self._images:
            self._images[topic.name].append((log_ns, header_stamp_ns(data)))
            if topic.name not in self._frame_of:
                header = bag_types.deserialize(data, topic.type_name).header
                self._frame_of[topic.name] = header.frame_id.lstrip('/')
            if topic == self._found.color:
                self._check_size(data)
            return
        message = bag_types.deserialize(data, topic.type_name)
        if topic == self._found.ground_truth:
            stamp_ns = stamp_from_msg(message.header.stamp)
            self._poses[stamp_ns] = pose_from_msg(message.pose)
        elif topic == self._found.true_detections:
            boxes = detections_from_msg(message)
            self._detections[boxes.stamp_ns] = boxes
        else:
            self._add_geometry(topic, message)

    def _add_geometry(self, topic: BagTopic, message: Message) -> None:
        """Store the camera info or the transform that a message contains."""
        if topic == self._found.camera_info:
            self.cameras.update(camera_from_info(message, self._found.color.name))
            self._warn_once('doubt', rectification_doubt(message, self._found.color.name))
            self._warn_once('change', self.cameras.change)
            self._warn_once('scaling', self.cameras.scaling)
        elif topic == self._found.depth_info:
            self.aligner.depth = camera_from_info(message, self._found.depth.name)
        elif topic == self._found.extrinsics:
            self._T_color_depth = bag_messages.extrinsics(message)
        else:
            for edge in bag_messages.static_edges(message):
                self.aligner.frames.add(*edge)

    def _check_size(self, color: bytes) -> None:
        """Pass the size of a color image to `CameraInfoCheck`, if its header states the size."""
        with suppress(MessageError):
            if size_px := image_head(color, self._found.color).size_px:
                self.cameras.check_image(size_px)
                self._warn_once('scaling', self.cameras.scaling)

    def _warn_once(self, kind: str, text: str) -> None:
        if text and kind not in self._reported:
            self._reported.add(kind)
            _LOG.warning('%s', text)

    def _report_problems(self, given_camera: CameraModel | None) -> None:
        """Warn of unusable messages; InputError if a required topic has no usable message."""
        found = self._found
        is_empty = {
            found.color.name: not self._images[found.color.name],
            found.depth.name: not self._images[found.depth.name],
            found.camera_info.name if found.camera_info else '': given_camera is None
            and self.cameras.camera is None,
        }
        for topic, texts in self._problems.items():
            if is_empty.get(topic, False):
                raise InputError(texts[0])
            _LOG.warning('%d messages left out: %s', len(texts), texts[0])


def _longest(
    path: Path, topic: str, images: list[tuple[int, int]]
) -> tuple[OrderedStamps, IntArray]:
    """Return the stamps in order of time, and the log times (ns), of the images that are used.

    If time starts anew within the bag, as after the restart of a simulator, only the part with
    the most images is used. A warning states this, and any repeated or late stamps.
    """
    rows = np.array(images, np.int64).reshape(-1, 2)
    chosen = rows[longest_pass(rows[:, 1])]
    order = in_order(chosen[:, 1])
    texts = [str(order)] if str(order) else []
    if len(chosen) < len(rows):
        texts.append(f'time starts anew; only the longest part is used ({len(chosen)} images)')
    if texts:
        _LOG.warning('%s: %s: %s', path, topic, ', '.join(texts))
    return order, chosen[:, 0]


def _trajectory(poses: dict[int, FloatArray]) -> Trajectory | None:
    if not poses:
        return None
    stamps_ns = sorted(poses)
    stacked = np.array([poses[t] for t in stamps_ns]).reshape(-1, 4, 4)
    return Trajectory(np.array(stamps_ns, np.int64), stacked)
