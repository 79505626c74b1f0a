"""Playback without ROS: schedule, clock, reading ahead and lockstep."""

from __future__ import annotations

import os
import pty
import struct
import sys
import threading
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from hoid_bags.bag import bag_messages
from hoid_bags.bag.bag_sequence import BagSequence
from hoid_bags.bag.bag_writer import BagWriter
from hoid_bags.bag.stamps import header_stamp_ns, shift_header_stamp
from hoid_bags.live.keyboard import KeyPresses
from hoid_bags.live.lockstep import LockstepGate
from hoid_bags.live.playback import (
    LOOP_GAP_NS,
    Pacer,
    PlayConfig,
    ScheduledMessage,
    open_plan,
)
from hoid_bags.live.read_ahead import ReadAhead
from hoid_bags.storage import bag_types
from hoid_common.errors import ConfigError, InputError
from hoid_common.values import NS_PER_S, CameraModel

START_NS = 1_305_031_102_175_304_123 - 5_000_001
PERIOD_NS = 33_333_333


def message(time_ns: int = 0, data: bytes = b'', topic: str = '/t') -> ScheduledMessage:
    return ScheduledMessage(topic, time_ns, 0, data)


def test_everything_is_played_in_order(whole_bag: Path) -> None:
    plan = open_plan(whole_bag, PlayConfig())
    messages = list(plan.messages(loop=False))
    assert len(messages) == 180
    assert [c.time_ns for c in messages] == sorted(c.time_ns for c in messages)
    assert messages[0].time_ns == START_NS
    assert all(header_stamp_ns(c.data) == c.time_ns for c in messages)


