"""A bag with changed bytes: it is read as it was written, reported as damaged, or refused."""

from __future__ import annotations

import shutil
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hoid_bags.bag.info import summarize
from hoid_bags.sequence import open_sequence
from hoid_common.errors import InputError

pytestmark = pytest.mark.slow

PLACES = st.floats(0.0, 1.0, exclude_max=True)
CHANGES = st.lists(st.tuples(PLACES, st.binary(min_size=1, max_size=9)), max_size=3)


@settings(max_examples=40, suppress_health_check=[HealthCheck.too_slow])
@given(
    name=st.sampled_from(['bag.mcap', 'metadata.yaml']),
    changes=CHANGES,
    kept=st.just(1.0) | PLACES,
)
def test_what_a_damaged_bag_gives_is_what_was_written(
    whole_bag: Path, name: str, changes: list[tuple[float, bytes]], kept: float
) -> None:
    written = {frame.stamp_ns: frame for frame in open_sequence(whole_bag)}
    with TemporaryDirectory() as folder:
        bag = shutil.copytree(whole_bag, Path(folder) / 'bag')
        data = bytearray((bag / name).read_bytes())
        for place, new in changes:
            at = int(place * len(data))
            data[at : at + len(new)] = new
        (bag / name).write_bytes(data[: round(kept * len(data))])
        with suppress(InputError):
            summarize(bag)
        with suppress(InputError):
            sequence = open_sequence(bag)
            frames = list(sequence)
            for frame in frames:
                np.testing.assert_array_equal(frame.depth_m, written[frame.stamp_ns].depth_m)
                np.testing.assert_array_equal(frame.image_bgr, written[frame.stamp_ns].image_bgr)
            assert len(frames) == len(written) or sequence.fault
