from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from hoid_common.sync import Match, Rate, StampMatcher

MS = 1_000_000
PERIOD = 33 * MS


def feed(matcher: StampMatcher, *events: tuple[str, int]) -> list[tuple[Any, ...]]:
    """Add items whose value is their stamp in ms; return the values of all matches."""
    return [
        match.values
        for name, stamp_ms in events
        for match in matcher.add(name, stamp_ms * MS, stamp_ms)
    ]


def two(**options: object) -> StampMatcher:
    return StampMatcher(('color', 'depth'), slop_ns=20 * MS, **options)  # type: ignore[arg-type]


def test_equal_stamps_match_at_once() -> None:
    assert feed(two(), ('color', 100), ('depth', 100)) == [(100, 100)]
    assert feed(two(), ('depth', 100), ('color', 100)) == [(100, 100)]


def test_a_match_carries_the_reference_stamp() -> None:
    matcher = two()
    matcher.add('depth', 5 * MS, 'd')
    assert matcher.add('color', 4 * MS, 'c') == [Match(4 * MS, ('c', 'd'))]


def test_the_nearest_item_matches_not_the_first() -> None:
    # Depth at 81 is 19 ms away, depth at 114 is 14 ms away.
    events = [('depth', 48), ('depth', 81), ('color', 100), ('depth', 114)]
    assert feed(two(), *events) == [(100, 114)]


def test_a_match_is_complete_when_no_nearer_item_can_arrive() -> None:
    # At a spacing of 33 ms the next depth comes at 123, which is further away than 90.
    assert feed(two(), ('depth', 57), ('depth', 90), ('color', 100)) == [(100, 90)]


def test_waiting_ends_when_the_other_stream_is_silent() -> None:
    events = [('depth', 50), ('depth', 83), ('color', 100), ('color', 133)]
    assert feed(two(), *events) == [(100, 83)]


def test_beyond_the_slop_nothing_matches() -> None:
    matcher = two()
    events = [('color', 100), ('depth', 130), ('color', 133), ('depth', 163)]
    assert feed(matcher, *events) == [(133, 130)]
    assert matcher.counts['color'].unmatched == 1
    assert matcher.counts['color'].matched == 1


def test_unmatched_items_are_counted() -> None:
    matcher = two()
    assert feed(matcher, ('depth', 10), ('depth', 43), ('depth', 100), ('color', 100)) == [
        (100, 100)
    ]
    assert matcher.counts['depth'].unmatched == 2


def test_full_queues_drop_the_oldest() -> None:
    matcher = two(capacity=2)
    feed(matcher, ('color', 100), ('color', 133), ('color', 166))
    assert matcher.counts['color'].overflowed == 1
    assert feed(matcher, ('depth', 133)) == [(133, 133)]


def test_late_items_are_counted_and_dropped() -> None:
    matcher = two()
    feed(matcher, ('color', 100), ('color', 90))
    assert matcher.counts['color'].late == 1


def test_a_restarted_clock_resets_the_streams() -> None:
    matcher = two()
    assert feed(matcher, ('color', 5000), ('depth', 5000)) == [(5000, 5000)]
    assert feed(matcher, ('color', 100), ('depth', 100)) == [(100, 100)]


def test_a_gap_is_not_reported_after_the_streams_were_reset() -> None:
    matcher = two()
    for n in range(20):
        feed(matcher, ('color', 5000 + 100 * n), ('depth', 5040 + 100 * n))
    assert '+40.0 ms' in matcher.gap
    feed(matcher, ('color', 100))  # another recording
    assert matcher.gap == ''


def three() -> StampMatcher:
    return StampMatcher(
        ('color', 'depth', 'boxes'), 20 * MS, optional=('boxes',), patience_ns=100 * MS
    )


def test_optional_streams_are_waited_for() -> None:
    assert feed(three(), ('color', 100), ('depth', 100)) == []
    events = [('color', 100), ('depth', 100), ('boxes', 100)]
    assert feed(three(), *events) == [(100, 100, 100)]


