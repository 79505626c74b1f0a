"""Reading of bags that this suite or `ros2 bag record` wrote, including damaged bags."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from contextlib import ExitStack, suppress
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Self

from rosbags.interfaces import ConnectionExtRosbag2

from hoid_bags.bag.contents import BagMessage, BagTopic, PartReader, is_container, parts_of
from hoid_bags.bag.metadata import METADATA, read_metadata
from hoid_bags.storage.chunks import DAMAGE, ZSTD_MAGIC, describe_damage, one_line, unpack_message
from hoid_bags.storage.mcap_file import McapFile
from hoid_bags.storage.packed_file import SUFFIX, unpack_file
from hoid_bags.storage.ros1_file import ROS1_SUFFIX, Ros1File
from hoid_bags.storage.sqlite_file import SqliteFile
from hoid_bags.storage.write_ahead_log import has_log, with_log
from hoid_common.errors import InputError, MessageError
from hoid_common.io.untrusted import open_regular
from hoid_common.values import NS_PER_S

_STORAGE_SUFFIXES = ('.mcap', '.db3', f'.mcap{SUFFIX}', f'.db3{SUFFIX}')
_File = McapFile | SqliteFile | Ros1File
# Chosen: time at the end of a bag that has the last message of most topics.
_FIRST_WINDOW_NS = NS_PER_S


def is_bag(path: Path) -> bool:
    """Return whether a path is the folder of a bag, or one file of a bag.

    The names of files decide; no file is read.
    """
    if path.is_dir():
        return (path / METADATA).exists() or bool(_storage_files(path))
    return path.exists() and path.name.endswith((*_STORAGE_SUFFIXES, ROS1_SUFFIX))


class BagReader:
    """Context manager that reads a bag, or the readable part of a damaged bag.

    `fault` then describes the part that is missing.
    """

    def __init__(self, path: Path) -> None:
        """Prepare to read the folder of a bag or one of its files; InputError if it is no bag."""
        if not path.exists():
            raise InputError(f'{path}: no such bag')
        if not is_bag(path):
            raise InputError(
                f'{path}: not a bag: it has neither {METADATA} nor an .mcap, .db3 or .bag file'
            )
        self.path = path
        self._fault: str | None = None
        self._has_packed_messages = False

    def __enter__(self) -> Self:
        """Open the bag; InputError if no file can be opened, or no message can be read."""
        with ExitStack() as stack:
            try:
                self._files = self._open_as_described(stack)
            except InputError as error:
                self._files = self._open_without_metadata(stack, error)
            self._note_unusable_files()
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def fault(self) -> str | None:
        """Return a line of text about the damage found so far, or None without damage."""
        damage = [chunk for file in self._mcap_files for chunk in file.damage.values()]
        if not damage:
            return self._fault
        before = f'{self._fault}; ' if self._fault else f'{self.path}: '
        return before + describe_damage(damage)

    @property
    def topics(self) -> tuple[BagTopic, ...]:
        """Return all topics, including those without messages.

        A topic that was recorded with several QoS profiles is listed once.
        """
        merged: dict[str, BagTopic] = {}
        for connection in (c for file in self._files for c in file.connections):
            extra, before = connection.ext, merged.get(connection.topic)
            profiles = (
                extra.offered_qos_profiles if isinstance(extra, ConnectionExtRosbag2) else []
            )
            merged[connection.topic] = BagTopic(
                connection.topic,
                connection.msgtype,
                connection.msgcount + (before.num_messages if before else 0),
                before.qos if before else profiles[0] if profiles else None,
                not isinstance(connection.owner, Ros1File)
                or connection.owner.is_readable(connection),
            )
        return tuple(merged.values())

    @cached_property
    def parts(self) -> tuple[BagTopic, ...]:
        """Return the topics that messages of other topics contain: images of a video or RGBD.

        `messages` yields their messages under their names. `topics` does not list them.
        """
        found: list[BagTopic] = []
        for topic in filter(is_container, self.topics):
            if (first := next(self.messages([topic.name]), None)) is not None:
                with suppress(MessageError):
                    found += parts_of(topic, first.data)
        return tuple(found)

    @property
    def span_ns(self) -> tuple[int, int]:
        """Return the log times of the first and the last message; (0, 0) without messages."""
        filled = [file.metadata for file in self._files if file.metadata.message_count]
        if not filled:
            return 0, 0
        return min(m.start_time for m in filled), max(m.end_time for m in filled) - 1

    def topic_span_ns(self, topic: str) -> tuple[int, int]:
        """Return the log times of a topic's first and last message.

        If no message of the topic can be read, the log times of the whole bag are returned.
        """
        first = next(self.messages([topic]), None)
        bag_first_ns, bag_last_ns = self.span_ns
        window_ns = _FIRST_WINDOW_NS
        while first is not None and window_ns < 4 * (bag_last_ns - bag_first_ns + NS_PER_S):
            tail = self.messages([topic], max(bag_last_ns - window_ns, first.log_ns))
            last_ns = max((message.log_ns for message in tail), default=None)
            if last_ns is not None:
                return first.log_ns, last_ns
            window_ns *= 4
        return bag_first_ns, bag_last_ns

    def messages(
        self, topics: Collection[str] | None = None, start_ns: int | None = None
    ) -> Iterator[BagMessage]:
        """Yield readable messages, file by file, from a log time on; `fault` describes lost ones.

        The messages of a file are in order of log time, except in an MCAP file without chunks,
        where they are in the order of the file. `topics` None: all topics are read.
        """
        num_read = first_ns = last_ns = 0
        try:
            for message in self._all_messages(topics, start_ns):
                num_read, last_ns = num_read + 1, message.log_ns
                first_ns = first_ns or last_ns
                yield message
        except DAMAGE as error:
            self._fault = (
                f'{self.path}: damaged after {num_read} messages'
                f' ({(last_ns - first_ns) / NS_PER_S:.2f} s); the rest is not read:'
                f' {one_line(error)}'
            )

    def _all_messages(
        self, topics: Collection[str] | None, start_ns: int | None
    ) -> Iterator[BagMessage]:
        readers = self._part_readers(topics)
        names = None if topics is None else {*topics, *readers}
        for file in self._files:
            wanted = [c for c in file.connections if names is None or c.topic in names]
            for connection, log_ns, stored in file.messages(wanted, start_ns) if wanted else ():
                is_packed = self._has_packed_messages or stored[:4] == ZSTD_MAGIC
                data = unpack_message(stored) if is_packed else stored
                if topics is None or connection.topic in topics:
                    yield BagMessage(connection.topic, log_ns, data)
                if (reader := readers.get(connection.topic)) is not None:
                    yield from reader.read(log_ns, data)
        for reader in readers.values():
            yield from reader.flush()

    def _part_readers(self, topics: Collection[str] | None) -> dict[str, PartReader]:
        by_name = {topic.name: topic for topic in self.topics}
        if topics is None or by_name.keys() >= set(topics):
            return {}
        sources = {part.source for part in self.parts if part.name in topics}
        return {source: PartReader(by_name[source], topics) for source in sources}

    @property
    def _mcap_files(self) -> list[McapFile]:
        return [file for file in self._files if isinstance(file, McapFile)]

    def _open_as_described(self, stack: ExitStack) -> list[_File]:
        """Open `path` if it is a file, else the files that metadata.yaml lists, else all files.

        InputError: a file cannot be opened, or metadata.yaml contradicts the files.
        """
        if not self.path.is_dir():
            return [_open_file(self.path, stack)]
        metadata = read_metadata(self.path)
        if metadata is None:
            return self._open_all(stack)
        self._has_packed_messages = metadata.has_packed_messages
        files = self._files = self._open_each(metadata.files, stack)
        is_whole = not any(file.is_cut_off or file.index_error for file in self._mcap_files)
        if is_whole and self._fault is None:
            metadata.check([c for file in files for c in file.connections], *self.span_ns)
        return files

    def _open_without_metadata(self, stack: ExitStack, error: InputError) -> list[_File]:
        files = self._open_all(stack) if self.path.is_dir() else []
        if not files:
            raise error
        before = f'{self._fault}; ' if self._fault else ''
        self._fault = f'{before}{error}; read without {METADATA}'
        return files

    def _open_all(self, stack: ExitStack) -> list[_File]:
        files = self._open_each(_storage_files(self.path), stack)
        return sorted(files, key=lambda file: file.metadata.start_time)

    def _open_each(self, paths: Iterable[Path], stack: ExitStack) -> list[_File]:
        """Open the files and record failures in `fault`; InputError if no file can be opened."""
        files, errors = [], []
        for path in paths:
            try:
                files.append(_open_file(path, stack))
            except InputError as error:
                errors.append(error)
        if errors and not files:
            raise errors[0]
        if errors:
            total = len(files) + len(errors)
            self._fault = f'{errors[0]}; {len(errors)} of {total} files left out'
        return files

    def _note_unusable_files(self) -> None:
        """Set `fault` if a file or its index is damaged; InputError if no message is readable."""
        num_messages = sum(topic.num_messages for topic in self.topics)
        errors = [file.index_error for file in self._mcap_files if file.index_error is not None]
        if errors and not num_messages:
            raise InputError(f'{self.path}: no message can be read: {errors[0]}')
        before = f'{self._fault}; ' if self._fault else f'{self.path}: '
        if any(file.is_cut_off for file in self._mcap_files):
            first_ns, last_ns = self.span_ns
            self._fault = (
                f'{before}cut off after {num_messages} messages'
                f' ({(last_ns - first_ns) / NS_PER_S:.2f} s); the rest is lost'
            )
        elif errors:
            self._fault = f'{before}the index is damaged: {errors[0]}; read without it'


def _open_file(path: Path, stack: ExitStack) -> _File:
    """Open one file of a bag, and have the stack close it; InputError if that fails.

    A compressed file, and a .db3 file with a write-ahead log, are first copied to a temporary
    folder. Damage inside an .mcap file raises no error.
    """
    open_regular(path).close()
    if path.suffix == SUFFIX:
        path = unpack_file(path, Path(stack.enter_context(TemporaryDirectory())))
    if path.suffix == '.db3' and has_log(path):
        path = with_log(path, Path(stack.enter_context(TemporaryDirectory())))
    kinds: dict[str, type[_File]] = {'.db3': SqliteFile, ROS1_SUFFIX: Ros1File}
    file = kinds.get(path.suffix, McapFile)(path)
    try:
        file.open()
    except DAMAGE as error:
        raise InputError(f'{path}: cannot be read: {one_line(error)}') from error
    stack.callback(file.close)
    return file


def _storage_files(folder: Path) -> list[Path]:
    """Return the storage files of a bag, without compressed copies of uncompressed files."""
    names = {path.name for path in folder.iterdir() if path.name.endswith(_STORAGE_SUFFIXES)}
    packed = {name for name in names if name.endswith(SUFFIX)}
    return sorted(
        folder / name for name in names - {p for p in packed if p.removesuffix(SUFFIX) in names}
    )
