from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hoid_bags.tum.association import MAX_PAIR_GAP_NS, associate, pair_images
from hoid_common.errors import InputError
from hoid_common.values import NS_PER_S

STAMPS = st.lists(st.integers(0, 60), max_size=12, unique=True).map(sorted)


def reference(first: list[int], second: list[int], max_gap: int) -> list[tuple[int, int]]:
    """Return the pairs by the rule of the TUM benchmark, implemented as plainly as possible."""
    close = sorted(
        (abs(a - b), i, j)
        for i, a in enumerate(first)
        for j, b in enumerate(second)
        if abs(a - b) < max_gap
    )
    used_i: set[int] = set()
    used_j: set[int] = set()
    pairs = []
    for _, i, j in close:
        if i not in used_i and j not in used_j:
            used_i.add(i)
            used_j.add(j)
            pairs.append((i, j))
    return sorted(pairs)


@given(STAMPS, STAMPS, st.integers(1, 20))
def test_agrees_with_the_plain_rule(first: list[int], second: list[int], max_gap: int) -> None:
    pairs = associate(np.array(first, np.int64), np.array(second, np.int64), max_gap)
    assert [tuple(pair) for pair in pairs.tolist()] == reference(first, second, max_gap)


def test_closest_first_and_the_limit_is_exclusive() -> None:
    first = np.array([0, 10, 40])
    second = np.array([8, 11, 60])
    assert associate(first, second, 20).tolist() == [[0, 0], [1, 1]]


def test_stamps_that_no_camera_gives_are_refused_before_they_fill_memory() -> None:
    stamps_ns = np.arange(100_000)
    with pytest.raises(InputError, match='x: stamps lie too close to each other'):
        associate(stamps_ns, stamps_ns, source='x')


def test_color_images_without_depth_are_counted(caplog: pytest.LogCaptureFixture) -> None:
    """Color and depth of two free-running cameras, of 2.2 and 6.8 Hz."""
    color_ns, depth_ns = (
        np.arange(count) * NS_PER_S * 10 // tenths + NS_PER_S
        for count, tenths in ((44, 22), (136, 68))
    )
    pairs = pair_images(color_ns, depth_ns, MAX_PAIR_GAP_NS, 0, 'walk')
    assert 0 < len(pairs) < 20
    assert caplog.messages[-1] == (
        f'walk: {44 - len(pairs)} of 44 color images, at 2.2 Hz, have no depth image within 20 ms '
        'and are left out; depth comes at 6.8 Hz'
    )
    caplog.clear()
    pair_images(color_ns, color_ns, MAX_PAIR_GAP_NS, 0, 'walk')
    assert not caplog.messages


@pytest.mark.parametrize('kinds', [('color',), ('depth',), ('color', 'depth')])
def test_streams_without_stamps_are_refused(kinds: tuple[str, ...]) -> None:
    stamps_ns = {kind: np.arange(5) * 10**8 + 1 for kind in ('color', 'depth')}
    stamps_ns |= {kind: np.zeros(5, np.int64) for kind in kinds}
    with pytest.raises(InputError, match=f'walk: the {kinds[0]} images have no stamps'):
        pair_images(stamps_ns['color'], stamps_ns['depth'], MAX_PAIR_GAP_NS, 0, 'walk')
