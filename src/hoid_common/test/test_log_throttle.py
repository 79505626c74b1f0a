from hoid_common.log_throttle import Backoff


def report_times(backoff: Backoff, kind: str, from_s: int, to_s: int) -> list[int]:
    return [t for t in range(from_s, to_s) if backoff.due([kind], float(t))]


def test_a_lasting_problem_is_reported_at_doubling_intervals() -> None:
    times = report_times(Backoff(5.0, 300.0), 'no images', 0, 1600)
    assert times == [0, 5, 15, 35, 75, 155, 315, 615, 915, 1215, 1515]


def test_a_returning_problem_is_reported_at_once_and_independently() -> None:
    backoff = Backoff(5.0, 300.0)
    assert report_times(backoff, 'a', 0, 100) == [0, 5, 15, 35, 75]
    assert backoff.due([], 100.0) == []
    assert report_times(backoff, 'a', 101, 110) == [101, 106]
    assert backoff.due(['a', 'b'], 110.0) == ['b']
    assert backoff.due(['a', 'b'], 115.0) == ['b']
    assert backoff.due(['a', 'b'], 116.0) == ['a']


def test_an_intermittent_problem_is_not_reported_each_time() -> None:
    backoff = Backoff(5.0, 300.0)
    times = [t for t in range(30) if backoff.due(['a'] if t % 2 else [], float(t))]
    assert times == [1, 7, 13, 19, 25]
