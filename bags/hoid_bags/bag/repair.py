"""Bags made of what a killed recording left, and of bags that are damaged."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

from hoid_bags.bag.bag_reader import BagReader
from hoid_bags.bag.bag_writer import BagWriter
from hoid_common.errors import InputError
from hoid_common.io.files import abandoned_scratch_folders

_SCRATCH = re.compile(r'\.(?P<name>.*[^.].*)\.partial-[^.]+')  # of `scratch_folder`


def repair(path: Path) -> Path:
    """Make a bag of all messages that can be read, and return where it lies: beside the old one.

    Args:
        path: A recording's hidden folder, `.NAME.partial-XXXX`, which becomes the bag NAME and
            then goes away; or a damaged bag or file NAME, which stays, beside NAME_repaired.

    Raises:
        InputError: It is still being recorded, nothing can be read, or no bag can be written.
    """
    scratch = _SCRATCH.fullmatch(path.name) if path.is_dir() else None
    if scratch is None:
        return _copied(path, path.with_name(f'{path.stem}_repaired'))
    if path not in abandoned_scratch_folders(path.parent):
        raise InputError(f'{path}: is still being recorded')
    target = path.with_name(scratch['name'])
    bag = _copied(
        path / scratch['name'],
        target if not target.exists() else path.with_name(f'{scratch["name"]}_repaired'),
    )
    shutil.rmtree(path, ignore_errors=True)
    return bag


def _copied(source: Path, target: Path) -> Path:
    with BagReader(source) as reader, BagWriter(target) as writer:
        for topic in reader.topics:
            if topic.num_messages:
                writer.add_topic(topic.name, topic.type_name, topic.qos)
        for message in reader.messages():
            writer.write_serialized(message.topic, message.log_ns, message.data)
    return target
