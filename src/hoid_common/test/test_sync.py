from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from hoid_common.sync import Match, StampMatcher

MS = 1_000_000
PERIOD = 33 * MS


def feed(matcher: StampMatcher, *events: tuple[str, int]) -> list[tuple[Any, ...]]:
    """Give items whose value is their stamp in ms; return the values of all matches."""
    return [
        match.values
        for name, stamp_ms in events
        for match in matcher.add(name, stamp_ms * MS, stamp_ms)
    ]


def two(**options: object) -> StampMatcher:
    return StampMatcher(('colour', 'depth'), slop_ns=20 * MS, **options)  # type: ignore[arg-type]


def test_equal_stamps_match_at_once() -> None:
    assert feed(two(), ('colour', 100), ('depth', 100)) == [(100, 100)]
    assert feed(two(), ('depth', 100), ('colour', 100)) == [(100, 100)]


def test_a_match_carries_the_reference_stamp() -> None:
    matcher = two()
    matcher.add('depth', 5 * MS, 'd')
    assert matcher.add('colour', 4 * MS, 'c') == [Match(4 * MS, ('c', 'd'))]


def test_the_nearest_is_taken_not_the_first() -> None:
    # Depth at 81 is 19 ms away, depth at 114 is 14 ms away.
    events = [('depth', 48), ('depth', 81), ('colour', 100), ('depth', 114)]
    assert feed(two(), *events) == [(100, 114)]


def test_no_waiting_when_no_nearer_one_can_come() -> None:
    # At a spacing of 33 ms the next depth comes at 123, further away than 90.
    assert feed(two(), ('depth', 57), ('depth', 90), ('colour', 100)) == [(100, 90)]


def test_waiting_ends_when_the_other_stream_falls_silent() -> None:
    events = [('depth', 50), ('depth', 83), ('colour', 100), ('colour', 133)]
    assert feed(two(), *events) == [(100, 83)]


def test_beyond_the_slop_nothing_matches() -> None:
    matcher = two()
    events = [('colour', 100), ('depth', 130), ('colour', 133), ('depth', 163)]
    assert feed(matcher, *events) == [(133, 130)]
    assert matcher.counts['colour'].unmatched == 1
    assert matcher.counts['colour'].matched == 1


def test_passed_over_items_are_counted() -> None:
    matcher = two()
    assert feed(matcher, ('depth', 10), ('depth', 43), ('depth', 100), ('colour', 100)) == [
        (100, 100)
    ]
    assert matcher.counts['depth'].unmatched == 2


def test_full_queues_drop_the_oldest() -> None:
    matcher = two(capacity=2)
    feed(matcher, ('colour', 100), ('colour', 133), ('colour', 166))
    assert matcher.counts['colour'].overflowed == 1
    assert feed(matcher, ('depth', 133)) == [(133, 133)]


def test_late_items_are_counted_not_used() -> None:
    matcher = two()
    feed(matcher, ('colour', 100), ('colour', 90))
    assert matcher.counts['colour'].late == 1


def test_time_may_start_anew() -> None:
    matcher = two()
    assert feed(matcher, ('colour', 5000), ('depth', 5000)) == [(5000, 5000)]
    assert feed(matcher, ('colour', 100), ('depth', 100)) == [(100, 100)]


def three() -> StampMatcher:
    return StampMatcher(
        ('colour', 'depth', 'boxes'), 20 * MS, optional=('boxes',), patience_ns=100 * MS
    )


def test_optional_streams_are_waited_for() -> None:
    assert feed(three(), ('colour', 100), ('depth', 100)) == []
    events = [('colour', 100), ('depth', 100), ('boxes', 100)]
    assert feed(three(), *events) == [(100, 100, 100)]


def test_optional_streams_are_left_out_when_they_skip_an_instant() -> None:
    events = [('colour', 100), ('depth', 100), ('boxes', 133)]
    assert feed(three(), *events) == [(100, 100, None)]


def test_optional_streams_are_left_out_when_patience_ends() -> None:
    events = [(name, stamp) for stamp in (100, 133, 166, 199) for name in ('colour', 'depth')]
    assert feed(three(), *events) == []
    matcher = three()
    feed(matcher, *events)
    assert feed(matcher, ('colour', 232)) == [(100, 100, None)]


@given(
    st.lists(st.integers(0, 25), max_size=25, unique=True),
    st.lists(st.integers(0, 25), max_size=25, unique=True),
    st.integers(0, 16),
)
def test_each_item_is_used_once_in_order_and_within_the_slop(
    colour: list[int], depth: list[int], offset_ms: int
) -> None:
    matcher = two(capacity=30)
    events = [('colour', 33 * i) for i in colour] + [('depth', 33 * i + offset_ms) for i in depth]
    matches = feed(matcher, *sorted(events, key=lambda event: event[1]))
    assert [c for c, _ in matches] == sorted({c for c, _ in matches})
    assert [d for _, d in matches] == sorted({d for _, d in matches})
    assert all(abs(c - d) <= 20 for c, d in matches)


@given(st.permutations(range(8)), st.integers(0, 10))
def test_every_pair_is_found_whichever_stream_is_ahead(order: list[int], offset_ms: int) -> None:
    matcher = two(capacity=20)
    ahead = [('colour', 33 * i) for i in range(8)]
    behind = [('depth', 33 * i + offset_ms) for i in range(8)]
    merged = sorted(
        [
            *((i, e) for i, e in enumerate(ahead)),
            *((i + order[0], e) for i, e in enumerate(behind)),
        ],
        key=lambda pair: pair[0],
    )
    matches = feed(matcher, *(event for _, event in merged), ('depth', 33 * 8 + offset_ms))
    assert matches == [(33 * i, 33 * i + offset_ms) for i in range(8)]
