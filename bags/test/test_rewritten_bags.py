"""Bags that are rewritten: packed as files or by messages, or with messages that are too short."""

from __future__ import annotations

import re
import tracemalloc
from pathlib import Path
from unittest import mock

import pytest
from backports import zstd
from rosbags.interfaces import Connection

from hoid_bags.bag.bag_reader import BagReader
from hoid_bags.sequence import open_sequence
from hoid_bags.storage import chunks
from hoid_common.errors import InputError

from .bag_copies import copy_bag, read_messages


def pack_file(bag: Path, data: bytes) -> None:
    """Replace a bag's file by a packed one, as `ros2 bag record --compression-mode file` does."""
    (bag / 'bag.mcap').unlink()
    (bag / 'bag.mcap.zstd').write_bytes(zstd.compress(data))
    metadata = bag / 'metadata.yaml'
    text = metadata.read_text()
    text = re.sub(r'compression_format: .*', "compression_format: 'zstd'", text)
    text = re.sub(r'compression_mode: .*', "compression_mode: 'FILE'", text)
    metadata.write_text(text.replace('bag.mcap', 'bag.mcap.zstd'))


def test_a_bag_packed_as_a_file_is_read(bag: Path) -> None:
    whole = [(m.topic, m.log_ns, m.data) for m in read_messages(bag)]
    pack_file(bag, (bag / 'bag.mcap').read_bytes())
    assert [(m.topic, m.log_ns, m.data) for m in read_messages(bag)] == whole


def test_a_bag_packed_by_messages_is_read(bag: Path, tmp_path: Path) -> None:
    copy_bag(bag, tmp_path / 'packed', lambda _c, _ns, data: data, pack=True)
    assert read_messages(tmp_path / 'packed') == read_messages(bag)


def test_a_message_that_unpacks_to_more_than_any_is_refused(bag: Path, tmp_path: Path) -> None:
    extra = bytes(1 << 24)
    copy_bag(bag, tmp_path / 'packed', lambda _c, _ns, data: data + extra, pack=True)
    with mock.patch.object(chunks, 'MAX_CHUNK_BYTES', 1 << 22):
        tracemalloc.start()
        with BagReader(tmp_path / 'packed') as reader:
            assert list(reader.messages()) == []
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
    assert 'unpacks to over 4194304 bytes' in (reader.fault or '')
    assert peak < 1 << 24


def test_a_packed_file_that_unpacks_to_more_than_any_bag_is_refused(bag: Path) -> None:
    pack_file(bag, bytes(1 << 28))  # 256 MB in 25 kB
    tracemalloc.start()
    with pytest.raises(InputError, match='which no bag does'), BagReader(bag):
        pass
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1 << 25


def test_images_that_are_too_short_for_a_header_cost_no_other_image(
    bag: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    stamps_ns = [m.log_ns for m in read_messages(bag) if m.topic.endswith('/image')]

    def shortened(connection: Connection, log_ns: int, data: bytes) -> bytes:
        is_short = connection.msgtype.endswith('/Image') and log_ns == stamps_ns[30]
        return bytes(5) if is_short else data

    copy_bag(bag, tmp_path / 'copy', shortened)
    sequence = open_sequence(tmp_path / 'copy')
    assert [m.levelname for m in caplog.records if '1 messages left out' in m.message] == [
        'WARNING'
    ]
    assert len(list(sequence)) == len(sequence) == 59