def test_a_part_is_played(whole_bag: Path) -> None:
    config = PlayConfig(start_s=0.5, duration_s=0.25)
    plan = open_plan(whole_bag, config, ('rgb/image', '/rgb/camera_info'))
    messages = list(plan.messages(loop=False))
    assert {c.topic for c in messages} == {'/rgb/image', '/rgb/camera_info'}
    first_ns = START_NS + 5_000_001
    assert [(c.time_ns - first_ns) // PERIOD_NS for c in messages[::2]] == list(range(16, 23))


def test_rounds_follow_each_other_with_rising_stamps(whole_bag: Path) -> None:
    plan = open_plan(whole_bag, PlayConfig(loop=True, duration_s=0.2))
    messages = list(islice(plan.messages(loop=True), 100))
    once = list(plan.messages(loop=False))
    times_ns = [c.time_ns for c in messages]
    assert times_ns == sorted(times_ns)
    assert all(header_stamp_ns(c.data) == c.time_ns for c in messages)
    n = len(once)
    assert messages[:n] == once
    assert messages[n].time_ns - messages[0].time_ns == 200_000_000 + LOOP_GAP_NS
    assert messages[n].data[12:] == once[0].data[12:]


@pytest.mark.parametrize(
    ('config', 'topics', 'expected'),
    [
        (PlayConfig(start_s=100.0), (), '--start 100 s lies after its end'),
        (PlayConfig(), ('/nothing',), 'has no topic "/nothing"'),
    ],
)
def test_nothing_to_play(
    whole_bag: Path, config: PlayConfig, topics: tuple[str, ...], expected: str
) -> None:
    with pytest.raises(InputError, match=expected):
        open_plan(whole_bag, config, topics)


def test_a_cut_bag_is_played_to_the_cut(bag: Path) -> None:
    file = bag / 'bag.mcap'
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    plan = open_plan(bag, PlayConfig())
    assert plan.fault is not None
    assert 50 < len(list(plan.messages(loop=False))) < 100


@pytest.mark.parametrize('rate', [0.0, -1.0, float('nan')])
def test_rates_that_make_no_sense(rate: float) -> None:
    with pytest.raises(ConfigError, match='rate must be in'):
        PlayConfig(rate=rate)


@pytest.mark.parametrize('order', ['<', '>'])
def test_shifted_stamp_of_either_byte_order(order: str) -> None:
    start = bytes([0, order == '<', 0, 0])
    data = start + struct.pack(f'{order}iI', 10, 999_999_999) + b'rest'
    moved = shift_header_stamp(data, 2)
    assert moved == start + struct.pack(f'{order}iI', 11, 1) + b'rest'


def test_pacer_keeps_the_rate_and_can_be_held() -> None:
    now_s = [100.0]
    pacer = Pacer(5_000_000_000, rate=2.0, now_s=lambda: now_s[0])
    assert pacer.remaining_s(6_000_000_000) == 0.5
    now_s[0] = 100.25
    assert pacer.time_ns() == 5_500_000_000
    pacer.hold()
    now_s[0] = 110.0
    pacer.hold()
    assert pacer.time_ns() == 5_500_000_000
    pacer.release()
    now_s[0] = 110.25
    pacer.release()
    assert pacer.remaining_s(6_000_000_000) == 0.0
    now_s[0] = 111.0
    assert pacer.remaining_s(6_000_000_000) == -0.75


def test_read_ahead_gives_all_in_order() -> None:
    messages = [message(i, bytes(i)) for i in range(200)]
    with ReadAhead(iter(messages), limit_bytes=500) as ahead:
        assert list(ahead) == messages


def test_read_ahead_is_bounded_and_ends_when_nobody_reads() -> None:
    given = []
    full = threading.Event()

    def endless() -> Iterator[ScheduledMessage]:
        while True:
            given.append(1)
            if len(given) == 11:
                full.set()
            yield message(data=bytes(100))

    with ReadAhead(endless(), limit_bytes=1000) as ahead:
        next(iter(ahead))
        assert full.wait(5)
    assert len(given) <= 12


def test_read_ahead_of_small_messages_is_bounded_by_time() -> None:
    """A topic with few bytes that is repeated without end would never fill the buffer."""
    given: list[int] = []

    def endless() -> Iterator[ScheduledMessage]:
        while True:
            given.append(1)
            yield message(len(given) * NS_PER_S, b'few bytes')

    with ReadAhead(endless(), rate=0.5) as ahead:
        assert next(iter(ahead)).time_ns == NS_PER_S
    assert len(given) <= 8  # 5 s of the bag, the one that was taken and one that waits


def test_read_ahead_hands_errors_on() -> None:
    def failing() -> Iterator[ScheduledMessage]:
        yield message(1)
        raise InputError('damaged')

    seen: list[ScheduledMessage] = []
    with pytest.raises(InputError, match='damaged'), ReadAhead(failing()) as ahead:
        seen.extend(ahead)
    assert seen == [message(1)]


@pytest.fixture
def uneven(tmp_path: Path) -> Path:
    """Write color at 1, 100, 200 and 300 ms; depth comes first at 1 and 300, and lacks at 200."""
    with BagWriter(tmp_path / 'bag') as writer:
        writer.add_topic('rgb/image', bag_types.IMAGE)
        writer.add_topic('depth/image', bag_types.IMAGE)
        images = [(0, 'd'), (1, 'c'), (100, 'c'), (103, 'd'), (200, 'c'), (298, 'd'), (300, 'c')]
        for ms, kind in images:
            t_ns = 10**9 + ms * 10**6
            shape, dtype = ((24, 32, 3), np.uint8) if kind == 'c' else ((24, 32), np.uint16)
            message = bag_messages.image(
                t_ns, np.zeros(shape, dtype), 'bgr8' if kind == 'c' else '16UC1'
            )
            writer.write('rgb/image' if kind == 'c' else 'depth/image', t_ns, message)
    return tmp_path / 'bag'


def test_a_frame_waits_for_the_answer_to_the_one_before(uneven: Path, camera: CameraModel) -> None:
    gate = LockstepGate(BagSequence(uneven, camera))
    messages = list(open_plan(uneven, PlayConfig()).messages(loop=False))
    answers_ms = {2: 1, 6: 100}  # before which message, to which color image
    for i, c in enumerate(messages):
        assert gate.blocks(c) == (i in answers_ms)
        if i in answers_ms:
            stamp_ns = 10**9 + answers_ms[i] * 10**6
            gate.note_answer(stamp_ns - 1)  # to an older image
            assert gate.blocks(c)
            gate.note_answer(stamp_ns)
            assert not gate.blocks(c)
        gate.note_published(c)
    assert (gate.num_answered, gate.num_unanswered) == (2, 0)


def test_giving_up_lets_the_next_frame_pass(uneven: Path, camera: CameraModel) -> None:
    gate = LockstepGate(BagSequence(uneven, camera))
    messages = list(open_plan(uneven, PlayConfig()).messages(loop=False))
    gate.note_published(messages[0])
    gate.note_published(messages[1])
    assert gate.blocks(messages[2])
    gate.give_up()
    assert not gate.blocks(messages[2])
    assert (gate.num_answered, gate.num_unanswered) == (0, 1)


def test_lockstep_in_a_later_round(uneven: Path, camera: CameraModel) -> None:
    gate = LockstepGate(BagSequence(uneven, camera))
    messages = list(islice(open_plan(uneven, PlayConfig()).messages(loop=True), 10))
    gate.note_published(messages[7])
    gate.note_published(messages[8])
    assert gate.blocks(messages[9])
    gate.note_answer(header_stamp_ns(messages[8].data))
    assert not gate.blocks(messages[9])


def test_keys_of_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    ours, theirs = pty.openpty()
    with os.fdopen(theirs, 'r', buffering=1) as terminal, KeyPresses() as none:
        assert none.read() == ''
        monkeypatch.setattr(sys, 'stdin', terminal)
        with KeyPresses() as keys:
            assert keys.read() == ''
            os.write(ours, b' ')
            assert keys.read() == ' '
            assert keys.read() == ''
    os.close(ours)
