"""Moves the depth of a bag into a camera of its own, as drivers publish it by default.

    ./hoid dev python lab/scripts/unaligned_depth.py BAG NEW_BAG

The new bag has depth of a camera 15 mm beside color, its camera_info, and /tf_static.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from hoid_bags.bag import bag_messages
from hoid_bags.bag.bag_reader import BagReader
from hoid_bags.bag.bag_sequence import BagSequence
from hoid_bags.bag.bag_writer import BagWriter
from hoid_bags.bag.image_messages import decode_depth
from hoid_bags.bag.stamps import header_stamp_ns
from hoid_bags.storage.bag_types import CAMERA_INFO, TF_MESSAGE
from hoid_bags.storage.qos_profiles import recorded_qos
from hoid_bags.storage.static_transforms import static_transforms
from hoid_common import se3, topics
from hoid_common.inputs.registration import Registration
from hoid_common.values import CameraModel

DEPTH = CameraModel(640, 480, 430.0, 430.0, 322.0, 241.0)
FRAME = 'depth_frame'
T_COLOR_DEPTH = se3.from_quat_translation(
    np.array([0.004, -0.006, 0.003, 1.0]), np.array([0.015, -0.001, 0.002])
)


def main() -> None:
    """Write the new bag."""
    source, target = map(Path, sys.argv[1:])
    sequence = BagSequence(source)
    depth, info = sequence.topics.depth, topics.camera_info_beside(sequence.topics.depth.name)
    moved = Registration(sequence.camera, DEPTH, se3.inverse(T_COLOR_DEPTH))
    with BagReader(source) as reader, BagWriter(target) as writer:
        for topic in reader.topics:
            writer.add_topic(topic.name, topic.type_name, topic.qos)
        writer.add_topic(info, CAMERA_INFO)
        writer.add_topic(topics.TF_STATIC, TF_MESSAGE, recorded_qos(latched=True))
        edge = (bag_messages.CAMERA_FRAME, FRAME, T_COLOR_DEPTH)
        writer.write(topics.TF_STATIC, reader.span_ns[0], static_transforms(edge))
        for message in reader.messages():
            if message.topic != depth.name:
                writer.write_serialized(message.topic, message.log_ns, message.data)
                continue
            stamp_ns = header_stamp_ns(message.data)
            depth_mm = np.rint(1000 * moved(decode_depth(message.data, depth))).astype(np.uint16)
            made = bag_messages.image(stamp_ns, depth_mm, '16UC1')
            camera = bag_messages.camera_info(stamp_ns, DEPTH)
            made.header.frame_id = camera.header.frame_id = FRAME
            writer.write(info, message.log_ns, camera)
            writer.write(depth.name, message.log_ns, made)


if __name__ == '__main__':
    main()