def test_a_match_has_no_value_when_an_optional_stream_skips_it() -> None:
    events = [('color', 100), ('depth', 100), ('boxes', 133)]
    assert feed(three(), *events) == [(100, 100, None)]


def test_a_match_has_no_value_after_the_longest_wait() -> None:
    events = [(name, stamp) for stamp in (100, 133, 166, 199) for name in ('color', 'depth')]
    assert feed(three(), *events) == []
    matcher = three()
    feed(matcher, *events)
    assert feed(matcher, ('color', 232)) == [(100, 100, None)]


@given(
    st.lists(st.integers(0, 25), max_size=25, unique=True),
    st.lists(st.integers(0, 25), max_size=25, unique=True),
    st.integers(0, 16),
)
def test_each_item_is_used_once_in_order_and_within_the_slop(
    color: list[int], depth: list[int], offset_ms: int
) -> None:
    matcher = two(capacity=30)
    events = [('color', 33 * i) for i in color] + [('depth', 33 * i + offset_ms) for i in depth]
    matches = feed(matcher, *sorted(events, key=lambda event: event[1]))
    assert [c for c, _ in matches] == sorted({c for c, _ in matches})
    assert [d for _, d in matches] == sorted({d for _, d in matches})
    assert all(abs(c - d) <= 20 for c, d in matches)


@given(st.permutations(range(8)), st.integers(0, 10))
def test_every_pair_is_found_whichever_stream_is_ahead(order: list[int], offset_ms: int) -> None:
    matcher = two(capacity=20)
    ahead = [('color', 33 * i) for i in range(8)]
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


def test_streams_that_never_match_say_how_far_they_are_apart() -> None:
    matcher = two()
    for i in range(20):
        assert feed(matcher, ('color', 100 * i), ('depth', 100 * i + 25)) == []
    assert matcher.mismatch == (
        'the stamps of depth are +25.0 ms from those of color (limit 20): raise sync_slop_s to '
        '0.030, or set --depth-offset 0.0250 (input.depth_offset_s of live nodes), if they belong '
        'together'
    )
    assert len(feed(matcher, ('color', 5000), ('depth', 5000))) == 1
    assert matcher.mismatch == ''


def test_two_clocks_are_named() -> None:
    for offset_ms in (-1_305_031_000_000, 1_305_031_000_000):
        matcher = two()
        for i in range(40):
            color_ms = 2_000_000_000_000 + 33 * i
            assert feed(matcher, ('color', color_ms), ('depth', color_ms + offset_ms)) == []
        assert 's from those of color, so two clocks were used' in matcher.mismatch


def test_a_missing_partner_now_and_then_is_no_mismatch() -> None:
    matcher = two()
    for i in range(60):
        feed(matcher, ('color', 33 * i), *([('depth', 33 * i)] if i % 3 else []))
    assert matcher.mismatch == ''


def taken(rate: Rate, stamps_ns: list[int]) -> list[int]:
    return [stamp_ns for stamp_ns in stamps_ns if rate.take_due(stamp_ns)]


def test_the_mean_rate_does_not_depend_on_the_frame_rate() -> None:
    stamps = [i * 33_333_333 for i in range(300)]
    assert len(taken(Rate(10.0), stamps)) == 100
    assert len(taken(Rate(7.0), stamps)) == 71  # both ends of 10 s count
    assert len(taken(Rate(60.0), stamps)) == 300


def test_a_rate_continues_after_a_gap_and_after_time_has_started_anew() -> None:
    rate = Rate(10.0)
    assert taken(rate, [0, 10**10, 10**10 + 10**8]) == [0, 10**10, 10**10 + 10**8]
    assert taken(rate, [5, 10, 10**8 + 5]) == [5, 10**8 + 5]


def test_a_rate_of_0_takes_every_stamp() -> None:
    assert taken(Rate(0.0), [7, 7, 6, 5]) == [7, 7, 6, 5]
