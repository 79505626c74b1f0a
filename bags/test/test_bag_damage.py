"""Bags that are cut off, damaged or none: what can be read is, and the fault is said."""

from __future__ import annotations

from collections import deque
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from hoid_bags.bag.bag_reader import BagReader
from hoid_bags.bag.info import summarize
from hoid_bags.live.playback import PlayConfig, open_plan
from hoid_bags.sequence import open_sequence
from hoid_common.errors import InputError
from hoid_common.values import CameraModel


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


def test_a_bag_with_senseless_metadata_says_so(bag: Path) -> None:
    (bag / 'metadata.yaml').write_text('- hello')
    sequence = open_sequence(bag)
    assert sequence.fault is not None
    assert 'read without metadata.yaml' in sequence.fault
    assert len(list(sequence)) == 60


def damage(bag: Path) -> None:
    """Overwrite a whole chunk; the index stays."""
    file = bag / 'bag.mcap'
    data = bytearray(file.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 300_000] = bytes(300_000)
    file.write_bytes(data)


def test_one_damaged_chunk(bag: Path) -> None:
    damage(bag)
    with BagReader(bag) as reader:
        num_read = sum(1 for _ in reader.messages())
        assert 0 < num_read < 180
        assert reader.fault is not None
        assert f'{bag}: damaged after {num_read} messages (' in reader.fault
        assert '\n' not in reader.fault


def test_a_damaged_bag_as_a_sequence_says_so(bag: Path) -> None:
    damage(bag)
    sequence = open_sequence(bag)
    assert sequence.fault is not None
    assert 'damaged after' in sequence.fault
    assert 0 < len(list(sequence)) == len(sequence) < 60


@pytest.mark.parametrize('loop', [False, True])
def test_a_damaged_bag_is_played_as_far_as_it_goes_and_then_said(bag: Path, loop: bool) -> None:
    damage(bag)
    score = open_plan(bag, PlayConfig())
    cues = score.cues(loop=loop)
    first = [next(cues) for _ in range(60)]
    assert [cue.time_ns for cue in first] == sorted(cue.time_ns for cue in first)
    with pytest.raises(InputError, match=r'damaged after \d+ messages'):
        deque(islice(cues, 180), maxlen=0)
    with pytest.raises(StopIteration):
        next(cues)


def test_the_summary_of_a_damaged_bag_says_so(bag: Path) -> None:
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
