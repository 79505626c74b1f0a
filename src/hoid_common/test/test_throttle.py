from hoid_common.throttle import Backoff


def times_said(backoff: Backoff, kind: str, from_s: int, to_s: int) -> list[int]:
    return [t for t in range(from_s, to_s) if backoff.due([kind], float(t))]


def test_what_stands_is_said_ever_more_seldom() -> None:
    said = times_said(Backoff(5.0, 300.0), 'no images', 0, 1600)
    assert said == [0, 5, 15, 35, 75, 155, 315, 615, 915, 1215, 1515]


def test_what_comes_back_is_said_at_once_and_each_kind_by_itself() -> None:
    backoff = Backoff(5.0, 300.0)
    assert times_said(backoff, 'a', 0, 100) == [0, 5, 15, 35, 75]
    assert backoff.due([], 100.0) == []
    assert times_said(backoff, 'a', 101, 110) == [101, 106]
    assert backoff.due(['a', 'b'], 110.0) == ['b']
    assert backoff.due(['a', 'b'], 115.0) == ['b']
    assert backoff.due(['a', 'b'], 116.0) == ['a']


def test_what_comes_and_goes_is_not_said_each_time() -> None:
    backoff = Backoff(5.0, 300.0)
    said = [t for t in range(30) if backoff.due(['a'] if t % 2 else [], float(t))]
    assert said == [1, 7, 13, 19, 25]
