"""Bags that are cut off, damaged or hostile: readable messages are read, the fault is reported."""

from __future__ import annotations

import os
import re
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from backports import zstd
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import (
    ReaderError,
)

from hoid_bags.bag.bag_reader import BagReader
from hoid_bags.bag.info import summarize
from hoid_bags.live.playback import PlayConfig, open_plan
from hoid_bags.sequence import open_sequence
from hoid_bags.storage.chunks import MAX_CHUNK_BYTES, split_records, unpack
from hoid_common.errors import InputError
from hoid_common.values import CameraModel

from .bag_copies import read_messages


@pytest.mark.parametrize('keep_metadata', [True, False])
def test_a_bag_cut_in_the_middle_gives_what_is_left(
    bag: Path, big_camera: CameraModel, keep_metadata: bool
) -> None:
    whole = list(open_sequence(bag))
    file = bag / 'bag.mcap'
    data = file.read_bytes()
    file.write_bytes(data[: len(data) * 7 // 10])
    if not keep_metadata:
        (bag / 'metadata.yaml').unlink()
    cut = open_sequence(bag)
    assert cut.fault is not None
    assert 'cut off after' in cut.fault
    assert '\n' not in cut.fault
    frames = list(cut)
    assert len(cut) == len(frames)
    assert 0.3 * len(whole) < len(frames) < 0.75 * len(whole)
    for ours, theirs in zip(frames, whole, strict=False):
        assert ours.stamp_ns == theirs.stamp_ns
        np.testing.assert_array_equal(ours.depth_m, theirs.depth_m)
    assert cut.camera == big_camera
    summary = summarize(bag)
    assert summary.fault == cut.fault
    assert summary.num_messages > 3 * len(frames) - 3


def test_a_bag_with_nothing_readable_left(bag: Path) -> None:
    file = bag / 'bag.mcap'
    file.write_bytes(file.read_bytes()[:100])
    with pytest.raises(InputError, match='no message can be read'):
        open_sequence(bag)


def test_a_bag_whose_metadata_was_lost_is_whole(bag: Path) -> None:
    (bag / 'metadata.yaml').unlink()
    sequence = open_sequence(bag)
    assert sequence.fault is None
    assert len(sequence) == 60


def test_a_bag_with_wrong_metadata_has_a_fault(bag: Path) -> None:
    (bag / 'metadata.yaml').write_text('- hello')
    sequence = open_sequence(bag)
    assert sequence.fault is not None
    assert 'read without metadata.yaml' in sequence.fault
    assert len(list(sequence)) == 60


@pytest.mark.parametrize(
    ('old', 'new', 'expected'),
    [
        ('rosbag2_bagfile_information:', 'a: &a [1]\nb: *a\nc:', 'an alias'),
        ('rosbag2_bagfile_information:', 'a: ' + '[' * 3000 + '\nc:', 'nested deeper'),
        ('  version: ', '  version: !!int ', 'the tag'),
    ],
)
def test_hostile_metadata_is_not_read(bag: Path, old: str, new: str, expected: str) -> None:
    path = bag / 'metadata.yaml'
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    sequence = open_sequence(bag)
    assert sequence.fault is not None
    assert expected in sequence.fault
    assert 'read without metadata.yaml' in sequence.fault
    assert len(sequence) == 60


@pytest.mark.parametrize(
    ('good', 'bad'),
    [
        ('/depth/image', '/depth/imagf'),
        ('sensor_msgs/msg/Image', 'a/msg/B'),
        ('message_count: 60', 'message_count: 59'),
        ('  - bag.mcap', '  - bag.mcap\n  - bag.mcap'),
        ('  - bag.mcap', '  - bag.mcap\n  - ./x/bag.mcap'),
        ('\n  - bag.mcap', ' []'),
    ],
)
def test_metadata_that_contradicts_the_files_is_not_believed(
    bag: Path, good: str, bad: str
) -> None:
    metadata = bag / 'metadata.yaml'
    text = metadata.read_text()
    assert good in text
    metadata.write_text(text.replace(good, bad, 1))
    sequence = open_sequence(bag)
    assert len(list(sequence)) == 60
    assert 'metadata.yaml: has another number of messages of /' in (sequence.fault or '')
    assert 'read without metadata.yaml' in (sequence.fault or '')


@pytest.mark.parametrize(
    ('name', 'added'), [('nanoseconds_since_epoch', 2 * 10**18), ('nanoseconds', 2 * 10**9)]
)
def test_metadata_with_other_times_are_not_believed(bag: Path, name: str, added: int) -> None:
    whole = summarize(bag)
    metadata = bag / 'metadata.yaml'
    text, num_changed = re.subn(
        rf'\b{name}: (\d+)', lambda m: f'{name}: {int(m[1]) + added}', metadata.read_text()
    )
    assert num_changed
    metadata.write_text(text)
    sequence = open_sequence(bag)
    assert len(list(sequence)) == 60
    assert 'metadata.yaml: has other times of messages than the files' in (sequence.fault or '')
    found = summarize(bag)
    assert (found.start_ns, found.end_ns) == (whole.start_ns, whole.end_ns)


def damage(bag: Path) -> None:
    """Overwrite a whole chunk; the index stays."""
    file = bag / 'bag.mcap'
    data = bytearray(file.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 300_000] = bytes(300_000)
    file.write_bytes(data)


def test_a_damaged_chunk_costs_no_more_than_itself(bag: Path) -> None:
    damage(bag)
    with BagReader(bag) as reader:
        stamps_ns = [message.log_ns for message in reader.messages()]
        assert stamps_ns == sorted(stamps_ns)
        fault = reader.fault or ''
    lost = [int(number) for number in re.findall(r'(\d+) of /', fault)]
    assert len(lost) == 3
    assert len(stamps_ns) == 180 - sum(lost)
    assert sum(lost) <= 48  # of two chunks, where the damage lies across both
    assert re.search(r'damaged: \d chunks? .* at byte \d+ of bag.mcap: checksum mismatch', fault)
    assert '\n' not in fault


@pytest.mark.parametrize('seed', range(25))
def test_a_flipped_bit_is_reported(bag: Path, seed: int) -> None:
    file = bag / 'bag.mcap'
    data = bytearray(file.read_bytes())
    place = np.random.default_rng(seed).integers(1000, len(data) - 10_000)
    data[place] ^= 1 << seed % 8
    file.write_bytes(data)
    with BagReader(bag) as reader:
        num_read = sum(1 for _ in reader.messages())
        assert reader.fault is not None
        assert 'damaged: 1 chunk is left out with messages: ' in reader.fault
        assert 140 < num_read < 180


def test_a_damaged_bag_as_a_sequence_gives_what_is_on_both_sides(bag: Path) -> None:
    damage(bag)
    sequence = open_sequence(bag)
    assert sequence.fault is not None
    assert 'left out' in sequence.fault
    stamps_ns = [frame.stamp_ns for frame in sequence]
    assert 40 < len(stamps_ns) == len(sequence) < 60
    assert max(np.diff(stamps_ns)) > 300_000_000
    assert stamps_ns[-1] - stamps_ns[0] > 1_900_000_000


def test_damage_at_the_start_is_not_taken_for_another_kind_of_bag(bag: Path) -> None:
    file = bag / 'bag.mcap'
    data = bytearray(file.read_bytes())
    data[50_000] ^= 1
    file.write_bytes(data)
    assert len(open_sequence(bag)) == 52  # a chunk holds eight


def test_damage_of_all_images_is_reported(bag: Path) -> None:
    file = bag / 'bag.mcap'
    data = bytearray(file.read_bytes())
    for at in range(50_000, len(data) - 100_000, 50_000):
        data[at] ^= 1
    file.write_bytes(data)
    with pytest.raises(InputError, match='damaged: 8 chunks are left out with messages: 60 of'):
        open_sequence(bag)


def test_a_cut_bag_with_a_damaged_chunk_gives_the_rest(bag: Path) -> None:
    file = bag / 'bag.mcap'
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data[: len(data) * 9 // 10])
    with BagReader(bag) as reader:
        num_read = sum(1 for _ in reader.messages())
        fault = reader.fault or ''
    assert num_read == (6 - 1) * 24  # messages of a chunk
    assert re.search(r'cut off after 120 .*; damaged: 1 chunk .* 8 of /depth/image, ', fault)


def test_a_damaged_index_costs_no_message(bag: Path) -> None:
    whole = read_messages(bag)
    file = bag / 'bag.mcap'
    data = bytearray(file.read_bytes())
    data[-28] ^= 1  # place of the index, in the footer
    file.write_bytes(data)
    with BagReader(bag) as reader:
        assert list(reader.messages()) == whole
        assert 'the index is damaged' in (reader.fault or '')


@pytest.mark.parametrize('chunked', [True, False])
@pytest.mark.parametrize('indexed', [True, False])
def test_other_layouts_of_mcap_files_are_read(
    bag: Path, tmp_path: Path, chunked: bool, indexed: bool
) -> None:
    whole = read_messages(bag)
    path = tmp_path / 'other.mcap'
    with path.open('wb') as file:
        kinds = IndexType.ALL if indexed else IndexType.NONE
        writer = McapWriter(
            file, compression=CompressionType.NONE, use_chunking=chunked, index_types=kinds
        )
        writer.start('ros2')
        channels = {}
        with BagReader(bag) as reader:
            for topic in reader.topics:
                schema = writer.register_schema(topic.type_name, 'ros2msg', b'')
                channels[topic.name] = writer.register_channel(topic.name, 'cdr', schema)
        for message in whole:
            writer.add_message(
                channels[message.topic], message.log_ns, message.data, message.log_ns
            )
        writer.finish()  # type: ignore[no-untyped-call]
    with BagReader(path) as reader:
        assert list(reader.messages()) == whole
        assert reader.fault is None
        assert sum(topic.num_messages for topic in reader.topics) == len(whole)


def test_zeros_after_a_power_cut_are_not_counted(bag: Path) -> None:
    file = bag / 'bag.mcap'
    data = file.read_bytes()
    file.write_bytes(data[: len(data) // 2])
    cut = summarize(bag)
    with file.open('ab') as more:
        more.truncate(10_000_000_000)
    assert summarize(bag).topics == cut.topics


def test_a_chunk_of_zeros_is_refused() -> None:
    with pytest.raises(ReaderError, match='zeros where a record should be'):
        list(split_records(bytes(MAX_CHUNK_BYTES)))


def test_a_chunk_that_unpacks_to_more_than_any_is_refused() -> None:
    with pytest.raises(ReaderError, match='a chunk claims'):
        unpack(b'', '', MAX_CHUNK_BYTES + 1, 0)
    bomb = zstd.compress(bytes(100_000_000))
    tracemalloc.start()
    with pytest.raises(ReaderError, match='unpacks to another size'):
        unpack(bomb, 'zstd', 1000, 0)
    assert tracemalloc.get_traced_memory()[1] < 10_000_000
    tracemalloc.stop()


def test_a_pipe_is_no_bag(bag: Path) -> None:
    (bag / 'bag.mcap').unlink()
    os.mkfifo(bag / 'bag.mcap')
    with pytest.raises(InputError, match=r'bag\.mcap: not a regular file'):
        summarize(bag)
    with pytest.raises(InputError, match='not a regular file'):
        summarize(bag / 'bag.mcap')


@pytest.mark.parametrize('loop', [False, True])
def test_a_damaged_bag_is_played_before_the_error(bag: Path, loop: bool) -> None:
    file = bag / 'bag.mcap'
    data = bytearray(file.read_bytes())
    data[len(data) // 4] ^= 1  # where opening does not look
    file.write_bytes(data)
    plan = open_plan(bag, PlayConfig())
    messages = plan.messages(loop=loop)
    played = [next(messages) for _ in range(180 - 24)]
    assert [message.time_ns for message in played] == sorted(message.time_ns for message in played)
    with pytest.raises(InputError, match='damaged: 1 chunk is left out'):
        next(messages)


def test_the_summary_of_a_damaged_bag_has_the_fault(bag: Path) -> None:
    damage(bag)
    summary = summarize(bag)
    assert summary.num_messages == 180  # by the index
    assert summary.fault is not None
    assert 'damaged' in summary.fault


def test_no_bag(tmp_path: Path) -> None:
    with pytest.raises(InputError, match='no such bag'):
        summarize(tmp_path / 'nothing')
    with pytest.raises(InputError, match='not a bag'):
        summarize(tmp_path)
    (tmp_path / 'x.db3').write_bytes(b'no database')
    with pytest.raises(InputError, match='cannot be read'):
        summarize(tmp_path / 'x.db3')


def test_links_in_a_bag_that_lead_nowhere_count_nothing(bag: Path) -> None:
    size = summarize(bag).size_bytes
    (bag / 'loop').symlink_to('loop')
    assert summarize(bag).size_bytes == size
