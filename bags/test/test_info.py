"""Bandwidths in the summary of a bag."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hoid_bags.bag.bag_reader import BagReader
from hoid_bags.bag.info import describe, summarize


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
