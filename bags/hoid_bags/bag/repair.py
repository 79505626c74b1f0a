"""Copies of the readable messages of bags: repair, and conversion of ROS 1 bags."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

from hoid_bags.bag.bag_reader import BagReader
from hoid_bags.bag.bag_topics import readable_topics
from hoid_bags.bag.bag_writer import BagWriter
from hoid_common.errors import InputError
from hoid_common.io.files import abandoned_scratch_folders

_SCRATCH = re.compile(r'\.(?P<name>.*[^.].*)\.partial-[^.]+')  # name made by `scratch_folder`


def repair(path: Path) -> Path:
    """Copy all readable messages to a new bag beside the old one, and return its path.

    A damaged bag (a folder or a file) is kept, and its copy has the suffix `_repaired`. The hidden
    folder `.NAME.partial-XXXX` of a killed recording is removed once its messages are in the bag
    NAME, or in NAME_repaired if NAME exists. InputError as in `copy_bag`, or if the recorder still
    runs.
    """
    scratch = _SCRATCH.fullmatch(path.name) if path.is_dir() else None
    if scratch is None:
        name = path.name if path.is_dir() else path.stem
        target = path.with_name(f'{name}_repaired')
        copy_bag(path, target)
        return target
    if path not in abandoned_scratch_folders(path.parent):
        raise InputError(f'{path}: is still being recorded')
    target = path.with_name(scratch['name'])
    if target.exists():
        target = path.with_name(f'{scratch["name"]}_repaired')
    copy_bag(path / scratch['name'], target)
    shutil.rmtree(path, ignore_errors=True)
    return target


def copy_bag(
    source: Path, target: Path, *, compress: bool = False, expand: bool = False
) -> str | None:
    """Copy all readable messages to a new MCAP bag; return a line about damage, or None.

    The copy of a ROS 1 bag has ROS 2 messages. Topics whose types ROS 2 lacks are left out with a
    warning. With `expand`, video and RGBD messages are replaced by the messages inside them.
    InputError if nothing can be read, the definition of a message type is unknown, or the new bag
    exists already or cannot be written.
    """
    with BagReader(source) as reader, BagWriter(target, compress=compress) as writer:
        parts = reader.parts if expand else ()
        sources = {part.source for part in parts}
        topics = [topic for topic in readable_topics(reader) if topic.name not in sources]
        copied = [topic for topic in (*topics, *parts) if topic.num_messages]
        for topic in copied:
            writer.add_topic(topic.name, topic.type_name, topic.qos)
        for message in reader.messages([topic.name for topic in copied]):
            writer.write_serialized(message.topic, message.log_ns, message.data)
        return reader.fault
