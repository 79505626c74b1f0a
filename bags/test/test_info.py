"""Rates and bandwidths in the summary of a bag."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hoid_bags.bag.bag_reader import BagReader
from hoid_bags.bag.bag_writer import BagWriter
from hoid_bags.bag.info import describe, summarize
from hoid_bags.storage import bag_types
from hoid_bags.storage.qos_profiles import recorded_qos


def test_the_bandwidth_of_a_topic(bag: Path) -> None:
    summary = summarize(bag, sizes=True)
    color = next(t for t in summary.topics if t.name == '/rgb/image')
    with BagReader(bag) as reader:
        sizes = [len(m.data) for m in reader.messages(['/rgb/image'])]
    assert color.size_bytes == sum(sizes)
    assert color.bytes_per_s == pytest.approx(np.mean(sizes) * color.rate_hz)
    assert f'{np.mean(sizes) * color.rate_hz / 1e6:.3f} MB/s' in describe(summary)
    assert summarize(bag).topics[0].bytes_per_s is None
    assert 'MB/s' not in describe(summarize(bag))


def test_old_messages_of_a_latched_topic_have_no_rate_of_kilohertz(tmp_path: Path) -> None:
    path = tmp_path / 'bag'
    second_ns = 10**9
    with BagWriter(path) as writer:
        writer.add_topic('grid_map', bag_types.CAMERA_INFO, recorded_qos(latched=True))
        writer.add_topic('odom', bag_types.CAMERA_INFO)
        for k in range(5):  # received at once when the recorder subscribed
            writer.write_serialized('grid_map', second_ns + 70_000 * k, b'\0\1\0\0')
        for k in range(11):
            writer.write_serialized('odom', second_ns + k * second_ns // 5, b'\0\1\0\0')
    rates_hz = {topic.name: topic.rate_hz for topic in summarize(path).topics}
    assert rates_hz == {'/grid_map': pytest.approx(2.0), '/odom': pytest.approx(5.0)}
