"""Bags as sequences of RGB-D frames."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from hoid_bags.bag import bag_messages, bag_types
from hoid_bags.bag.bag_reader import BagReader, BagTopic
from hoid_bags.bag.bag_topics import RecordedTopics, find_topics
from hoid_bags.bag.image_messages import decode_color, decode_depth
from hoid_bags.bag.stamps import header_stamp_ns, stamp_ns
from hoid_bags.images import check_size
from hoid_bags.tum.association import associate
from hoid_common.errors import InputError, MessageError
from hoid_common.io.camera_info import camera_from_info
from hoid_common.values import (
    CameraModel,
    Detections,
    FloatArray,
    IntArray,
    RgbdFrame,
    Trajectory,
)


class BagSequence:
    """The paired color and depth images of a bag, as a `Sequence`.

    Topics, stamps, camera and ground truth are read when it is opened, images when it is iterated.
    """

    def __init__(self, path: Path, camera: CameraModel | None = None) -> None:
        """Open a bag.

        Args:
            path: The folder or file of the bag.
            camera: The camera to use in place of the bag's own `camera_info`.

        Raises:
            InputError: It is no bag, has no RGB-D images, or stamps that are out of order.
        """
        self.path = path
        self.name = path.resolve().name
        with BagReader(path) as reader:
            self.topics = find_topics(reader)
            index = _Index(reader, self.topics)
            self.fault = reader.fault
        camera = camera or index.camera
        if camera is None:
            raise InputError(f'{path}: has no camera_info of the color images; give --camera')
        self.camera = camera
        self.ground_truth = index.ground_truth
        self.true_detections: Mapping[int, Detections] | None = index.true_detections
        pairs = associate(index.color_ns, index.depth_ns, source=path)
        self.depth_of_color = {
            int(index.color_ns[i]): int(index.depth_ns[j]) for i, j in pairs.tolist()
        }
        """Stamp of the depth image (ns) by the stamp of the color image, in order of time."""
        if not self.depth_of_color:
            raise InputError(f'{path}: no color and depth images within 0.02 s of each other')

    def __len__(self) -> int:
        return len(self.depth_of_color)

    def __iter__(self) -> Iterator[RgbdFrame]:
        color_name, depth_name = self.topics.color.name, self.topics.depth.name
        wanted_depth = set(self.depth_of_color.values())
        waiting = iter(self.depth_of_color.items())
        color_ns, depth_ns = next(waiting)
        color: dict[int, bytes] = {}
        depth: dict[int, bytes] = {}
        with BagReader(self.path) as reader:
            for message in reader.messages([color_name, depth_name]):
                message_ns = header_stamp_ns(message.data)
                if message.topic == color_name and message_ns in self.depth_of_color:
                    color[message_ns] = message.data
                elif message.topic == depth_name and message_ns in wanted_depth:
                    depth[message_ns] = message.data
                while color_ns in color and depth_ns in depth:
                    yield self._frame(color_ns, color.pop(color_ns), depth.pop(depth_ns))
                    color_ns, depth_ns = next(waiting, (-1, -1))

    def _frame(self, color_ns: int, color: bytes, depth: bytes) -> RgbdFrame:
        topic = self.topics.color
        try:
            image_bgr = decode_color(color, topic)
            check_size(image_bgr, self.camera, topic.name)
            topic = self.topics.depth
            depth_m = decode_depth(depth, topic)
            check_size(depth_m, self.camera, topic.name)
        except (MessageError, InputError) as error:
            raise InputError(f'{self.path}: {topic.name} at {color_ns} ns: {error}') from error
        return RgbdFrame(color_ns, image_bgr, depth_m)


class _Index:
    """Stamps of the images, camera and ground truth, collected in one pass over a bag."""

    def __init__(self, reader: BagReader, found: RecordedTopics) -> None:
        self.camera: CameraModel | None = None
        self._found = found
        self._stamps_ns: dict[str, list[int]] = {found.color.name: [], found.depth.name: []}
        self._poses: dict[int, FloatArray] = {}
        self._detections: dict[int, Detections] = {}
        by_name = {topic.name: topic for topic in found if topic is not None}
        for topic, _, data in reader.messages(list(by_name)):
            try:
                self._add(by_name[topic], data)
            except MessageError as error:
                raise InputError(f'{reader.path}: {topic}: {error}') from error
        self.color_ns, self.depth_ns = (
            _increasing(reader.path, topic, stamps_ns)
            for topic, stamps_ns in self._stamps_ns.items()
        )
        self.true_detections = self._detections if found.true_detections else None
        self.ground_truth = _trajectory(self._poses) if found.ground_truth else None

    def _add(self, topic: BagTopic, data: bytes) -> None:
        if topic.name in self._stamps_ns:
            self._stamps_ns[topic.name].append(header_stamp_ns(data))
            return
        if topic == self._found.camera_info and self.camera is not None:
            return
        message = bag_types.deserialize(data, topic.type_name)
        if topic == self._found.camera_info:
            self.camera = camera_from_info(message)
        elif topic == self._found.ground_truth:
            self._poses[stamp_ns(message)] = bag_messages.pose_from_message(message)
        else:
            boxes = bag_messages.detections_from_message(message)
            self._detections[boxes.stamp_ns] = boxes


def _increasing(path: Path, topic: str, stamps_ns: list[int]) -> IntArray:
    array = np.array(stamps_ns, np.int64)
    backwards = np.flatnonzero(np.diff(array) <= 0)
    if len(backwards):
        i = int(backwards[0]) + 1
        raise InputError(
            f'{path}: {topic}: stamp {array[i]} ns of message {i + 1} is not after the one before'
            f' it ({array[i - 1]} ns); record again'
        )
    return array


def _trajectory(poses: dict[int, FloatArray]) -> Trajectory:
    stamps_ns = sorted(poses)
    stacked = np.array([poses[t] for t in stamps_ns]).reshape(-1, 4, 4)
    return Trajectory(np.array(stamps_ns, np.int64), stacked)
