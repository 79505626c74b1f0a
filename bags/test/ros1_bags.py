"""Writes ROS 1 bags, as TUM's benchmark and RealSense Viewer publish them."""

from __future__ import annotations

import struct
from pathlib import Path

from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from hoid_bags.bag.bag_reader import BagReader
from hoid_bags.storage.bag_types import IMAGE, shared_typestore

NOETIC = get_typestore(Stores.ROS1_NOETIC)
FOREIGN = 'dynamic_reconfigure/msg/BoolParameter'
NOETIC.register(get_types_from_msg('string name\nbool value', FOREIGN))


def ros1_copy(
    bag: Path, to: Path, compression: str = '', image_unit_m: float | None = None
) -> Path:
    """Copy a bag of ROS 2 to a ROS 1 bag, with a topic of a type that ROS 2 lacks.

    Args:
        bag: The bag of ROS 2.
        to: The .bag file.
        compression: '', 'bz2' or 'lz4'.
        image_unit_m: Depth unit that librealsense appends to images; None: another recorder.
    """
    writer = Writer(to)
    if compression:
        writer.set_compression(Writer.CompressionFormat[compression.upper()])
    with BagReader(bag) as reader, writer:
        kinds = {topic.name: topic.type_name for topic in reader.topics}
        copies = {
            name: writer.add_connection(name, kind, typestore=NOETIC)
            for name, kind in kinds.items()
        }
        foreign = writer.add_connection('/driver/a parameter/0', FOREIGN, typestore=NOETIC)
        parameter = NOETIC.types[FOREIGN](name='emitter', value=True)
        writer.write(foreign, 1, NOETIC.serialize_ros1(parameter, FOREIGN))
        for message in reader.messages():
            kind = kinds[message.topic]
            data = bytes(shared_typestore().cdr_to_ros1(message.data, kind))
            if kind == IMAGE and image_unit_m is not None:
                data += struct.pack('<f', image_unit_m)
            writer.write(copies[message.topic], message.log_ns, data)
    return to
