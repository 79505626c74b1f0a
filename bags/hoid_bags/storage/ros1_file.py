"""ROS 1 bags, whose messages are converted to those of ROS 2 while they are read."""

from __future__ import annotations

import re
from collections.abc import Collection, Generator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag1,
    ConnectionExtRosbag2,
)
from rosbags.rosbag1 import Reader
from rosbags.rosbag1.reader import Chunk, decompressors
from rosbags.typesys import get_types_from_msg
from rosbags.typesys.base import TypesysError

from hoid_bags.storage import bag_types
from hoid_bags.storage.bag_types import TF_MESSAGE, ensure_type, shared_typestore
from hoid_bags.storage.chunks import unpack
from hoid_bags.storage.qos_profiles import recorded_qos
from hoid_bags.storage.viewer_bag import Converter, viewer_topic
from hoid_common import topics
from hoid_common.errors import InputError

ROS1_SUFFIX = '.bag'
_RENAMED = {'tf/msg/tfMessage': TF_MESSAGE}
_HEADER = 'std_msgs/msg/Header'  # its field `seq` exists in ROS 1 only, and is left out
# In a topic name: characters that ROS 2 forbids, and the place before a part's leading digit.
_FORBIDDEN = re.compile(r'[^\w/]|(?<=/)(?=\d)', re.ASCII)


class Ros1File(Reader):
    """A ROS 1 bag (format 2.0), read by its index.

    Topics whose type ROS 2 defines differently, or not at all, are listed, but cannot be read.
    Names that ROS 2 does not allow get underscores: /tf/0 becomes /tf/_0.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._converters: dict[int, Converter] = {}  # converter by id of the connection

    def open(self) -> None:
        """Read the index; rosbags.rosbag1.ReaderError if it is missing or incomplete."""
        super().open()
        for i, found in enumerate(self.connections):
            viewer = viewer_topic(found.topic, found.msgtype)
            name = viewer.name if viewer else found.topic
            type_name = viewer.type_name if viewer else found.msgtype
            extra = found.ext
            is_latched = isinstance(extra, ConnectionExtRosbag1) and bool(extra.latching)
            self.connections[i] = found._replace(
                topic=_FORBIDDEN.sub('_', name),
                msgtype=_RENAMED.get(type_name, type_name),
                ext=ConnectionExtRosbag2(
                    'cdr', [recorded_qos(latched=is_latched or name == topics.TF_STATIC)]
                ),
            )
            converter = viewer.convert if viewer else _converter(self.connections[i])
            if converter is not None:
                self._converters[found.id] = converter

    @property
    def metadata(self) -> Ros1File:
        """Return this file, which has the times and the number of messages as attributes."""
        return self

    def is_readable(self, connection: Connection) -> bool:
        """Return whether ROS 2 defines the type of a topic in the same way."""
        return connection.id in self._converters

    def read_chunk(self) -> Chunk:
        """Return the chunk at the current position; it is unpacked to at most 256 MiB."""
        chunk = super().read_chunk()
        (name,) = (name for name, unpack in decompressors.items() if unpack is chunk.decompressor)
        compression = '' if name == 'none' else name
        return chunk._replace(decompressor=partial(unpack, compression=compression))

    def messages(
        self,
        connections: Collection[Connection] = (),
        start: int | None = None,
        stop: int | None = None,
    ) -> Generator[tuple[Connection, int, bytes], None, None]:
        """Yield messages of readable topics in order of time: topic, log time (ns), CDR bytes."""
        readable = [c for c in connections if c.id in self._converters]
        found = super().messages(readable, start, stop) if readable else ()
        for connection, log_ns, data in found:
            yield connection, log_ns, bytes(self._converters[connection.id](data))


def _converter(connection: Connection) -> Converter | None:
    """Return the converter of a topic's messages to CDR; None: ROS 2 has no equal type."""
    name = connection.msgtype
    try:
        ensure_type(name)
        types = get_types_from_msg(connection.msgdef.data, name)
    except (InputError, TypesysError):
        return None
    if not _is_equal(types, name):
        return None
    return partial(shared_typestore().ros1_to_cdr, typename=name)


def _is_equal(types: Mapping[str, Any], name: str) -> bool:
    """Return whether ROS 2 serializes the fields of a type in the same order and kinds."""
    if name == _HEADER or name not in types:  # not in `types`: time and duration
        return True
    store = shared_typestore()
    if name not in store.fielddefs:
        return False
    kinds = [kind for _, kind in types[name][1]]
    if kinds != [kind for _, kind in store.fielddefs[name][1]]:
        return False
    return all(_is_equal(types, inner) for inner in bag_types.named_types(types[name][1]))
