"""The metadata.yaml of rosbag2 bags: read within limits, and compared with the files.

Topics, times and messages are always taken from the files. The metadata are used only for what the
files do not contain: their order, and whether each message is compressed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final, NamedTuple

from rosbags.interfaces import Connection

from hoid_common.errors import InputError
from hoid_common.io.yaml_file import read_yaml
from hoid_common.values import NS_PER_S

METADATA: Final = 'metadata.yaml'
_MAX_TIME_ERROR_NS = NS_PER_S  # chosen: recorders define the time of a message differently


class BagMetadata(NamedTuple):
    """Content of a metadata.yaml."""

    path: Path
    files: tuple[Path, ...]  # in the listed order
    has_packed_messages: bool  # whether each message is compressed on its own
    num_messages: Counter[tuple[str, str]]  # by name and type of the topic
    first_ns: int  # log time of the first message
    last_ns: int  # log time of the last message

    def check(self, connections: Iterable[Connection], first_ns: int, last_ns: int) -> None:
        """Raise InputError if the metadata contradict the files: messages may be missing then.

        The numbers of messages must be equal; times may differ by one second.
        """
        found: Counter[tuple[str, str]] = Counter()
        for connection in connections:
            found[connection.topic, connection.msgtype] += connection.msgcount
        if wrong := sorted((+found).items() ^ (+self.num_messages).items()):
            (topic, _), _ = wrong[0]
            raise InputError(
                f'{self.path}: has another number of messages of {topic} than the files'
            )
        error_ns = max(abs(self.first_ns - first_ns), abs(self.last_ns - last_ns))
        if found.total() and error_ns > _MAX_TIME_ERROR_NS:
            raise InputError(f'{self.path}: has other times of messages than the files')


def read_metadata(folder: Path) -> BagMetadata | None:
    """Return the metadata in a bag folder, or None without a file; InputError if it is bad."""
    path = folder / METADATA
    if not path.exists():
        return None
    match read_yaml(path):
        case {
            'rosbag2_bagfile_information': {
                'relative_file_paths': [*names],
                'starting_time': {'nanoseconds_since_epoch': int(first_ns)},
                'duration': {'nanoseconds': int(duration_ns)},
                'topics_with_message_count': [*topics],
                **others,
            }
        }:
            num_messages: Counter[tuple[str, str]] = Counter()
            for topic in topics:
                num_messages += _topic(path, topic)
            return BagMetadata(
                path,
                tuple(folder / Path(str(name)).name for name in names),
                str(others.get('compression_mode')).lower() == 'message',
                num_messages,
                first_ns,
                first_ns + duration_ns,
            )
    raise InputError(f'{path}: is not the metadata of a bag')


def _topic(path: Path, entry: Any) -> Counter[tuple[str, str]]:
    match entry:
        case {
            'message_count': int(number),
            'topic_metadata': {'name': str(name), 'type': str(type_name)},
        }:
            return Counter({(name, type_name): number})
    raise InputError(f'{path}: an entry of topics_with_message_count is incomplete')
