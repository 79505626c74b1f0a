"""Bags of this suite and of `ros2 bag record`, whole or cut off."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

from hoid_bags.bag.bag_source import BagMessage, BagSource, BagTopic, WholeBag
from hoid_bags.bag.cut_bag import CutBag
from hoid_bags.bag.packed_files import check_packed
from hoid_bags.mcap.chunks import DAMAGE, describe_damage, one_line
from hoid_common.errors import InputError
from hoid_common.io.yaml_file import parse_yaml, read_yaml
from hoid_common.values import NS_PER_S

METADATA = 'metadata.yaml'


def is_bag(path: Path) -> bool:
    """Return whether a path is a bag's folder, or a file of one."""
    if path.is_dir():
        return (path / METADATA).exists() or any(_files(path, '.mcap'))
    return path.suffix in ('.mcap', '.db3') and path.exists()


class BagReader:
    """Read a bag; a context manager.

    A bag that is damaged or was cut off gives what is readable of it; `fault` then says what is
    wrong.
    """

    def __init__(self, path: Path) -> None:
        """Prepare to read.

        Args:
            path: Of the bag's folder, or of one .mcap or .db3 file.

        Raises:
            InputError: nothing there, no bag, or metadata larger than any.
        """
        if not path.exists():
            raise InputError(f'{path}: no such bag')
        if not is_bag(path):
            raise InputError(f'{path}: not a bag: it has neither {METADATA} nor an .mcap file')
        self.path = path
        self._fault: str | None = None

    def __enter__(self) -> Self:
        """Open the bag.

        Raises:
            InputError: not a single message can be read.
        """
        try:
            _check_metadata(self.path / METADATA)
            if self.path.is_dir():
                check_packed(self.path)
            self._source: BagSource = WholeBag(self.path)
        except (*DAMAGE, InputError) as error:
            self._source = self._salvage(error)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._source.close()

    @property
    def fault(self) -> str | None:
        """Return what is wrong with what has been read so far, in one line, else None."""
        damage = self._source.damage
        if not damage:
            return self._fault
        said = describe_damage(damage)
        return f'{self._fault}; {said}' if self._fault else f'{self.path}: {said}'

    @property
    def topics(self) -> tuple[BagTopic, ...]:
        """Return every topic of the bag."""
        return self._source.topics

    @property
    def span_ns(self) -> tuple[int, int]:
        """Return the log times of the first and the last message; (0, 0) without messages."""
        return self._source.span_ns

    def topic_span_ns(self, topic: str) -> tuple[int, int]:
        """Return the log times of a topic's first and last message; (0, 0) without messages.

        Where the bag is damaged, these are the times of the whole bag: see `fault`.
        """
        try:
            return self._source.topic_span_ns(topic)
        except DAMAGE as error:
            self._fault = f'{self.path}: damaged: {one_line(error)}'
            return self.span_ns

    def messages(
        self, topics: Collection[str] | None = None, start_ns: int | None = None
    ) -> Iterator[BagMessage]:
        """Yield messages in order of time, less what is damaged: see `fault`.

        Args:
            topics: Absolute names; None means all.
            start_ns: Log time from which on to read.
        """
        num_read = first_ns = last_ns = 0
        try:
            for message in self._source.messages(topics, start_ns):
                num_read, last_ns = num_read + 1, message.log_ns
                first_ns = first_ns or last_ns
                yield message
        except DAMAGE as error:
            self._fault = (
                f'{self.path}: damaged after {num_read} messages'
                f' ({(last_ns - first_ns) / NS_PER_S:.2f} s); the rest is not read:'
                f' {one_line(error)}'
            )

    def _salvage(self, error: Exception) -> CutBag:
        files = _files(self.path, '.mcap') if self.path.is_dir() else [self.path]
        if not files or files[0].suffix != '.mcap':
            raise InputError(f'{self.path}: cannot be read: {one_line(error)}') from error
        bag = CutBag(files)
        num_messages = sum(topic.num_messages for topic in bag.topics)
        if not num_messages:
            raise InputError(f'{self.path}: no message can be read: {one_line(error)}') from error
        if not bag.is_whole:
            first_ns, last_ns = bag.span_ns
            self._fault = (
                f'{self.path}: cut off after {num_messages} messages'
                f' ({(last_ns - first_ns) / NS_PER_S:.2f} s); the rest is lost'
            )
        elif (self.path / METADATA).exists():
            self._fault = f'{self.path}: {one_line(error)}; read without {METADATA}'
        return bag


def _check_metadata(path: Path) -> None:
    """Refuse what the bag library's own YAML reader would take without limit.

    Raises:
        InputError: It is no plain YAML, or one of the QoS profiles, which are YAML in its text.
    """
    if not path.exists():  # of a single file's bag
        return
    match read_yaml(path):
        case {'rosbag2_bagfile_information': {'topics_with_message_count': [*topics]}}:
            for topic in topics:
                match topic:
                    case {'topic_metadata': {'offered_qos_profiles': str(profiles)}}:
                        parse_yaml(profiles, f'{path}: offered_qos_profiles')


def _files(folder: Path, suffix: str) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.suffix == suffix)
